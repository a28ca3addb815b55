// Traversal of two tensors on CUDA, element by element: one block per chunk of a row, 16 bytes of both at a time per
// thread. Included by *.cu files.
#pragma once

#include "core/row_sums.cuh"
#include "core/row_vectors.cuh"
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

// Elements of a vector of 16 bytes, and how many vectors a thread has in flight.
template <class T>
constexpr int kVectorSize = 16 / int(sizeof(T));
template <int P>
constexpr int kAtOnce = P == 1 ? 4 : 2;

// Calls f(element, x, y) for the elements of a chunk: arrays of P elements, and of one where elements are peeled. If P
// is not 1, rows have the same alignment.
template <int P, class T, class Call>
__device__ __forceinline__ void for_each_vector(Pair<T> const& pair, int64_t row, int64_t chunk, Call f) {
  using F = Compute<T>;
  int64_t const begin = chunk * kPointChunk;
  T const *const x = pair.x + row * pair.x_stride + begin, *const y = pair.y + row * pair.y_stride + begin;
  AlignedBody<P, int> const body(x, 0, int(min(kPointChunk, pair.size - begin)));
  body.for_each_peeled([&](int e) {
    F const u[1] = {read(x[e])}, v[1] = {read(y[e])};
    f(begin + e, u, v);
  });
#pragma unroll 1
  for (int e = body.begin + P * int(threadIdx.x); e < body.end; e += kAtOnce<P> * P * kSumThreads) {
    Vector<T, P> a[kAtOnce<P>], b[kAtOnce<P>];
#pragma unroll
    for (int k = 0; k < kAtOnce<P>; ++k)
      if (int const at = e + k * P * kSumThreads; at < body.end) {
        a[k] = *reinterpret_cast<Vector<T, P> const*>(x + at);
        b[k] = *reinterpret_cast<Vector<T, P> const*>(y + at);
      }
#pragma unroll
    for (int k = 0; k < kAtOnce<P>; ++k)
      if (int const at = e + k * P * kSumThreads; at < body.end) {
        F u[P], v[P];
#pragma unroll
        for (int i = 0; i < P; ++i) u[i] = read(a[k].v[i]), v[i] = read(b[k].v[i]);
        f(begin + at, u, v);
      }
  }
}

// Stores the sum of loss(x, y) over the block's chunk in `partial`.
template <int P, class T, class Loss>
__device__ __forceinline__ void sum_chunk(Pair<T> const& pair, int64_t row, int64_t chunks, Compute<T>* partial,
                                          Loss loss) {
  Compute<T> sum = 0;
  for_each_vector<P>(pair, row, blockIdx.x - row * chunks, [&](int64_t, auto const& x, auto const& y) {
#pragma unroll
    for (int i = 0; i < int(sizeof(x) / sizeof(*x)); ++i) sum += loss(x[i], y[i]);
  });
  sum = block_sum<kSumThreads>(sum);
  if (threadIdx.x == 0) partial[blockIdx.x] = sum;
}

// Stores value(element, x, y) in `out` for the block's chunk.
template <int P, class T, class Value>
__device__ __forceinline__ void map_chunk(Pair<T> const& pair, int64_t row, int64_t chunks, T* out, Value value) {
  for_each_vector<P>(pair, row, blockIdx.x - row * chunks, [&](int64_t e, auto const& x, auto const& y) {
    constexpr int N = sizeof(x) / sizeof(*x);
    Compute<T> result[N];
#pragma unroll
    for (int i = 0; i < N; ++i) result[i] = value(row * pair.size + e + i, x[i], y[i]);
    store_vector(out + row * pair.size + e, result);
  });
}

// Whether vectors of both tensors, and of a result like them or null, have the same alignment in every row.
template <class T>
bool are_equally_aligned(Pair<T> const& pair, T const* result) {
  auto const view = [&](T const* data, int64_t stride) {
    return Planes<T const>{data, pair.rows, 1, stride, 0, 0, 1, pair.size, 1};
  };
  auto const x = view(pair.x, pair.x_stride);
  return kv::are_equally_aligned<kVectorSize<T>>(x, view(pair.y, pair.y_stride)) &&
         (!result || kv::are_equally_aligned<kVectorSize<T>>(x, view(result, pair.size)));
}

}  // namespace
}  // namespace kv::metrics::cuda
