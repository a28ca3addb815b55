// Confusion matrices on CUDA. A block counts a chunk of a sample in shared memory and adds its counts to those of the
// sample; counts of too many classes for shared memory are added directly. A second kernel computes the statistic from
// the counts.
#include "confusion_matrix.h"
#include "core/launch.cuh"

namespace kv::metrics::cuda {
namespace {

constexpr int kThreads = 256, kBytes = 32 << 10, kAtOnce = 4;
constexpr int64_t kChunk = kThreads * kAtOnce * 8;  // pixels

// Counts in shared memory, in several copies where they fit: neighboring threads often have equal labels, and add to
// different copies. Without room for one copy there is none.
template <class T>
__global__ void __launch_bounds__(kThreads)
    count_labels(__grid_constant__ ConfusionMatrix<T> const p, int64_t chunks, int copies) {
  __shared__ uint32_t shared[kBytes / sizeof(uint32_t)];
  int const cells = p.classes * p.classes;
  int64_t const sample = blockIdx.x / chunks, first = (blockIdx.x - sample * chunks) * kChunk;
  int64_t const last = min(first + kChunk, p.pixels);
  uint32_t* const counts = p.counts + sample * cells;
  for (int i = threadIdx.x; i < cells * copies; i += kThreads) shared[i] = 0;
  __syncthreads();
  T const *const pred = p.pred + sample * p.pixels, *const target = p.target + sample * p.pixels;
  for (int64_t i = first + threadIdx.x; i < last; i += kThreads * kAtOnce) {
    T predicted[kAtOnce], labelled[kAtOnce];
#pragma unroll
    for (int k = 0; k < kAtOnce; ++k) {
      int64_t const at = min(i + k * kThreads, last - 1);
      predicted[k] = pred[at], labelled[k] = target[at];
    }
#pragma unroll
    for (int k = 0; k < kAtOnce; ++k) {
      int64_t const cell = i + k * kThreads < last ? p.cell(predicted[k], labelled[k]) : -1;
      if (cell >= 0) atomicAdd(copies ? shared + cell * copies + threadIdx.x % copies : counts + cell, 1u);
    }
  }
  __syncthreads();
  for (int i = threadIdx.x; copies && i < cells; i += kThreads) {
    uint32_t count = 0;
    for (int k = 0; k < copies; ++k) count += shared[i * copies + k];
    if (count) atomicAdd(counts + i, count);
  }
}

// One warp per class of a sample.
template <class T>
__global__ void __launch_bounds__(kThreads) finalize_counts(__grid_constant__ ConfusionMatrix<T> const p) {
  int64_t const n = p.classes, row = (blockIdx.x * int64_t(kThreads) + threadIdx.x) / 32, sample = row / n;
  if (sample >= p.samples) return;
  int const lane = threadIdx.x % 32;
  uint32_t const *const own = p.counts + row * n, *const column = p.counts + sample * n * n + (row - sample * n);
  uint32_t labelled = 0, predicted = 0;
  if (p.statistic != ConfusionStatistic::counts) {
    for (int64_t k = lane; k < n; k += 32) labelled += own[k], predicted += column[k * n];
    labelled = warp_reduce(labelled, Sum()), predicted = warp_reduce(predicted, Sum());
  }
  if (p.statistic == ConfusionStatistic::iou) {
    if (lane == 0) p.result[row] = p.overlap(float(own[row - sample * n]), float(labelled), float(predicted));
    return;
  }
  for (int64_t k = lane; k < n; k += 32)
    p.result[row * n + k] =
        p.statistic == ConfusionStatistic::counts ? float(own[k]) : p.rate(float(own[k]), float(labelled));
}

}  // namespace

template <class T>
int confusion_matrix(ConfusionMatrix<T> const& p, CUstream_st* stream) {
  int64_t const cells = int64_t(p.classes) * p.classes, chunks = ceil_div(p.pixels, kChunk);
  int copies = 32;
  while (copies * cells > int64_t(kBytes / sizeof(uint32_t))) copies /= 2;
  if (int const error = cudaMemsetAsync(p.counts, 0, size_t(p.samples * cells) * sizeof(uint32_t), stream))
    return error;
  if (chunks > 0) count_labels<<<unsigned(p.samples * chunks), kThreads, 0, stream>>>(p, chunks, copies);
  finalize_counts<<<unsigned(ceil_div(p.samples * p.classes * 32, kThreads)), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_ONE(confusion_matrix, ConfusionMatrix, int64_t)
KV_INSTANTIATE_ONE(confusion_matrix, ConfusionMatrix, uint8_t)

}  // namespace kv::metrics::cuda
