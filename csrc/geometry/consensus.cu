// Consensus on CUDA: a warp a model, its threads take correspondences in turns.
#include "consensus.h"
#include "core/launch.cuh"

namespace kv::cuda {
namespace {

constexpr int kThreads = 256;

template <class T>
__global__ void __launch_bounds__(kThreads) count_consensus(Consensus<T> p) {
  int64_t const candidate = blockIdx.x * int64_t(kThreads / 32) + threadIdx.x / 32;
  if (candidate >= p.candidates) return;
  T m[9], score = 0, count = 0;
#pragma unroll
  for (int k = 0; k < 9; ++k) m[k] = p.models[candidate * 9 + k];
  for (int64_t i = threadIdx.x % 32; i < p.count; i += 32) {
    T const e = error_of<T>(p, m, i, [&](T const* points, int k, int64_t i) { return points[k * p.count + i]; });
    if (e <= p.limit) score += 1 - e / p.limit, count += 1;
  }
  score = warp_sum(score);
  count = warp_sum(count);
  if (threadIdx.x % 32 == 0) p.scores[2 * candidate] = score, p.scores[2 * candidate + 1] = count;
}

}  // namespace

template <class T>
int consensus(Consensus<T> const& p, CUstream_st* stream) {
  count_consensus<T><<<unsigned(ceil_div(p.candidates, kThreads / 32)), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_COMPUTED(consensus, Consensus)

}  // namespace kv::cuda
