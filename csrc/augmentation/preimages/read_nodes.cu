// Nodes of maps on CUDA: a block has neighboring nodes of a map, row by row.
#include "augmentation/preimages/read_nodes.h"
#include "core/ceil_div.h"

namespace kv::augmentation::cuda {
namespace {

constexpr int kThreads = 256, kNodes = 4;  // of a thread

template <class F>
__global__ void __launch_bounds__(kThreads) read_nodes(__grid_constant__ ReadNodes<F> const p) {
  int const b = p.sample_of(int(blockIdx.x)), columns = p.columns[b], count = p.rows[b] * columns;
  int const begin = (int(blockIdx.x) - p.first[b]) * (kThreads * kNodes) + int(threadIdx.x);
#pragma unroll
  for (int k = 0; k < kNodes; ++k) {
    int const at = begin + k * kThreads;
    if (at < count) p.run(b, at / columns, at % columns);
  }
}

}  // namespace

template <class F>
int read_nodes_list(ReadNodes<F> const& given, CUstream_st* stream) {
  ReadNodes<F> p = given;
  int64_t blocks = 0;
  for (int b = 0; b < p.count; ++b) {
    p.first[b] = int(blocks);
    blocks += ceil_div(int64_t(p.rows[b]) * p.columns[b], kThreads * kNodes);
    if (blocks > INT32_MAX) return cudaErrorInvalidConfiguration;
  }
  read_nodes<F><<<unsigned(blocks), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_COMPUTED(read_nodes_list, ReadNodes)

}  // namespace kv::augmentation::cuda
