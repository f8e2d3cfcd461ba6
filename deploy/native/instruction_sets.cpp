#include "instruction_sets.h"

#if defined(__x86_64__) && !defined(GV_BASELINE_ONLY)
#include <cpuid.h>
#endif

namespace gv {

#if defined(__x86_64__) && !defined(GV_BASELINE_ONLY)

extern const Kernels kernels_sse4, kernels_avx2, kernels_avx512;

namespace {
// __builtin_cpu_supports asks the compiler's runtime library, which not every linker brings: with
// Zig's it says no to everything. So the processor is asked itself (Intel's manual, volume 1,
// chapters 14.3 and 15.2): what it has, and which registers the system keeps for a process.
struct Processor {
  uint32_t basic_c = 0, more_b = 0;
  uint64_t kept = 0;

  Processor() {
    uint32_t a, b, c, d;
    if (__get_cpuid(1, &a, &b, &c, &d)) basic_c = c;
    if (__get_cpuid_count(7, 0, &a, &b, &c, &d)) more_b = b;
    if (basic_c & 1u << 27) {  // OSXSAVE: xgetbv may be used
      asm volatile("xgetbv" : "=a"(a), "=d"(d) : "c"(0));
      kept = (uint64_t)d << 32 | a;
    }
#if defined(__APPLE__)  // keeps the registers of AVX-512 from a process's first use of them
    if ((kept & 6) == 6) kept |= 0xe0;
#endif
  }
  bool keeps(uint64_t registers) const { return (kept & registers) == registers; }
  bool has(uint32_t bits) const { return (more_b & bits) == bits; }
};

const Processor& processor() {
  static const Processor one;
  return one;
}

// Each with all that setup.py lets the compiler use.
bool supports_sse4() { return processor().basic_c & 1u << 19; }
bool supports_avx2() {
  const uint32_t AVX = 1u << 28, FMA = 1u << 12, AVX2 = 1u << 5, BMI = 1u << 3, BMI2 = 1u << 8;
  return (processor().basic_c & (AVX | FMA)) == (AVX | FMA) &&
         processor().has(AVX2 | BMI | BMI2) && processor().keeps(0x06);
}
bool supports_avx512() {
  const uint32_t F = 1u << 16, DQ = 1u << 17, BW = 1u << 30, VL = 1u << 31;
  return supports_avx2() && processor().has(F | DQ | BW | VL) && processor().keeps(0xe6);
}
}  // namespace

const InstructionSet INSTRUCTION_SETS[] = {
    {"sse4", &kernels_sse4, supports_sse4},
    {"avx2", &kernels_avx2, supports_avx2},
    {"avx512", &kernels_avx512, supports_avx512},
};

#else

extern const Kernels kernels_baseline;

const InstructionSet INSTRUCTION_SETS[] = {
    {"baseline", &kernels_baseline, [] { return true; }},
};

#endif

const int INSTRUCTION_SET_COUNT = sizeof INSTRUCTION_SETS / sizeof INSTRUCTION_SETS[0];

}  // namespace gv
