// The rows of codes that a band of the result takes, some adjacent rows of it, on CUDA: which, with which weights, and
// how many rows a band has. Included by the kernels of boxes.
#pragma once

#include "core/row_prefetcher.cuh"
#include "frames.cuh"

namespace kv::color::cuda {
namespace {

constexpr int kRing = 8, kAhead = kRing - 1;  // rows of codes in shared memory, and of those asked for ahead
constexpr int kMinBandRows = 4, kMaxBandRows = 32;
// Rows of codes are added to at most as many rows of the result at once, of luma and of chroma.
constexpr int kLumaRows = 2, kChromaRows = 3;

// A row of codes, and its weights in the rows of the result that take rows of codes at once.
struct alignas(16) BandStep {
  static constexpr uint32_t kChroma = 1u << 31;  // added to those of chroma
  float weights[3];
  uint32_t at;  // bytes behind the first row

  __device__ __forceinline__ bool is_chroma() const { return int(at) < 0; }
  __device__ __forceinline__ int offset() const { return int(at & ~kChroma); }

  static __device__ __forceinline__ BandStep load(BandStep const* from) {
    auto const words = *reinterpret_cast<Vector<uint32_t, 4> const*>(from);
    return {{__uint_as_float(words.v[0]), __uint_as_float(words.v[1]), __uint_as_float(words.v[2])}, words.v[3]};
  }
};

// The rows of luma or of chroma that rows of the result take.
struct BandRanges {
  int first[kMaxBandRows], last[kMaxBandRows];

  __device__ __forceinline__ int begin_of(int i, bool rolling) const {
    return rolling && i > 0 ? max(first[i], last[i - 1]) : first[i];
  }
  __device__ __forceinline__ int steps_of(int i, bool rolling) const { return max(last[i] - begin_of(i, rolling), 0); }
  // Whether no row of codes is taken by more than N rows of the result, which are neighbors.
  template <int N>
  __device__ __forceinline__ bool can_roll(int i, int count) const {
    return (i + N >= count || last[i] <= first[i + N]) &&
           (i + 1 >= count || (first[i] <= first[i + 1] && last[i] <= last[i + 1]));
  }
  // The steps of row i, whose own weights are at `slot`, and those of the rows behind it in the next ones.
  template <int N, class Weight>
  __device__ __forceinline__ void write(BandStep* steps, int i, int count, bool rolling, int slot_of_row, int stride,
                                        uint32_t kind, Weight weight) const {
    int const begin = begin_of(i, rolling), own = steps_of(i, rolling);
    for (int k = 0; k < own; ++k) {
      BandStep step{{}, uint32_t((begin + k) * stride) | kind};
#pragma unroll
      for (int n = 0; n < N; ++n)
        if (n == 0 || (rolling && i + n < count)) {
          float const w = weight(n, begin + k);
#pragma unroll
          for (int slot = 0; slot < N; ++slot)
            if ((slot_of_row + n) % N == slot) step.weights[slot] = w;
        }
      steps[k] = step;
    }
  }
};

// Exact for 1, else within an ulp.
__device__ __forceinline__ float inverse(float x) { return __fdividef(1.f, x); }

struct BandRows {
  BandRanges luma, chroma;
  // Of a row: the steps of those before and its own of luma; the steps of it and of those before.
  int luma_end[kMaxBandRows], step_end[kMaxBandRows];

