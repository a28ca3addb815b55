// What the kernel of vision_patches_bytes.cu is made of: instructions, weights of columns and rows, pixels.
#pragma once

#include "contrib/vision_patches.cuh"
#include "core/row_vectors.cuh"

namespace kv::contrib::cuda {
namespace {

constexpr int kChunk = 32;  // rows of the image that are resized at once, and of the result

// --- instructions ----------------------------------------------------------------------------------------------------

// Adds the product of 16 x 16 weights and 16 x 8 levels, of two 16-bit floats a register.
__device__ __forceinline__ void multiply(float (&sums)[4], uint4 a, uint32_t b0, uint32_t b1) {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 800
  asm("mma.sync.aligned.m16n8k16.row.col.f32.f16.f16.f32 {%0, %1, %2, %3}, {%4, %5, %6, %7}, {%8, %9}, {%0, %1, %2, "
      "%3};"
      : "+f"(sums[0]), "+f"(sums[1]), "+f"(sums[2]), "+f"(sums[3])
      : "r"(a.x), "r"(a.y), "r"(a.z), "r"(a.w), "r"(b0), "r"(b1));
#endif
}
// The product of 16 x 8 and 8 x 8, plus a number or what the product is added to.
__device__ __forceinline__ void multiply(float (&sums)[4], uint32_t a0, uint32_t a1, uint32_t b, float4 plus) {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 800
  asm("mma.sync.aligned.m16n8k8.row.col.f32.f16.f16.f32 {%0, %1, %2, %3}, {%4, %5}, {%6}, {%7, %8, %9, %10};"
      : "=f"(sums[0]), "=f"(sums[1]), "=f"(sums[2]), "=f"(sums[3])
      : "r"(a0), "r"(a1), "r"(b), "f"(plus.x), "f"(plus.y), "f"(plus.z), "f"(plus.w));
#endif
}
// A pair of 16-bit floats, the first one in the low bits.
__device__ __forceinline__ uint32_t half_pair(float low, float high) {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ < 800
  return round_to_half(low).bits | uint32_t(round_to_half(high).bits) << 16;
#else
  uint32_t both;
  asm("cvt.rn.f16x2.f32 %0, %1, %2;" : "=r"(both) : "f"(high), "f"(low));
  return both;
#endif
}
__device__ __forceinline__ uint32_t positive_half_pair(float low, float high) {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ < 800
  return half_pair(fmaxf(low, 0), fmaxf(high, 0));
#else
  uint32_t both;
  asm("cvt.rn.relu.f16x2.f32 %0, %1, %2;" : "=r"(both) : "f"(high), "f"(low));
  return both;
#endif
}
// Of pairs of 16-bit floats, a * b + c, 0 instead of less.
__device__ __forceinline__ uint32_t positive_fma(uint32_t a, uint32_t b, uint32_t c) {
  uint32_t both = 0;
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 800
  asm("fma.rn.relu.f16x2 %0, %1, %2, %3;" : "=r"(both) : "r"(a), "r"(b), "r"(c));
#endif
  return both;
}
__device__ __forceinline__ Vector<float, 2> rounded_pair(float a, float b, float) { return {a, b}; }
__device__ __forceinline__ uint32_t rounded_pair(float a, float b, BFloat16) {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ < 800
  return to_bfloat16(a).bits | uint32_t(to_bfloat16(b).bits) << 16;
#else
  uint32_t both;
  asm("cvt.rn.bf16x2.f32 %0, %1, %2;" : "=r"(both) : "f"(b), "f"(a));
  return both;
#endif
}

// Shared memory by 32-bit addresses: from pointers, nvcc finds where it begins again in every loop.
__device__ __forceinline__ uint4 load_shared(uint32_t from) {
  uint4 v;
  asm volatile("ld.shared.v4.u32 {%0, %1, %2, %3}, [%4];"
               : "=r"(v.x), "=r"(v.y), "=r"(v.z), "=r"(v.w)
               : "r"(from)
               : "memory");
  return v;
}
__device__ __forceinline__ uint2 load_shared(uint32_t from, uint2) {
  uint2 v;
  asm volatile("ld.shared.v2.u32 {%0, %1}, [%2];" : "=r"(v.x), "=r"(v.y) : "r"(from) : "memory");
  return v;
}
__device__ __forceinline__ uint32_t load_shared(uint32_t from, uint32_t) {
  uint32_t v;
  asm volatile("ld.shared.u32 %0, [%1];" : "=r"(v) : "r"(from) : "memory");
  return v;
}
__device__ __forceinline__ void store_shared(uint32_t to, uint4 v) {
  asm volatile("st.shared.v4.u32 [%0], {%1, %2, %3, %4};" ::"r"(to), "r"(v.x), "r"(v.y), "r"(v.z), "r"(v.w) : "memory");
}
__device__ __forceinline__ void store_shared(uint32_t to, uint32_t v) {
  asm volatile("st.shared.u32 [%0], %1;" ::"r"(to), "r"(v) : "memory");
}
__device__ __forceinline__ void store_shared(uint32_t to, Vector<float, 2> v) {
  asm volatile("st.shared.v2.f32 [%0], {%1, %2};" ::"r"(to), "f"(v.v[0]), "f"(v.v[1]) : "memory");
}
__device__ __forceinline__ void store_shared(uint32_t to, float v) {
  asm volatile("st.shared.f32 [%0], %1;" ::"r"(to), "f"(v) : "memory");
}
__device__ __forceinline__ void store_shared(uint32_t to, BFloat16 v) {
  asm volatile("st.shared.u16 [%0], %1;" ::"r"(to), "h"(v.bits) : "memory");
}
// Global memory, likewise, at an address of a multiple of the size.
__device__ __forceinline__ uint2 load_global(uint64_t from, uint2) {
  uint2 v;
  asm("ld.global.nc.v2.u32 {%0, %1}, [%2];" : "=r"(v.x), "=r"(v.y) : "l"(from));
  return v;
}
__device__ __forceinline__ uint32_t load_global(uint64_t from, uint32_t) {
  uint32_t v;
  asm("ld.global.nc.u32 %0, [%1];" : "=r"(v) : "l"(from));
  return v;
}
__device__ __forceinline__ uint32_t shared_address(void const* p) { return uint32_t(__cvta_generic_to_shared(p)); }
// Copies 16 bytes to shared memory, if `enabled`, while the thread goes on until it waits for all its copies.
__device__ __forceinline__ void start_copy(uint32_t to, uint64_t from, bool enabled) {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 800
  asm volatile("{.reg .pred p; setp.ne.s32 p, %2, 0; @p cp.async.cg.shared.global [%0], [%1], 16;}" ::"r"(to),
               "l"(from), "r"(int(enabled))
               : "memory");
#endif
}
__device__ __forceinline__ void wait_for_copies() {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 800
  asm volatile("cp.async.wait_all;" ::: "memory");
#endif
}
// The same number, of which nvcc knows nothing.
__device__ __forceinline__ uint32_t opaque(uint32_t x) { return __shfl_xor_sync(0xffffffffu, x, 0); }

// --- levels ----------------------------------------------------------------------------------------------------------

// Sums begin with 1 / 1024 of a level: where weights are exact, as those of sizes by 2, ties are frequent, and go up as
// on the CPU.
template <int N>
__device__ __forceinline__ void begin_sums(float (&sums)[N][4]) {
#pragma unroll
  for (auto& of_product : sums)
#pragma unroll
    for (float& sum : of_product) sum = 0x1p-34f;
}
// A pair of levels, as words and as floats in 2^-24, of sums in that unit.
__device__ __forceinline__ uint32_t levels_of(float a, float b) {
  return __vminu2(positive_half_pair(a, b), 0x00ff00ffu);
}
// What such levels lack to 255, in 1 / 512.
__device__ __forceinline__ uint32_t levels_below(float a, float b) {
  constexpr uint32_t kMinus2To15 = 0xf800f800, kMost = 0x37f837f8;
  return positive_fma(positive_half_pair(a, b), kMinus2To15, kMost);
}
// Pairs of four bytes.
__device__ __forceinline__ uint32_t low_pair(uint32_t bytes) { return __byte_perm(bytes, 0, 0x4140); }
__device__ __forceinline__ uint32_t high_pair(uint32_t bytes) { return __byte_perm(bytes, 0, 0x4342); }

// --- weights ---------------------------------------------------------------------------------------------------------

// A bilinear or bicubic filter without branches: polynomials of |x| below 1 and from there to 2.
struct Filter {
  float inner[4], outer[4];
  __device__ __forceinline__ explicit Filter(geometry::ResizeFilter filter)
      : inner{1.5f, -2.5f, 0, 1}, outer{-0.5f, 2.5f, -4, 2} {
    if (filter == geometry::ResizeFilter::bilinear)
      inner[0] = inner[1] = 0, inner[2] = -1, outer[0] = outer[1] = outer[2] = outer[3] = 0;
  }
  __device__ __forceinline__ float operator()(float x) const {
    x = fminf(fabsf(x), 2);
    float y = x < 1 ? inner[0] : outer[0];
#pragma unroll
    for (int i = 1; i < 4; ++i) y = y * x + (x < 1 ? inner[i] : outer[i]);
    return y;
  }
};

__device__ __forceinline__ float as_half(float x) { return read(round_to_half(x)); }
// The tap that is farthest from the center, which is `-start` taps after the first one.
__device__ __forceinline__ int farthest(float start, int count) { return -start > start + count - 1 ? 0 : count - 1; }

// The columns of the image that lane % 4 multiplies in a step: four from here on. `split`: of three steps, the first
// two as of two.
template <int Steps>
__device__ __forceinline__ int column_of(int step, bool split = false) {
  int const t = int(threadIdx.x % 4);
  if (Steps == 3 && split) return step < 2 ? 8 * t + 4 * step : 32 + 4 * t;
  return Steps > 0 ? 4 * (Steps * t + step) : 16 * step + 4 * t;
}

// The weights of two columns of the result for columns of the image from `from` on, by steps: operands of products.
template <int Steps, class F>
__device__ __forceinline__ void find_x_weights(Axis const& axis, int const (&columns)[2], int from, int steps,
                                               bool split, F store) {
  double const scale = axis.scale();
  float const per_unit = float(1 / max(scale, 1.));
  Filter const filter(axis.filter);
  int begin[2], count[2];
  float start[2];
#pragma unroll
  for (int i = 0; i < 2; ++i) {
    double const center = axis.center(columns[i], scale);
    begin[i] = axis.first(center, scale), count[i] = axis.end(center, scale) - begin[i];
    start[i] = float(begin[i] - center), begin[i] -= from;
  }
  auto const weight = [&](int s, int n) {
    int const i = n / 4, k = column_of<Steps>(s, split) + n % 4 - begin[i];
    return unsigned(k) < unsigned(count[i]) ? filter((start[i] + k) * per_unit) : 0.f;
  };
  float kept[Steps > 0 ? Steps : 1][8]{};
  if constexpr (Steps > 0)
#pragma unroll
    for (int s = 0; s < Steps; ++s)
#pragma unroll
      for (int n = 0; n < 8; ++n) kept[s][n] = weight(s, n);
  float factors[] = {1, 1}, rest[] = {0, 0};
  auto const value = [&](int s, int n) {
    int const i = n / 4;
    float const w = factors[i] * (Steps > 0 ? kept[Steps > 0 ? s : 0][n] : weight(s, n));
    bool const has_rest = column_of<Steps>(s, split) + n % 4 - begin[i] == farthest(start[i], count[i]);
    return rest[i] != 0 && has_rest ? as_half(w) + rest[i] : w;
  };
  auto const sum_of = [&](int i, auto f) {
    float sum = 0;
#pragma unroll
    for (int s = 0; s < steps; ++s)
#pragma unroll
      for (int n = 0; n < 4; ++n) sum += f(value(s, 4 * i + n));
    sum += __shfl_xor_sync(0xffffffffu, sum, 1);
    return sum + __shfl_xor_sync(0xffffffffu, sum, 2);
  };
#pragma unroll
  for (int i = 0; i < 2; ++i) {
    factors[i] = __fdividef(1, sum_of(i, [](float w) { return w; }));
    rest[i] = 1 - sum_of(i, [](float w) { return as_half(w); });
  }
#pragma unroll
  for (int s = 0; s < steps; ++s) {
    uint32_t pairs[4];
#pragma unroll
    for (int n = 0; n < 4; ++n) {
      int const at = n % 2 * 4 + n / 2 * 2;
      pairs[n] = half_pair(value(s, at), value(s, at + 1));
    }
    store(s, uint4{pairs[0], pairs[1], pairs[2], pairs[3]});
  }
}

// Rows of the image that a tile reads.
struct TileRows {
  int top, count;
};

// Writes the weights of the `rows` rows of the result from `first_row` on, by chunks of the image, by 16 rows of the
// result and of it, and lane. Rows after the last one are as it is. By a warp, a row each lane.
__device__ __forceinline__ void write_y_weights(Axis const& axis, double scale, float per_unit, int first_row, int rows,
                                                unsigned char* weights, int bytes, TileRows& of_tile) {
  Filter const filter(axis.filter);
  int const lane = int(threadIdx.x % 32);
#pragma unroll 1
  for (int t = 16 * lane; t < bytes; t += 16 * 32) *reinterpret_cast<uint4*>(weights + t) = uint4{};
  __syncwarp();
  double const center = axis.center(first_row + min(lane, rows - 1), scale);
  int const first = axis.first(center, scale), count = axis.end(center, scale) - first;
  int const top = __shfl_sync(0xffffffffu, first, 0);
  if (lane == 31) of_tile = {top, first + count - top};
  float const start = float(first - center);
  auto const weight = [&](int k) { return filter((start + k) * per_unit); };
  float sum = 0, rest = 1;
#pragma unroll 1
  for (int k = 0; k < count; ++k) sum += weight(k);
  float const factor = __fdividef(1, sum);
#pragma unroll 1
  for (int k = 0; k < count; ++k) rest -= as_half(weight(k) * factor);
  unsigned char* const to = weights + lane / 16 * 1024 + lane % 16 / 8 * 4 + lane % 8 * 64;
  int const has_rest = farthest(start, count);
#pragma unroll 1
  for (int k = 0; k < count; ++k) {
    unsigned const i = unsigned(first - top + k);
    float const value = weight(k) * factor;
    *reinterpret_cast<uint16_t*>(to + i / 32 * 2048 + i % 32 / 16 * 512 + i % 16 / 8 * 8 + i % 8 / 2 * 16 + i % 2 * 2) =
        round_to_half(k == has_rest ? as_half(value) + rest : value).bits;
  }
}

// --- pixels ----------------------------------------------------------------------------------------------------------

// How the pixels of an image are loaded: words that all rows of all channels have at the same columns; words that rows
// have at others, shifted; three channels next to each other, of which one is picked; or each byte alone.
enum class Pixels { aligned, shifted, interleaved, apart };

// The columns of the image that a warp reads, from `from` on. Planes: the first two of these only, in fewer registers;
// from shared memory where `Steps` is known.
// Words with a pixel of a row are safe to load as a whole. A lane's rows are 8 apart, so that its vectors of 8 bytes
// are equally aligned in all of them: after the last row, the last one of these is read again.
template <int Steps, bool Planes>
struct Source {
  static constexpr int kWords = Steps > 0 ? Steps : 1;
  static constexpr int kBytes = Steps > 0 ? 8 : 4;     // of an aligned load
  static constexpr int kShifted = Steps == 2 ? 8 : 4;  // of one that is to be shifted
  Pixels pixels;
  int from, last, last_row, step;
  unsigned row_stride;
  bool is_inner;  // pixels after those that are read are in the row, too

