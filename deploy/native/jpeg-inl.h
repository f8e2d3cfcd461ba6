// A line of blocks of a JPEG image (ITU T.81, baseline), colours at full resolution.
//
// LANES blocks go together: lane b of a vector is of block b, so that nothing within a block has to
// change its place before the coefficients are coded. The DCT is the one of Arai, Agui and Nakajima
// (1988), whose scaling the table of quantization has taken in.
#pragma once
#include <stdint.h>

#include "kernels.h"
#include "simd-inl.h"

namespace gv::GV_NAMESPACE {

constexpr int JPEG_ZIGZAG[64] = {
    0,  1,  8,  16, 9,  2,  3,  10, 17, 24, 32, 25, 18, 11, 4,  5,  12, 19, 26, 33, 40, 48,
    41, 34, 27, 20, 13, 6,  7,  14, 21, 28, 35, 42, 49, 56, 57, 50, 43, 36, 29, 22, 15, 23,
    30, 37, 44, 51, 58, 59, 52, 45, 38, 31, 39, 46, 53, 60, 61, 54, 47, 55, 62, 63};

// Eight values of each lane, STRIDE apart.
template <int STRIDE>
GV_INLINE void jpeg_dct(V* m) {
#define GV_AT(i) m[(i)*STRIDE]
  const V s0 = GV_AT(0) + GV_AT(7), d0 = GV_AT(0) - GV_AT(7);
  const V s1 = GV_AT(1) + GV_AT(6), d1 = GV_AT(1) - GV_AT(6);
  const V s2 = GV_AT(2) + GV_AT(5), d2 = GV_AT(2) - GV_AT(5);
  const V s3 = GV_AT(3) + GV_AT(4), d3 = GV_AT(3) - GV_AT(4);
  const V e0 = s0 + s3, e1 = s1 + s2, e2 = s1 - s2, e3 = s0 - s3;
  const V turned = (e2 + e3) * 0.70710678f;
  GV_AT(0) = e0 + e1;
  GV_AT(4) = e0 - e1;
  GV_AT(2) = e3 + turned;
  GV_AT(6) = e3 - turned;
  const V o0 = d3 + d2, o1 = d2 + d1, o2 = d1 + d0;
  const V z5 = (o0 - o2) * 0.38268343f;
  const V z2 = o0 * 0.54119610f + z5, z4 = o2 * 1.30656296f + z5, z3 = o1 * 0.70710678f;
  const V z11 = d0 + z3, z13 = d0 - z3;
  GV_AT(5) = z13 + z2;
  GV_AT(3) = z13 - z2;
  GV_AT(1) = z11 + z4;
  GV_AT(7) = z11 - z4;
#undef GV_AT
}

struct JpegScratch {
  alignas(64) float samples[3][LANES * 64];        // Y, Cb, Cr around zero, by block
  alignas(64) int32_t coefficients[3][LANES * 64]; // quantized, by block in the zigzag order
  uint64_t nonzero[3][LANES];                      // of coefficients 1 to 63: bit by bit
};

// The samples of LANES blocks from column `x` on. Beyond the image its last row and column go on.
GV_INLINE void jpeg_samples(const JpegImage& image, int32_t x, int32_t y, JpegScratch& s) {
  constexpr int ACROSS = 8 * LANES;
  uint8_t line[3 * ACROSS];
  float plane[3][ACROSS];
  const int32_t inside = image.width - x < ACROSS ? image.width - x : ACROSS;
  for (int row = 0; row < 8; row++) {
    const int32_t from = y + row < image.height ? y + row : image.height - 1;
    const uint8_t* pixel = image.pixels + 3 * ((int64_t)from * image.width + x);
    if (inside < ACROSS) {
      __builtin_memcpy(line, pixel, 3 * inside);
      for (int i = 3 * inside; i < 3 * ACROSS; i++) line[i] = line[i - 3];
      pixel = line;
    }
    for (int i = 0; i < ACROSS; i++) {
      const float r = pixel[3 * i], g = pixel[3 * i + 1], b = pixel[3 * i + 2];
      plane[0][i] = 0.299f * r + 0.587f * g + 0.114f * b - 128.f;
      plane[1][i] = -0.168735892f * r - 0.331264108f * g + 0.5f * b;
      plane[2][i] = 0.5f * r - 0.418687589f * g - 0.081312411f * b;
    }
    for (int c = 0; c < 3; c++)
      for (int block = 0; block < LANES; block++)
        __builtin_memcpy(s.samples[c] + 64 * block + 8 * row, plane[c] + 8 * block, 32);
  }
}

// Of one colour: `factor` of each coefficient in the zigzag order.
GV_INLINE void jpeg_coefficients(const float* samples, const float* factor, int32_t* coefficients,
                                 uint64_t* nonzero) {
  constexpr float ROUND_UP = 12582912.f;  // 1.5 * 2^23 leaves the nearest integer in the low bits
  constexpr float MOST = 1023.f;          // of a baseline coefficient
  V m[64], z[64];
  for (int j = 0; j < 64; j += LANES) {
    for (int b = 0; b < LANES; b++) m[j + b] = load(samples + 64 * b + j);
    transpose(m + j);
  }
  for (int row = 0; row < 8; row++) jpeg_dct<1>(m + 8 * row);
  for (int column = 0; column < 8; column++) jpeg_dct<8>(m + column);
  U some[2] = {};
  for (int k = 0; k < 64; k++) {
    V x = minimum(m[JPEG_ZIGZAG[k]] * factor[k], splat(MOST));
    x = -minimum(-x, splat(MOST));
    const I whole = (I)(x + ROUND_UP) - (I)splat(ROUND_UP);
    some[k >> 5] |= (U)(whole != 0) & (1u << (k & 31));
    z[k] = (V)whole;
  }
  for (int j = 0; j < 64; j += LANES) {
    transpose(z + j);
    for (int b = 0; b < LANES; b++)
      __builtin_memcpy(coefficients + 64 * b + j, &z[j + b], sizeof(V));
  }
  for (int b = 0; b < LANES; b++) nonzero[b] = ((uint64_t)some[1][b] << 32 | some[0][b]) & ~1ull;
}

// Bits that go out from the highest on.
struct JpegBits {
  uint64_t held = 0;
  int32_t count = 0;  // below 32 between calls
  uint8_t* to;
};

// A byte of ones would begin a marker: a zero says that it does not.
GV_INLINE void jpeg_byte(JpegBits& bits, uint8_t value) {
  *bits.to++ = value;
  if (value == 0xff) *bits.to++ = 0;
}

// length: at most 32.
GV_INLINE void jpeg_put(JpegBits& bits, uint32_t code, int32_t length) {
  bits.held = bits.held << length | code;
  bits.count += length;
  if (bits.count < 32) return;
  bits.count -= 32;
  const uint32_t word = (uint32_t)(bits.held >> bits.count);
  if ((~word - 0x01010101u) & word & 0x80808080u) {  // one of its bytes is all ones
    for (int shift = 24; shift >= 0; shift -= 8) jpeg_byte(bits, (uint8_t)(word >> shift));
    return;
  }
  for (int i = 0; i < 4; i++) bits.to[i] = (uint8_t)(word >> (24 - 8 * i));
  bits.to += 4;
}

// A code, and the bits of `value` after it: as they are above zero, less one below.
GV_INLINE void jpeg_put_value(JpegBits& bits, JpegCode code, int32_t value, int32_t size) {
  const uint32_t low = (uint32_t)(value + (value >> 31)) & ((1u << size) - 1);
  jpeg_put(bits, (uint32_t)code.bits << size | low, code.length + size);
}

GV_INLINE int32_t jpeg_size(int32_t value) {
  const uint32_t absolute = (uint32_t)(value < 0 ? -value : value);
  return absolute ? 32 - __builtin_clz(absolute) : 0;
}

GV_INLINE void jpeg_block(JpegBits& bits, const JpegCodes& codes, const int32_t* coefficients,
                          uint64_t nonzero, int32_t& before) {
  const int32_t difference = coefficients[0] - before, size = jpeg_size(difference);
  before = coefficients[0];
  jpeg_put_value(bits, codes.first[size], difference, size);
  int32_t last = 0;
  for (; nonzero; nonzero &= nonzero - 1) {
    const int32_t k = __builtin_ctzll(nonzero);
    int32_t zeros = k - last - 1;
    for (; zeros > 15; zeros -= 16) jpeg_put(bits, codes.rest[0xf0].bits, codes.rest[0xf0].length);
    const int32_t value = coefficients[k], length = jpeg_size(value);
    jpeg_put_value(bits, codes.rest[zeros << 4 | length], value, length);
    last = k;
  }
  if (last < 63) jpeg_put(bits, codes.rest[0].bits, codes.rest[0].length);
}

// Codes the line of blocks whose first row of pixels is `y` by itself; the end of what it wrote.
static uint8_t* jpeg_line(const JpegImage* image, int32_t y, uint8_t* to) {
  JpegScratch scratch;
  JpegBits bits;
  bits.to = to;
  int32_t before[3] = {};
  for (int32_t x = 0; x < image->width; x += 8 * LANES) {
    jpeg_samples(*image, x, y, scratch);
    for (int c = 0; c < 3; c++)
      jpeg_coefficients(scratch.samples[c], image->factors[c > 0], scratch.coefficients[c],
                        scratch.nonzero[c]);
    const int32_t blocks = (image->width - x + 7) / 8 < LANES ? (image->width - x + 7) / 8 : LANES;
    for (int32_t b = 0; b < blocks; b++)
      for (int c = 0; c < 3; c++)
        jpeg_block(bits, image->codes[c > 0], scratch.coefficients[c] + 64 * b,
                   scratch.nonzero[c][b], before[c]);
  }
  jpeg_put(bits, 0x7f, 7);  // ones up to the next whole byte
  while (bits.count >= 8) {
    bits.count -= 8;
    jpeg_byte(bits, (uint8_t)(bits.held >> bits.count));
  }
  return bits.to;
}

}  // namespace gv::GV_NAMESPACE
