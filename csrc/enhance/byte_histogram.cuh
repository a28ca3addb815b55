// Histograms of 8-bit levels in shared memory, and vectorized loads of pixels. Included by *.cu files.
#pragma once

#include "byte_histogram.h"
#include "core/block_reduce.cuh"
#include "core/row_vectors.cuh"

namespace kv::enhance {

// x, clamped to [0, 1]; 0 for NaN.
__device__ __forceinline__ float saturated(float x) { return __saturatef(x); }
__device__ __forceinline__ double saturated(double x) { return fmin(fmax(x, 0.0), 1.0); }

template <class T>
__device__ __forceinline__ int level_of(T stored) {
  if constexpr (sizeof(T) == 1) return stored;
  using F = Compute<T>;
  F const pixel = read(stored);
  F x = saturated(pixel) * 255;
  if constexpr (sizeof(T) == 2) x = read(round_to<T>(x));
  int const level = int(x);
  return pixel == pixel ? level : kNanLevel;
}

// Pixels of a vector of 16 bytes. float64, which is rare, has single pixels: each form costs compile time.
template <class T>
constexpr int kRowVector = sizeof(T) == 8 ? 1 : 16 / int(sizeof(T));

// Calls f(vector, i) for the pixels [begin, end) of a flat plane, each in one vector that begins at pixel i: aligned
// vectors of P pixels, and peeled ones of a single pixel. P is 1 if pixels are not adjacent. Each thread issues several
// loads before it uses one.
template <int Threads, int P, class T, class F>
__device__ __forceinline__ void for_each_vector(T const* x, int64_t step, int begin, int end, F f) {
  constexpr int kAtOnce = P > 8 ? 2 : 4;
  AlignedBody<P, int> const body(x, begin, end);
  body.for_each_peeled([&](int i) { f(Vector<T, 1>{x[i]}, i); });
  for (int64_t first = body.begin + int(threadIdx.x) * P; first < body.end; first += Threads * P * kAtOnce) {
    Vector<T, P> vectors[kAtOnce];
#pragma unroll
    for (int k = 0; k < kAtOnce; ++k) {
      int64_t const i = first + k * Threads * P;
      if (i < body.end) vectors[k] = *reinterpret_cast<Vector<T, P> const*>(x + i * step);
    }
#pragma unroll
    for (int k = 0; k < kAtOnce; ++k) {
      int64_t const i = first + k * Threads * P;
      if (i < body.end) f(vectors[k], int(i));
    }
  }
}

// Level counts in shared memory, aligned to 16 bytes, with `Copies` counters per level. Neighboring pixels often have
// the same level, and atomic additions to the same counter are serialized. The copies of a level are adjacent, so they
// are in different banks.
template <int Copies>
struct LevelCounter {
  static constexpr int kSize = (kNanLevel + 1) * Copies;  // NaN is counted without use: leaving it out takes a branch
  int32_t* counts;
  template <int Threads>
  __device__ __forceinline__ void clear() const {
    constexpr int kVectors = kLevels * Copies / 4;
#pragma unroll
    for (int first = 0; first < kVectors; first += Threads) {
      int const i = first + int(threadIdx.x);
      if (kVectors % Threads == 0 || i < kVectors) reinterpret_cast<int4*>(counts)[i] = int4{};
    }
  }
  __device__ __forceinline__ void add(int level) const { atomicAdd(counts + level * Copies + threadIdx.x % Copies, 1); }
  __device__ __forceinline__ int operator[](int level) const {
    constexpr int kEach = Copies < 4 ? Copies : 4, kVectors = Copies / kEach;
    auto const* const vectors = reinterpret_cast<Vector<int32_t, kEach> const*>(counts) + level * kVectors;
    int const first = level * Copies / 32;  // threads with adjacent levels read different banks at a time
    int sum = 0;
#pragma unroll
    for (int i = 0; i < kVectors; ++i)
      for (int32_t const count : vectors[(first + i) & (kVectors - 1)].v) sum += count;
    return sum;
  }
};

// An inclusive prefix sum of `count` over the threads of the block, and the total.
template <int Threads>
__device__ __forceinline__ int block_inclusive_scan(int count, int& total) {
  __shared__ __align__(16) int sums[Threads / 32];  // so that no vector of them has another variable
  int const lane = threadIdx.x % 32, warp = threadIdx.x / 32;
  int sum = warp_prefix_sum(count);
  __syncthreads();  // an earlier sum may still use the memory
  if (lane == 31) sums[warp] = sum;
  __syncthreads();
  total = 0;
#pragma unroll
  for (int i = 0; i < Threads / 32; ++i) {
    if (i < warp) sum += sums[i];
    total += sums[i];
  }
  return sum;
}

}  // namespace kv::enhance