  __device__ __forceinline__ Source(PatchImage const& image, int channels, int first, int steps)
      : from(first),
        last(image.width - 1),
        last_row(image.height - 1),
        step(int(image.step)),
        row_stride(unsigned(image.row_stride)),
        is_inner(first + 16 * steps + 8 <= image.width) {
    bool const is_aligned = image.row_stride % kBytes == 0 && (channels == 1 || image.channel_stride % kBytes == 0);
    pixels = step == 1                                           ? is_aligned ? Pixels::aligned : Pixels::shifted
             : step == 3 && image.row_stride >= 48 * (steps + 1) ? Pixels::interleaved
                                                                 : Pixels::apart;
    if (pixels == Pixels::aligned) from -= int((reinterpret_cast<uintptr_t>(image.data) + first) % kBytes);
  }
  // Of the lane, where its pixels of a row are adjacent.
  __device__ __forceinline__ int offset() const {
    if (Steps == 0 || (!Planes && pixels == Pixels::apart)) return 0;
    int const x = from + column_of<Steps>(0, is_split());
    return !Planes && pixels == Pixels::interleaved ? 3 * x : min(x, last);
  }
  __device__ __forceinline__ bool is_split() const { return Steps == 3 && pixels == Pixels::aligned; }
  // Whether interleaved rows before `end` may be read some bytes further.
  __device__ __forceinline__ bool is_safe(int end) const { return is_inner || end <= last_row; }

