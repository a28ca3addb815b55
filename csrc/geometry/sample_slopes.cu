// The gradient to places and matrices on CUDA; see sample.h.
#include "patch.cuh"

namespace kv::cuda {
namespace {

// What the taps of a place and its gradients give to the gradient of the place itself.
template <int K, class F>
struct Slopes {
  F wx[K], wy[K], dx[K], dy[K];
  F along_x = 0, along_y = 0;

  __device__ __forceinline__ Slopes(Window<K, F> const& window) {
    tap_weights(window.tx, wx);
    tap_weights(window.ty, wy);
    tap_slopes(window.tx, dx);
    tap_slopes(window.ty, dy);
  }
  // Of values(j, i), with the gradient g.
  template <class Values>
  __device__ __forceinline__ void add(Values values, F g) {
    F x = 0, y = 0;
#pragma unroll
    for (int j = 0; j < K; ++j) {
      F line = 0, across = 0;
#pragma unroll
      for (int i = 0; i < K; ++i) {
        F const value = F(values(j, i));
        line += value * wx[i];
        across += value * dx[i];
      }
      x += across * wy[j];
      y += line * dy[j];
    }
    along_x += g * x;
    along_y += g * y;
  }
};

template <class T, int K>
__global__ void __launch_bounds__(kThreads, K == 4 || sizeof(T) == 8 ? 2 : 4)
    slope_tiles(__grid_constant__ SampleSlopes<T> const p, Tiles tiles, bool aligned) {
  using F = Compute<T>;
  __shared__ View<F> view;
  extern __shared__ __align__(16) unsigned char shared_pixels[];
  int const width = int(p.grad.width), height = int(p.grad.height);
  view.template open<K>(tiles, p, width, height);
  PlacesOf<F> const places(p.places, view);
  int64_t const b = view.b;

  F sums[9] = {};
#pragma unroll 1
  for (int tile = 0; tile < int(tiles.row) && view.x + tile * kTile < width; ++tile) {
    Patch<T> const patch(shared_pixels, view.template taps_of<K>(tile, p, width, height), p, F());
    int const x = view.x + tile * kTile + column_in_tile();
    in_groups<Patch<T>::kChannels>(p.x.channels, [&](int first, auto number) {
      constexpr int N = number.value;
      if (patch.fits)
        patch.template load<N>(p.x, b, first, p.x_axis, p.y_axis, aligned,
                               [&](int c) { return p.fill ? round_to<T>(p.fill_of(b, c)) : T{}; });
#pragma unroll 1
      for (int y = view.y + row_in_tile(); x < width && y < min(view.y + kTile, height); y += kRunRows) {
        T const* const grad = p.grad.row(b, first, y) + x * p.grad.step;
        F g[N];
#pragma unroll
        for (int k = 0; k < N; ++k) g[k] = F(read(grad[k * p.grad.channel_stride]));
        F u, v;
        places.at(y, x, u, v);
        Window<K, F> const window(p, u, v);
        Slopes<K, F> slopes(window);
        int const at = patch.fits ? patch.template find<K>(window.x, window.y) : -1;
        if (at >= 0) {
          T const* const taps = patch.pixels + at;
#pragma unroll
          for (int k = 0; k < N; ++k)
            slopes.add([&](int j, int i) { return read(taps[k * Patch<T>::kSize + j * Patch<T>::kPitch + i]); }, g[k]);
        } else {
#pragma unroll 1
          for (int k = 0; k < N; ++k) {
            F values[K][K];
            T const* const plane = p.x.row(b, first + k, 0);
            F const fill = p.fill_of(b, first + k), gradient = F(read(grad[k * p.grad.channel_stride]));
            window.for_each(p, p.x.row_stride, p.x.step,
                            [&](int j, int i, int64_t at) { values[j][i] = at < 0 ? fill : F(read(plane[at])); });
            slopes.add([&](int j, int i) { return values[j][i]; }, gradient);
          }
        }
        if (p.places.matrices) {
          F const scale = reciprocal(places.map.weight(F(x), F(y))), to_u = slopes.along_x * scale,
                  to_v = slopes.along_y * scale;
          F to_map[] = {to_u, to_v, -(to_u * u + to_v * v)};
#pragma unroll
          for (int i = 0; i < 3; ++i) {
            if (to_map[i] - to_map[i] != 0) to_map[i] = 0;  // a place at infinity has no slope
            sums[3 * i] += to_map[i] * F(x);
            sums[3 * i + 1] += to_map[i] * F(y);
            sums[3 * i + 2] += to_map[i];
          }
        } else {
          F &to_x = p.grad_x.row(b, 0, y)[x], &to_y = p.grad_y.row(b, 0, y)[x];
          to_x = slopes.along_x * p.places.scale[0] + (first > 0 ? to_x : 0);
          to_y = slopes.along_y * p.places.scale[1] + (first > 0 ? to_y : 0);
        }
      }
    });
  }
  if (!p.places.matrices) return;
  add_block(sums, p.sums + int64_t(blockIdx.x) * 9);
}

// A block a sample.
template <class T>
__global__ void add_parts(MatrixGradient<T> p) {
  __shared__ double total[9];
  int64_t const b = blockIdx.x;
  double sums[9] = {};
  for (int64_t part = threadIdx.x; part < p.parts; part += kThreads)
    for (int i = 0; i < 9; ++i) sums[i] += p.sums[(b * p.parts + part) * 9 + i];
  add_block(sums, total);
  __syncthreads();
  if (threadIdx.x != 0) return;
  MatrixUse const& use = p.places.use;
  homography_vjp(p.places.matrices + b * p.places.matrix_stride, use, total, p.grad + b * 3 * use.rows);
}

}  // namespace

template <class T>
int sample_slopes(SampleSlopes<T> const& p, CUstream_st* stream) {
  Tiles const tiles(p.grad.batch, p.grad.height, p.grad.width, tile_row(p.grad.batch, p.grad.height, p.grad.width));
  with_taps(p.interpolation, [&](auto taps) {
    slope_tiles<T, taps.value>
        <<<tiles.count, kThreads, Patch<T>::bytes(p.x.channels), stream>>>(p, tiles, in_packs(p.x));
  });
  return cudaGetLastError();
}

template <class T>
int matrix_gradient(MatrixGradient<T> const& p, CUstream_st* stream) {
  add_parts<T><<<unsigned(p.batch), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE(sample_slopes, SampleSlopes)
KV_INSTANTIATE_COMPUTED(matrix_gradient, MatrixGradient)

}  // namespace kv::cuda
