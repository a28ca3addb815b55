// Sampling on CUDA: a thread takes places of a tile one after the other, and of each all channels.
#include "sample.cuh"

namespace kv::cuda {
namespace {

// Tap by tap, for places at the rim, and where a tap of weight 0 may be NaN or inf: it is no part of the value.
template <int K, class T, class F>
__device__ __noinline__ F value_of_taps(Sampling<T> const& p, Window<K, F> const& window, T const* plane,
                                        int64_t row_stride, int64_t step, F fill) {
  F wx[K], wy[K], sum = 0;
  tap_weights(window.tx, wx);
  tap_weights(window.ty, wy);
  window.for_each(p, row_stride, step, [&](int j, int i, int64_t at) {
    F const weight = wx[i] * wy[j];
    if (weight != 0) sum += weight * (at < 0 ? fill : F(read(plane[at])));
  });
  return sum;
}

template <class T, int K, bool matrix>
__global__ void __launch_bounds__(kThreads) sample_tiles(__grid_constant__ Sample<T> const p, Tiles tiles) {
  using F = Compute<T>;
  __shared__ Homography<F> map;
  int64_t b;
  int y0, x0;
  tiles.place(b, y0, x0);
  By<matrix, F> const by(p.places, map, b);
  int const x = x0 + column_in_tile();
  if (x >= p.y.width) return;
  T const* const source = p.x.row(b, 0, 0);
  int64_t const row = p.x.row_stride, step = p.x.step;
#pragma unroll 1
  for (int run = 0; run < kRuns; ++run) {
    int const y = y0 + row_in_tile(run);
    if (y >= p.y.height) return;
    F u, v;
    by.at(b, y, x, u, v);
    Window<K, F> const window(p, u, v);
    F wx[K], wy[K];
    tap_weights(window.tx, wx);
    tap_weights(window.ty, wy);
    T const* from = source + window.y * row + window.x * step;
    T* to = p.y.row(b, 0, y) + x * p.y.step;
#pragma unroll 3
    for (int c = 0; c < p.x.channels; ++c) {
      F sum = 0;
      if (window.inside) {
        T const* at = from + c * p.x.channel_stride;
#pragma unroll
        for (int j = 0; j < K; ++j, at += row) {
          F line = 0;
#pragma unroll
          for (int i = 0; i < K; ++i) line += F(read(at[i * step])) * wx[i];
          sum += line * wy[j];
        }
      }
      if (!window.inside || sum - sum != 0)
        sum = value_of_taps(p, window, source + c * p.x.channel_stride, row, step, p.fill_of(b, c));
      to[c * p.y.channel_stride] = round_to<T>(sum);
    }
  }
}

}  // namespace

template <class T>
int sample(Sample<T> const& p, CUstream_st* stream) {
  Tiles const tiles(p.y.batch, p.y.height, p.y.width);
  with_kind(p, [&](auto matrix, auto taps) {
    sample_tiles<T, taps.value, matrix.value><<<tiles.count, kThreads, 0, stream>>>(p, tiles);
  });
  return cudaGetLastError();
}

KV_INSTANTIATE_WITH_BYTES(sample, Sample)

}  // namespace kv::cuda
