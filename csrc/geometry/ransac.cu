// RANSAC's scores on CUDA: a warp for each model, or a block if models are few. Its threads take correspondences in
// turns.
#include "core/launch.cuh"
#include "geometry/ransac.h"

namespace kv::geometry::cuda {
namespace {

constexpr int kThreads = 256;

template <class T>
__device__ __forceinline__ T squared_error_at(Consensus<T> const& p, T const* m, int64_t i) {
  return squared_error<T>(p, m, i, [&](T const* points, int k, int64_t i) { return points[k * p.count + i]; });
}

// The number of threads of a model: 32, or all of the block.
template <class T>
__global__ void __launch_bounds__(kThreads) score_models(Consensus<T> p, int threads) {
  __shared__ T parts[2][kThreads / 32];
  int64_t const candidate = (blockIdx.x * int64_t(kThreads) + threadIdx.x) / threads;
  if (candidate >= p.num_models) return;
  T m[9], score = 0, count = 0;
#pragma unroll
  for (int k = 0; k < 9; ++k) m[k] = p.models[candidate * 9 + k];
  for (int64_t i = threadIdx.x % threads; i < p.count; i += threads) {
    T const e = squared_error_at(p, m, i);
    if (e <= p.squared_threshold) score += 1 - e / p.squared_threshold, count += 1;
  }
  score = warp_reduce(score, Sum());
  count = warp_reduce(count, Sum());
  if (threads == kThreads) {
    if (threadIdx.x % 32 == 0) parts[0][threadIdx.x / 32] = score, parts[1][threadIdx.x / 32] = count;
    __syncthreads();
    score = count = 0;
    for (int w = 0; w < kThreads / 32; ++w) score += parts[0][w], count += parts[1][w];
  }
  if (threadIdx.x % threads == 0) p.scores[2 * candidate] = score, p.scores[2 * candidate + 1] = count;
}

// A block computes the weights of kThreads correspondences for the model of one rank.
template <class T>
__global__ void __launch_bounds__(kThreads)
    merge_and_weigh(__grid_constant__ MergeTopK<T> const p, unsigned blocks_per_rank) {
  __shared__ int winner;  // stays 0, the first model, where NaN scores leave a rank empty
  int64_t const rank = blockIdx.x / blocks_per_rank,
                i = (blockIdx.x - rank * blocks_per_rank) * int64_t(kThreads) + threadIdx.x;
  if (threadIdx.x == 0) winner = 0;
  __syncthreads();
  if (threadIdx.x < p.num_candidates && p.rank_of(threadIdx.x) == rank) winner = int(threadIdx.x);
  __syncthreads();
  if (i == 0) p.copy(winner, rank);
  if (i >= p.count) return;
  T const e = squared_error_at<T>(p, p.model_of(winner), i);
  p.weights[rank * p.count + i] = e <= p.squared_threshold ? 1 / (1 + e * p.softness) : T(0);
}

constexpr int kMaxThreads = 1024;

// One block: each rank is the best of what its threads select.
template <class T>
__global__ void __launch_bounds__(kMaxThreads) find_top_k(__grid_constant__ TopKModels<T> const p) {
  __shared__ int64_t warp_best[kMaxThreads / 32];
  int64_t last = -1;
  for (int64_t rank = 0; rank < p.top_k; ++rank) {
    int64_t best = p.next_best(last, threadIdx.x, kMaxThreads);
    auto const better = [&](int64_t a, int64_t b) { return p.is_better(b, a) ? b : a; };
    best = warp_reduce(best, better);
    __syncthreads();  // other threads may still read the last rank's model
    if (threadIdx.x % 32 == 0) warp_best[threadIdx.x / 32] = best;
    __syncthreads();
    last = warp_reduce(warp_best[threadIdx.x % 32], better);
    if (threadIdx.x == 0) p.copy(last, rank);
  }
}

}  // namespace

template <class T>
int top_k_models(TopKModels<T> const& p, CUstream_st* stream) {
  find_top_k<T><<<1, kMaxThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int consensus(Consensus<T> const& p, CUstream_st* stream) {
  int const threads = p.num_models < 1024 ? kThreads : 32;
  score_models<T><<<unsigned(ceil_div(p.num_models * threads, kThreads)), kThreads, 0, stream>>>(p, threads);
  return cudaGetLastError();
}

template <class T>
int merge_top_k(MergeTopK<T> const& p, CUstream_st* stream) {
  unsigned const blocks_per_rank = unsigned(ceil_div(p.count, kThreads));
  merge_and_weigh<T><<<unsigned(p.top_k) * blocks_per_rank, kThreads, 0, stream>>>(p, blocks_per_rank);
  return cudaGetLastError();
}

KV_INSTANTIATE_COMPUTED(consensus, Consensus)
KV_INSTANTIATE_COMPUTED(top_k_models, TopKModels)
KV_INSTANTIATE_COMPUTED(merge_top_k, MergeTopK)

}  // namespace kv::geometry::cuda
