// Boxes that shrink frames of bytes, to bytes or half types, on CUDA, where chroma is in pairs and rows are vectors:
// NV12 from a decoder. A block has a band, some rows of the result, each of its warps 32 columns of it. A thread has a
// column:
//
//   across    It reads its codes of a row, which lie in a few words. Two of them are multiplied at once, by weights of
//             16 bits in registers, which add up to about 2^15, so that sums are integers below 2^23, and exact as
//             float.
//   down      Each sum is added to the rows of the result that take the row.
//
// So a row of codes costs instructions by the columns of the result, not by its own. A weight is off by at most 2^-16
// of their sum, a result by 0.002 levels for noise: float32 goes by bands. Their sum is divided by, so that what is
// constant stays so. Neighbors read the same words: the caches serve them.
#pragma once

#include "frame_steps.cuh"

namespace kv::color::cuda {
namespace {

// Warps of a block at most, and blocks at once on a multiprocessor.
constexpr int kColumnWarps = 7, kColumnBlocks = 4;
constexpr int kFewWords = 4, kManyWords = 8;              // that a column has of a row, at most
constexpr float kWeightSum = 32768, kExponent = 8388608;  // of weights; the smallest float whose bits count units

struct ColumnPlan {
  int warps, columns, rows;  // of a block, of a warp, of a block
  int steps;                 // that there is room for

  int bytes() const { return int(sizeof(BandStep)) * steps; }
};

// Pairs of 16-bit weights.
template <int N, class Weight>
__device__ __forceinline__ float set_pairs(uint32_t (&pairs)[N], Weight weight) {
  uint32_t sum = 0;
#pragma unroll
  for (int k = 0; k < N; ++k) {
    uint32_t const low = __float2uint_rn(weight(2 * k) * kWeightSum),
                   high = __float2uint_rn(weight(2 * k + 1) * kWeightSum);
    pairs[k] = low | high << 16;
    sum += low + high;
  }
  return float(sum);
}

// The four bytes of a word, weighted.
__device__ __forceinline__ uint32_t add_bytes(uint32_t const* pairs, uint32_t word, uint32_t sum) {
  return __dp2a_hi(pairs[1], word, __dp2a_lo(pairs[0], word, sum));
}
__device__ __forceinline__ float number_of_sum(uint32_t sum) { return __uint_as_float(sum) - kExponent; }

// A column of the result, and its words of a row of codes: K of luma, and K of chroma, of which each two have four
// samples.
template <int K>
struct ColumnWeights {
  uint32_t luma[2 * K], chroma[K];
  float of_luma, of_chroma;  // inverse sums
  int luma_at, chroma_at;    // where the words begin in a row

  // The words of bytes [first, last) begin at a multiple of four, and are within the row.
  static __device__ __forceinline__ int begin_of(int first, int size) { return min(first / 4 * 4, size - 4 * K); }
  static __device__ __forceinline__ bool has_room(int first, int last, int size) {
    return last - begin_of(first, size) <= 4 * K;
  }
  __device__ __forceinline__ ColumnWeights(PixelWindow<float> const& w, FrameAxis const& axis) {
    int const first = w.first_chroma(axis), last = w.last_chroma(axis);
    float const factor = inverse(w.sum());
    luma_at = begin_of(w.first, axis.size), chroma_at = begin_of(2 * first, axis.size);
    of_luma = inverse(set_pairs(luma, [&](int k) { return w.weight(luma_at + k) * factor; }));
    of_chroma = inverse(set_pairs(chroma, [&](int k) {
      int const c = chroma_at / 2 + k;
      return c >= first && c < last ? w.chroma_weight(axis, c) * factor : 0.f;
    }));
  }
  __device__ __forceinline__ float luma_of(uint32_t const (&words)[K]) const {
    uint32_t sum = __float_as_uint(kExponent);
#pragma unroll
    for (int k = 0; k < K; ++k) sum = add_bytes(luma + 2 * k, words[k], sum);
    return number_of_sum(sum);
  }
  __device__ __forceinline__ void chroma_of(uint32_t const (&words)[K], float& u, float& v) const {
    uint32_t sums[2] = {__float_as_uint(kExponent), __float_as_uint(kExponent)};
#pragma unroll
    for (int k = 0; k < K; k += 2) {
      sums[0] = add_bytes(chroma + k, __byte_perm(words[k], words[k + 1], 0x6420), sums[0]);
      sums[1] = add_bytes(chroma + k, __byte_perm(words[k], words[k + 1], 0x7531), sums[1]);
    }
    u = number_of_sum(sums[0]), v = number_of_sum(sums[1]);
  }
};

// The rows of luma and of chroma that are requested at once, for columns of K words.
template <int K>
constexpr int kLumaAtOnce = K == 4 ? 5 : 2;
template <int K>
constexpr int kChromaAtOnce = K == 4   ? 3
                              : K == 2 ? 2
                                       : 1;

// N rows of codes, of which the first `count` are used. The others are requested again: words that may keep their
// values would take registers in all paths.
template <int K, int N>
struct RequestedRows {
  uint32_t words[N][K];

