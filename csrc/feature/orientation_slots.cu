// Slots of orientations on CUDA: one block per sample traverses its frames in order, by prefix sums.
#include "core/block_reduce.cuh"
#include "orientation_slots.h"

namespace kv::feature::cuda {
namespace {

constexpr int kThreads = 1024, kWarps = kThreads / 32;

template <class F>
__global__ void __launch_bounds__(kThreads) fill_slots(__grid_constant__ OrientationSlots<F> const p) {
  __shared__ int warp_sums[kWarps];
  int const lane = threadIdx.x % 32, warp = threadIdx.x / 32;
  int64_t const sample = blockIdx.x;
  int filled = 0;
  for (int start = 0; start < p.count && filled < p.count; start += kThreads) {
    int const at = start + int(threadIdx.x);
    int64_t const i = sample * p.count + at;
    int const own = at < p.count ? p.count_orientations(i) : 0;
    int const inclusive = warp_prefix_sum(own);
    if (lane == 31) warp_sums[warp] = inclusive;
    __syncthreads();
    int before = filled + inclusive - own, all = 0;
    for (int w = 0; w < kWarps; ++w) {
      before += w < warp ? warp_sums[w] : 0;
      all += warp_sums[w];
    }
    if (own > 0 && before < p.count) p.store(sample, before, i);
    filled += all;
    __syncthreads();  // before the next counts
  }
  for (int slot = filled + int(threadIdx.x); slot < p.count; slot += kThreads) p.clear(sample, slot);
}

}  // namespace

template <class F>
int orientation_slots(OrientationSlots<F> const& p, CUstream_st* stream) {
  fill_slots<F><<<unsigned(p.batch), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_COMPUTED(orientation_slots, OrientationSlots)

}  // namespace kv::feature::cuda
