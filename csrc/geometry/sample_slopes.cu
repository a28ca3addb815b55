// The gradient to places and matrices on CUDA; see sample.h.
#include "sample.cuh"

namespace kv::cuda {
namespace {

template <class T, int K, bool matrix>
__global__ void __launch_bounds__(kThreads, K == 4 ? 2 : 3)
    slope_tiles(__grid_constant__ SampleSlopes<T> const p, Tiles tiles) {
  using F = Compute<T>;
  __shared__ Homography<F> map;
  int64_t b;
  int y0, x0;
  tiles.place(b, y0, x0);
  By<matrix, F> const by(p.places, map, b);
  int const x = x0 + column_in_tile();
  T const* const source = p.x.row(b, 0, 0);
  T const* const grad = p.grad.row(b, 0, 0);
  int const row = int(p.x.row_stride), step = int(p.x.step);  // a plane has less than 2^31 elements
  F sums[9] = {};
#pragma unroll 1
  for (int run = 0; run < kRuns; ++run) {
    int const y = y0 + row_in_tile(run);
    if (x >= p.grad.width || y >= p.grad.height) break;
    F u, v;
    by.at(b, y, x, u, v);
    Window<K, F> const window(p, u, v);
    F wx[K], wy[K], dx[K], dy[K];
    tap_weights(window.tx, wx);
    tap_weights(window.ty, wy);
    tap_slopes(window.tx, dx);
    tap_slopes(window.ty, dy);
    int const from = window.y * row + window.x * step, to = y * int(p.grad.row_stride) + x * int(p.grad.step);
    F to_u = 0, to_v = 0;
#pragma unroll 1
    for (int first = 0; first < p.x.channels; first += kAtOnce<K>) {
      F values[kAtOnce<K>][K][K];
#pragma unroll
      for (int k = 0; k < kAtOnce<K>; ++k) {
        if (first + k >= p.x.channels) break;
        T const* const plane = source + (first + k) * p.x.channel_stride;
        if (window.inside) {
#pragma unroll
          for (int j = 0; j < K; ++j)
#pragma unroll
            for (int i = 0; i < K; ++i) values[k][j][i] = F(read(plane[from + j * row + i * step]));
        } else {
          F const fill = p.fill_of(b, first + k);
          window.for_each(p, row, step,
                          [&](int j, int i, int64_t at) { values[k][j][i] = at < 0 ? fill : F(read(plane[at])); });
        }
      }
#pragma unroll
      for (int k = 0; k < kAtOnce<K>; ++k) {
        if (first + k >= p.x.channels) break;
        F along_x = 0, along_y = 0;
#pragma unroll
        for (int j = 0; j < K; ++j) {
          F line = 0, across = 0;
#pragma unroll
          for (int i = 0; i < K; ++i) {
            line += values[k][j][i] * wx[i];
            across += values[k][j][i] * dx[i];
          }
          along_x += across * wy[j];
          along_y += line * dy[j];
        }
        F const g = F(read(grad[(first + k) * p.grad.channel_stride + to]));
        to_u += g * along_x;
        to_v += g * along_y;
      }
    }
    if constexpr (matrix) {
      F const scale = 1 / map.weight(F(x), F(y));
      F g[] = {to_u * scale, to_v * scale, -(to_u * u + to_v * v) * scale};
#pragma unroll
      for (int i = 0; i < 3; ++i) {
        if (g[i] - g[i] != 0) g[i] = 0;  // a place at infinity has no slope
        sums[3 * i] += g[i] * F(x);
        sums[3 * i + 1] += g[i] * F(y);
        sums[3 * i + 2] += g[i];
      }
    } else {
      p.grad_x.row(b, 0, y)[x] = to_u * p.places.scale[0];
      p.grad_y.row(b, 0, y)[x] = to_v * p.places.scale[1];
    }
  }
  if constexpr (matrix) {
    __shared__ F parts[9][kThreads / 32];
    for (int i = 0; i < 9; ++i) {
      F const sum = warp_sum(sums[i]);
      if (threadIdx.x % 32 == 0) parts[i][threadIdx.x / 32] = sum;
    }
    __syncthreads();
    if (threadIdx.x < 9) {
      double sum = 0;
      for (F const part : parts[threadIdx.x]) sum += part;
      p.sums[int64_t(blockIdx.x) * 9 + threadIdx.x] = sum;
    }
  }
}

// A block a sample.
template <class T>
__global__ void add_parts(MatrixGradient<T> p) {
  __shared__ double parts[9][kThreads / 32], total[9];
  int64_t const b = blockIdx.x;
  double sums[9] = {};
  for (int64_t part = threadIdx.x; part < p.parts; part += kThreads)
    for (int i = 0; i < 9; ++i) sums[i] += p.sums[(b * p.parts + part) * 9 + i];
  for (int i = 0; i < 9; ++i) {
    double const sum = warp_sum(sums[i]);
    if (threadIdx.x % 32 == 0) parts[i][threadIdx.x / 32] = sum;
  }
  __syncthreads();
  if (threadIdx.x != 0) return;
  for (int i = 0; i < 9; ++i) {
    total[i] = 0;
    for (double const part : parts[i]) total[i] += part;
  }
  MatrixUse const& use = p.places.use;
  homography_vjp(p.places.matrices + b * p.places.matrix_stride, use, total, p.grad + b * 3 * use.rows);
}

}  // namespace

template <class T>
int sample_slopes(SampleSlopes<T> const& p, CUstream_st* stream) {
  Tiles const tiles(p.grad.batch, p.grad.height, p.grad.width);
  with_kind(p, [&](auto matrix, auto taps) {
    slope_tiles<T, taps.value, matrix.value><<<tiles.count, kThreads, 0, stream>>>(p, tiles);
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
