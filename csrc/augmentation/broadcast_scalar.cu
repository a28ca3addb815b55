// Fills a tensor with a number in device memory: a thread writes a few vectors of 16 bytes.
#include "augmentation/broadcast_scalar.h"
#include "core/launch.cuh"

namespace kv::augmentation::cuda {
namespace {

constexpr int kThreads = 256, kVectors = 4;  // of a thread

template <class T>
__global__ void __launch_bounds__(kThreads) broadcast(__grid_constant__ BroadcastScalar<T> const p) {
  constexpr int N = 16 / sizeof(T);
  T const scalar = *p.scalar;
  Vector<T, N> vector;
#pragma unroll
  for (int i = 0; i < N; ++i) vector.v[i] = scalar;
  int64_t const first = (int64_t(blockIdx.x) * kVectors * kThreads + threadIdx.x) * N;
#pragma unroll
  for (int k = 0; k < kVectors; ++k) {
    int64_t const i = first + k * kThreads * N;
    if (i + N <= p.count)
      *reinterpret_cast<Vector<T, N>*>(p.result + i) = vector;
    else
      for (int64_t j = i; j < p.count; ++j) p.result[j] = scalar;
  }
}

}  // namespace

template <class T>
int broadcast_scalar(BroadcastScalar<T> const& p, CUstream_st* stream) {
  int64_t const of_block = kVectors * kThreads * int64_t(16 / sizeof(T));
  broadcast<<<unsigned(ceil_div(p.count, of_block)), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE(broadcast_scalar, BroadcastScalar)

}  // namespace kv::augmentation::cuda
