// Affine shapes on CUDA: one block for each patch, which sums in a fixed order.
#include "affine_shape.h"
#include "patch_gradient.cuh"

namespace kv::feature::cuda {
namespace {

constexpr int kThreads = 128;

extern __shared__ double shared_memory[];

// The sums of a patch, for all threads. The weights along an axis are behind the patch.
template <class T, class F>
__device__ __forceinline__ void sum_moments(SharedPatch<F> patch, F* weights, T const* from, F scale, F (&m)[3]) {
  patch.read_from(from);
  for (int i = threadIdx.x; i < patch.n; i += kThreads) weights[i] = shape_weight<F>(i, patch.n);
  __syncthreads();
  m[0] = m[1] = m[2] = 0;
  for_each_pixel(patch.n, [&](int, int y, int x) {
    auto const g = patch_gradient(sobel_stencil<F>(), patch.around(y, x));
    F const w = weights[y] * weights[x];
    m[0] += w * g.x * g.x, m[1] += w * g.x * g.y, m[2] += w * g.y * g.y;
  });
  block_reduce<kThreads>(m, Sum());
  for (int i = 0; i < 3; ++i) m[i] *= scale;
}

template <class T>
__global__ void __launch_bounds__(kThreads) shape_patch(__grid_constant__ AffineShape<T> const p) {
  using F = Compute<T>;
  SharedPatch<F> const patch{reinterpret_cast<F*>(shared_memory), p.n};
  F m[3];
  sum_moments(patch, patch.data + p.n * p.n, p.patches + int64_t(blockIdx.x) * p.n * p.n, p.scale, m);
  to_shape(m, p.eps);
  if (threadIdx.x == 0)
    for (int i = 0; i < 3; ++i) p.shapes[int64_t(blockIdx.x) * 3 + i] = round_to<T>(m[i]);
}

template <class T>
__global__ void __launch_bounds__(kThreads) shape_patch_backward(__grid_constant__ AffineShapeBackward<T> const p) {
  using F = Compute<T>;
  int const n = p.n;
  int64_t const first = int64_t(blockIdx.x) * n * n;
  SharedPatch<F> const patch{reinterpret_cast<F*>(shared_memory), n};
  F* const weights = patch.data + n * n;
  SharedPatch<F> const u{weights + n, n}, v{u.data + n * n, n};
  F m[3], g[3];
  sum_moments(patch, weights, p.patches + first, p.scale, m);
  for (int i = 0; i < 3; ++i) g[i] = read(p.grad[int64_t(blockIdx.x) * 3 + i]);
  to_shape_vjp(m, p.eps, g);
  for_each_pixel(n, [&](int i, int y, int x) {
    auto const gradient = patch_gradient(sobel_stencil<F>(), patch.around(y, x));
    F const w = weights[x] * (weights[y] * p.scale);
    u.data[i] = w * (gradient.x * (2 * g[0]) + gradient.y * g[1]);
    v.data[i] = w * (gradient.y * (2 * g[2]) + gradient.x * g[1]);
  });
  __syncthreads();
  write_patch_gradient(p.grad_patches + first, sobel_stencil<F>(), u, v);
}

}  // namespace

template <class T>
int affine_shape(AffineShape<T> const& p, CUstream_st* stream) {
  size_t const bytes = (p.n * p.n + p.n) * sizeof(Compute<T>);
  if (int const error = allow_shared(shape_patch<T>, bytes)) return error;
  shape_patch<<<unsigned(p.count), kThreads, bytes, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int affine_shape_backward(AffineShapeBackward<T> const& p, CUstream_st* stream) {
  size_t const bytes = (3 * p.n * p.n + p.n) * sizeof(Compute<T>);
  if (int const error = allow_shared(shape_patch_backward<T>, bytes)) return error;
  shape_patch_backward<<<unsigned(p.count), kThreads, bytes, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE(affine_shape, AffineShape)
KV_INSTANTIATE(affine_shape_backward, AffineShapeBackward)

}  // namespace kv::feature::cuda
