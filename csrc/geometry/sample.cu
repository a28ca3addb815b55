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
__global__ void __launch_bounds__(kThreads, K == 4 ? 2 : 4)
    sample_tiles(__grid_constant__ Sample<T> const p, Tiles tiles) {
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
    T const* const from = source + window.y * row + window.x * step;
    T* const to = p.y.row(b, 0, y) + x * p.y.step;
#pragma unroll 1
    for (int first = 0; first < p.x.channels; first += kChannels) {
      F sums[kChannels] = {};
      if (window.inside) {
#pragma unroll
        for (int j = 0; j < K; ++j) {
          F values[kChannels][K];
          read_taps(values, from + first * p.x.channel_stride + j * row, step, p.x, first);
#pragma unroll
          for (int k = 0; k < kChannels; ++k) {
            F line = 0;
#pragma unroll
            for (int i = 0; i < K; ++i) line += values[k][i] * wx[i];
            sums[k] += line * wy[j];
          }
        }
      }
#pragma unroll
      for (int k = 0; k < kChannels; ++k) {
        int const c = first + k;
        if (c >= p.x.channels) break;
        if (!window.inside || sums[k] - sums[k] != 0)
          sums[k] = value_of_taps(p, window, source + c * p.x.channel_stride, row, step, p.fill_of(b, c));
        to[c * p.y.channel_stride] = round_to<T>(sums[k]);
      }
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
