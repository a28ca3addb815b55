// Loads and stores adjacent points of a thread, in accesses of 16 bytes where possible. Included by transform_points.cu
// and transform_points_backward.cu.
#pragma once

#include "core/launch.cuh"
#include "geometry/transform_points.h"

namespace kv::geometry::cuda {

constexpr int kRun = 4;

// Whether the points of every matrix can be read in vectors of four.
template <class T>
bool is_vectorizable_by_4(int64_t count, T const* a, T const* b, T const* c) {
  uintptr_t const at = reinterpret_cast<uintptr_t>(a) | reinterpret_cast<uintptr_t>(b) | reinterpret_cast<uintptr_t>(c);
  return count % kRun == 0 && at % alignof(Vector<T, kRun>) == 0;
}

// Reads K coordinates of each point from point `first` on, n points at most, into the columns from `column` on.
template <int K, class T, class F, int W>
__device__ __forceinline__ void load_points(T const* from, int64_t first, int n, bool vectorized, F (&p)[kRun][W],
                                            int column = 0) {
  from += first * K;
  if (vectorized) {
#pragma unroll
    for (int k = 0; k < K; ++k) {
      Vector<T, kRun> const vector = reinterpret_cast<Vector<T, kRun> const*>(from)[k];
#pragma unroll
      for (int i = 0; i < kRun; ++i) p[(k * kRun + i) / K][column + (k * kRun + i) % K] = read(vector.v[i]);
    }
  } else {
#pragma unroll
    for (int i = 0; i < kRun; ++i)
#pragma unroll
      for (int k = 0; k < K; ++k) p[i][column + k] = i < n ? F(read(from[i * K + k])) : F(0);
  }
}
template <int K, class T, class F, int W>
__device__ __forceinline__ void store_points(T* to, int64_t first, int n, bool vectorized, F const (&p)[kRun][W],
                                             int column = 0) {
  to += first * K;
  if (vectorized) {
#pragma unroll
    for (int k = 0; k < K; ++k) {
      F vector[kRun];
#pragma unroll
      for (int i = 0; i < kRun; ++i) vector[i] = p[(k * kRun + i) / K][column + (k * kRun + i) % K];
      store_vector(to + k * kRun, vector);
    }
  } else {
#pragma unroll
    for (int i = 0; i < kRun; ++i)
#pragma unroll
      for (int k = 0; k < K; ++k)
        if (i < n) to[i * K + k] = round_to<T>(p[i][column + k]);
  }
}
// The arguments of a map: the points, and for unproject their depths.
template <class Map, class T, class F>
__device__ __forceinline__ void load_arguments(T const* points, T const* depth, int64_t first, int n, bool vectorized,
                                               F (&p)[kRun][Map::in]) {
  if constexpr (__is_same(Map, Unproject)) {
    load_points<2>(points, first, n, vectorized, p);
    load_points<1>(depth, first, n, vectorized, p, 2);
  } else {
    load_points<Map::in>(points, first, n, vectorized, p);
  }
}

}  // namespace kv::geometry::cuda