  // The window of row i of the band: its rows are taken from the top of the frame to its bottom.
  static __device__ __forceinline__ PixelWindow<float> window_of(BoxAxis<float> const& box, int y0, int rows, int i) {
    return box.window(box.scale < 0 ? y0 + rows - 1 - i : y0 + i);
  }
  // Finds what `rows` rows from y0 on take. Returns whether the first one of the band is the lowest one of them.
  template <class T>
  __device__ __forceinline__ bool find(PlanesToRgb<T> const& p, int64_t frame, int y0, int rows, int warps) {
    int const lane = int(threadIdx.x % 32), warp = int(threadIdx.x / 32);
    BoxAxis<float> const box = p.box_axis(frame, true);
    for (int kind = warp; kind < 2; kind += warps)
      if (lane < rows) {
        PixelWindow<float> const w = window_of(box, y0, rows, lane);
        BandRanges& own_rows = kind ? chroma : luma;
        own_rows.first[lane] = kind ? w.first_chroma(p.y) : w.first;
        own_rows.last[lane] = kind ? w.last_chroma(p.y) : w.last;
      }
    return box.scale < 0;
  }
  // Their steps, where there is room for them. The block synchronizes before and behind this. `rotate`: the weights of
  // row i of the result begin at slot i modulo their number, not at 0.
  template <class T>
  __device__ __forceinline__ void write(PlanesToRgb<T> const& p, int64_t frame, int y0, int rows, int warps, int room,
                                        int code_bytes, bool rotate, BandStep* steps) {
    int const lane = int(threadIdx.x % 32), warp = int(threadIdx.x / 32);
    BoxAxis<float> const box = p.box_axis(frame, true);
    bool const has_row = lane < rows;
    for (int kind = warp; kind < 2; kind += warps) {
      bool const rolls_luma = __all_sync(0xffffffffu, !has_row || luma.can_roll<kLumaRows>(lane, rows));
      bool const rolls_chroma = __all_sync(0xffffffffu, !has_row || chroma.can_roll<kChromaRows>(lane, rows));
      int const luma_steps = has_row ? luma.steps_of(lane, rolls_luma) : 0;
      int end = luma_steps + (has_row ? chroma.steps_of(lane, rolls_chroma) : 0);
      int const own_steps = end;
#pragma unroll
      for (int k = 1; k < 32; k *= 2) {
        int const before = __shfl_up_sync(0xffffffffu, end, k);
        if (lane >= k) end += before;
      }
      if (has_row && kind == 0) luma_end[lane] = end - own_steps + luma_steps, step_end[lane] = end;
      if (!has_row || end > room) continue;
      PixelWindow<float> const w[] = {window_of(box, y0, rows, lane), window_of(box, y0, rows, min(lane + 1, rows - 1)),
                                      window_of(box, y0, rows, min(lane + 2, rows - 1))};
      float const factor[] = {inverse(w[0].sum()), inverse(w[1].sum()), inverse(w[2].sum())};
      BandStep* const own = steps + end - own_steps;
      if (kind == 0)
        luma.write<kLumaRows>(own, lane, rows, rolls_luma, rotate ? lane : 0, int(p.planes[0].row_stride) * code_bytes,
                              0, [&](int n, int row) { return w[n].weight(row) * factor[n]; });
      else
        chroma.write<kChromaRows>(own + luma_steps, lane, rows, rolls_chroma, rotate ? lane : 0,
                                  int(p.planes[1].row_stride) * code_bytes, BandStep::kChroma,
                                  [&](int n, int row) { return w[n].chroma_weight(p.y, row) * factor[n]; });
    }
  }
};

// Stored, and 0 for the next row of the result that is added up there.
__device__ __forceinline__ float take(float& sum) {
  float const value = sum;
  sum = 0;
  return value;
}

template <class S, class T>
__device__ __noinline__ void run_each_window(PlanesToRgb<T> const& p, int64_t frame, int x0, int y0, int columns,
                                             int rows) {
  BoxAxis<float> const box_x = p.box_axis(frame, false), box_y = p.box_axis(frame, true);
  for (int i = int(threadIdx.x % 32); i < columns * rows; i += 32) {
    int const x = x0 + i % columns, y = y0 + i / columns;
    PixelWindow<float> const wx = box_x.window(x), wy = box_y.window(y);
    float sums[3];
    sum_windows(wx, wy, p.x, p.y, Reader<S, T>{p, frame}, sums);
    float const factor = 1 / (wx.sum() * wy.sum());
#pragma unroll
    for (float& sum : sums) sum *= factor;
#pragma unroll
    for (int k = 0; k < 3; ++k)
      p.rgb.row(3 * frame + k, y)[x] = round_to<T>(channel_of(p.colors, k, sums[0], sums[1], sums[2]));
  }
}

// Parts of a size that are at most `most` and about equal.
inline int divided(int size, int most) { return int(ceil_div(size, ceil_div(size, most))); }

// As many rows as fill all multiprocessors a whole number of times, with `at_once` blocks; `count` of them are side by
// side.
inline int band_rows(int64_t count, int height, int64_t at_once) {
  int64_t const times = ceil_div(count * height, at_once * kMaxBandRows);
  int64_t const down_count = clamp(times * at_once / count, int64_t(1), int64_t(height));
  return int(clamp(ceil_div(int64_t(height), down_count), int64_t(min(kMinBandRows, height)), int64_t(kMaxBandRows)));
}

// Boxes within the frame have no more steps.
template <class T>
int most_steps(PlanesToRgb<T> const& p, BoxAxis<float> const& down, int rows) {
  int const reads = p.antialias ? int(float(rows) * down.scale + 2 * down.support) + 3 : 0;
  // Rows of interpolated chroma are taken by more rows of the result than are added up at once.
  int const each_row = p.y.site == ChromaSite::nearest ? 3 : max(3, int(down.support) + 3);
  return max(2 * rows, reads) + max(each_row * rows, reads);
}

}  // namespace
}  // namespace kv::color::cuda
