// Rows of tensors as one tensor, on CUDA: a block has a part of a row.
#include "augmentation/lists/copy_rows.h"
#include "core/launch.cuh"

namespace kv::augmentation::cuda {
namespace {

constexpr int kCopyThreads = 256, kCopiesOfThread = 4;

// V is what a thread reads at once.
template <class V>
__global__ void __launch_bounds__(kCopyThreads) copy(__grid_constant__ CopyRows<uint8_t> const p, int64_t count) {
  V const* const from = reinterpret_cast<V const*>(p.from[blockIdx.y]);
  V* const to = reinterpret_cast<V*>(p.to + blockIdx.y * p.size);
  int64_t const first = blockIdx.x * int64_t(kCopyThreads * kCopiesOfThread) + threadIdx.x;
  V v[kCopiesOfThread];
#pragma unroll
  for (int i = 0; i < kCopiesOfThread; ++i)
    if (first + i * kCopyThreads < count) v[i] = from[first + i * kCopyThreads];
#pragma unroll
  for (int i = 0; i < kCopiesOfThread; ++i)
    if (first + i * kCopyThreads < count) to[first + i * kCopyThreads] = v[i];
}

template <class V>
int launch_copy(CopyRows<uint8_t> const& p, CUstream_st* stream) {
  int64_t const count = p.size / int64_t(sizeof(V));
  dim3 const blocks(unsigned(ceil_div(count, int64_t(kCopyThreads * kCopiesOfThread))), unsigned(p.count));
  copy<V><<<blocks, kCopyThreads, 0, stream>>>(p, count);
  return cudaGetLastError();
}

}  // namespace

template <class T>
int copy_rows(CopyRows<T> const& p, CUstream_st* stream) {
  uintptr_t bits = reinterpret_cast<uintptr_t>(p.to) | uintptr_t(p.size);
  for (int i = 0; i < p.count; ++i) bits |= reinterpret_cast<uintptr_t>(p.from[i]);
  return bits % 16 == 0  ? launch_copy<uint4>(p, stream)
         : bits % 4 == 0 ? launch_copy<uint32_t>(p, stream)
                         : launch_copy<uint8_t>(p, stream);
}

KV_INSTANTIATE_ONE(copy_rows, CopyRows, uint8_t)

}  // namespace kv::augmentation::cuda
