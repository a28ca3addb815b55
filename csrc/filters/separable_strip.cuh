// The strip kernel of separable filters on CUDA: planar images, square windows of odd sizes from 3 to 31. Included by
// separable_<type>.cu and separable_*backward.cu, which instantiate it, and by its callers separable.cu and box.cu.
//
// Each warp goes down a strip of 32 P columns and prefetches its rows (core/row_prefetcher.cuh).
//
// Along y only running sums are stored, one for each of the K - 1 output rows whose windows are not complete. A new row
// adds to all of them; then the first sum is complete and the others move up, which costs nothing: sum[i] = sum[i + 1]
// + weight * row.
#pragma once

#include "core/row_prefetcher.cuh"
#include "core/stencils/filter_list.cuh"
#include "separable.h"

namespace kv::filters::cuda {

// Launch kernels for the size of p.kx, which is that of p.ky. The result is divided by `divisor`.
//
//   separable_strips                   forward passes, and transposes without border accumulation
//   separable_reflect_backward_strips  transposes of a reflected border with symmetric weights
//   separable_backward_strips          all transposes with border accumulation; separable_backward.cu
template <class T>
int separable_strips(Separable<T> const& p, float divisor, CUstream_st* stream);
template <class T>
int separable_reflect_backward_strips(Separable<T> const& p, float divisor, CUstream_st* stream);
template <class T>
int separable_backward_strips(Separable<T> const& p, CUstream_st* stream);
// The same of lists.
template <class T>
int separable_strips(SeparableList<T> const& p, float divisor, CUstream_st* stream);
template <class T>
int separable_reflect_backward_strips(SeparableList<T> const& p, float divisor, CUstream_st* stream);

// Whether the strip kernels serve images and a window of this size.
template <class T>
bool supports_strips(Planes<T const> const& x, int64_t ky, int64_t kx) {
  return kx == ky && kx % 2 == 1 && kx >= 3 && kx <= 31 && x.step == 1 &&
         x.row_stride * int64_t(sizeof(T)) <= INT32_MAX && x.width <= INT32_MAX / 2;
}

namespace {

constexpr int kLargest = 31;  // window; see supports_strips
constexpr int kWarps = 4;     // of a block; they do not synchronize

// Types of 1 and 2 bytes take 8 pixels a thread where the sums of 8 fit into the registers.
template <class T, int K>
constexpr int kStripPixels = sizeof(T) < 4 && K <= 11 ? 8 : 4;

// Rows of the ring; all but one are in flight. Where the sums take most registers, a shorter ring is faster.
template <int K>
constexpr int kRing = K <= 15 ? 4 : 2;

// Blocks on a multiprocessor, limited by its registers, 512 for each thread of a block.
template <int K, int P>
constexpr int kRegisters = P * K + (K <= 7 ? 52 : 64);
template <int K, int P>
constexpr int kResident = 512 / (kRegisters<K, P> < 170 ? kRegisters<K, P> : 170);

template <class T, int K, int P, bool ReflectBackward, class Aligned>
struct alignas(16) WarpMemory {
  T rows[kRing<K>][kRingPitch<T, P, Aligned>];
  float x[32], y[32];  // weights; those of y begin with the one that completes a row
  float first[ReflectBackward ? 32 * P
                              : 1];  // the weight with which a pixel of the strip reads the first pixel of the row
  float last[ReflectBackward ? 32 * P : 1];  // a second time, and the same of the last pixel
};

// The thread's weight, or 0.
template <class F>
__device__ __forceinline__ F weight_of_lane(Taps<F> const& taps, int64_t sample, int lane) {
  F const weight = lane < taps.size ? tap_weight(taps, sample, lane) : F(0);
  return taps.gaussian ? weight / warp_reduce(weight, Sum()) : weight;
}

// Reads `weights` four at a time, in an unrolled loop over i.
__device__ __forceinline__ float weight_at(float const* weights, int i, float4& four) {
  if (i % 4 == 0) four = *reinterpret_cast<float4 const*>(weights + i);
  return i % 4 == 0 ? four.x : i % 4 == 1 ? four.y : i % 4 == 2 ? four.z : four.w;
}

// Along x: the sums over the windows in v. `weight` is a function of the tap.
template <int K, int P, int N, class W>
__device__ __forceinline__ void filter_row(float const (&v)[N], W weight, float (&h)[P]) {
#pragma unroll
  for (int t = 0; t < K; ++t) {
    float const w = weight(t);
#pragma unroll
    for (int j = 0; j < P; ++j) {
      float const pixel = v[kBefore<K, P> - K / 2 + t + j];
      h[j] = t == 0 ? w * pixel : fmaf(w, pixel, h[j]);
    }
  }
}

// Along y: adds a row to the sums that it belongs to, of which the first is complete.
template <int K, int P, class W>
__device__ __forceinline__ void add_row(float const (&h)[P], W weight, float (&sums)[K - 1][P], float (&complete)[P]) {
#pragma unroll
  for (int t = 0; t < K; ++t) {
    float const w = weight(t);
#pragma unroll
    for (int j = 0; j < P; ++j) {
      float const sum = t < K - 1 ? fmaf(w, h[j], sums[t][j]) : w * h[j];
      (t == 0 ? complete[j] : sums[max(t - 1, 0)][j]) = sum;
    }
  }
}

// `aligned`: rows of input and output are vectors of P pixels that start at the same columns. ReflectBackward: the
// transpose of a reflected border with symmetric weights. It is D^-1 A D, where A is the forward pass and D doubles the
// first and the last pixel of an axis; see BoxAxis in smoothing/box.h.
template <class T, int K, int P, bool ReflectBackward, class Aligned>
__device__ __forceinline__ void filter_strip(Separable<T> const& p, Strips<P> const& strips, unsigned block,
                                             float divisor, Aligned aligned) {
  constexpr int R = K / 2;
  __shared__ WarpMemory<T, K, P, ReflectBackward, Aligned> memory[kWarps];
  WarpMemory<T, K, P, ReflectBackward, Aligned>& shared = memory[threadIdx.x / 32];
  int64_t plane;
  int x, y0;
  if (!strips.locate(block, plane, x, y0)) return;
  int const lane = threadIdx.x % 32, x0 = x - P * lane;
  int const width = int(p.y.width), height = int(p.y.height), y1 = min(y0 + int(strips.rows), height);

  int const left = x0 + R - p.kx.before,
            out_stride = int(p.y.row_stride * sizeof(T));  // windows reach kx / 2 pixels to the left of `left`
  RowPrefetcher<T, P, R, kRing<K>, Aligned> rows(shared.rows, p.x, plane, p.border, p.border, aligned, left,
                                                 y0 - p.ky.before, y1 - y0 + K - 1);

  int64_t const sample = plane / p.planes;
  shared.x[lane] = weight_of_lane(p.kx, sample, lane);
  float const weight_y = p.alpha * weight_of_lane(p.ky, sample, lane);
  shared.y[lane] = __shfl_sync(0xffffffffu, weight_y, (K - 1 - lane) & 31);
  __syncwarp();
  constexpr bool kInRegisters = K <= 7;
  [[maybe_unused]] float weights_x[kInRegisters ? K : 1], weights_y[kInRegisters ? K : 1];
  if constexpr (kInRegisters) {
#pragma unroll
    for (int t = 0; t < K; ++t) weights_x[t] = shared.x[t], weights_y[t] = shared.y[t];
  }

  // The first and the last pixel of a row count twice. Pixel 0 is also at position 2 (width - 1) and the last one at
  // -(width - 1), which windows of a narrow image may reach.
  bool const near_first = x0 == 0, near_last = x0 + 32 * P >= width - R;
  bool reads_first = false, reads_last = false, on_border = false;
  if (ReflectBackward && (near_first || near_last)) {
#pragma unroll
    for (int j = 0; j < P; ++j) {
      int const i = P * lane + j, n = width - 1;
      auto const weight_for = [&](int at) {
        return at >= x + j - R && at <= x + j + R ? shared.x[at - x - j + R] : 0.f;
      };
      float const first = weight_for(0) + weight_for(2 * n), last = weight_for(n) + weight_for(-n);
      reads_first |= near_first && first != 0;
      reads_last |= near_last && last != 0;
      on_border |= x + j == 0 || x + j == n;
      shared.first[ReflectBackward ? i : 0] = first;
      shared.last[ReflectBackward ? i : 0] = last;
    }
    __syncwarp();
  }
  auto const add_doubled = [&](float const* weights, T pixel, float(&h)[P]) {
#pragma unroll
    for (int j = 0; j < P; ++j) {
      float const weight = weights[P * lane + j], more = weight * read(pixel);
      h[j] += weight != 0 ? more : 0.f;  // 0 times an infinite pixel is not 0
    }
  };
  auto const is_end = [](int i, int n) { return i == 0 || i == n - 1; };

  T* const out = p.y.plane(plane) + x;
  float const reciprocal = 1 / divisor;
  float sums[K - 1][P] = {};
#pragma unroll 1
  for (int i = 0; i < rows.count; ++i) {
    int const y = y0 + i - (K - 1);  // the output row that this row completes
    T const* const row = rows.row(i);

    float v[P + 2 * kBefore<K, P>], h[P], result[P];
    [[maybe_unused]] float4 four;
    read_windows<K, P>(row, v, aligned);
    filter_row<K>(
        v, [&](int t) { return kInRegisters ? weights_x[kInRegisters ? t : 0] : weight_at(shared.x, t, four); }, h);
    if (reads_first) add_doubled(shared.first, row[kHalo], h);
    if (reads_last) add_doubled(shared.last, row[kHalo + width - 1 - x0], h);

    [[maybe_unused]] bool const row_doubled =
        ReflectBackward && is_end(border_index(Border::reflect, y + R, height), height);
    if (row_doubled) {
#pragma unroll
      for (int j = 0; j < P; ++j) h[j] *= 2;
    }
    add_row<K>(
        h, [&](int t) { return kInRegisters ? weights_y[kInRegisters ? t : 0] : weight_at(shared.y, t, four); }, sums,
        result);
    if (p.beta != 0) {
#pragma unroll
      for (int j = 0; j < P; ++j) {
        float pixel = v[kBefore<K, P> + j];
        if (row_doubled) pixel *= 2;
        if (on_border && is_end(x + j, width)) pixel *= 2;
        sums[R - 1][j] = fmaf(p.beta, pixel, sums[R - 1][j]);
      }
    }
    if (i < K - 1) continue;
    if (on_border || (ReflectBackward && is_end(y, height))) {
#pragma unroll
      for (int j = 0; j < P; ++j) {
        if (is_end(y, height)) result[j] /= 2;
        if (on_border && is_end(x + j, width)) result[j] /= 2;
      }
    }
    if (divisor != 1) {
#pragma unroll
      for (int j = 0; j < P; ++j) result[j] = quotient<T>(result[j], divisor, reciprocal);
    }
    store_pixels(row_at(out, y, out_stride), result, x, width, aligned);
  }
}

template <class T, int K, int P, bool ReflectBackward, class Aligned>
__global__ void __launch_bounds__(32 * kWarps, kResident<K, P>)
    separable_strip(__grid_constant__ Separable<T> const p, __grid_constant__ Strips<P> const strips, float divisor,
                    Aligned aligned) {
  filter_strip<T, K, P, ReflectBackward>(p, strips, blockIdx.x, divisor, aligned);
}

template <class T, int K, int P, bool ReflectBackward>
__global__ void __launch_bounds__(32 * kWarps, kResident<K, P>)
    separable_strip_of_list(__grid_constant__ SeparableList<T> const list, int rows, float divisor) {
  unsigned block;
  Separable<T> const* const p = sample_of_block(list, block);
  if (!p) return;
  Strips<P> const strips(p->y.count(), p->y.height, p->y.width, rows);
  filter_strip<T, K, P, ReflectBackward>(*p, strips, block, divisor, std::false_type{});
}

// `columns`: strips side by side.
template <int K, int P>
int rows_per_strip(int64_t columns, int64_t height, int64_t blocks_resident) {
  if (K <= 7) return (K <= 5 ? 3 : 4) * P;  // limited by memory, which is faster where warps are close to each other
  int64_t const machine = multiprocessors(), resident = machine * blocks_resident * kWarps;
  return strip_height(columns, height, K, resident, min(resident, machine * 10));
}
template <int K, int P, class T>
int rows_per_strip(Planes<T> const& y, int64_t blocks_resident) {
  int64_t const columns = y.count() * ceil_div(y.width, 32 * P);
  int const rows = rows_per_strip<K, P>(columns, y.height, blocks_resident);
  // Half types and bytes are limited by instructions.
  bool const in_waves = K <= 7 && sizeof(T) < 4;
  return in_waves ? height_near(rows, columns, y.height, K, multiprocessors() * blocks_resident * kWarps) : rows;
}

template <class T, int K, bool ReflectBackward>
int launch_strip(Separable<T> p, float divisor, CUstream_st* stream) {
  constexpr int P = kStripPixels<T, K>;
  Strips<P> const strips(p.y.count(), p.y.height, p.y.width, rows_per_strip<K, P>(p.y, kResident<K, P>));
  auto const launch = [&](auto aligned) {
    separable_strip<T, K, P, ReflectBackward>
        <<<strips.blocks(kWarps), 32 * kWarps, 0, stream>>>(p, strips, divisor, aligned);
  };
  bool const aligned = is_vectorizable<P>(p.x) && is_vectorizable<P>(p.y) && p.kx.before == K / 2;
  if constexpr (ReflectBackward) {
    p.border = p.accumulation = Border::reflect;
  }
  with_alignment<T>(aligned, launch);
  return cudaGetLastError();
}

template <class T, int K, bool ReflectBackward>
int launch_strip(SeparableList<T> p, float divisor, CUstream_st* stream) {
  constexpr int P = kStripPixels<T, K>;
  if constexpr (ReflectBackward) {
    p.all.border = p.all.accumulation = Border::reflect;
  }
  int64_t const columns =
      sum_of_samples(p, [](Separable<T> const& one) { return one.y.count() * ceil_div(one.y.width, 32 * P); });
  int const rows = rows_per_strip<K, P>(columns, largest_height(p), kResident<K, P>);
  return launch_list(
      p,
      [&](Separable<T> const& one) { return Strips<P>(one.y.count(), one.y.height, one.y.width, rows).blocks(kWarps); },
      [&](SeparableList<T> const& list, unsigned blocks) {
        separable_strip_of_list<T, K, P, ReflectBackward><<<blocks, 32 * kWarps, 0, stream>>>(list, rows, divisor);
      });
}

template <class T>
int taps_along_x(Separable<T> const& p) {
  return p.kx.size;
}
template <class T>
int taps_along_x(SeparableList<T> const& p) {
  return p.all.kx.size;
}

// Work: Separable<T> or SeparableList<T>.
template <class T, bool ReflectBackward, int K = 3, class Work>
int launch_strip_of_size(Work const& p, float divisor, CUstream_st* stream) {
  if constexpr (K < kLargest)
    if (taps_along_x(p) != K) return launch_strip_of_size<T, ReflectBackward, K + 2>(p, divisor, stream);
  return launch_strip<T, K, ReflectBackward>(p, divisor, stream);
}

}  // namespace

}  // namespace kv::filters::cuda
