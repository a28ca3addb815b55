// Numbers of the tensors of a list on CUDA: some blocks for each tensor, four numbers a thread at a time.
#include "core/launch.cuh"
#include "geometry/transform/lists/list_numbers.h"

namespace kv::geometry::cuda {
namespace {

constexpr int kNumberThreads = 256, kNumbersOfThread = 4, kVectorsOfThread = 4;

template <class T>
__global__ void __launch_bounds__(kNumberThreads) write_listed(__grid_constant__ ListedNumbers<T> const p) {
  using F = Compute<T>;
  constexpr int N = kNumbersOfThread;
  int const b = int(blockIdx.y);
  F const* const from = p.from[b];
  T* const to = p.to[b];
  int64_t const numbers = p.numbers[b], step = int64_t(N) * kNumberThreads * gridDim.x;
  for (int64_t i = (blockIdx.x * int64_t(kNumberThreads) + threadIdx.x) * N; i < numbers; i += step) {
    if (i + N <= numbers) {  // tensors begin at vectors
      Vector<F, N> v{};
      if (from) v = *reinterpret_cast<Vector<F, N> const*>(from + i);
      store_vector(to + i, v.v);
    } else {
      for (int64_t k = i; k < numbers; ++k) to[k] = round_to<T>(from ? from[k] : F(0));
    }
  }
}

}  // namespace

template <class T>
int write_numbers(ListedNumbers<T> const& p, CUstream_st* stream) {
  int64_t most = 0;
  for (int b = 0; b < p.count; ++b) most = max(most, p.numbers[b]);
  int64_t const of_block = int64_t(kNumberThreads) * kNumbersOfThread * kVectorsOfThread;
  dim3 const blocks(unsigned(min(max(ceil_div(most, of_block), int64_t(1)), int64_t(1) << 20)), unsigned(p.count));
  write_listed<<<blocks, kNumberThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE(write_numbers, ListedNumbers)

}  // namespace kv::geometry::cuda
