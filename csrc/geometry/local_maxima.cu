// Local maxima on CUDA. Windows of 3 x 3, 5 x 5 and 3 x 3 x 3 are walked down in registers; for others, and for
// channels-last images, a thread takes the window of one element.
#include "core/launch.cuh"
#include "local_maxima.h"

namespace kv::cuda {
namespace {

constexpr int kThreads = 256;
constexpr int kRows = 8;  // of a strip

// Any window. Blocks of 32 x 8 elements of a plane's rows, planes last.
template <class T>
__global__ void __launch_bounds__(kThreads)
    any_window(__grid_constant__ LocalMaxima<T> const p, unsigned across, unsigned down) {
  using F = Compute<T>;
  unsigned const line = blockIdx.x / across;
  int64_t const plane = line / down;
  int const at = int(blockIdx.x - line * across) * 32 + threadIdx.x % 32;
  int const y = int(line - unsigned(plane) * down) * 8 + threadIdx.x / 32, step = int(p.x.step);
  if (at >= p.x.row_size() || y >= p.x.height) return;
  int64_t first, last;
  p.fitting(plane, y, first, last);
  int const column = step == 1 ? at : at / step;
  bool above = column >= first && column < last, below = above;
  T const* const centre = p.x.row(plane, y) + at;
  F const v = read(*centre);
  for (int k = -p.before[0]; k <= p.after[0]; ++k)
    for (int j = -p.before[1]; j <= p.after[1] && (above || below); ++j) {
      T const* const row = centre + k * p.x.outer_stride + j * p.x.row_stride;
      for (int i = -p.before[2]; i <= p.after[2]; ++i) {
        if (i == 0 && j == 0 && k == 0) continue;
        F const other = read(row[i * step]);
        above = above && v > other;
        below = below && v < other;
      }
    }
  if (p.y.data) p.y.row(plane, y)[at] = above ? p.kept.row(plane, y)[at] : T{};
  if (p.maxima.data) p.maxima.row(plane, y)[at] = above;
  if (p.minima.data) p.minima.row(plane, y)[at] = below;
}

// (2R + 1)^2 pixels, in one plane or, with D = 1, in three.
template <class T, int R, int D>
__global__ void __launch_bounds__(kThreads)
    strips_down(__grid_constant__ LocalMaxima<T> const p, Strips<kPixels<T>> const strips) {
  constexpr int P = kPixels<T>, kWindow = 2 * R + 1, kPlanes = 2 * D + 1;
  using F = Compute<T>;
  int64_t plane;
  int x, y0;
  if (!strips.place(plane, x, y0)) return;
  int const y1 = min(y0 + int(strips.rows), int(p.x.height));
  Strip<R, true, P> const strip(x, int(p.x.width), Border::replicate);
  int const z = D > 0 ? int(plane % p.depth) : 0;
  auto const rows_of = [&](int k) { return RowsDown<T>(p.x, plane - z + clamp(z + k, 0, int(p.depth) - 1), y0 - R); };
  RowsDown<T> before = rows_of(-1), same(p.x, plane, y0 - R), after = rows_of(1);
  F window[kWindow][kPlanes][P + 2 * R];
  auto const next = [&](F(&row)[kPlanes][P + 2 * R]) {
    strip.load(row[D], same.next());
    if constexpr (D > 0) {
      strip.load(row[0], before.next());
      strip.load(row[2], after.next());
    }
  };
#pragma unroll
  for (int j = 0; j < kWindow - 1; ++j) next(window[j]);
#pragma unroll 1
  for (int y = y0; y < y1; ++y) {
    next(window[kWindow - 1]);
    int64_t first, last;
    p.fitting(plane, y, first, last);
    Pack<uint8_t, P> maxima, minima;
#pragma unroll
    for (int n = 0; n < P; ++n) {
      F const v = window[R][D][n + R];
      bool above = x + n >= first && x + n < last, below = above;
#pragma unroll
      for (int j = 0; j < kWindow; ++j)
#pragma unroll
        for (int k = 0; k < kPlanes; ++k)
#pragma unroll
          for (int i = 0; i < kWindow; ++i)
            if (j != R || k != D || i != R) {
              above = above && v > window[j][k][n + i];
              below = below && v < window[j][k][n + i];
            }
      maxima.v[n] = above;
      minima.v[n] = below;
    }
    if (p.y.data && strip.inside) {
      Pack<T, P> values{};
      bool some = false;
#pragma unroll
      for (int n = 0; n < P; ++n) some = some || maxima.v[n] != 0;
      if (some) values = *reinterpret_cast<Pack<T, P> const*>(p.kept.row(plane, y) + x);
#pragma unroll
      for (int n = 0; n < P; ++n) values.v[n] = maxima.v[n] ? values.v[n] : T{};
      *reinterpret_cast<Pack<T, P>*>(p.y.row(plane, y) + x) = values;
    }
    if (p.maxima.data && strip.inside) *reinterpret_cast<Pack<uint8_t, P>*>(p.maxima.row(plane, y) + x) = maxima;
    if (p.minima.data && strip.inside) *reinterpret_cast<Pack<uint8_t, P>*>(p.minima.row(plane, y) + x) = minima;
#pragma unroll
    for (int j = 0; j < kWindow - 1; ++j)
#pragma unroll
      for (int k = 0; k < kPlanes; ++k)
#pragma unroll
        for (int i = 0; i < P + 2 * R; ++i) window[j][k][i] = window[j + 1][k][i];
  }
}

}  // namespace

template <class T>
int local_maxima(LocalMaxima<T> const& p, CUstream_st* stream) {
  constexpr int P = kPixels<T>;
  auto const reaches = [&](int d, int r) {
    return p.before[0] == d && p.after[0] == d && p.before[1] == r && p.after[1] == r && p.before[2] == r &&
           p.after[2] == r;
  };
  if constexpr (sizeof(T) < 8)
    if (is_strip<P>(p.x) && (!p.y.data || (is_strip<P>(p.y) && is_strip<P>(p.kept)))) {
      Strips<P> const strips(p.x.count(), p.x.height, p.x.width, kRows);
      auto const run = [&](auto r, auto d) {
        strips_down<T, r.value, d.value><<<strips.blocks(), kThreads, 0, stream>>>(p, strips);
        return cudaGetLastError();
      };
      using One = std::integral_constant<int, 1>;
      if (reaches(0, 1)) return run(One{}, std::integral_constant<int, 0>{});
      if (reaches(0, 2)) return run(std::integral_constant<int, 2>{}, std::integral_constant<int, 0>{});
      if (reaches(1, 1)) return run(One{}, One{});
    }
  unsigned const across = unsigned(ceil_div(p.x.row_size(), 32)), down = unsigned(ceil_div(p.x.height, 8));
  any_window<T><<<unsigned(p.x.count() * across * down), kThreads, 0, stream>>>(p, across, down);
  return cudaGetLastError();
}

KV_INSTANTIATE(local_maxima, LocalMaxima)

}  // namespace kv::cuda
