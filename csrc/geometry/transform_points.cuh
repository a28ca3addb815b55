// Loads and stores adjacent points of a thread, in accesses of 16 bytes where possible.
#pragma once

#include "core/launch.cuh"
#include "geometry/transform_points.h"

namespace kv::geometry::cuda {

constexpr int kRun = 4;

// Adjacent points of a thread. Runs begin at every fourth of all points, so that they are vectors whatever the number
// of points of a matrix is: the first and the last run of a matrix may contain points of others.
struct Run {
  int64_t first;   // among all points
  int begin, end;  // those of the matrix
  bool is_vector;

  // The run that contains point `at` of a matrix whose points begin at `start`, or would if it had as many. Points from
  // `limit` on are left out.
  __device__ __forceinline__ Run(int64_t start, int64_t at, int64_t limit, bool vectorized)
      : first(start + at), begin(at < 0 ? int(-at) : 0), end(int(min(limit - at, int64_t(kRun)))) {
    is_vector = vectorized && begin == 0 && end == kRun;
  }
  __device__ __forceinline__ bool has(int i) const { return i >= begin && i < end; }
  // Points of other matrices in the first run of the matrix whose points begin at `start`.
  static __device__ __forceinline__ int before(int64_t start) { return int(start) & (kRun - 1); }
};

// Whether runs can be read in vectors.
template <class T>
bool is_vectorizable(T const* a, T const* b, T const* c) {
  uintptr_t const at = reinterpret_cast<uintptr_t>(a) | reinterpret_cast<uintptr_t>(b) | reinterpret_cast<uintptr_t>(c);
  return at % alignof(Vector<T, kRun>) == 0;
}

// Reads K coordinates of each point of a run into the columns from `column` on.
template <int K, class T, class F, int W>
__device__ __forceinline__ void load_points(T const* from, Run const& run, F (&p)[kRun][W], int column = 0) {
  from += run.first * K;
  if (run.is_vector) {
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
      for (int k = 0; k < K; ++k) p[i][column + k] = run.has(i) ? F(read(from[i * K + k])) : F(0);
  }
}
template <int K, class T, class F, int W>
__device__ __forceinline__ void store_points(T* to, Run const& run, F const (&p)[kRun][W], int column = 0) {
  to += run.first * K;
  if (run.is_vector) {
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
        if (run.has(i)) to[i * K + k] = round_to<T>(p[i][column + k]);
  }
}
// The arguments of a map: the points, and for unproject their depths.
template <class Map, class T, class F>
__device__ __forceinline__ void load_arguments(T const* points, T const* depth, Run const& run, F (&p)[kRun][Map::in]) {
  if constexpr (__is_same(Map, Unproject)) {
    load_points<2>(points, run, p);
    load_points<1>(depth, run, p, 2);
  } else {
    load_points<Map::in>(points, run, p);
  }
}

}  // namespace kv::geometry::cuda
