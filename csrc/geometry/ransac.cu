// RANSAC's scores on CUDA: a warp for each model, whose threads take correspondences in turns.
#include "core/launch.cuh"
#include "geometry/ransac.h"

namespace kv::geometry::cuda {
namespace {

constexpr int kThreads = 256;

template <class T>
__global__ void __launch_bounds__(kThreads) score_models(__grid_constant__ Consensus<T> const p) {
  int64_t const candidate = (blockIdx.x * int64_t(kThreads) + threadIdx.x) / 32, b = candidate / p.num_models;
  if (b >= p.batch) return;
  T m[9], score = 0, count = 0, is_known = 0;
  T const t = p.squared_threshold(b), least = p.least(b);
#pragma unroll
  for (int k = 0; k < 9; ++k) m[k] = p.models[candidate * 9 + k], is_known += m[k];
  bool is_given_up = !(is_known == is_known);
  for (int64_t start = 0; start < p.count && !is_given_up; start += kChunk) {
#pragma unroll
    for (int k = 0; k < kChunk; k += 32) {
      int64_t const i = start + k + threadIdx.x % 32;
      if (i >= p.count) continue;
      T const e = squared_error<T>(p, m, b, i, [](T const* x) { return *x; });
      if (e <= t) score += 1 - e / t, count += 1;
    }
    if (start + kChunk <= p.count && least > 0)
      is_given_up = warp_reduce(score, Sum()) < p.bound(least, start + kChunk);
  }
  score = warp_reduce(score, Sum());
  count = warp_reduce(count, Sum());
  if (threadIdx.x % 32 == 0) p.scores[2 * candidate] = score, p.scores[2 * candidate + 1] = count;
}

constexpr int kTopThreads = 1024;

// One block for each pair: each rank is the best of what its threads select.
template <class T>
__global__ void __launch_bounds__(kTopThreads) find_top_k(__grid_constant__ TopKModels<T> const p) {
  __shared__ int64_t warp_best[kTopThreads / 32];
  int64_t const b = blockIdx.x;
  int64_t last = -1;
  for (int64_t rank = 0; rank < p.top_k; ++rank) {
    int64_t best = p.next_best(b, last, threadIdx.x, kTopThreads);
    auto const better = [&](int64_t i, int64_t k) { return p.is_better(b, k, i) ? k : i; };
    best = warp_reduce(best, better);
    __syncthreads();  // other threads may still read the last rank's model
    if (threadIdx.x % 32 == 0) warp_best[threadIdx.x / 32] = best;
    __syncthreads();
    last = warp_reduce(warp_best[threadIdx.x % 32], better);
    if (threadIdx.x == 0) p.copy(b, last, rank);
  }
}

template <class T>
__global__ void __launch_bounds__(kMaxThreads) select_of_pairs(__grid_constant__ Selection<T> const p) {
  select_pair(p, blockIdx.x, ThreadBlock{});
}

}  // namespace

template <class T>
int select_inliers(Selection<T> const& p, CUstream_st* stream) {
  select_of_pairs<T><<<unsigned(p.batch), block_size(p.count), 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int consensus(Consensus<T> const& p, CUstream_st* stream) {
  score_models<T><<<unsigned(ceil_div(p.batch * p.num_models * 32, kThreads)), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int top_k_models(TopKModels<T> const& p, CUstream_st* stream) {
  find_top_k<T><<<unsigned(p.batch), kTopThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_COMPUTED(consensus, Consensus)
KV_INSTANTIATE_COMPUTED(top_k_models, TopKModels)
KV_INSTANTIATE_ONE(select_inliers, Selection, double)

}  // namespace kv::geometry::cuda
