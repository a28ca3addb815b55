// Filters of lists on CUDA: a block finds its sample in the table, and computes what a block of a batch does. Included
// by *.cu files.
#pragma once

#include <new>

#include "core/stencils/filter_list.h"

namespace kv {
namespace {

// The sample of a block, in shared memory, and the number of the block among those of the sample. Of a sample that is
// not chosen each block copies as many rows, and there is nothing left to do: null.
template <class List>
  requires requires(List const& p) { p.list; }
__device__ __forceinline__ auto sample_of_block(List const& p, unsigned& block) -> decltype(p.sample(0)) const* {
  using Filter = decltype(p.sample(0));
  __shared__ __align__(16) unsigned char memory[sizeof(Filter)];
  int const b = p.list.sample_of(int(blockIdx.x)), first = p.list.first[b];
  if (threadIdx.x == 0) new (memory) Filter(p.sample(b));
  block = blockIdx.x - unsigned(first);
  __syncthreads();
  auto const* const one = reinterpret_cast<Filter const*>(memory);
  if (!p.copies(b)) return one;
  int64_t const blocks = end_of_items(p.list, b) - first;
  int const height = int(one->y.height), size = int(one->y.row_size());
  for (int64_t r = one->y.rows() * block / blocks; r < one->y.rows() * (block + 1) / blocks; ++r) {
    int64_t const plane = r / height;
    auto const* const from = one->x.row(plane, r - plane * height);
    auto* const to = one->y.row(plane, r - plane * height);
    for (int e = int(threadIdx.x); e < size; e += int(blockDim.x)) to[e] = from[e];
  }
  return nullptr;
}

template <class List, class Is>
bool all_samples(List const& p, Is is) {
  for (int b = 0; b < p.list.count; ++b)
    if (!is(p.sample(b))) return false;
  return true;
}

template <class List, class Number>
int64_t sum_of_samples(List const& p, Number number) {
  int64_t sum = 0;
  for (int b = 0; b < p.list.count; ++b) sum += number(p.sample(b));
  return sum;
}

template <class List>
int64_t largest_height(List const& p) {
  int height = 1;
  for (int b = 0; b < p.list.count; ++b) height = max(height, p.list.results[b].height);
  return height;
}

// Calls launch(table, number of blocks) with as many blocks of each sample as blocks_of(sample) says.
template <class List, class BlocksOf, class Launch>
int launch_list(List p, BlocksOf blocks_of, Launch launch) {
  int64_t blocks = 0;
  for (int b = 0; b < p.list.count; ++b) {
    p.list.first[b] = int(blocks);
    blocks += int64_t(blocks_of(p.sample(b)));
    if (blocks > INT32_MAX) return cudaErrorInvalidConfiguration;
  }
  p.list.items = int(blocks);
  launch(p, unsigned(blocks));
  return cudaGetLastError();
}

}  // namespace
}  // namespace kv
