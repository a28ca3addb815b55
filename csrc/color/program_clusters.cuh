// Color programs around a mean in one launch: what the blocks of a cluster do, which have a sample.
#pragma once

#include "core/cluster.cuh"
#include "program.cuh"
#include "program_clusters.h"

namespace kv::color::cuda {
namespace {

constexpr int kClusterThreads = 512;
constexpr int P = 4;  // pixels of a thread at a time
using Values = float[3][P];

__device__ __forceinline__ void load(float const* at, int64_t plane, Values& c) {
#pragma unroll
  for (int k = 0; k < 3; ++k) {
    auto const vector = *reinterpret_cast<Vector<float, P> const*>(at + k * plane);
#pragma unroll
    for (int j = 0; j < P; ++j) c[k][j] = vector.v[j];
  }
}
__device__ __forceinline__ void keep(float* at, int plane, Values const& c) {
#pragma unroll
  for (int k = 0; k < 3; ++k)
    *reinterpret_cast<Vector<float, P>*>(at + k * plane) = {c[k][0], c[k][1], c[k][2], c[k][3]};
}
__device__ __forceinline__ void store(float* at, int64_t plane, Values const& c) {
#pragma unroll
  for (int k = 0; k < 3; ++k) store_vector(at + k * plane, c[k]);
}

// Pixels i, ... of sample b: planes of floats, or whatever is stored, by vectors in both cases.
template <bool Plain>
__device__ __forceinline__ void load(Pixels const& x, int64_t offset, int i, int64_t pixels, Values& c) {
  if constexpr (Plain)
    load(static_cast<float const*>(x.data) + offset + i, x.channel_stride, c);
  else
    load_pixels<false>(x, offset, i, pixels, 0.f, c);
}
template <bool Plain>
__device__ __forceinline__ void store(Pixels const& y, int64_t offset, int i, int64_t pixels, Values const& c) {
  if constexpr (Plain)
    store(static_cast<float*>(y.data) + offset + i, y.channel_stride, c);
  else
    store_pixels<false>(y, offset, i, pixels, c);
}

// The cluster of a block.
__device__ __forceinline__ unsigned cluster_of_block() { return blockIdx.x / unsigned(kMaxClusterSize); }

// The part of a sample that a block of a cluster has.
struct ClusterPart {
  int begin, pixels;
  __device__ __forceinline__ ClusterPart(int all, int part_pixels) {
    begin = int(blockIdx.x % kMaxClusterSize) * part_pixels;
    pixels = clamp(all - begin, 0, part_pixels);
  }
};

// The sum over the threads of a cluster, in the first thread of each block. Followed by cluster_wait, after which
// blocks may end.
__device__ __forceinline__ float cluster_sum(float x) {
  __shared__ float warp_sums[kClusterThreads / 32];
  __shared__ float part;
  x = warp_reduce(x, Sum());
  if (threadIdx.x % 32 == 0) warp_sums[threadIdx.x / 32] = x;
  __syncthreads();
  if (threadIdx.x == 0) {
    float sum = 0;
    for (float const of_warp : warp_sums) sum += of_warp;
    part = sum;
  }
  __syncthreads();
  cluster_arrive();
  cluster_wait();
  float total = 0;
  if (threadIdx.x == 0)
#pragma unroll
    for (int i = 0; i < kMaxClusterSize; ++i)
      total += __int_as_float(load_of_block(reinterpret_cast<int const*>(&part), unsigned(i)));
  __syncthreads();
  cluster_arrive();
  return total;
}

__device__ __forceinline__ void run_steps(Sample<float> const& sample, int begin, int end, Values& c) {
#pragma unroll 1
  for (int s = begin; s < end; ++s) {
    auto const entry = sample.order[s];
    EvaluateStep<float, 3, P, true> values{c, sample.p + entry.first};
    run_entry(entry, values);
  }
}

// The blocks of a cluster run a program on sample b, whose pixels begin at elements `from` of x and `to` of y.
template <bool Plain>
__device__ __forceinline__ void run_cluster(Program<float> const& p, Sample<float>& sample, float* kept,
                                            Pixels const& x, Pixels const& y, int64_t b, int64_t from, int64_t to,
                                            int64_t pixels, int part_pixels) {
  ClusterPart const part(int(pixels), part_pixels);
  Values ahead;
  int const first = P * int(threadIdx.x);
  if (first < part.pixels) load<Plain>(x, from, part.begin + first, pixels, ahead);
  sample.prepare(p, b, false);
  bool const around_mean = sample.steps_before_mean < sample.length;
  // Where the result overwrites the input, all of a sample is read before any of it is written.
  bool const waits = around_mean || p.overwrites;
  float sum = 0;
#pragma unroll 1
  for (int i = first; i < part.pixels; i += P * kClusterThreads) {
    Values c;
#pragma unroll
    for (int k = 0; k < 3; ++k)
#pragma unroll
      for (int j = 0; j < P; ++j) c[k][j] = ahead[k][j];
    int const next = i + P * kClusterThreads;
    if (next < part.pixels) load<Plain>(x, from, part.begin + next, pixels, ahead);
    run_steps(sample, 0, sample.steps_before_mean, c);
    if (!waits) {
      store<Plain>(y, to, part.begin + i, pixels, c);
      continue;
    }
    keep(kept + i, part_pixels, c);
#pragma unroll
    for (int k = 0; k < 3; ++k)
#pragma unroll
      for (int j = 0; j < P; ++j) sum += c[k][j] * p.gray_weights[k];
  }
  float const total = cluster_sum(sum);
  if (threadIdx.x == 0) {
    float const mean = around_mean ? total / float(pixels) : 0;
    if (around_mean) sample.p[sample.mean_parameter] = mean;
    if (part.begin == 0) p.means[b] = mean;
  }
  __syncthreads();
  if (waits)
#pragma unroll 1
    for (int i = first; i < part.pixels; i += P * kClusterThreads) {
      Values c;
      load(kept + i, part_pixels, c);
      run_steps(sample, sample.steps_before_mean, sample.length, c);
      store<Plain>(y, to, part.begin + i, pixels, c);
    }
  cluster_wait();  // shared memory exists until all blocks have read it
}

KV_HD int64_t part_pixels_of(int64_t pixels) { return (ceil_div(pixels, int64_t(kMaxClusterSize)) + P - 1) / P * P; }
inline size_t bytes_of(int64_t pixels) { return size_t(part_pixels_of(pixels)) * 3 * sizeof(float); }

constexpr int64_t kMaxShared = 112 << 10;  // two blocks on a multiprocessor

template <class Kernel>
bool takes_clusters(Kernel* kernel, Program<float> const& p) {
  constexpr int64_t kStaticShared = 2 << 10;
  // This does not depend on the number of samples. Two runs are faster for few samples, but they sum in another order,
  // and the result of a sample must not depend on the size of the batch.
  return p.contrast >= 0 && p.x.channels == 3 && p.pixels % P == 0 && has_frequent_steps_only(p) &&
         int64_t(bytes_of(p.pixels)) + kStaticShared <= max_shared_bytes(kMaxShared) && supports_clusters(kernel);
}

}  // namespace
}  // namespace kv::color::cuda