  __device__ __forceinline__ RequestedRows(char const* first_row, BandStep const* steps, int count) {
    int offset = 0;
#pragma unroll
    for (int i = 0; i < N; ++i) {
      if (i < count) offset = steps[i].offset();
      auto const* const row = reinterpret_cast<uint32_t const*>(row_of(first_row, offset, 1));
#pragma unroll
      for (int k = 0; k < K; ++k) words[i][k] = __ldg(row + k);
    }
  }
};

// A column of a band, from `to` on. `luma`, `chroma`: the first row of the frame.
template <int K, class T>
__device__ __forceinline__ void run_column(PlanesToRgb<T> const& p, ColumnWeights<K> const& weights,
                                           BandRows const& band, BandStep const* steps, int rows, char const* luma,
                                           char const* chroma, T* to, int64_t stride, bool has_column) {
  luma += weights.luma_at, chroma += weights.chroma_at;
  float y[kLumaRows]{}, u[kChromaRows]{}, v[kChromaRows]{};
  int next = 0;
  int64_t const plane = p.rgb.plane(1) - p.rgb.plane(0);  // the result is dense
#pragma unroll 1
  for (int r = 0; r < rows; ++r, to += stride) {
    int const end_of_luma = band.luma_end[r], end = band.step_end[r];
    int next_chroma = end_of_luma;
    while (next < end_of_luma || next_chroma < end) {
      RequestedRows<K, kLumaAtOnce<K>> const of_luma(luma, steps + next, end_of_luma - next);
      RequestedRows<K, kChromaAtOnce<K>> const of_chroma(chroma, steps + next_chroma, end - next_chroma);
#pragma unroll
      for (int i = 0; i < kLumaAtOnce<K>; ++i)
        if (next + i < end_of_luma) {
          BandStep const step = BandStep::load(steps + next + i);
          float const number = weights.luma_of(of_luma.words[i]);
#pragma unroll
          for (int n = 0; n < kLumaRows; ++n) y[n] += step.weights[n] * number;
        }
#pragma unroll
      for (int i = 0; i < kChromaAtOnce<K>; ++i)
        if (next_chroma + i < end) {
          BandStep const step = BandStep::load(steps + next_chroma + i);
          float numbers[2];
          weights.chroma_of(of_chroma.words[i], numbers[0], numbers[1]);
#pragma unroll
          for (int n = 0; n < kChromaRows; ++n)
            u[n] += step.weights[n] * numbers[0], v[n] += step.weights[n] * numbers[1];
        }
      next += kLumaAtOnce<K>, next_chroma += kChromaAtOnce<K>;
    }
    next = end;
    float const numbers[] = {y[0] * weights.of_luma, u[0] * weights.of_chroma, v[0] * weights.of_chroma};
#pragma unroll
    for (int n = 0; n < kLumaRows; ++n) y[n] = n + 1 < kLumaRows ? y[n + 1] : 0;
#pragma unroll
    for (int n = 0; n < kChromaRows; ++n) {
      u[n] = n + 1 < kChromaRows ? u[n + 1] : 0;
      v[n] = n + 1 < kChromaRows ? v[n + 1] : 0;
    }
    if (!has_column) continue;
#pragma unroll
    for (int k = 0; k < 3; ++k) {
      float const* const m = p.colors.matrix + 3 * k;
      float const color = numbers[0] * m[0] + (numbers[1] * m[1] + (numbers[2] * m[2] + p.colors.bias[k]));
      float const inside = nan_min(nan_max(color, p.colors.lowest[k]), p.colors.highest[k]);
      if constexpr (sizeof(T) == 1)
        to[k * plane] = uint8_t(__float_as_uint(inside + kRounding));
      else
        to[k * plane] = round_to<T>(inside);
    }
  }
}

template <class T, bool Antialias>
__global__ void __launch_bounds__(32 * kColumnWarps, kColumnBlocks)
    run_columns(__grid_constant__ PlanesToRgb<T> const p, __grid_constant__ ColumnPlan const plan) {
  extern __shared__ __align__(16) float memory[];
  __shared__ BandRows band;
  int const lane = int(threadIdx.x % 32), warp = int(threadIdx.x / 32);
  BandStep* const steps = reinterpret_cast<BandStep*>(memory);
  int const x0 = (int(blockIdx.x) * plan.warps + warp) * plan.columns, y0 = int(blockIdx.y) * plan.rows;
  int const columns = min(plan.columns, int(p.rgb.width) - x0), rows = min(plan.rows, int(p.rgb.height) - y0);
  for (int64_t frame = blockIdx.z; frame < p.rgb.count() / 3; frame += gridDim.z) {
    bool const is_mirrored = band.set(p, frame, y0, rows, plan.warps, plan.steps, 1, false, steps);
    __syncthreads();
    if (columns > 0) {
      PixelWindow<float> const window = p.box_axis(frame, false).window(x0 + min(lane, columns - 1));
      auto const fit = [&](auto words) {
        using Weights = ColumnWeights<decltype(words)::value>;
        return __all_sync(0xffffffffu,
                          Weights::has_room(window.first, window.last, p.x.size) &&
                              Weights::has_room(2 * window.first_chroma(p.x), 2 * window.last_chroma(p.x), p.x.size));
      };
      auto const run = [&](auto words) {
        auto const first_row = [&](int k) {
          return reinterpret_cast<char const*>(p.planes[k].template row<uint8_t>(frame, 0));
        };
        run_column(p, ColumnWeights<decltype(words)::value>(window, p.x), band, steps, rows, first_row(0), first_row(1),
                   p.rgb.row(3 * frame, is_mirrored ? y0 + rows - 1 : y0) + x0 + lane,
                   is_mirrored ? -p.rgb.row_stride : p.rgb.row_stride, lane < columns);
      };
      constexpr std::integral_constant<int, Antialias ? kFewWords : 2> few{};
      constexpr std::integral_constant<int, kManyWords> many{};
      bool const has_steps = band.step_end[rows - 1] <= plan.steps;
      if (has_steps && fit(few))
        run(few);
      else if (Antialias && has_steps && fit(many))
        run(many);
      else
        run_each_window<uint8_t>(p, frame, x0, y0, columns, rows);
    }
    __syncthreads();
  }
}

// Whether columns serve a call, and how. Boxes within the frame have room.
template <class T>
bool plan_columns(PlanesToRgb<T> const& p, CodeRowsPlan const& codes, ColumnPlan& plan) {
  int const width = int(p.rgb.width), height = int(p.rgb.height);
  BoxAxis<float> const across(0, float(p.x.size), width, p.x.size, p.antialias);
  BoxAxis<float> const down(0, float(p.y.size), height, p.y.size, p.antialias);
  // Where columns are about as many as codes, bands take fewer instructions. A window may begin with the last byte of
  // a word, and its chroma one sample before and end one behind it.
  if (!codes.is_plain || across.scale < 2 || p.x.size < 4 * kManyWords ||
      across.largest_window(p.x.size) + 3 > 4 * kManyWords)
    return false;
  plan.columns = divided(width, 32);
  int const warps_across = int(ceil_div(width, plan.columns));
  plan.warps = divided(warps_across, kColumnWarps);
  plan.rows = band_rows(p.rgb.count() / 3 * ceil_div(warps_across, plan.warps), height,
                        int64_t(kColumnBlocks * kColumnWarps / plan.warps) * multiprocessors());
  plan.steps = most_steps(p, down, plan.rows);
  return plan.bytes() + int(sizeof(BandRows)) <= 48 << 10;
}

template <class T>
int launch_columns(PlanesToRgb<T> p, ColumnPlan const& plan, CUstream_st* stream) {
  take_first_for_u(p);
  for (int k = 0; k < 3; ++k) p.colors.bias[k] += std::exchange(p.colors.offset[k], 0.f);
  auto* const kernel = p.antialias ? run_columns<T, true> : run_columns<T, false>;
  dim3 const blocks(unsigned(ceil_div(p.rgb.width, plan.warps * plan.columns)),
                    unsigned(ceil_div(p.rgb.height, plan.rows)), unsigned(min(p.rgb.count() / 3, int64_t(65535))));
  kernel<<<blocks, 32 * plan.warps, plan.bytes(), stream>>>(p, plan);
  return cudaGetLastError();
}

}  // namespace
}  // namespace kv::color::cuda
