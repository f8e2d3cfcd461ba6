// Vectors of the widest kind the compiler's flags allow.
//
// Written with the vector extensions of GCC and Clang, so that one source serves AVX-512, AVX2, SSE
// and NEON; intrinsics stand only where the extension has no word (minimum, reciprocal, sign mask),
// each with a portable twin.
//
// This file and all -inl.h files are compiled once per instruction set, in the namespace
// gv::GV_NAMESPACE, by kernels.cpp alone. A file that is included twice there is empty the second
// time; nothing of it may be included anywhere else.
#pragma once
#include <stdint.h>

#if defined(GV_FORCE_LANES)  // tests the wide code on a narrow machine
#define GV_LANES GV_FORCE_LANES
#elif defined(__AVX512F__)
#define GV_LANES 16
#elif defined(__AVX2__)
#define GV_LANES 8
#else
#define GV_LANES 4
#endif
#if defined(__SSE4_1__)
#if !defined(__clang__)  // GCC 12 warns of its own header (bug 105593)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wmaybe-uninitialized"
#endif
#include <immintrin.h>
#if !defined(__clang__)
#pragma GCC diagnostic pop
#endif
#elif defined(__ARM_NEON)
#include <arm_neon.h>
#endif
#define GV_INLINE static inline __attribute__((always_inline))
// where copies in every template would only cost compile time
#define GV_NOINLINE __attribute__((noinline))

