// Warps by depth on CUDA: one thread for each pixel of the output, which loops over its channels.
#include "geometry/depth/warp.cuh"

namespace kv::geometry::cuda {
namespace {

template <class T>
__global__ void __launch_bounds__(kThreads) warp_tiles(__grid_constant__ DepthWarp<T> const p, DepthTiles tiles) {
  using F = Compute<T>;
  int64_t b;
  int y, x;
  tiles.locate(b, y, x);
  if (x >= p.y.width || y >= p.y.height) return;
  auto const window = DepthCoords<T>(p, p.projection(b), b, y, x).window(p);
  int64_t const row = p.x.row_stride, step = p.x.step;
  F wx[2], wy[2];
  tap_weights(window.tx, wx);
  tap_weights(window.ty, wy);
  T const* plane = p.x.row(b, 0, 0);
  T* to = p.y.row(b, 0, y) + x * p.y.step;
#pragma unroll 3
  for (int c = 0; c < p.x.channels; ++c) {
    F sum = 0;
    if (window.inside) {
      T const* const from = plane + window.y * row + window.x * step;
      F const a00 = read(from[0]), a01 = read(from[step]), a10 = read(from[row]), a11 = read(from[row + step]);
      sum = (a00 * wx[0] + a01 * wx[1]) * wy[0] + (a10 * wx[0] + a11 * wx[1]) * wy[1];
    }
    if (!window.inside || sum - sum != 0) {  // a tap of weight 0 does not contribute, even if it is NaN or inf
      sum = 0;
      window.for_each(p, row, step, [&](int j, int i, int64_t at) {
        F const weight = wx[i] * wy[j];
        if (at >= 0 && weight != 0) sum += weight * F(read(plane[at]));
      });
    }
    *to = round_to<T>(sum);
    plane += p.x.channel_stride;
    to += p.y.channel_stride;
  }
}

template <class T>
__global__ void __launch_bounds__(kThreads)
    coords_backward_tiles(__grid_constant__ DepthWarpCoordsBackward<T> const p, DepthTiles tiles) {
  using F = Compute<T>;
  int64_t b;
  int y, x;
  tiles.locate(b, y, x);
  F sums[kProjectionSums] = {};
  if (x < p.grad.width && y < p.grad.height) {
    auto const projection = p.projection(b);
    DepthCoords<T> const coords(p, projection, b, y, x);
    auto const window = coords.window(p);
    int64_t const row = p.x.row_stride, step = p.x.step;
    F wx[2], wy[2], grad_u = 0, grad_v = 0;
    tap_weights(window.tx, wx);
    tap_weights(window.ty, wy);
    T const* plane = p.x.row(b, 0, 0);
    T const* grad = p.grad.row(b, 0, y) + x * p.grad.step;
#pragma unroll 3
    for (int c = 0; c < p.x.channels; ++c) {
      F a[2][2] = {};
      if (window.inside) {
        T const* const from = plane + window.y * row + window.x * step;
        a[0][0] = read(from[0]), a[0][1] = read(from[step]), a[1][0] = read(from[row]),
        a[1][1] = read(from[row + step]);
      } else {
        window.for_each(p, row, step, [&](int j, int i, int64_t at) {
          if (at >= 0) a[j][i] = read(plane[at]);
        });
      }
      F const g = read(*grad);
      grad_u += g * ((a[0][1] - a[0][0]) * wy[0] + (a[1][1] - a[1][0]) * wy[1]);
      grad_v += g * ((a[1][0] - a[0][0]) * wx[0] + (a[1][1] - a[0][1]) * wx[1]);
      plane += p.x.channel_stride;
      grad += p.grad.channel_stride;
    }
    if (p.interpolation == Interpolation::nearest) grad_u = grad_v = 0;
    F g[3];
    p.grad_depth[(b * p.grad.height + y) * p.grad.width + x] =
        projection.vjp(coords.x, coords.y, coords.u, coords.v, coords.scale, grad_u, grad_v, g);
    add_to_projection(g, coords.x, coords.y, coords.d, sums);
  }
  store_block_sums<kThreads>(sums, p.sums + int64_t(blockIdx.x) * kProjectionSums);
}

// Adds with atomics into a gradient that starts as zeros.
template <class F>
__global__ void __launch_bounds__(kThreads)
    scatter_tiles(__grid_constant__ DepthWarpImageBackward<F> const p, DepthTiles tiles) {
  int64_t b;
  int y, x;
  tiles.locate(b, y, x);
  if (x >= p.grad.width || y >= p.grad.height) return;
  auto const window = DepthCoords<F>(p, p.projection(b), b, y, x).window(p);
  F wx[2], wy[2];
  tap_weights(window.tx, wx);
  tap_weights(window.ty, wy);
  F* const planes = p.grad_x.row(b, 0, 0);
  F const* const grad = p.grad.row(b, 0, y) + x * p.grad.step;
  window.for_each(p, p.grad_x.row_stride, 1, [&](int j, int i, int64_t at) {
    F const weight = wx[i] * wy[j];
    if (at < 0 || weight == 0) return;
    for (int c = 0; c < p.grad.channels; ++c)
      atomicAdd(planes + c * p.grad_x.channel_stride + at, weight * grad[c * p.grad.channel_stride]);
  });
}

// One block for each sample.
template <class T>
__global__ void __launch_bounds__(kThreads) total_of(ProjectionTotal<T> p) {
  __shared__ double total[12];
  int64_t const b = blockIdx.x, count = p.parts * p.views;
  double const* const from = p.sums + b * count * kProjectionSums;
  double inverse_terms = 1;
  if (p.loss) {
    double sums[2] = {};
    for (int64_t i = threadIdx.x; i < count; i += kThreads)
      for (int k = 0; k < 2; ++k) sums[k] += from[i * kProjectionSums + 12 + k];
    store_block_sums<kThreads>(sums, total);
    __syncthreads();
    double const terms = total[1] * double(p.channels);
    inverse_terms = terms > 0 ? 1 / terms : 0;
    if (threadIdx.x == 0) {
      p.loss[b] = T(total[0] / terms);
      p.inverse_terms[b] = T(inverse_terms);
    }
    __syncthreads();
  }
  for (int view = 0; view < p.views; ++view) {
    double sums[12] = {};
    for (int64_t part = threadIdx.x; part < p.parts; part += kThreads)
      for (int i = 0; i < 12; ++i) sums[i] += from[(part * p.views + view) * kProjectionSums + i];
    store_block_sums<kThreads>(sums, total);
    if (threadIdx.x < 12) p.grad[(b * p.views + view) * 12 + threadIdx.x] = T(total[threadIdx.x] * inverse_terms);
  }
}

}  // namespace

template <class T>
int depth_warp(DepthWarp<T> const& p, CUstream_st* stream) {
  DepthTiles const tiles(p.y.batch, p.y.height, p.y.width);
  warp_tiles<T><<<tiles.count, kThreads, 0, stream>>>(p, tiles);
  return cudaGetLastError();
}

template <class T>
int depth_warp_coords_backward(DepthWarpCoordsBackward<T> const& p, CUstream_st* stream) {
  DepthTiles const tiles(p.grad.batch, p.grad.height, p.grad.width);
  coords_backward_tiles<T><<<tiles.count, kThreads, 0, stream>>>(p, tiles);
  return cudaGetLastError();
}

template <class F>
int depth_warp_image_backward(DepthWarpImageBackward<F> const& p, CUstream_st* stream) {
  int64_t const count = p.grad_x.batch * p.grad_x.channels * p.grad_x.height * p.grad_x.width;
  if (int const error = cudaMemsetAsync(p.grad_x.data, 0, size_t(count) * sizeof(F), stream)) return error;
  DepthTiles const tiles(p.grad.batch, p.grad.height, p.grad.width);
  scatter_tiles<F><<<tiles.count, kThreads, 0, stream>>>(p, tiles);
  return cudaGetLastError();
}

template <class T>
int projection_total(ProjectionTotal<T> const& p, CUstream_st* stream) {
  total_of<T><<<unsigned(p.batch), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE(depth_warp, DepthWarp)
KV_INSTANTIATE(depth_warp_coords_backward, DepthWarpCoordsBackward)
KV_INSTANTIATE_COMPUTED(depth_warp_image_backward, DepthWarpImageBackward)
KV_INSTANTIATE_COMPUTED(projection_total, ProjectionTotal)

}  // namespace kv::geometry::cuda
