// Sampling on CUDA: a thread takes places of a tile one after the other, and of each all channels. Their taps are read
// from a patch in shared memory, or where they are when the tile looks at more of the image than a patch holds.
#include "patch.cuh"

namespace kv::cuda {
namespace {

// A place tap by tap, some channels: at the rim, and where a tap of weight 0 may be NaN or inf, which is no part of the
// value.
template <int K, class T, class F>
__device__ __noinline__ void sample_taps(Sample<T> const& p, Window<K, F> window, int64_t b, int first, int count,
                                         int y, int x) {
  F wx[K], wy[K];
  tap_weights(window.tx, wx);
  tap_weights(window.ty, wy);
#pragma unroll 1
  for (int c = first; c < first + count; ++c) {
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

// The value of K x K taps, rows `pitch` apart and pixels `step`.
template <int K, class T, class F>
__device__ __forceinline__ F weighted(T const* taps, int pitch, int step, F const (&wx)[K], F const (&wy)[K]) {
  F sum = 0;
#pragma unroll
  for (int j = 0; j < K; ++j) {
    F line = 0;
#pragma unroll
    for (int i = 0; i < K; ++i) line += F(read(taps[j * pitch + i * step])) * wx[i];
    sum += line * wy[j];
  }
  return sum;
}

template <class T, int K>
constexpr int kBlocks = sizeof(T) == 8 || K == 4 ? 2 : 4;  // on a multiprocessor at once

template <class T, int K>
__global__ void __launch_bounds__(kThreads, kBlocks<T, K>)
    sample_tiles(__grid_constant__ Sample<T> const p, Tiles tiles, bool aligned) {
  using F = Compute<T>;
  __shared__ View<F> view;
  extern __shared__ __align__(16) unsigned char shared_pixels[];
  int const width = int(p.y.width), height = int(p.y.height);
  view.template open<K>(tiles, p, width, height);
  PlacesOf<F> const places(p.places, view);
  int64_t const b = view.b;
  int const row = int(p.x.row_stride), step = int(p.x.step);  // a plane has less than 2^31 elements
  int const to_row = int(p.y.row_stride), to_step = int(p.y.step);

#pragma unroll 1
  for (int tile = 0; tile < int(tiles.row) && view.x + tile * kTile < width; ++tile) {
    Patch<T> const patch(shared_pixels, view.template taps_of<K>(tile, p, width, height), p, F());
    int const x = view.x + tile * kTile + column_in_tile();
    in_groups<Patch<T>::kChannels>(p.x.channels, [&](int first, auto number) {
      constexpr int N = number.value;
      if (patch.fits)
        patch.template load<N>(p.x, b, first, p.x_axis, p.y_axis, aligned,
                               [&](int c) { return p.fill ? round_to<T>(p.fill_of(b, c)) : T{}; });
      T* const result = p.y.row(b, first, 0);
      int y = view.y + row_in_tile(), to = y * to_row + x * to_step;
#pragma unroll 1
      for (int run = 0; run < kRuns; ++run, y += kRunRows, to += kRunRows * to_row) {
        if (x >= width || y >= height) break;
        F u, v;
        places.at(y, x, u, v);
        Window<K, F> const window(p, u, v);
        F wx[K], wy[K], poison = 0;
        tap_weights(window.tx, wx);
        tap_weights(window.ty, wy);
        auto const put = [&](int k, F sum) {
          if constexpr (sizeof(T) > 1) poison += sum * 0;
          result[k * p.y.channel_stride + to] = round_to<T>(sum);
        };
        bool plain;
        if (patch.fits) {
          int const at = patch.template find<K>(window.x, window.y);
          plain = at >= 0;
          if (plain)
#pragma unroll
            for (int k = 0; k < N; ++k)
              put(k, weighted<K>(patch.pixels + at + k * Patch<T>::kSize, Patch<T>::kPitch, 1, wx, wy));
        } else {
          plain = window.inside;
          T const* const taps = p.x.row(b, first, 0) + (window.y * row + window.x * step);
          if (plain)
#pragma unroll
            for (int k = 0; k < N; ++k) put(k, weighted<K>(taps + k * p.x.channel_stride, row, step, wx, wy));
        }
        if (!plain || poison != 0) sample_taps(p, window, b, first, N, y, x);
      }
    });
  }
}

}  // namespace

template <class T>
int sample(Sample<T> const& p, CUstream_st* stream) {
  Tiles const tiles(p.y.batch, p.y.height, p.y.width, tile_row(p.y.batch, p.y.height, p.y.width));
  with_taps(p.interpolation, [&](auto taps) {
    sample_tiles<T, taps.value>
        <<<tiles.count, kThreads, Patch<T>::bytes(p.x.channels), stream>>>(p, tiles, in_packs(p.x));
  });
  return cudaGetLastError();
}

KV_INSTANTIATE_WITH_BYTES(sample, Sample)

}  // namespace kv::cuda
