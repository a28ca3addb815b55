// Heat maps of Gaussians on CUDA: one block for a few rows of a plane. Its threads first sum the weights of both axes,
// then take four pixels at a time. A second kernel adds the gradients of planes that have several chunks.
#include "core/block_reduce.cuh"
#include "geometry/subpix/plane_vectors.cuh"
#include "geometry/subpix/render_gaussian2d.h"

namespace kv::geometry::cuda {
namespace {

// The weight of a pixel, relative to the largest one.
template <class F>
__device__ __forceinline__ F weight_of(F q) {
  return fast_exp2(q * F(-.5 * 1.44269504088896340736));
}

template <class F>
struct BlockAxes {
  GaussianAxis<F> x, y;

  template <class T>
  __device__ __forceinline__ BlockAxes(RenderGaussian2d<T> const& p, int64_t plane)
      : x(gaussian_axis(p, plane, 0, [](T v) { return read(v); })),
        y(gaussian_axis(p, plane, 1, [](T v) { return read(v); })) {
    F sums[6] = {};
    add(x, p.width, sums);
    add(y, p.height, sums + 3);
    block_reduce<kThreads>(sums, Sum());
    x.take({sums[0], sums[1], sums[2]});
    y.take({sums[3], sums[4], sums[5]});
  }
  static __device__ __forceinline__ void add(GaussianAxis<F> const& axis, int64_t size, F* sums) {
    for (unsigned i = threadIdx.x; i < unsigned(size); i += kThreads) {
      F const u = axis.u(F(i)), q = axis.q(u), w = weight_of(q);
      sums[0] += w;
      if (w != 0) sums[1] += w * u, sums[2] += w * q;  // q may be inf where w is 0
    }
  }
};

template <class T>
__global__ void __launch_bounds__(kThreads)
    draw(__grid_constant__ RenderGaussian2d<T> const p, unsigned chunks, bool vectorized) {
  using F = Compute<T>;
  int64_t const plane = blockIdx.x / chunks;
  BlockAxes<F> const axes(p, plane);
  F const normalizer = axes.x.normalizer * axes.y.normalizer;
  T* const to = p.maps + plane * p.height * p.width;
  for_each_vector<T>(p, blockIdx.x - plane * chunks, vectorized, [&](auto count, unsigned i, unsigned x, unsigned row) {
    constexpr int P = decltype(count)::value;
    F const down = normalizer * weight_of(axes.y.q(axes.y.u(F(row))));
    F v[P];
#pragma unroll
    for (int k = 0; k < P; ++k) v[k] = down * weight_of(axes.x.q(axes.x.u(F(x + k))));
    store_vector(to + i, v);
  });
}

template <class T>
__global__ void __launch_bounds__(kThreads)
    draw_backward(__grid_constant__ RenderGaussian2d<T> const p, unsigned chunks, bool vectorized) {
  using F = Compute<T>;
  int64_t const plane = blockIdx.x / chunks;
  BlockAxes<F> const axes(p, plane);
  T const* const from = p.grad + plane * p.height * p.width;
  F sums[4] = {};
  for_each_vector<T>(p, blockIdx.x - plane * chunks, vectorized, [&](auto count, unsigned i, unsigned x, unsigned row) {
    constexpr int P = decltype(count)::value;
    Vector<T, P> const vector = *reinterpret_cast<Vector<T, P> const*>(from + i);
    F const v = axes.y.u(F(row)), r = axes.y.q(v), down = weight_of(r);
    F all = 0;
#pragma unroll
    for (int k = 0; k < P; ++k) {
      F const u = axes.x.u(F(x + k)), q = axes.x.q(u), w = weight_of(q);
      if (w == 0 || down == 0) continue;
      F const g = w * down * read(vector.v[k]);
      all += g, sums[0] += g * (u - axes.x.mean_u), sums[2] += g * (q - axes.x.mean_q);
    }
    if (down != 0) sums[1] += all * (v - axes.y.mean_u), sums[3] += all * (r - axes.y.mean_q);
  });
  block_reduce<kThreads>(sums, Sum());
  if (threadIdx.x >= 4) return;
  F const sum = threadIdx.x == 0 ? sums[0] : threadIdx.x == 1 ? sums[1] : threadIdx.x == 2 ? sums[2] : sums[3];
  F const gradient = sum * (threadIdx.x % 2 ? axes.y.inverse : axes.x.inverse) * axes.x.normalizer * axes.y.normalizer;
  if (chunks > 1)
    p.partial[4 * blockIdx.x + threadIdx.x] = gradient;
  else
    (threadIdx.x < 2 ? p.grad_mean : p.grad_std)[2 * plane + threadIdx.x % 2] = round_to<T>(gradient);
}

template <class T>
__global__ void __launch_bounds__(kThreads)
    add_chunks_of_plane(__grid_constant__ RenderGaussian2d<T> const p, unsigned chunks) {
  Compute<T> sums[4] = {};
  for (unsigned i = threadIdx.x; i < chunks; i += kThreads)
#pragma unroll
    for (int k = 0; k < 4; ++k) sums[k] += p.partial[4 * (int64_t(blockIdx.x) * chunks + i) + k];
  block_reduce<kThreads>(sums, Sum());
  if (threadIdx.x != 0) return;
#pragma unroll
  for (int k = 0; k < 4; ++k) (k < 2 ? p.grad_mean : p.grad_std)[2 * blockIdx.x + k % 2] = round_to<T>(sums[k]);
}

}  // namespace

template <class T>
int render_gaussian2d(RenderGaussian2d<T> const& p, CUstream_st* stream) {
  unsigned const chunks = unsigned(p.chunks());
  draw<<<unsigned(p.planes) * chunks, kThreads, 0, stream>>>(p, chunks, is_vectorizable<T>(p.width, {p.maps}));
  return cudaGetLastError();
}

template <class T>
int render_gaussian2d_backward(RenderGaussian2d<T> const& p, CUstream_st* stream) {
  unsigned const chunks = unsigned(p.chunks());
  draw_backward<<<unsigned(p.planes) * chunks, kThreads, 0, stream>>>(p, chunks, is_vectorizable<T>(p.width, {p.grad}));
  if (chunks > 1) add_chunks_of_plane<<<unsigned(p.planes), kThreads, 0, stream>>>(p, chunks);
  return cudaGetLastError();
}

KV_INSTANTIATE(render_gaussian2d, RenderGaussian2d)
KV_INSTANTIATE(render_gaussian2d_backward, RenderGaussian2d)

}  // namespace kv::geometry::cuda
