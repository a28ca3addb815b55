// CUDA kernel for add_weighted: each thread computes two vectors.
#include "add_weighted.h"
#include "core/launch.cuh"

namespace kv::enhance::cuda {
namespace {

constexpr int kThreads = 256, kVectors = 2;

template <class T, bool Vectorized>
__global__ void __launch_bounds__(kThreads) run(__grid_constant__ AddWeighted<T> const p) {
  using F = Compute<T>;
  constexpr int P = Vectorized ? kPixels<T> : 1;
  int64_t const first = (blockIdx.x * int64_t(kVectors * kThreads) + threadIdx.x) * P, step = p.x.step;
  for (int64_t plane = blockIdx.y; plane < p.x.count(); plane += gridDim.y) {
    F const a = p.weight_of(p.alpha, plane), b = p.weight_of(p.beta, plane), c = p.weight_of(p.gamma, plane);
    T const *const x = p.x.plane(plane), *const y = p.y.plane(plane);
    T* const result = p.result.plane(plane);
    Vector<T, P> xs[kVectors], ys[kVectors];
#pragma unroll
    for (int k = 0; k < kVectors; ++k) {
      int64_t const i = first + k * kThreads * P;
      if (i >= p.x.width) break;
      xs[k] = *reinterpret_cast<Vector<T, P> const*>(x + i * step);
      ys[k] = *reinterpret_cast<Vector<T, P> const*>(y + i * step);
    }
#pragma unroll
    for (int k = 0; k < kVectors; ++k) {
      int64_t const i = first + k * kThreads * P;
      if (i >= p.x.width) break;
      F v[P];
#pragma unroll
      for (int j = 0; j < P; ++j) v[j] = read(xs[k].v[j]) * a + read(ys[k].v[j]) * b + c;
      store_vector(result + i * step, v);
    }
  }
}

}  // namespace

template <class T>
int add_weighted(AddWeighted<T> const& p, CUstream_st* stream) {
  constexpr int P = kPixels<T>;
  with_alignment<T>(is_vectorizable<P>(p.x) && is_vectorizable<P>(p.y) && is_vectorizable<P>(p.result),
                    [&](auto vectorized) {
                      dim3 const blocks(unsigned(ceil_div(p.x.width, kVectors * kThreads * (vectorized.value ? P : 1))),
                                        unsigned(min(p.x.count(), int64_t(65535))));
                      run<T, vectorized.value><<<blocks, kThreads, 0, stream>>>(p);
                    });
  return cudaGetLastError();
}

KV_INSTANTIATE(add_weighted, AddWeighted)

}  // namespace kv::enhance::cuda
