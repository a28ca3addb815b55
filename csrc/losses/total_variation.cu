// Total variation on CUDA: warps traverse strips of the planes downwards, with the rows of Strip.
#include "core/row_sums.cuh"
#include "total_variation.h"

namespace kv::losses::cuda {
namespace {

constexpr int kThreads = 256, kSumming = 512;

// The differences v[j] - v[j + 1] of a row that starts one pixel left of column x; 0 if either pixel is out of bounds.
template <class F, int P>
__device__ __forceinline__ void differences(F const (&v)[P + 2], int x, int width, F (&d)[P + 1]) {
#pragma unroll
  for (int j = 0; j <= P; ++j) d[j] = x + j > 0 && x + j < width ? v[j] - v[j + 1] : F(0);
}

// The sum of absolute differences of a strip's pixels to their next neighbors along y and along x.
template <class T, bool Aligned>
__device__ __forceinline__ Compute<T> sum_of_strip(TotalVariation<T> const& p, int64_t plane, int x, int y0) {
  constexpr int P = kPixels<T>, kAhead = 2;  // kAhead: rows that are prefetched
  using F = Compute<T>;
  int const width = int(p.x.width), height = int(p.x.height), y1 = min(y0 + kVariationRows, height);
  using Row = Strip<1, Aligned, P, kSumming / 32>;
  Row const strip(x, width, Border::replicate);
  RowCursor<T> rows(p.x, plane, y0);
  F along_x = 0, along_y = 0, v[P + 2], above[P];
  auto const add_row = [&] {
#pragma unroll
    for (int j = 1; j <= P; ++j) along_x += x + j < width ? fabs(v[j] - v[j + 1]) : F(0);
  };
  strip.load(v, rows.next());
  add_row();
  for (int y = y0 + 1; y <= y1; y += kAhead) {  // the last one is the first row of the strip below
    typename Row::template FetchedRow<T> fetched[kAhead];
#pragma unroll
    for (int r = 0; r < kAhead; ++r) fetched[r] = strip.fetch(rows.next());
#pragma unroll
    for (int r = 0; r < kAhead; ++r) {
#pragma unroll
      for (int j = 0; j < P; ++j) above[j] = v[j + 1];
      strip.spread(fetched[r], v);
      if (y + r < y1) add_row();
      if (y + r <= y1 && y + r < height) {
#pragma unroll
        for (int j = 0; j < P; ++j) along_y += x + j < width ? fabs(v[j + 1] - above[j]) : F(0);
      }
    }
  }
  return p.along_y * along_y + p.along_x * along_x;
}

// Each warp sums a strip. For `whole` planes each block sums a plane, and its warps take strips in turn.
template <class T, bool Aligned>
__global__ void __launch_bounds__(kSumming, sizeof(T) == 4 ? 3 : 1)
    sum_differences(__grid_constant__ TotalVariation<T> const p, Strips<kPixels<T>> const strips, bool whole) {
  constexpr unsigned kWarps = kSumming / 32;
  unsigned const warp = threadIdx.x / 32, chunks = strips.across * strips.down;
  unsigned const first = whole ? blockIdx.x * chunks : blockIdx.x * kWarps;
  unsigned const end = min(first + (whole ? chunks : kWarps), strips.count);
  Compute<T> sum = 0;
  for (unsigned chunk = first + warp; chunk < end; chunk += kWarps) {
    unsigned const plane = chunk / chunks, line = (chunk - plane * chunks) / strips.across;
    int const column = int(chunk - plane * chunks - line * strips.across) * 32 + int(threadIdx.x % 32);
    sum += sum_of_strip<T, Aligned>(p, plane, column * kPixels<T>, int(line * strips.rows));
  }
  if (whole) {
    sum = block_sum<kSumming>(sum);
    if (threadIdx.x == 0) p.sums[blockIdx.x] = sum;
  } else {
    sum = warp_reduce(sum, Sum());
    if (threadIdx.x % 32 == 0 && first + warp < end) p.partial[first + warp] = sum;
  }
}

template <class T, bool Aligned>
__global__ void __launch_bounds__(kThreads)
    differences_backward(__grid_constant__ TotalVariationBackward<T> const p, Strips<kPixels<T>> const strips) {
  constexpr int P = kPixels<T>;
  using F = Compute<T>;
  int64_t plane;
  int x, y0;
  if (!strips.locate(plane, x, y0)) return;
  int const width = int(p.x.width), height = int(p.x.height), y1 = min(y0 + int(strips.rows), height);
  F const g = p.grad[plane], of_y = p.along_y * g, of_x = p.along_x * g;
  Strip<1, Aligned, P> const strip(x, width, Border::replicate);
  RowCursor<T> rows(p.x, plane, y0 - 1);
  T* out = p.grad_x.row(plane, y0);
  F v[P + 2], below[P + 2], sign_above[P];
  strip.load(below, rows.next());  // the row above, until the first step
  strip.load(v, rows.next());
  constexpr int kAhead = 2;  // rows that are prefetched
  typename Strip<1, Aligned, P>::template FetchedRow<T> fetched[kAhead];
#pragma unroll
  for (int r = 0; r < kAhead; ++r) fetched[r] = strip.fetch(rows.next());
#pragma unroll
  for (int j = 0; j < P; ++j) sign_above[j] = y0 > 0 ? sign_of(v[j + 1] - below[j + 1]) : F(0);
#pragma unroll 1
  for (int y = y0; y < y1; y += kAhead) {
#pragma unroll
    for (int r = 0; r < kAhead; ++r) {
      if (y + r >= y1) break;
      F d[P + 1], result[P];
      strip.spread(fetched[r], below);
      if (y + r + kAhead < y1) fetched[r] = strip.fetch(rows.next());
      differences<F, P>(v, x, width, d);
#pragma unroll
      for (int j = 0; j <= P; ++j) d[j] = sign_of(d[j]);
#pragma unroll
      for (int j = 0; j < P; ++j) {
        F const sign_below = y + r + 1 < height ? sign_of(v[j + 1] - below[j + 1]) : F(0);
        result[j] = of_y * (sign_above[j] + sign_below) + of_x * (d[j + 1] - d[j]);
        sign_above[j] = -sign_below;
      }
      strip.store(out, result);
      out += p.grad_x.row_stride;
#pragma unroll
      for (int j = 0; j < P + 2; ++j) v[j] = below[j];
    }
  }
}

}  // namespace

template <class T>
int total_variation(TotalVariation<T> const& p, CUstream_st* stream) {
  constexpr int P = kPixels<T>;
  static_assert(kVariationColumns<T> == 32 * P);
  int64_t const planes = p.x.count(), machine = multiprocessors();
  // Planes that occupy the GPU evenly need no second launch.
  bool const whole = planes >= 2 * machine && 10 * ceil_div(planes, machine) * machine <= 11 * planes;
  Strips<P> const strips(planes, p.x.height, p.x.width, kVariationRows);
  with_alignment<T>(is_vectorizable<P>(p.x), [&](auto aligned) {
    unsigned const blocks = whole ? unsigned(planes) : strips.blocks(kSumming / 32);
    sum_differences<T, aligned.value><<<blocks, kSumming, 0, stream>>>(p, strips, whole);
  });
  return whole ? cudaGetLastError() : sum_chunks(p.partial, planes, p.chunks, p.sums, stream);
}

template <class T>
int total_variation_backward(TotalVariationBackward<T> const& p, CUstream_st* stream) {
  constexpr int P = kPixels<T>;
  Strips<P> const strips(p.x.count(), p.x.height, p.x.width, kVariationRows);
  with_alignment<T>(is_vectorizable<P>(p.x) && is_vectorizable<P>(p.grad_x), [&](auto aligned) {
    differences_backward<T, aligned.value><<<strips.blocks(), kThreads, 0, stream>>>(p, strips);
  });
  return cudaGetLastError();
}

KV_INSTANTIATE(total_variation, TotalVariation)
KV_INSTANTIATE(total_variation_backward, TotalVariationBackward)

}  // namespace kv::losses::cuda
