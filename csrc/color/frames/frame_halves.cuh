// Frames of bytes at half their size, antialiased, on CUDA. For the case of a whole frame with pairs of repeated
// chroma, whose rows are vectors: NV12 from a decoder. The weights are 1, 3, 3, 1 of luma along each axis, and 1, 6, 1
// of chroma, so that sums of bytes over both axes are integers below 2^14: two of them are added in one register.
//
// A thread has eight columns of luma and four pixels of the result. It goes down the frame; of its neighbors it needs
// one column on either side, by shuffles, so the first and the last thread of a warp have no pixels of their own.
// Beyond the frame there are zeros, and pixels at its border are divided by the weights within.
#pragma once

#include "frames.cuh"

namespace kv::color::cuda {
namespace {

constexpr int kHalfWarps = 4, kHalfLanes = 30, kHalfRing = 4;  // groups of rows in the ring

struct HalfPlan {
  int strips, bands, rows;  // across, down, of a band
  uint32_t exponent;
};

// Two bytes of a word, each in 16 bits: bytes 0 and 2, or 1 and 3.
__device__ __forceinline__ uint32_t even_bytes(uint32_t word) { return word & 0x00ff00ffu; }
__device__ __forceinline__ uint32_t odd_bytes(uint32_t word) { return __byte_perm(word, 0, 0x4341); }
// The second of two numbers in one register, and the first of two in another.
__device__ __forceinline__ uint32_t straddle(uint32_t left, uint32_t right) { return __byte_perm(left, right, 0x5432); }
__device__ __forceinline__ float number_of_pair(uint32_t pair, int k, uint32_t exponent) {
  return __uint_as_float(__byte_perm(pair, exponent, k ? 0x7632 : 0x7610)) - 8388608.f;
}

template <class T>
__global__ void __launch_bounds__(32 * kHalfWarps)
    run_halves(__grid_constant__ PlanesToRgb<T> const p, __grid_constant__ HalfPlan const plan) {
  __shared__ __align__(16) uint32_t memory[kHalfWarps][kHalfRing][3][32][2];
  unsigned const lane = threadIdx.x % 32, warp = blockIdx.x * kHalfWarps + threadIdx.x / 32;
  unsigned const band_of_frames = warp / plan.strips, frame = band_of_frames / plan.bands;
  if (frame >= unsigned(p.rgb.count() / 3)) return;
  int const strip = int(warp - band_of_frames * plan.strips), band = int(band_of_frames - frame * plan.bands);
  int const x = (strip * kHalfLanes + int(lane) - 1) * kOwn, height = int(p.rgb.height), width = p.x.size;
  int const first = band * plan.rows, last = min(first + plan.rows, height);
  bool const is_inside = x >= 0 && x < width, is_own = is_inside && lane > 0 && lane <= kHalfLanes;
  auto const column = [&](int k) {
    return reinterpret_cast<char const*>(p.planes[k].template row<uint8_t>(frame, 0) + x);
  };
  char const *const luma = column(0), *const chroma = column(1);
  int const luma_stride = int(p.planes[0].row_stride), chroma_stride = int(p.planes[1].row_stride);
  // Groups of two rows of luma and one of chroma, of zeros beyond the frame.
  constexpr int kGroup = 3 * 32 * 2;
  uint32_t const* const ring = memory[threadIdx.x / 32][0][0][lane];
  auto const ring_address = uint32_t(__cvta_generic_to_shared(ring));
  auto const ask = [&](int row) {
    if (row <= last) {
      bool const is_zero = !is_inside || row < 0 || row >= height;
      uint32_t const to = ring_address + 4 * kGroup * (unsigned(row) % kHalfRing);
      char const* const pair = row_of(luma, 2 * row, luma_stride);
      copy_async_if<8>(to, pair, 1, is_zero);
      copy_async_if<8>(to + 256, pair + luma_stride, 1, is_zero);
      copy_async_if<8>(to + 512, row_of(chroma, row, chroma_stride), 1, is_zero);
    }
    __pipeline_commit();
  };
  for (int row = first - 1; row < first + kHalfRing - 2; ++row) ask(row);

  // Of the row of the result before the group of rows: the sums so far. Even columns 0 and 2, 4 and 6, odd ones 1 and
  // 3, 5 and 7; u of samples 0 and 1, 2 and 3, and v.
  uint32_t luma_sums[4]{}, luma_above[4]{}, chroma_sums[4]{}, chroma_above[4]{};
  int64_t const plane = p.rgb.plane(1) - p.rgb.plane(0);
  T* to = p.rgb.row(3 * int64_t(frame), first) + x / 2;
  constexpr float kBorder = 8.f / 7;
  for (int row = first - 1; row <= last; ++row) {
    ask(row + kHalfRing - 1);
    __pipeline_wait_prior(kHalfRing - 1);
    auto const* const own = reinterpret_cast<Vector<uint32_t, 2> const*>(ring + kGroup * (unsigned(row) % kHalfRing));
    Vector<uint32_t, 2> const words[] = {own[0], own[32], own[64]};
    uint32_t a[4], b[4], c[4];
#pragma unroll
    for (int k = 0; k < 2; ++k) {
      a[k] = even_bytes(words[0].v[k]), a[2 + k] = odd_bytes(words[0].v[k]);
      b[k] = even_bytes(words[1].v[k]), b[2 + k] = odd_bytes(words[1].v[k]);
      c[k] = even_bytes(words[2].v[k]), c[2 + k] = odd_bytes(words[2].v[k]);
    }
    uint32_t y[4], uv[4];
#pragma unroll
    for (int k = 0; k < 4; ++k) {
      y[k] = luma_sums[k] + a[k];
      uv[k] = chroma_sums[k] + c[k];
      luma_sums[k] = 3 * (a[k] + b[k]) + luma_above[k];
      chroma_sums[k] = 6 * c[k] + chroma_above[k];
      luma_above[k] = b[k], chroma_above[k] = c[k];
    }
    if (row <= first) continue;
    // The last odd column and the last samples on the left, the first even column and the first samples on the right.
    uint32_t const left = __shfl_up_sync(0xffffffffu, y[3], 1), right = __shfl_down_sync(0xffffffffu, y[0], 1);
    uint32_t const left_uv = __shfl_up_sync(0xffffffffu, __byte_perm(uv[1], uv[3], 0x7632), 1);
    uint32_t const right_uv = __shfl_down_sync(0xffffffffu, __byte_perm(uv[0], uv[2], 0x5410), 1);
    uint32_t const luma_pairs[2] = {straddle(left, y[2]) + 3 * (y[0] + y[2]) + straddle(y[0], y[1]),
                                    straddle(y[2], y[3]) + 3 * (y[1] + y[3]) + straddle(y[1], right)};
    uint32_t chroma_pairs[2][2];
#pragma unroll
    for (int k = 0; k < 2; ++k) {
      uint32_t const u0 = uv[2 * k], u1 = uv[2 * k + 1];
      uint32_t const before =
          __byte_perm(left_uv, u0, k ? 0x5432 : 0x5410);  // the sample on the left, and the first one
      uint32_t const after = __byte_perm(u1, right_uv, k ? 0x7632 : 0x5432);
      chroma_pairs[k][0] = before + 6 * u0 + straddle(u0, u1);
      chroma_pairs[k][1] = straddle(u0, u1) + 6 * u1 + after;
    }
    float numbers[3][4];
#pragma unroll
    for (int j = 0; j < 4; ++j) {
      auto const number = [&](uint32_t pair) { return number_of_pair(pair, j % 2, plan.exponent); };
      numbers[0][j] = number(luma_pairs[j / 2]);
      numbers[1][j] = number(chroma_pairs[0][j / 2]);
      numbers[2][j] = number(chroma_pairs[1][j / 2]);
    }
    int const done = row - 1;
    float const of_row = done == 0 || done == height - 1 ? kBorder : 1.f;
    bool const has_left = x > 0, has_right = x + kOwn < width;
    if (of_row != 1.f || !has_left || !has_right)
#pragma unroll
      for (int k = 0; k < 3; ++k)
#pragma unroll
        for (int j = 0; j < 4; ++j)
          numbers[k][j] *= of_row * (j == 0 && !has_left ? kBorder : 1.f) * (j == 3 && !has_right ? kBorder : 1.f);
    if (is_own)
#pragma unroll
      for (int k = 0; k < 3; ++k) {
        float color[4];
#pragma unroll
        for (int j = 0; j < 4; ++j) color[j] = p.colors.linear(k, numbers[0][j], numbers[1][j], numbers[2][j], 1.f);
        store_vector(to + k * plane, within<T>(color, p.colors.lowest[k], p.colors.highest[k]));
      }
    to += p.rgb.row_stride;
  }
}

template <class T>
bool are_halves(PlanesToRgb<T> const& p, CodeRowsPlan const& codes) {
  return p.code_bytes == 1 && codes.is_plain && p.kind == FrameMap::boxes && !p.map && p.antialias && p.y.is_halved() &&
         p.x.site == ChromaSite::nearest && p.y.site == ChromaSite::nearest && p.x.size == 2 * p.rgb.width &&
         p.y.size == 2 * p.rgb.height && p.rgb.height > 1;
}

template <class T>
int launch_halves(PlanesToRgb<T> p, CUstream_st* stream) {
  for (float& x : p.colors.matrix) x /= 64;
  take_first_for_u(p);
  HalfPlan plan{int(ceil_div(p.x.size, kHalfLanes * kOwn)), 1, 1, CodeRowsPlan{}.exponent};
  int64_t const strips = p.rgb.count() / 3 * plan.strips, at_once = int64_t(24) * multiprocessors();
  int64_t const times = ceil_div(strips * p.rgb.height, at_once * 64);
  plan.bands = int(clamp(times * at_once / strips, int64_t(1), ceil_div(p.rgb.height, int64_t(8))));
  plan.rows = int(ceil_div(p.rgb.height, plan.bands));
  plan.bands = int(ceil_div(p.rgb.height, plan.rows));
  run_halves<T><<<unsigned(ceil_div(strips * plan.bands, kHalfWarps)), 32 * kHalfWarps, 0, stream>>>(p, plan);
  return cudaGetLastError();
}

}  // namespace
}  // namespace kv::color::cuda
