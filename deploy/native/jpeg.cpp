// JPEG files (ITU T.81): baseline, 4:4:4, with the tables of its annex K. Every line of blocks is
// coded by itself, a marker between them, so that the threads share the lines.
#include <algorithm>
#include <cmath>
#include <cstring>
#include <vector>

#include "engine.h"

namespace {

constexpr int32_t MOST_PIXELS = 65535;  // of a side
constexpr double PI = 3.14159265358979323846;
// Bytes: before the first line; of a block at most, each followed by a zero; of a line beyond its
// blocks, which is filled up and followed by a marker.
constexpr int64_t HEADER = 629, BLOCK = 2 * ((22 + 63 * 26 + 7) / 8), LINE = 4;

// Steps of quantization at quality 50, natural order: luminance, colour.
const uint8_t STEPS[2][64] = {
    {16, 11, 10, 16, 24,  40,  51,  61,  12, 12, 14, 19, 26,  58,  60,  55,
     14, 13, 16, 24, 40,  57,  69,  56,  14, 17, 22, 29, 51,  87,  80,  62,
     18, 22, 37, 56, 68,  109, 103, 77,  24, 35, 55, 64, 81,  104, 113, 92,
     49, 64, 78, 87, 103, 121, 120, 101, 72, 92, 95, 98, 112, 100, 103, 99},
    {17, 18, 24, 47, 99, 99, 99, 99, 18, 21, 26, 66, 99, 99, 99, 99, 24, 26, 56, 99, 99, 99,
     99, 99, 47, 66, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99,
     99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99}};
const uint8_t ZIGZAG[64] = {0,  1,  8,  16, 9,  2,  3,  10, 17, 24, 32, 25, 18, 11, 4,  5,
                            12, 19, 26, 33, 40, 48, 41, 34, 27, 20, 13, 6,  7,  14, 21, 28,
                            35, 42, 49, 56, 57, 50, 43, 36, 29, 22, 15, 23, 30, 37, 44, 51,
                            58, 59, 52, 45, 38, 31, 39, 46, 53, 60, 61, 54, 47, 55, 62, 63};

// A Huffman table as the file has it: how many symbols have codes of 1 to 16 bits, and the symbols.
struct Table {
  uint8_t counts[16];
  std::vector<uint8_t> symbols;
};

// Symbols of runs and sizes that stand one after another in the tables' tails.
std::vector<uint8_t> with_tail(std::vector<uint8_t> symbols, const std::vector<uint8_t>& firsts) {
  for (uint8_t first : firsts)
    for (uint8_t symbol = first; (symbol & 15) <= 10; symbol++) symbols.push_back(symbol);
  return symbols;
}

const Table FIRST[2] = {
    {{0, 1, 5, 1, 1, 1, 1, 1, 1}, {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11}},
    {{0, 3, 1, 1, 1, 1, 1, 1, 1, 1, 1}, {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11}},
};
const Table REST[2] = {
    {{0, 2, 1, 3, 3, 2, 4, 3, 5, 5, 4, 4, 0, 0, 1, 125},
     with_tail({0x01, 0x02, 0x03, 0x00, 0x04, 0x11, 0x05, 0x12, 0x21, 0x31, 0x41, 0x06, 0x13,
                0x51, 0x61, 0x07, 0x22, 0x71, 0x14, 0x32, 0x81, 0x91, 0xa1, 0x08, 0x23, 0x42,
                0xb1, 0xc1, 0x15, 0x52, 0xd1, 0xf0, 0x24, 0x33, 0x62, 0x72, 0x82},
               {0x09, 0x16, 0x25, 0x34, 0x43, 0x53, 0x63, 0x73, 0x83, 0x92, 0xa2, 0xb2, 0xc2,
                0xd2, 0xe1, 0xf1})},
    {{0, 2, 1, 2, 4, 4, 3, 4, 7, 5, 4, 4, 0, 1, 2, 119},
     with_tail({0x00, 0x01, 0x02, 0x03, 0x11, 0x04, 0x05, 0x21, 0x31, 0x06, 0x12, 0x41,
                0x51, 0x07, 0x61, 0x71, 0x13, 0x22, 0x32, 0x81, 0x08, 0x14, 0x42, 0x91,
                0xa1, 0xb1, 0xc1, 0x09, 0x23, 0x33, 0x52, 0xf0, 0x15, 0x62, 0x72, 0xd1,
                0x0a, 0x16, 0x24, 0x34, 0xe1, 0x25, 0xf1},
               {0x17, 0x26, 0x35, 0x43, 0x53, 0x63, 0x73, 0x82, 0x92, 0xa2, 0xb2, 0xc2, 0xd2,
                0xe2, 0xf2})},
};

// Codes of a table, by symbol.
void fill_codes(const Table& table, gv::JpegCode* codes) {
  uint32_t code = 0;
  size_t next = 0;
  for (int length = 1; length <= 16; length++, code <<= 1)
    for (int i = 0; i < table.counts[length - 1]; i++)
      codes[table.symbols[next++]] = {(uint16_t)code++, (uint16_t)length};
}

// The step of a coefficient at a quality, as the Independent JPEG Group counts it.
int step_at(int which, int place, int32_t quality) {
  const int percent = quality < 50 ? 5000 / quality : 200 - 2 * quality;
  return std::min(std::max((STEPS[which][place] * percent + 50) / 100, 1), 255);
}

// What a coefficient of the kernel's DCT is divided by, beside its step.
double dct_scale(int frequency) {
  return frequency ? std::cos(frequency * PI / 16) * std::sqrt(2.0) : 1.0;
}

gv::JpegImage job_of(int32_t height, int32_t width, const uint8_t* pixels, int32_t quality) {
  gv::JpegImage job{};
  job.pixels = pixels;
  job.height = height;
  job.width = width;
  for (int which = 0; which < 2; which++) {
    fill_codes(FIRST[which], job.codes[which].first);
    fill_codes(REST[which], job.codes[which].rest);
    for (int k = 0; k < 64; k++) {
      const int place = ZIGZAG[k];
      const double scale = 8 * dct_scale(place / 8) * dct_scale(place % 8);
      job.factors[which][k] = (float)(1 / (scale * step_at(which, place, quality)));
    }
  }
  return job;
}

// Bytes one after another, and segments with their lengths.
struct Writer {
  uint8_t* to;
  void bytes(std::initializer_list<int> values) {
    for (int value : values) *to++ = (uint8_t)value;
  }
  void segment(int marker, size_t length) {  // `length`: of what follows
    bytes({0xff, marker, (int)(length + 2) >> 8, (int)(length + 2) & 255});
  }
  void table(int kind, const Table& table) {
    segment(0xc4, 17 + table.symbols.size());
    bytes({kind});
    to = std::copy_n(table.counts, 16, to);
    to = std::copy(table.symbols.begin(), table.symbols.end(), to);
  }
};

uint8_t* write_header(int32_t height, int32_t width, int32_t quality, uint8_t* to) {
  Writer out{to};
  out.bytes({0xff, 0xd8});
  out.segment(0xe0, 14);  // JFIF 1.1, square pixels
  out.bytes({'J', 'F', 'I', 'F', 0, 1, 1, 0, 0, 1, 0, 1, 0, 0});
  for (int which = 0; which < 2; which++) {
    out.segment(0xdb, 65);
    out.bytes({which});
    for (int k = 0; k < 64; k++) out.bytes({step_at(which, ZIGZAG[k], quality)});
  }
  out.segment(0xc0, 15);
  out.bytes({8, height >> 8, height & 255, width >> 8, width & 255, 3});
  for (int c = 0; c < 3; c++) out.bytes({c + 1, 0x11, c > 0});
  for (int which = 0; which < 2; which++) {
    out.table(which, FIRST[which]);
    out.table(0x10 | which, REST[which]);
  }
  const int32_t blocks = (width + 7) / 8;
  out.segment(0xdd, 2);  // blocks between two markers
  out.bytes({blocks >> 8, blocks & 255});
  out.segment(0xda, 10);
  out.bytes({3, 1, 0, 2, 0x11, 3, 0x11, 0, 63, 0});
  return out.to;
}

bool sound(int32_t height, int32_t width) {
  return height >= 1 && width >= 1 && height <= MOST_PIXELS && width <= MOST_PIXELS;
}

int64_t line_bytes(int32_t width) { return 3 * BLOCK * ((width + 7) / 8) + LINE; }

}  // namespace

