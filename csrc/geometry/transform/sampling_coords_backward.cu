// The gradient to places and matrices on CUDA; see sampling.h.
#include "geometry/transform/source_tile.cuh"

namespace kv::cuda {
namespace {

// What the taps of a place and its gradients give to the gradient of the place itself.
template <int K, class F>
struct Slopes {
  F wx[K], wy[K], dx[K], dy[K];
  F along_x = 0, along_y = 0;

  __device__ __forceinline__ void set(F tx, F ty) {
    tap_weights(tx, wx);
    tap_weights(ty, wy);
    tap_slopes(tx, dx);
    tap_slopes(ty, dy);
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

  F sums[9] = {};
#pragma unroll 1
  for (int number = 0; number < int(tiles.row) && view.tiles[number].x < width; ++number) {
    Tile<F> const& tile = view.tiles[number];
    PlacesOf<F> const places(p.places, tile);
    void* const kept = shared_pixels + Patch<T>::bytes(p.x.channels);
    Patch<T> const patch(shared_pixels, view.template look<K>(number, p, width, height, kept), p, F());
    int const origin = patch.origin(tile.u, tile.v);
    int64_t const b = tile.b;
    int const x = tile.x + column_in_tile<T>();
    in_groups<Patch<T>::kChannels>(p.x.channels, [&](int first, auto number) {
      constexpr int N = number.value;
      if (patch.fits)
        patch.template load<N>(p.x, b, first, p.x_axis, p.y_axis, aligned,
                               [&](int c) { return p.fill ? round_to<T>(p.fill_of(b, c)) : T{}; });
      Runs<F> const runs(tile, p.places, kept, column_in_tile<T>(), row_in_tile<T>());
#pragma unroll 1
      for (int run = 0; run < kRuns; ++run) {
        int const y = tile.y + row_in_tile<T>() + run * kRunRows;
        if (x >= width || y >= height) break;
        T const* const grad = p.grad.row(b, first, y) + x * p.grad.step;
        F g[N];
#pragma unroll
        for (int k = 0; k < N; ++k) g[k] = F(read(grad[k * p.grad.channel_stride]));
        F u, v;
        Slopes<K, F> slopes;
        if (patch.fits) {
          F tx, ty;
          runs.at(run, u, v);
          int const column = near_tap<K>(u, tx), row = near_tap<K>(v, ty);
          T const* const taps = patch.pixels + (row * Patch<T>::kPitch + column + origin);
          slopes.set(tx, ty);
#pragma unroll
          for (int k = 0; k < N; ++k)
            slopes.add([&](int j, int i) { return read(taps[k * Patch<T>::kSize + j * Patch<T>::kPitch + i]); }, g[k]);
        } else {
          places.near(y, x, u, v);
        }
        u += F(tile.u);
        v += F(tile.v);
        if (!patch.fits) {
          Window<K, F> const window(p, u, v);
          slopes.set(window.tx, window.ty);
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
        if (!p.places.has_map()) {
          F const scale = reciprocal(places.weight(y, x)), to_u = slopes.along_x * scale, to_v = slopes.along_y * scale;
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
  if (p.places.has_map()) return;
  add_block(sums, p.sums + int64_t(blockIdx.x) * 9);
}

// A block a sample.
template <class T>
__global__ void matrix_samples(MatrixGradient<T> p) {
  int64_t const b = blockIdx.x;
  double* const total = add_parts<9>(p.sums + b * p.parts * 9, p.parts);
  MatrixUse const& use = p.places.use;
  if (threadIdx.x == 0)
    homography_vjp(p.places.matrices + b * p.places.matrix_stride, use, total, p.grad + b * 3 * use.rows);
}

}  // namespace

template <class T>
int sample_slopes(SampleSlopes<T> const& p, CUstream_st* stream) {
  Tiles const tiles(p.grad.batch, p.grad.height, p.grad.width, tile_row(p.grad.batch, p.grad.height, p.grad.width));
  with_taps(p.interpolation, [&](auto taps) {
    slope_tiles<T, taps.value>
        <<<tiles.count, kThreads, Patch<T>::bytes(p.x.channels, p.places), stream>>>(p, tiles, rows_are_aligned(p.x));
  });
  return cudaGetLastError();
}

template <class T>
int matrix_gradient(MatrixGradient<T> const& p, CUstream_st* stream) {
  matrix_samples<T><<<unsigned(p.batch), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE(sample_slopes, SampleSlopes)
KV_INSTANTIATE_COMPUTED(matrix_gradient, MatrixGradient)

}  // namespace kv::cuda