namespace gv::GV_NAMESPACE {

constexpr int LANES = GV_LANES;
constexpr int PARTS = 16 / LANES;  // vectors of sixteen pixels

typedef float V __attribute__((vector_size(4 * GV_LANES)));
typedef int32_t I __attribute__((vector_size(4 * GV_LANES)));
typedef uint32_t U __attribute__((vector_size(4 * GV_LANES)));

GV_INLINE V splat(float x) { return V{} + x; }
// A mask has all bits of a lane set or none, as comparisons leave them.
GV_INLINE V select(I mask, V yes, V no) { return mask ? yes : no; }
GV_INLINE V keep(I mask, V x) { return (V)((I)x & mask); }
GV_INLINE V drop(I mask, V x) { return (V)((I)x & ~mask); }
// All bits where x is below zero (or -0). A comparison would say the same, but on Zen 4 it takes a
// port that multiplies.
GV_INLINE I negative(V x) { return (I)x >> 31; }
GV_INLINE V load(const float* p) {
  V x;
  __builtin_memcpy(&x, p, sizeof x);
  return x;
}
GV_INLINE void store(float* p, V x) { __builtin_memcpy(p, &x, sizeof x); }

// any_positive: a lane of 0 may count or not.
#if GV_LANES == 16 && defined(__AVX512F__)
GV_INLINE V minimum(V a, V b) { return (V)_mm512_min_ps((__m512)a, (__m512)b); }
GV_INLINE V reciprocal_estimate(V x) { return (V)_mm512_rcp14_ps((__m512)x); }
GV_INLINE bool any_positive(V x) {
  return _mm512_cmp_ps_mask((__m512)x, _mm512_setzero_ps(), _CMP_GT_OQ) != 0;
}
#define GV_HAS_ESTIMATE 1
#elif GV_LANES == 8 && defined(__AVX2__)
GV_INLINE V minimum(V a, V b) { return (V)_mm256_min_ps((__m256)a, (__m256)b); }
GV_INLINE V reciprocal_estimate(V x) { return (V)_mm256_rcp_ps((__m256)x); }
GV_INLINE bool any_positive(V x) { return _mm256_movemask_ps((__m256)x) != 255; }
#define GV_HAS_ESTIMATE 1
#elif GV_LANES == 4 && defined(__SSE4_1__)
GV_INLINE V minimum(V a, V b) { return (V)_mm_min_ps((__m128)a, (__m128)b); }
GV_INLINE V reciprocal_estimate(V x) { return (V)_mm_rcp_ps((__m128)x); }
GV_INLINE bool any_positive(V x) { return _mm_movemask_ps((__m128)x) != 15; }
#define GV_HAS_ESTIMATE 1
#else
GV_INLINE V minimum(V a, V b) { return a < b ? a : b; }
GV_INLINE bool any_positive(V x) {
  I positive = x > 0.f;
  int32_t any = 0;
  for (int i = 0; i < LANES; i++) any |= positive[i];
  return any != 0;
}
#define GV_HAS_ESTIMATE 0
#endif

// Bit j of the result: the lowest bit of words[j]. n: a multiple of LANES, at most 64.
GV_INLINE uint64_t lowest_bits(const uint32_t* words, int n) {
  uint64_t bits = 0;
  for (int j = 0; j < n; j += LANES) {
    U lanes;
    __builtin_memcpy(&lanes, words + j, sizeof lanes);
    lanes <<= 31;
#if GV_LANES == 16 && defined(__AVX512F__)
    uint64_t some = _mm512_movepi32_mask((__m512i)lanes);
#elif GV_LANES == 8 && defined(__AVX2__)
    uint64_t some = (uint32_t)_mm256_movemask_ps((__m256)lanes);
#elif GV_LANES == 4 && defined(__SSE4_1__)
    uint64_t some = (uint32_t)_mm_movemask_ps((__m128)lanes);
#else
    uint64_t some = 0;
    for (int i = 0; i < LANES; i++) some |= (uint64_t)(lanes[i] >> 31) << i;
#endif
    bits |= some << j;
  }
  return bits;
}

// 1/x to float32 accuracy. The estimate has 12 bits or more, one Newton step doubles them; a
// division costs more.
GV_INLINE V reciprocal(V x) {
#if GV_HAS_ESTIMATE
  V r = reciprocal_estimate(x);
  return r + r * (1.f - x * r);
#else
  return 1.f / x;
#endif
}

// Whole and part: x is whole(t) + f with f in [-1/2, 1/2] where t = rounded(x), and y 2^whole(t) is
// scaled(y, t).
#if GV_LANES == 16 && defined(__AVX512F__)
GV_INLINE V rounded(V x) { return (V)_mm512_roundscale_ps((__m512)x, 8); }
GV_INLINE V whole(V t) { return t; }
GV_INLINE V scaled(V y, V t) { return (V)_mm512_scalef_ps((__m512)y, (__m512)t); }
#else
// 1.5 * 2^23: added, it leaves the nearest integer in the lowest bits.
constexpr float ROUND = 12582912.f;
GV_INLINE V rounded(V x) { return x + ROUND; }
GV_INLINE V whole(V t) { return t - ROUND; }
// The integer in the lowest bits of t is added to the exponent of y, which begins at bit 23.
GV_INLINE V scaled(V y, V t) { return (V)((U)y + ((U)t << 23)); }
#endif

// 2^x / 255 for x in [0, 100]: a polynomial, minimax in relative error (1.6e-7 of degree 5, 7.5e-5
// of degree 3 with FAST), for what rounding leaves. Below 0 is rubbish that the caller masks.
// N values go step by step together: one alone is a chain of dependent operations, and a
// processor's window is too short to find the next one behind it.
template <bool FAST, int N>
GV_INLINE void power(const V (&x)[N], V (&p)[N]) {
  V t[N], f[N];
#define GV_STEP(to, expression) \
  for (int i = 0; i < N; i++) to[i] = expression
  GV_STEP(t, rounded(x[i]));
  GV_STEP(f, x[i] - whole(t[i]));
  if (FAST) {
    GV_STEP(p, f[i] * 0.0002163594877f + 0.0009514162015f);
    GV_STEP(p, p[i] * f[i] + 0.002718670534f);
    GV_STEP(p, p[i] * f[i] + 0.003921286561f);
  } else {
    GV_STEP(p, f[i] * 5.20645962e-06f + 3.794329992e-05f);
    GV_STEP(p, p[i] * f[i] + 0.0002176750304f);
    GV_STEP(p, p[i] * f[i] + 0.0009420439106f);
    GV_STEP(p, p[i] * f[i] + 0.0027182234f);
    GV_STEP(p, p[i] * f[i] + 0.003921568908f);
  }
  GV_STEP(p, scaled(p[i], t[i]));
#undef GV_STEP
}

// Four floats, on every machine.
typedef float Four __attribute__((vector_size(16)));
typedef int32_t FourInts __attribute__((vector_size(16)));
GV_INLINE Four load4(const float* p) {
  Four x;
  __builtin_memcpy(&x, p, sizeof x);
  return x;
}
GV_INLINE void store4(float* p, Four x) { __builtin_memcpy(p, &x, sizeof x); }
#if defined(__clang__)
#define GV_SHUFFLE4(a, b, ...) __builtin_shufflevector(a, b, __VA_ARGS__)
#else
#define GV_SHUFFLE4(a, b, ...) __builtin_shuffle(a, b, FourInts{__VA_ARGS__})
#endif

// ---- transposition of LANES x LANES floats -----------------------------------------------------
//
// GV_SHUFFLE(a, b, i...): lane by lane the i-th of a, or the (i - LANES)-th of b. The indices are
// made at compile time, from Lanes<0, 1, ..., LANES - 1>.

template <int... N>
struct Lanes {};
template <int N, int... Rest>
struct MakeLanes : MakeLanes<N - 1, N - 1, Rest...> {};
template <int... Rest>
struct MakeLanes<0, Rest...> {
  typedef Lanes<Rest...> type;
};
#if defined(__clang__)
#define GV_SHUFFLE(a, b, ...) __builtin_shufflevector(a, b, __VA_ARGS__)
#else
#define GV_SHUFFLE(a, b, ...) __builtin_shuffle(a, b, I{__VA_ARGS__})
#endif
// Of lane l in each group of four: a0 b0 a1 b1 (or with `high` a2 b2 a3 b3),
constexpr int interleave(int l, int high) {
  return (l & ~3) + ((l & 3) >> 1) + 2 * high + (l & 1) * LANES;
}
// a0 a1 b0 b1 (a2 a3 b2 b3),
constexpr int pair_up(int l, int high) {
  return (l & ~3) + (l & 1) + 2 * high + ((l & 2) ? LANES : 0);
}
// and, s lanes being a group, the even groups of a and b by turns (the odd ones).
constexpr int exchange(int l, int s, int high) {
  return (l & s) == (high ? s : 0) ? (high ? LANES + l : l) : (high ? l + s : LANES + l - s);
}
template <int HIGH, int... N>
GV_INLINE V interleave_v(V a, V b, Lanes<N...>) {
  return GV_SHUFFLE(a, b, interleave(N, HIGH)...);
}
template <int HIGH, int... N>
GV_INLINE V pair_up_v(V a, V b, Lanes<N...>) {
  return GV_SHUFFLE(a, b, pair_up(N, HIGH)...);
}
template <int S, int HIGH, int... N>
GV_INLINE V exchange_v(V a, V b, Lanes<N...>) {
  return GV_SHUFFLE(a, b, exchange(N, S, HIGH)...);
}
// Groups of S lanes and S rows change places across the diagonal.
template <int S>
GV_INLINE void exchange_rows(V* m) {
  for (int i = 0; i < LANES; i++)
    if (!(i & S)) {
      V a = m[i], b = m[i + S];
      m[i] = exchange_v<S, 0>(a, b, typename MakeLanes<LANES>::type{});
      m[i + S] = exchange_v<S, 1>(a, b, typename MakeLanes<LANES>::type{});
    }
}

// m[row][column] becomes m[column][row]. Two steps inside groups of four lanes, then whole groups
// change places.
GV_INLINE void transpose(V* m) {
  typename MakeLanes<LANES>::type lanes;
  for (int i = 0; i < LANES; i += 4) {
    V a = interleave_v<0>(m[i], m[i + 1], lanes);
    V b = interleave_v<1>(m[i], m[i + 1], lanes);
    V c = interleave_v<0>(m[i + 2], m[i + 3], lanes);
    V d = interleave_v<1>(m[i + 2], m[i + 3], lanes);
    m[i] = pair_up_v<0>(a, c, lanes);
    m[i + 1] = pair_up_v<1>(a, c, lanes);
    m[i + 2] = pair_up_v<0>(b, d, lanes);
    m[i + 3] = pair_up_v<1>(b, d, lanes);
  }
#if GV_LANES > 4
  exchange_rows<4>(m);
#endif
#if GV_LANES > 8
  exchange_rows<8>(m);
#endif
}

}  // namespace gv::GV_NAMESPACE
