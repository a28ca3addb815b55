// Sampling at a coordinate by the taps in global memory, on CUDA.
#pragma once

#include "geometry/transform/sampling.cuh"

namespace kv::geometry::cuda {
namespace {

// The value of K x K taps, rows `pitch` apart and pixels `step`, with the weights of (tx, ty).
template <int K, class T, class F>
__device__ __forceinline__ F mean(T const* taps, int pitch, int step, F tx, F ty, F const (&wx)[K], F const (&wy)[K]) {
  auto const at = [&](int j, int i) { return F(read(taps[j * pitch + i * step])); };
  if constexpr (K == 2) {
    F const above = at(0, 0) + tx * (at(0, 1) - at(0, 0)), below = at(1, 0) + tx * (at(1, 1) - at(1, 0));
    return above + ty * (below - above);
  } else {
    F sum = 0;
#pragma unroll
    for (int j = 0; j < K; ++j) {
      F line = 0;
#pragma unroll
      for (int i = 0; i < K; ++i) line += at(j, i) * wx[i];
      sum += line * wy[j];
    }
    return sum;
  }
}

// N channels at a sampling coordinate, from global memory. Tap by tap at the border, and where a tap of weight 0, which
// contributes nothing, may be NaN or inf.
template <int K, int N, class T, class F>
__device__ __noinline__ void sample_unstaged(Sample<T> const& p, Tile<F> const& tile, int first, int y, int x) {
  F u, v, wx[K], wy[K], poison = 0;
  TileCoords<F>(p.coords, tile).at(y, x, u, v);
  TapWindow<K, F> const window(p, u, v);
  tap_weights(window.tx, wx);
  tap_weights(window.ty, wy);
  int64_t const row = p.x.row_stride, step = p.x.step;
  T* const result = p.y.row(tile.b, first, y) + x * p.y.step;
  if (window.inside) {
    T const* const taps = p.x.row(tile.image, first, window.y) + window.x * step;
#pragma unroll
    for (int k = 0; k < N; ++k) {
      F const sum = mean<K>(taps + k * p.x.channel_stride, int(row), int(step), window.tx, window.ty, wx, wy);
      poison += sum * 0;
      result[k * p.y.channel_stride] = round_to<T>(sum);
    }
    if (poison == 0) return;
  }
#pragma unroll 1
  for (int k = 0; k < N; ++k) {
    T const* const plane = p.x.row(tile.image, first + k, 0);
    F const fill = p.fill_value(tile.b, first + k);
    F sum = 0;
    window.for_each(p, row, step, [&](int j, int i, int64_t at) {
      F const weight = wx[i] * wy[j];
      if (weight != 0) sum += weight * (at < 0 ? fill : F(read(plane[at])));
    });
    result[k * p.y.channel_stride] = round_to<T>(sum);
  }
}

}  // namespace
}  // namespace kv::geometry::cuda
