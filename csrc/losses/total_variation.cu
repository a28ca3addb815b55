// Total variation on CUDA: warps walk down strips of the planes, with the rows of Strip.
#include "metrics/sums.cuh"
#include "total_variation.h"

namespace kv::cuda {
namespace {

constexpr int kThreads = 256;

// The differences v[j] - v[j + 1] of a row that starts one pixel left of column x, 0 where one is outside of it.
template <class F, int P>
__device__ __forceinline__ void differences(F const (&v)[P + 2], int x, int width, F (&d)[P + 1]) {
#pragma unroll
  for (int j = 0; j <= P; ++j) d[j] = x + j > 0 && x + j < width ? v[j] - v[j + 1] : F(0);
}

template <class T, bool Aligned>
__global__ void __launch_bounds__(kThreads)
    sum_differences(__grid_constant__ TotalVariation<T> const p, Strips<kPixels<T>> const strips) {
  constexpr int P = kPixels<T>;
  using F = Compute<T>;
  int64_t plane;
  int x, y0;
  if (!strips.place(plane, x, y0)) return;
  int const width = int(p.x.width), last = min(y0 + p.rows, int(p.x.height)) - 1;
  Strip<1, Aligned, P> const strip(x, width, Border::replicate);
  RowsDown<T> rows(p.x, plane, y0);
  F along_x = 0, along_y = 0, v[P + 2], d[P + 1];
  auto const add_row = [&] {
    differences<F, P>(v, x, width, d);
#pragma unroll
    for (int j = 1; j <= P; ++j) along_x += fabs(d[j]);  // the one before is that of the neighbouring thread
  };
  strip.load(v, rows.next());
  add_row();
#pragma unroll 4
  for (int y = y0; y < last; ++y) {
    F above[P];
#pragma unroll
    for (int j = 0; j < P; ++j) above[j] = v[j + 1];
    strip.load(v, rows.next());
    add_row();
#pragma unroll
    for (int j = 0; j < P; ++j) along_y += x + j < width ? fabs(v[j + 1] - above[j]) : F(0);
  }
  if (last + 1 < p.x.height) {  // to the first row of the strip below
    F above[P];
#pragma unroll
    for (int j = 0; j < P; ++j) above[j] = v[j + 1];
    strip.load(v, rows.next());
#pragma unroll
    for (int j = 0; j < P; ++j) along_y += x + j < width ? fabs(v[j + 1] - above[j]) : F(0);
  }
  F const sum = warp_sum(p.along_y * along_y + p.along_x * along_x);
  if (threadIdx.x % 32 == 0) p.partial[blockIdx.x * (kThreads / 32) + threadIdx.x / 32] = sum;
}

template <class T, bool Aligned>
__global__ void __launch_bounds__(kThreads)
    differences_backward(__grid_constant__ TotalVariationBackward<T> const p, Strips<kPixels<T>> const strips) {
  constexpr int P = kPixels<T>;
  using F = Compute<T>;
  int64_t plane;
  int x, y0;
  if (!strips.place(plane, x, y0)) return;
  int const width = int(p.x.width), height = int(p.x.height), y1 = min(y0 + int(strips.rows), height);
  F const g = p.grad[plane], of_y = p.along_y * g, of_x = p.along_x * g;
  Strip<1, Aligned, P> const strip(x, width, Border::replicate);
  RowsDown<T> rows(p.x, plane, y0 - 1);
  T* out = p.grad_x.row(plane, y0);
  F v[P + 2], below[P + 2], sign_above[P];
  strip.load(below, rows.next());  // the row above, for now
  strip.load(v, rows.next());
#pragma unroll
  for (int j = 0; j < P; ++j) sign_above[j] = y0 > 0 ? sign_of(v[j + 1] - below[j + 1]) : F(0);
#pragma unroll 4
  for (int y = y0; y < y1; ++y) {
    F d[P + 1], result[P];
    strip.load(below, rows.next());
    differences<F, P>(v, x, width, d);
#pragma unroll
    for (int j = 0; j <= P; ++j) d[j] = sign_of(d[j]);
#pragma unroll
    for (int j = 0; j < P; ++j) {
      F const sign_below = y + 1 < height ? sign_of(v[j + 1] - below[j + 1]) : F(0);
      result[j] = of_y * (sign_above[j] + sign_below) + of_x * (d[j + 1] - d[j]);
      sign_above[j] = -sign_below;
    }
    strip.store(out, result);
    out += p.grad_x.row_stride;
#pragma unroll
    for (int j = 0; j < P + 2; ++j) v[j] = below[j];
  }
}

}  // namespace

template <class T>
int total_variation(TotalVariation<T> const& p, CUstream_st* stream) {
  constexpr int P = kPixels<T>;
  static_assert(kVariationColumns<T> == 32 * P);
  int64_t const planes = p.x.count();
  Strips<P> const strips(planes, p.x.height, p.x.width, p.rows);
  with_alignment<T>(is_strip<P>(p.x), [&](auto aligned) {
    sum_differences<T, aligned.value><<<strips.blocks(), kThreads, 0, stream>>>(p, strips);
  });
  using F = Compute<T>;
  Finish<F> const as_it_is{F(0), F(1), false};
  finish_sums<<<unsigned(planes), kSumThreads, 0, stream>>>(p.partial, p.pieces, as_it_is, p.sums);
  return cudaGetLastError();
}

template <class T>
int total_variation_backward(TotalVariationBackward<T> const& p, CUstream_st* stream) {
  constexpr int P = kPixels<T>;
  Strips<P> const strips(p.x.count(), p.x.height, p.x.width, kVariationRows);
  with_alignment<T>(is_strip<P>(p.x) && is_strip<P>(p.grad_x), [&](auto aligned) {
    differences_backward<T, aligned.value><<<strips.blocks(), kThreads, 0, stream>>>(p, strips);
  });
  return cudaGetLastError();
}

KV_INSTANTIATE(total_variation, TotalVariation)
KV_INSTANTIATE(total_variation_backward, TotalVariationBackward)

}  // namespace kv::cuda
