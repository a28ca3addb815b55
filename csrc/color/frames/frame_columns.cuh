// Boxes that shrink frames of bytes, to bytes or half types, on CUDA, where rows are vectors and chroma is in pairs or
// planes: frames of a decoder, of which all layouts have the same results. A block has a band, some rows of the result,
// each of its warps 32 columns of it. A thread has a column:
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
constexpr int kFewWords = 4, kMostWords = 8;              // that a column has of a row
constexpr float kWeightSum = 32768, kExponent = 8388608;  // of weights; the smallest float whose bits count units

struct ColumnPlan {
  int warps, columns, rows;  // of a block, of a warp, of a block
  int steps;                 // that there is room for
  int luma_at_once, words;   // rows of luma that are requested, of large windows
  bool has_planes;
  uint32_t selectors[2];  // of u and of v of two words of pairs

  int bytes() const { return int(sizeof(BandStep)) * steps; }
};

// Pairs of 16-bit weights. A loop that moves them up through registers is less code, three quarters of the kernel, but
// takes 1.8 times as long from whole frames to 224 x 224, and spills two to three times as much.
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

// Where `words` words of bytes from `first` on begin: at a multiple of four, and within the row.
__device__ __forceinline__ int words_at(int first, int words, int size) { return min(first / 4 * 4, size - 4 * words); }
// Whether K words hold the luma of a window, and K of pairs its chroma. Planes have a word more, and room then too.
template <int K>
__device__ __forceinline__ bool has_room(PixelWindow<float> const& w, FrameAxis const& axis) {
  return w.last - words_at(w.first, K, axis.size) <= 4 * K &&
         2 * w.last_chroma(axis) - words_at(2 * w.first_chroma(axis), K, axis.size) <= 4 * K;
}

// A column of the result, and its words of a row of codes: K of luma, and of chroma K, of which each two have four
// samples of u and v, or as many of each plane as hold those.
template <int K, bool Planes>
struct ColumnWeights {
  static constexpr int kParts = Planes ? 2 : 1, kChroma = Planes ? K / 2 + 1 : K;
  uint32_t luma[2 * K], chroma[Planes ? 2 * kChroma : K];
  float of_luma, of_chroma;  // inverse sums
  int luma_at, chroma_at;    // where the words begin in a row

  __device__ __forceinline__ ColumnWeights(PixelWindow<float> const& w, FrameAxis const& axis) {
    int const first = w.first_chroma(axis), last = w.last_chroma(axis), bytes = 2 / kParts;  // of a sample of chroma
    float const factor = inverse(w.sum());
    luma_at = words_at(w.first, K, axis.size), chroma_at = words_at(bytes * first, kChroma, bytes * axis.chroma_size);
    of_luma = inverse(set_pairs(luma, [&](int k) { return w.weight(luma_at + k) * factor; }));
    of_chroma = inverse(set_pairs(chroma, [&](int k) {
      int const c = chroma_at / bytes + k;
      return c >= first && c < last ? w.chroma_weight(axis, c) * factor : 0.f;
    }));
  }
  __device__ __forceinline__ float luma_of(uint32_t const (&words)[1][K]) const {
    uint32_t sum = __float_as_uint(kExponent);
#pragma unroll
    for (int k = 0; k < K; ++k) sum = add_bytes(luma + 2 * k, words[0][k], sum);
    return number_of_sum(sum);
  }
  // Of u or v.
  __device__ __forceinline__ float chroma_of(uint32_t const (&words)[kParts][kChroma], int i, uint32_t selector) const {
    uint32_t sum = __float_as_uint(kExponent);
    if constexpr (Planes) {
#pragma unroll
      for (int k = 0; k < kChroma; ++k) sum = add_bytes(chroma + 2 * k, words[i][k], sum);
    } else {
#pragma unroll
      for (int k = 0; k < K; k += 2)
        sum = add_bytes(chroma + k, __byte_perm(words[0][k], words[0][k + 1], selector), sum);
    }
    return number_of_sum(sum);
  }
};

// N rows of codes, each of which has `Parts` in memory, of which the first `count` are used. The others are requested
// again: words that may keep their values would take registers in all paths.
template <int N, int Parts, int K>
struct RequestedRows {
  uint32_t words[N][Parts][K];

  __device__ __forceinline__ RequestedRows(char const* const (&first_row)[Parts], BandStep const* steps, int count) {
    int offset = 0;
#pragma unroll
    for (int i = 0; i < N; ++i) {
      if (i < count) offset = steps[i].offset();
#pragma unroll
      for (int part = 0; part < Parts; ++part) {
        auto const* const row = reinterpret_cast<uint32_t const*>(row_of(first_row[part], offset, 1));
#pragma unroll
        for (int k = 0; k < K; ++k) words[i][part][k] = __ldg(row + k);
      }
    }
  }
};

