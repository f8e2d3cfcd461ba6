// Memory of the engine.
#pragma once
#include <cstddef>
#include <cstring>
#include <new>

namespace gv {

// Aligned for vectors, not initialised. Only grows, and what it held is lost when it does.
template <class T>
class Buffer {
 public:
  Buffer() = default;
  Buffer(const Buffer&) = delete;
  Buffer& operator=(const Buffer&) = delete;
  ~Buffer() { ::operator delete(data_, ALIGNMENT); }

  // Room for n. Throws std::bad_alloc.
  T* reserve(size_t n) {
    if (n > capacity_) {
      ::operator delete(data_, ALIGNMENT);
      data_ = nullptr;
      capacity_ = 0;
      size_t wanted = n + n / 4 + 64;
      data_ = static_cast<T*>(::operator new(wanted * sizeof(T), ALIGNMENT));
      capacity_ = wanted;
    }
    return data_;
  }
  T* reserve_zeroed(size_t n) {  // zero when it grows; whoever writes puts the zeros back
    size_t before = capacity_;
    reserve(n);
    if (capacity_ != before) std::memset(static_cast<void*>(data_), 0, capacity_ * sizeof(T));
    return data_;
  }
  T* data() const { return data_; }
  size_t bytes() const { return capacity_ * sizeof(T); }

 private:
  static constexpr std::align_val_t ALIGNMENT{64};
  T* data_ = nullptr;
  size_t capacity_ = 0;
};

}  // namespace gv
