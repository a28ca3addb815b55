// Gradients of lists on CUDA: a block finds its sample in the table, and computes what a block of a batch does.
// Included by *.cu files.
#pragma once

#include <new>

#include "core/stencils/gradient_list.h"

namespace kv {
namespace {

// The sample of a block, in shared memory, and the number of the block among those of the sample. Of a sample that is
// not chosen each block copies as many rows, and there is nothing left to do: null.
template <class List>
  requires requires(List const& p) { p.grads; }
__device__ __forceinline__ auto sample_of_block(List const& p, unsigned& block) -> decltype(p.sample(0)) const* {
  using Gradient = decltype(p.sample(0));
  __shared__ __align__(16) unsigned char memory[sizeof(Gradient)];
  int const b = p.sample_of(int(blockIdx.x));
  unsigned const thread = threadIdx.y * blockDim.x + threadIdx.x;
  if (thread == 0) new (memory) Gradient(p.sample(b));
  block = blockIdx.x - unsigned(p.first[b]);
  __syncthreads();
  auto const* const one = reinterpret_cast<Gradient const*>(memory);
  if (!p.copies(b)) return one;
  int64_t const blocks = end_of_items(p, b) - p.first[b], rows = one->x.rows(), height = one->x.height;
  for (int64_t r = rows * block / blocks; r < rows * (block + 1) / blocks; ++r)
    copy_gradients<List::kAsStored>(*one, r / height, r % height, thread, blockDim.x * blockDim.y);
  return nullptr;
}

template <class List, class Is>
bool all_gradients(List const& p, Is is) {
  for (int b = 0; b < p.count; ++b)
    if (!is(p.sample(b))) return false;
  return true;
}

// Calls launch(table, number of blocks) with as many blocks of each sample as blocks_of(sample) says.
template <class List, class BlocksOf, class Launch>
int launch_gradients(List p, BlocksOf blocks_of, Launch launch) {
  static_assert(sizeof(List) <= 32764, "more than a kernel's parameters");
  int64_t blocks = 0;
  for (int b = 0; b < p.count; ++b) {
    p.first[b] = int(blocks);
    blocks += int64_t(blocks_of(p.sample(b)));
    if (blocks > INT32_MAX) return cudaErrorInvalidConfiguration;
  }
  p.items = int(blocks);
  launch(p, unsigned(blocks));
  return cudaGetLastError();
}

}  // namespace
}  // namespace kv