// A column of a band, from `to` on. N, M: the rows of luma and of chroma that are requested at once.
template <int N, int M, int K, bool Planes, class T>
__device__ __forceinline__ void run_column(PlanesToRgb<T> const& p, ColumnPlan const& plan, int64_t frame,
                                           ColumnWeights<K, Planes> const& weights, BandRows const& band,
                                           BandStep const* steps, int rows, T* to, int64_t stride, bool has_column) {
  using Weights = ColumnWeights<K, Planes>;
  auto const plane = [&](int k) { return reinterpret_cast<char const*>(p.planes[k].template row<uint8_t>(frame, 0)); };
  char const* const luma[1] = {plane(0) + weights.luma_at};
  char const* chroma[Weights::kParts];
  if constexpr (Planes)
    chroma[0] = plane(1) + weights.chroma_at, chroma[1] = plane(2) + weights.chroma_at;
  else
    chroma[0] = min(plane(1), plane(2)) + weights.chroma_at;
  float y[kLumaRows]{}, u[kChromaRows]{}, v[kChromaRows]{};
  int next = 0;
  int64_t const to_plane = p.rgb.plane(1) - p.rgb.plane(0);  // the result is dense
#pragma unroll 1
  for (int r = 0; r < rows; ++r, to += stride) {
    int const end_of_luma = band.luma_end[r], end = band.step_end[r];
    int next_chroma = end_of_luma;
    while (next < end_of_luma || next_chroma < end) {
      RequestedRows<N, 1, K> const of_luma(luma, steps + next, end_of_luma - next);
      RequestedRows<M, Weights::kParts, Weights::kChroma> const of_chroma(chroma, steps + next_chroma,
                                                                          end - next_chroma);
#pragma unroll
      for (int i = 0; i < N; ++i)
        if (next + i < end_of_luma) {
          BandStep const step = BandStep::load(steps + next + i);
          float const number = weights.luma_of(of_luma.words[i]);
#pragma unroll
          for (int n = 0; n < kLumaRows; ++n) y[n] += step.weights[n] * number;
        }
#pragma unroll
      for (int i = 0; i < M; ++i)
        if (next_chroma + i < end) {
          BandStep const step = BandStep::load(steps + next_chroma + i);
          float const of_u = weights.chroma_of(of_chroma.words[i], 0, plan.selectors[0]);
          float const of_v = weights.chroma_of(of_chroma.words[i], 1, plan.selectors[1]);
#pragma unroll
          for (int n = 0; n < kChromaRows; ++n) u[n] += step.weights[n] * of_u, v[n] += step.weights[n] * of_v;
        }
      next += N, next_chroma += M;
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
        to[k * to_plane] = uint8_t(__float_as_uint(inside + kRounding));
      else
        to[k * to_plane] = round_to<T>(inside);
    }
  }
}

// AtOnce: the rows of luma that are requested at once where windows are few words. Many: the words of others; 0 without
// antialiasing.
template <class T, int AtOnce, int Many, bool Planes>
__global__ void __launch_bounds__(32 * kColumnWarps, kColumnBlocks)
    run_columns(__grid_constant__ PlanesToRgb<T> const p, __grid_constant__ ColumnPlan const plan) {
  extern __shared__ __align__(16) float memory[];
  __shared__ BandRows band;
  constexpr int kFew = Many == 0 ? 2 : kFewWords, kMany = Many == 0 ? kFew : Many;
  constexpr int kFewChromaAtOnce = Many == 0 ? 2 : 3, kManyAtOnce = Many == kMostWords ? 2 : 3;
  int const lane = int(threadIdx.x % 32), warp = int(threadIdx.x / 32);
  BandStep* const steps = reinterpret_cast<BandStep*>(memory);
  int const x0 = (int(blockIdx.x) * plan.warps + warp) * plan.columns, y0 = int(blockIdx.y) * plan.rows;
  int const columns = min(plan.columns, int(p.rgb.width) - x0), rows = min(plan.rows, int(p.rgb.height) - y0);
  for (int64_t frame = blockIdx.z; frame < p.rgb.count() / 3; frame += gridDim.z) {
    bool const is_mirrored = band.find(p, frame, y0, rows, plan.warps);
    PixelWindow<float> const window = p.box_axis(frame, false).window(x0 + min(lane, columns - 1));
    bool const has_few = __syncthreads_and(has_room<kFew>(window, p.x));
    bool const has_many = Many > 0 && (has_few || __syncthreads_and(has_room<kMany>(window, p.x)));
    band.write(p, frame, y0, rows, plan.warps, plan.steps, 1, false, steps);
    auto const run_each = [&] {
      if (columns > 0) run_each_window<uint8_t>(p, frame, x0, y0, columns, rows);
    };
    auto const run = [&](auto words, auto luma_rows, auto chroma_rows) {
      ColumnWeights<decltype(words)::value, Planes> const weights(window, p.x);
      __syncthreads();
      if (band.step_end[rows - 1] > plan.steps)
        run_each();
      else if (columns > 0)
        run_column<decltype(luma_rows)::value, decltype(chroma_rows)::value>(
            p, plan, frame, weights, band, steps, rows,
            p.rgb.row(3 * frame, is_mirrored ? y0 + rows - 1 : y0) + x0 + lane,
            is_mirrored ? -p.rgb.row_stride : p.rgb.row_stride, lane < columns);
    };
    using std::integral_constant;
    if (has_few)
      run(integral_constant<int, kFew>{}, integral_constant<int, AtOnce>{}, integral_constant<int, kFewChromaAtOnce>{});
    else if (has_many)
      run(integral_constant<int, kMany>{}, integral_constant<int, kManyAtOnce>{},
          integral_constant<int, kManyAtOnce - 1>{});
    else
      run_each();
    __syncthreads();
  }
}

