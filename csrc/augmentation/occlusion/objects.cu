// Dropped objects on CUDA: a block has a sample, whose next lower rank it looks for once for each object.
#include "augmentation/occlusion/objects.h"
#include "core/block_reduce.cuh"
#include "core/launch.cuh"

namespace kv::augmentation::cuda {
namespace {

constexpr int kObjectThreads = 1024;

struct Largest {
  __device__ __forceinline__ long long operator()(long long a, long long b) const { return a < b ? b : a; }
};

template <class T>
__global__ void __launch_bounds__(kObjectThreads) drop_ranks(__grid_constant__ DropObjects<T> const p) {
  int64_t const b = blockIdx.x, size = p.masks * p.pixels;
  uint32_t const word = p.word(b);
  long long lowest = p.kNone;
  for (int k = 0; k < p.count(b); ++k) {
    long long best[1] = {-1};
    for (int64_t i = threadIdx.x; i < size; i += kObjectThreads) {
      long long const rank = p.rank(b, i, word);
      if (rank < lowest) best[0] = max(best[0], rank);
    }
    block_reduce<kObjectThreads>(best, Largest());
    if (best[0] < 0) break;
    lowest = best[0];
  }
  for (int64_t i = threadIdx.x; i < p.pixels; i += kObjectThreads) {
    bool is_dropped = false;
    for (int64_t n = 0; n < p.masks; ++n) is_dropped |= p.rank(b, n * p.pixels + i, word) >= lowest;
    p.y[b * p.pixels + i] = is_dropped;
  }
}

}  // namespace

template <class T>
int drop_objects(DropObjects<T> const& p, CUstream_st* stream) {
  drop_ranks<T><<<unsigned(p.batch), kObjectThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_ONE(drop_objects, DropObjects, int64_t)

}  // namespace kv::augmentation::cuda