GV_API int64_t gv_jpeg_most(int32_t height, int32_t width) {
  if (!sound(height, width)) return GV_OUT_OF_RANGE;
  return HEADER + line_bytes(width) * ((height + 7) / 8);
}

GV_API int64_t gv_jpeg(int32_t height, int32_t width, const uint8_t* pixels, int32_t quality,
                       uint8_t* out) {
  if (!sound(height, width) || quality < 1 || quality > 100) return GV_OUT_OF_RANGE;
  int64_t written = 0;
  const int32_t code = gv::guarded([&](gv::Engine& engine) {
    const gv::Kernels& kernels = engine.kernels();
    const gv::JpegImage job = job_of(height, width, pixels, quality);
    const int32_t lines = (height + 7) / 8;
    std::vector<int64_t> length(lines);
    // each line where it lies when all before it are as long as can be: they close up afterwards
    uint8_t* to = write_header(height, width, quality, out);
    auto place = [&, first = to](int32_t line) { return first + line_bytes(width) * line; };
    gv::for_each_task(engine, (uint32_t)lines, [&](uint32_t i, int) {
      length[i] = kernels.jpeg_line(&job, 8 * (int32_t)i, place((int32_t)i)) - place((int32_t)i);
    });
    for (int32_t line = 0; line < lines; line++) {
      std::memmove(to, place(line), length[line]);
      to += length[line];
      *to++ = 0xff;
      *to++ = (uint8_t)(line + 1 < lines ? 0xd0 + line % 8 : 0xd9);
    }
    written = to - out;
    return GV_DONE;
  });
  return code == GV_DONE ? written : code;
}
