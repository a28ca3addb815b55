// Consensus on CUDA: a warp a model, or a block where models are few; its threads take correspondences in turns.
#include "core/launch.cuh"
#include "geometry/ransac.h"

namespace kv::cuda {
namespace {

constexpr int kThreads = 256;

template <class T>
__device__ __forceinline__ T error_at(Consensus<T> const& p, T const* m, int64_t i) {
  return error_of<T>(p, m, i, [&](T const* points, int k, int64_t i) { return points[k * p.count + i]; });
}

// So many threads a model: 32, or those of the block.
template <class T>
__global__ void __launch_bounds__(kThreads) count_consensus(Consensus<T> p, int threads) {
  __shared__ T parts[2][kThreads / 32];
  int64_t const candidate = (blockIdx.x * int64_t(kThreads) + threadIdx.x) / threads;
  if (candidate >= p.candidates) return;
  T m[9], score = 0, count = 0;
#pragma unroll
  for (int k = 0; k < 9; ++k) m[k] = p.models[candidate * 9 + k];
  for (int64_t i = threadIdx.x % threads; i < p.count; i += threads) {
    T const e = error_at(p, m, i);
    if (e <= p.limit) score += 1 - e / p.limit, count += 1;
  }
  score = warp_sum(score);
  count = warp_sum(count);
  if (threads == kThreads) {
    if (threadIdx.x % 32 == 0) parts[0][threadIdx.x / 32] = score, parts[1][threadIdx.x / 32] = count;
    __syncthreads();
    score = count = 0;
    for (int w = 0; w < kThreads / 32; ++w) score += parts[0][w], count += parts[1][w];
  }
  if (threadIdx.x % threads == 0) p.scores[2 * candidate] = score, p.scores[2 * candidate + 1] = count;
}

// A block takes kThreads correspondences of the model of a rank.
template <class T>
__global__ void __launch_bounds__(kThreads) hold_contest(__grid_constant__ Contest<T> const p, unsigned across) {
  __shared__ int winner;  // the first one where scores are no numbers
  int64_t const rank = blockIdx.x / across, i = (blockIdx.x - rank * across) * int64_t(kThreads) + threadIdx.x;
  if (threadIdx.x == 0) winner = 0;
  __syncthreads();
  if (threadIdx.x < p.total && p.rank_of(threadIdx.x) == rank) winner = int(threadIdx.x);
  __syncthreads();
  if (i == 0) p.copy(winner, rank);
  if (i >= p.count) return;
  T const e = error_at<T>(p, p.model_of(winner), i);
  p.weights[rank * p.count + i] = e <= p.limit ? 1 / (1 + e * p.softness) : T(0);
}

constexpr int kAll = 1024;

// One block: each rank is the first of what its threads find.
template <class T>
__global__ void __launch_bounds__(kAll) find_leaders(__grid_constant__ Leaders<T> const p) {
  __shared__ int64_t firsts[kAll / 32];
  int64_t last = -1;
  for (int64_t rank = 0; rank < p.kept; ++rank) {
    int64_t mine = p.next(last, threadIdx.x, kAll);
    auto const join = [&] {
      for (int lane = 16; lane > 0; lane /= 2) {
        int64_t const other = __shfl_xor_sync(0xffffffffu, mine, lane);
        if (p.before(other, mine)) mine = other;
      }
    };
    join();
    __syncthreads();  // of who reads the last rank's
    if (threadIdx.x % 32 == 0) firsts[threadIdx.x / 32] = mine;
    __syncthreads();
    mine = firsts[threadIdx.x % 32];
    join();
    last = mine;
    if (threadIdx.x == 0) p.copy(last, rank);
  }
}

template <class T>
__global__ void __launch_bounds__(kAll) pass_verdict(__grid_constant__ Verdict<T> const p) {
  __shared__ unsigned parts[kAll / 32];
  unsigned fitting = 0;
  for (int64_t i = threadIdx.x; i < p.count; i += kAll) fitting += p.weights[i] > 0;
  fitting = __reduce_add_sync(0xffffffffu, fitting);
  if (threadIdx.x % 32 == 0) parts[threadIdx.x / 32] = fitting;
  __syncthreads();
  bool const some = int64_t(__reduce_add_sync(0xffffffffu, parts[threadIdx.x % 32])) > p.least;
  for (int64_t i = threadIdx.x; i < p.count; i += kAll) p.fits[i] = some && p.weights[i] > 0;
  if (threadIdx.x == 0) p.decide(some);
}

}  // namespace

template <class T>
int leaders(Leaders<T> const& p, CUstream_st* stream) {
  find_leaders<T><<<1, kAll, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int verdict(Verdict<T> const& p, CUstream_st* stream) {
  pass_verdict<T><<<1, kAll, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int consensus(Consensus<T> const& p, CUstream_st* stream) {
  int const threads = p.candidates < 1024 ? kThreads : 32;
  count_consensus<T><<<unsigned(ceil_div(p.candidates * threads, kThreads)), kThreads, 0, stream>>>(p, threads);
  return cudaGetLastError();
}

template <class T>
int contest(Contest<T> const& p, CUstream_st* stream) {
  unsigned const across = unsigned(ceil_div(p.count, kThreads));
  hold_contest<T><<<unsigned(p.kept) * across, kThreads, 0, stream>>>(p, across);
  return cudaGetLastError();
}

KV_INSTANTIATE_COMPUTED(consensus, Consensus)
KV_INSTANTIATE_COMPUTED(leaders, Leaders)
KV_INSTANTIATE_COMPUTED(verdict, Verdict)
KV_INSTANTIATE_COMPUTED(contest, Contest)

}  // namespace kv::cuda
