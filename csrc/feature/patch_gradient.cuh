// Patches in shared memory: one block for each patch. Included by *.cu files.
#pragma once

#include "core/block_reduce.cuh"
#include "patch_gradient.h"

namespace kv::feature::cuda {
namespace {

// n x n numbers in shared memory; out of bounds they repeat the border.
template <class F>
struct SharedPatch {
  F* data;
  int n;

  // The neighbors of pixel (y, x), with the sign changed out of bounds along x or y.
  template <int SignX = 1, int SignY = 1>
  __device__ __forceinline__ auto around(int y, int x) const {
    return [this, y, x](int dy, int dx) {
      int const row = y + dy, column = x + dx, r = clamp(row, 0, n - 1), c = clamp(column, 0, n - 1);
      F const value = data[r * n + c];
      return (SignX < 0 && c != column) != (SignY < 0 && r != row) ? -value : value;
    };
  }
  template <class T>
  __device__ __forceinline__ void read_from(T const* from) const {
    for (int i = threadIdx.x; i < n * n; i += blockDim.x) data[i] = read(from[i]);
  }
};

// Calls f(index, y, x) for the thread's pixels.
template <class Call>
__device__ __forceinline__ void for_each_pixel(int n, Call f) {
  for (int i = threadIdx.x; i < n * n; i += blockDim.x) {
    int const y = i / n;
    f(i, y, i - y * n);
  }
}

template <class T, class F>
__device__ __forceinline__ void write_patch_gradient(T* to, Stencil<F> stencil, SharedPatch<F> u, SharedPatch<F> v) {
  for_each_pixel(u.n, [&](int i, int y, int x) {
    to[i] = round_to<T>(patch_gradient_vjp(stencil, u.template around<-1, 1>(y, x), v.template around<1, -1>(y, x)));
  });
}

// Lets a kernel have `bytes` of shared memory.
template <class Kernel>
inline int allow_shared(Kernel kernel, size_t bytes) {
  if (bytes <= 48 << 10) return 0;
  return cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, int(bytes));
}

}  // namespace
}  // namespace kv::feature::cuda
