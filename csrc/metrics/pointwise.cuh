// Traversal of two tensors on CUDA, element by element: one block per chunk of a row, four elements of both per thread
// and step. Included by *.cu files.
#pragma once

#include "core/row_sums.cuh"
#include "pointwise.h"

namespace kv::metrics::cuda {
namespace {

template <class F>
struct PointMath {
  __device__ __forceinline__ static F exp(F x) {
    if constexpr (sizeof(F) == 4)
      return ::expf(x);
    else
      return ::exp(x);
  }
  __device__ __forceinline__ static F log(F x) {
    if constexpr (sizeof(F) == 4)
      return ::logf(x);
    else
      return ::log(x);
  }
  __device__ __forceinline__ static F sqrt(F x) { return fast_sqrt(x); }
  __device__ __forceinline__ static F divide(F x, F y) { return x * fast_reciprocal(y); }
};

constexpr int kVectorSize = 4;

// Calls f(first element, x, y) for the elements of chunk `chunk` that the thread processes: with vectors of kVectorSize
// if rows are `vectorized`, which means that they start and end at multiples of a vector; otherwise, and for doubles,
// with single elements. The loop is not unrolled: f is long, and a multiprocessor has enough threads to hide memory
// latency.
template <class T, class Call>
__device__ __forceinline__ void for_each_vector(Pair<T> const& pair, int64_t row, int64_t chunk, bool vectorized,
                                                Call f) {
  using F = Compute<T>;
  T const *const x = pair.x + row * pair.x_stride, *const y = pair.y + row * pair.y_stride;
  int64_t const first = chunk * kPointChunk, last = min(first + kPointChunk, pair.size);
  auto const take = [&](auto width) {
    constexpr int P = decltype(width)::value;
#pragma unroll 1
    for (int64_t e = first + P * threadIdx.x; e < last; e += P * kSumThreads) {
      Vector<T, P> const a = *reinterpret_cast<Vector<T, P> const*>(x + e);
      Vector<T, P> const b = *reinterpret_cast<Vector<T, P> const*>(y + e);
      F u[P], v[P];
#pragma unroll
      for (int i = 0; i < P; ++i) u[i] = read(a.v[i]), v[i] = read(b.v[i]);
      f(row * pair.size + e, u, v);
    }
  };
  if (sizeof(T) < 8 && vectorized)
    take(std::integral_constant<int, sizeof(T) < 8 ? kVectorSize : 1>{});
  else
    take(std::integral_constant<int, 1>{});
}

// Stores the sum of loss(x, y) over the block's chunk in `partial`.
template <class T, class Loss>
__device__ __forceinline__ void sum_chunk(Pair<T> const& pair, int64_t row, int64_t chunks, bool vectorized,
                                          Compute<T>* partial, Loss loss) {
  Compute<T> sum = 0;
  for_each_vector(pair, row, blockIdx.x - row * chunks, vectorized, [&](int64_t, auto const& x, auto const& y) {
#pragma unroll
    for (int i = 0; i < int(sizeof(x) / sizeof(*x)); ++i) sum += loss(x[i], y[i]);
  });
  sum = block_sum<kSumThreads>(sum);
  if (threadIdx.x == 0) partial[blockIdx.x] = sum;
}

// Stores value(element, x, y) in `out` for the block's chunk.
template <class T, class Value>
__device__ __forceinline__ void map_chunk(Pair<T> const& pair, int64_t row, int64_t chunks, bool vectorized, T* out,
                                          Value value) {
  for_each_vector(pair, row, blockIdx.x - row * chunks, vectorized, [&](int64_t e, auto const& x, auto const& y) {
    constexpr int P = sizeof(x) / sizeof(*x);
    Compute<T> result[P];
#pragma unroll
    for (int i = 0; i < P; ++i) result[i] = value(e + i, x[i], y[i]);
    store_vector(out + e, result);
  });
}

template <class T>
bool is_vectorizable(Pair<T> const& pair, void const* other) {
  auto const aligned = [](void const* at) {
    return reinterpret_cast<uintptr_t>(at) % sizeof(Vector<T, kVectorSize>) == 0;
  };
  return aligned(pair.x) && aligned(pair.y) && aligned(other) && pair.size % kVectorSize == 0;
}

}  // namespace
}  // namespace kv::metrics::cuda