// Whether columns serve a call, and how. Boxes within the frame have room.
template <class T>
bool plan_columns(PlanesToRgb<T> const& p, CodeRowsPlan const& codes, ColumnPlan& plan) {
  int const width = int(p.rgb.width), height = int(p.rgb.height);
  BoxAxis<float> const across(0, float(p.x.size), width, p.x.size, p.antialias);
  BoxAxis<float> const down(0, float(p.y.size), height, p.y.size, p.antialias);
  int const window = across.largest_window(p.x.size);
  bool const has_words = codes.layout != CodeLayout::packed && codes.luma_vectors && codes.chroma_vectors &&
                         p.x.size % kOwn == 0 && p.x.size >= 4 * kMostWords + kOwn;
  // Frames that shrink less have more columns for their codes: bands take 0.8 of the time at 2.25 antialiased, 0.9 at 3
  // not antialiased. A window may begin with the last byte of a word, and its chroma one sample before and end one
  // behind it.
  if (!has_words || across.scale < (p.antialias ? 3 : 4) || window + 3 > 4 * kMostWords) return false;
  plan.columns = divided(width, 32);
  int const warps_across = int(ceil_div(width, plan.columns));
  plan.warps = divided(warps_across, kColumnWarps);
  plan.rows = band_rows(p.rgb.count() / 3 * ceil_div(warps_across, plan.warps), height,
                        int64_t(kColumnBlocks * kColumnWarps / plan.warps) * multiprocessors());
  plan.steps = most_steps(p, down, plan.rows);
  plan.has_planes = codes.layout == CodeLayout::planes;
  plan.luma_at_once = down.scale < 4 ? 3 : 5;
  plan.words = !p.antialias ? 0 : plan.luma_at_once == 5 && window + 3 <= 24 ? 6 : kMostWords;
  for (int k = 0; k < 2; ++k)
    plan.selectors[k] = (codes.layout == CodeLayout::swapped_pairs) == (k == 0) ? 0x7531 : 0x6420;
  return plan.bytes() + int(sizeof(BandRows)) <= 48 << 10;
}

template <class T>
int launch_columns(PlanesToRgb<T> p, ColumnPlan const& plan, CUstream_st* stream) {
  for (int k = 0; k < 3; ++k) p.colors.bias[k] += std::exchange(p.colors.offset[k], 0.f);
  auto const kernel_of = [&](auto planes) {
    constexpr bool kPlanes = decltype(planes)::value;
    return plan.words == 0          ? run_columns<T, 2, 0, kPlanes>
           : plan.words == 6        ? run_columns<T, 5, 6, kPlanes>
           : plan.luma_at_once == 5 ? run_columns<T, 5, kMostWords, kPlanes>
                                    : run_columns<T, 3, kMostWords, kPlanes>;
  };
  auto* const kernel = plan.has_planes ? kernel_of(std::true_type{}) : kernel_of(std::false_type{});
  dim3 const blocks(unsigned(ceil_div(p.rgb.width, plan.warps * plan.columns)),
                    unsigned(ceil_div(p.rgb.height, plan.rows)), unsigned(min(p.rgb.count() / 3, int64_t(65535))));
  kernel<<<blocks, 32 * plan.warps, plan.bytes(), stream>>>(p, plan);
  return cudaGetLastError();
}

}  // namespace
}  // namespace kv::color::cuda
