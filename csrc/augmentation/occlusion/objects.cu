// Dropped objects on CUDA. A block, or a cluster where the GPU has clusters, looks for the next lower rank of a sample
// once for each object.
#include "augmentation/occlusion/objects.h"
#include "core/block_reduce.cuh"
#include "core/cluster.cuh"

namespace kv::augmentation::cuda {
namespace {

constexpr int kObjectThreads = 512, kElements = 4;  // that a thread loads at once, which hides the latency of memory
constexpr int64_t kSmallSample = 16 * 1024;         // elements that one block traverses

struct Largest {
  __device__ __forceinline__ long long operator()(long long a, long long b) const { return a < b ? b : a; }
};

// The ranks of elements `step` apart from i on, -1 for those from `end` on.
template <class Ranks>
__device__ __forceinline__ void load_ranks(Ranks const& of, int64_t i, int64_t step, int64_t end,
                                           long long (&ranks)[kElements]) {
  int64_t values[kElements], numbers[kElements];
#pragma unroll
  for (int k = 0; k < kElements; ++k) values[k] = i + k * step < end ? of.values[i + k * step] : 0;
#pragma unroll
  for (int k = 0; k < kElements; ++k) numbers[k] = of.number(i + k * step, values[k]);
#pragma unroll
  for (int k = 0; k < kElements; ++k) ranks[k] = of.rank(i + k * step, values[k], numbers[k]);
}

// The largest number of the blocks of a cluster, each of which has the same in all its threads.
__device__ __forceinline__ long long cluster_max(long long own, unsigned parts) {
  __shared__ int words[2];
  if (threadIdx.x == 0) words[0] = int(own), words[1] = int(own >> 32);
  __syncthreads();
  cluster_arrive();
  cluster_wait();
  long long largest = own;
  for (unsigned part = 0; part < parts; ++part) {
    int const low = load_of_block(&words[0], part), high = load_of_block(&words[1], part);
    largest = max(largest, (static_cast<long long>(high) << 32) | uint32_t(low));
  }
  cluster_arrive();
  cluster_wait();  // shared memory exists, and stays as it is, until it has been read
  return largest;
}

template <class T>
__global__ void __launch_bounds__(kObjectThreads) drop_ranks(__grid_constant__ DropObjects<T> const p, unsigned parts) {
  int64_t const b = blockIdx.x / parts, size = p.masks * p.pixels, step = int64_t(parts) * kObjectThreads;
  int64_t const first = (blockIdx.x - b * parts) * kObjectThreads + threadIdx.x;
  auto const of_sample = p.ranks(b);
  long long lowest = p.kNone, ranks[kElements];
  for (int k = 0; k < p.count(b); ++k) {
    long long best[1] = {-1};
    for (int64_t i = first; i < size; i += kElements * step) {
      load_ranks(of_sample, i, step, size, ranks);
      for (long long const rank : ranks)
        if (rank < lowest) best[0] = max(best[0], rank);
    }
    block_reduce<kObjectThreads>(best, Largest());
    if (parts > 1) best[0] = cluster_max(best[0], parts);
    if (best[0] < 0) break;
    lowest = best[0];
  }
  for (int64_t i = first; i < p.pixels; i += kElements * step) {
    bool dropped[kElements] = {};
    for (int64_t n = 0; n < p.masks; ++n) {
      load_ranks(of_sample, n * p.pixels + i, step, (n + 1) * p.pixels, ranks);
#pragma unroll
      for (int k = 0; k < kElements; ++k) dropped[k] |= ranks[k] >= lowest;
    }
#pragma unroll
    for (int k = 0; k < kElements; ++k)
      if (i + k * step < p.pixels) p.y[b * p.pixels + i + k * step] = dropped[k];
  }
}

}  // namespace

template <class T>
int drop_objects(DropObjects<T> const& p, CUstream_st* stream) {
  bool const shares = p.masks * p.pixels > kSmallSample && supports_clusters(drop_ranks<T>);
  unsigned const parts = shares ? kMaxClusterSize : 1;
  return launch_clusters(drop_ranks<T>, unsigned(p.batch) * parts, kObjectThreads, 0, parts, stream, p, parts);
}

KV_INSTANTIATE_ONE(drop_objects, DropObjects, int64_t)

}  // namespace kv::augmentation::cuda