  template <class V>
  static __device__ __forceinline__ V const* aligned(uint8_t const* at) {
    return reinterpret_cast<V const*>(reinterpret_cast<uintptr_t>(at) & ~uintptr_t(sizeof(V) - 1));
  }
  // The first bytes of four times three.
  static __device__ __forceinline__ uint32_t every_third(uint32_t a, uint32_t b, uint32_t c) {
    return __byte_perm(__byte_perm(a, b, 0x0630), c, 0x5210);
  }
  __device__ __forceinline__ uint8_t const* row_of(uint8_t const* plane, int y) const {
    return plane + uint64_t(unsigned(min(y, last_row))) * row_stride;
  }
  // Each byte alone, from column x on.
  __device__ __forceinline__ uint32_t gather(uint8_t const* row, int x) const {
    uint32_t bytes[4];
#pragma unroll
    for (int i = 0; i < 4; ++i) bytes[i] = row[min(x + i, last) * step];
    return bytes[0] | bytes[1] << 8 | bytes[2] << 16 | bytes[3] << 24;
  }

  // Four bytes from column x on.
  template <Pixels P>
  __device__ __forceinline__ uint32_t word(uint8_t const* row, int x) const {
    if constexpr (P == Pixels::aligned) return *aligned<uint32_t>(row + min(x, last));
    if constexpr (P == Pixels::shifted)
      return __funnelshift_r(*aligned<uint32_t>(row + min(x, last)), *aligned<uint32_t>(row + min(x + 3, last)),
                             8 * (unsigned(reinterpret_cast<uintptr_t>(row + x)) % 4));
    if constexpr (P == Pixels::interleaved) {
      uint32_t const* const at = aligned<uint32_t>(row + 3 * x);
      unsigned const bits = 8 * (unsigned(reinterpret_cast<uintptr_t>(row + 3 * x)) % 4);
      uint32_t const a = at[0], b = at[1], c = at[2], d = at[3];
      return every_third(__funnelshift_r(a, b, bits), __funnelshift_r(b, c, bits), __funnelshift_r(c, d, bits));
    }
    return gather(row, x);
  }

