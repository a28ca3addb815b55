// Sampling on CUDA: a thread takes places of a tile one after the other, and of each all channels.
#include "sample.cuh"

namespace kv::cuda {
namespace {

// A place tap by tap: at the rim, and where a tap of weight 0 may be NaN or inf, which is no part of the value.
template <int K, class T, class F>
__device__ __noinline__ void sample_taps(Sample<T> const& p, Window<K, F> window, int64_t b, int y, int x) {
  F wx[K], wy[K];
  tap_weights(window.tx, wx);
  tap_weights(window.ty, wy);
#pragma unroll 1
  for (int c = 0; c < p.x.channels; ++c) {
    T const* const plane = p.x.row(b, c, 0);
    F const fill = p.fill_of(b, c);
    F sum = 0;
    window.for_each(p, p.x.row_stride, p.x.step, [&](int j, int i, int64_t at) {
      F const weight = wx[i] * wy[j];
      if (weight != 0) sum += weight * (at < 0 ? fill : F(read(plane[at])));
    });
    p.y.row(b, c, y)[x * p.y.step] = round_to<T>(sum);
  }
}

template <class T, int K, bool matrix>
__global__ void __launch_bounds__(kThreads, K == 4 ? 3 : 4)
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
  T* const result = p.y.row(b, 0, 0);
  int const row = int(p.x.row_stride), step = int(p.x.step);  // a plane has less than 2^31 elements
#pragma unroll 1
  for (int run = 0; run < kRuns; ++run) {
    int const y = y0 + row_in_tile(run);
    if (y >= p.y.height) return;
    F u, v;
    by.at(b, y, x, u, v);
    Window<K, F> const window(p, u, v);
    bool plain = window.inside;
    if (plain) {
      F wx[K], wy[K];
      tap_weights(window.tx, wx);
      tap_weights(window.ty, wy);
      int const from = window.y * row + window.x * step, to = y * int(p.y.row_stride) + x * int(p.y.step);
#pragma unroll 1
      for (int first = 0; first < p.x.channels; first += kAtOnce<K>) {
        F values[kAtOnce<K>][K][K];
#pragma unroll
        for (int k = 0; k < kAtOnce<K>; ++k) {
          if (first + k >= p.x.channels) break;
          T const* const plane = source + (first + k) * p.x.channel_stride;
#pragma unroll
          for (int j = 0; j < K; ++j)
#pragma unroll
            for (int i = 0; i < K; ++i) values[k][j][i] = F(read(plane[from + j * row + i * step]));
        }
#pragma unroll
        for (int k = 0; k < kAtOnce<K>; ++k) {
          if (first + k >= p.x.channels) break;
          F sum = 0;
#pragma unroll
          for (int j = 0; j < K; ++j) {
            F line = 0;
#pragma unroll
            for (int i = 0; i < K; ++i) line += values[k][j][i] * wx[i];
            sum += line * wy[j];
          }
          plain = plain && sum - sum == 0;
          result[(first + k) * p.y.channel_stride + to] = round_to<T>(sum);
        }
      }
    }
    if (!plain) sample_taps(p, window, b, y, x);
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