  // Registers for all loads at once would be taken from what is kept in them.
  static __device__ __forceinline__ void limit_loads() { asm volatile("" ::: "memory"); }

  // Loads the words of all steps in rows y + 8 i of a channel, which begins at `plane`, or `offset()` further. Those of
  // rows that are not aligned are still to be shifted.
  __device__ __forceinline__ void load(uint8_t const* plane, int y, uint32_t (&words)[4][kWords]) const {
    int const top = min(y, last_row);
    unsigned const more = unsigned(last_row - top) / 8, stride = 8 * row_stride;
    uint64_t const first = reinterpret_cast<uint64_t>(plane) + uint64_t(unsigned(top)) * row_stride;
    auto const load_all = [&](uint64_t at, auto store) {
#pragma unroll
      for (unsigned i = 0; i < 4; ++i) store(i, at + uint64_t(min(i, more)) * stride);
    };
    if (pixels == Pixels::aligned || pixels == Pixels::shifted) {
      if (Steps == 2 || pixels == Pixels::aligned) {
        load_all(first & ~uint64_t(7), [&](int i, uint64_t at) {
          uint2 const both = load_global(at, uint2{});
          words[i][0] = both.x, words[i][1] = both.y;
        });
        if constexpr (Steps == 3)
          load_all((first + (min(from + column_of<3>(2, true), last) - offset())) & ~uint64_t(3),
                   [&](int i, uint64_t at) { words[i][2] = load_global(at, uint32_t{}); });
      } else {
        int const left = int(first % 4) + last - offset();
#pragma unroll
        for (int s = 0; s < Steps; ++s)
          load_all((first & ~uint64_t(3)) + 4 * min(s, left / 4),
                   [&](int i, uint64_t at) { words[i][s] = load_global(at, uint32_t{}); });
      }
    } else if (pixels == Pixels::interleaved && is_safe(y - int(threadIdx.x % 32 / 4) + kChunk)) {
      constexpr int kVectors = (7 + 12 * Steps) / 8 + 1;
#pragma unroll
      for (int i = 0; i < 4; ++i) {
        if (i == 2) limit_loads();
        uint8_t const* const row = row_of(plane, y + 8 * i);
        uint32_t all[2 * kVectors], own[3 * Steps + 1];
#pragma unroll
        for (int v = 0; v < kVectors; ++v) {
          uint2 const both = aligned<uint2>(row)[v];
          all[2 * v] = both.x, all[2 * v + 1] = both.y;
        }
        unsigned const before = unsigned(reinterpret_cast<uintptr_t>(row)) % 8;
#pragma unroll
        for (int w = 0; w <= 3 * Steps; ++w) own[w] = before >= 4 ? all[w + 1] : all[w];
#pragma unroll
        for (int w = 0; w < 3 * Steps; ++w) own[w] = __funnelshift_r(own[w], own[w + 1], 8 * (before % 4));
#pragma unroll
        for (int s = 0; s < Steps; ++s) words[i][s] = every_third(own[3 * s], own[3 * s + 1], own[3 * s + 2]);
      }
    } else {
#pragma unroll
      for (int i = 0; i < 4; ++i) {
        limit_loads();
        uint8_t const* const row = row_of(plane, y + 8 * i) - offset();
#pragma unroll
        for (int s = 0; s < Steps; ++s) words[i][s] = gather(row, from + column_of<Steps>(s));
      }
    }
  }
  // The same from shared memory, where the first of these rows begins at `rows` and the column `from` so many bytes
  // further: `even` in this row, `odd` in the next one of the lane, and so on.
  __device__ __forceinline__ void load(uint32_t rows, uint32_t pitch, uint32_t even, uint32_t odd,
                                       uint32_t (&words)[4][kWords]) const {
    bool const by_vectors = Steps == 2 || pixels == Pixels::aligned;
    uint32_t const mask = by_vectors ? ~7u : ~3u, own = threadIdx.x % 4 * (by_vectors ? 8 : 4 * Steps);
    uint32_t const from[] = {rows + (even & mask) + own, rows + (odd & mask) + own};
#pragma unroll
    for (unsigned i = 0; i < 4; ++i) {
      uint32_t const at = from[i % 2] + 8 * i * pitch;
      if (by_vectors) {
        uint2 const both = load_shared(at, uint2{});
        words[i][0] = both.x, words[i][1] = both.y;
        if constexpr (Steps == 3) words[i][2] = load_shared(at + 32 - own / 2, uint32_t{});
      } else {
#pragma unroll
        for (int s = 0; s < Steps; ++s) words[i][s] = load_shared(at + 4 * s, uint32_t{});
      }
    }
  }
  // Makes the bytes from `from` on, whose address this is, of what was loaded. Lane % 4 has those before the next
  // lane's; the last one's are no longer read.
  __device__ __forceinline__ void shift(unsigned address, uint32_t (&words)[4][kWords]) const {
    unsigned const before = address % kShifted, bits = 8 * (before % 4);
    if constexpr (Steps == 2) {
      bool const by_word = before >= 4;
      int const lane = int(threadIdx.x % 32), lane_of_second = lane + by_word;
#pragma unroll
      for (int i = 0; i < 4; ++i) {
        uint32_t const first = by_word ? words[i][1] : words[i][0];
        uint32_t const second = __shfl_sync(0xffffffffu, by_word ? words[i][0] : words[i][1], lane_of_second);
        uint32_t const third = __shfl_down_sync(0xffffffffu, first, 1);
        words[i][0] = __funnelshift_r(first, second, bits), words[i][1] = __funnelshift_r(second, third, bits);
      }
    } else {
#pragma unroll
      for (int i = 0; i < 4; ++i) {
        uint32_t const next = __shfl_down_sync(0xffffffffu, words[i][0], 1);
#pragma unroll
        for (int s = 0; s < Steps; ++s)
          words[i][s] = __funnelshift_r(words[i][s], s + 1 < Steps ? words[i][s + 1] : next, bits);
      }
    }
  }
};

}  // namespace
}  // namespace kv::contrib::cuda
