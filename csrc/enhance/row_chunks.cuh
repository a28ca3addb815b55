// Reduction of counts over the chunks of a row, one chunk per block. Included by *.cu files.
#pragma once

#include "core/launch.cuh"

namespace kv::enhance {

// Sums partial (rows, chunks, bins) over chunks in a fixed order. Blocks of 256 threads, one count per thread.
template <class T>
__global__ void add_chunks(T const* partial, int64_t rows, int64_t chunks, int64_t bins, T* counts) {
  int64_t const i = blockIdx.x * int64_t(256) + threadIdx.x, row = i / bins, k = i - row * bins;
  if (row >= rows) return;
  T sum = 0;
  for (int64_t chunk = 0; chunk < chunks; ++chunk) sum += partial[(row * chunks + chunk) * bins + k];
  counts[i] = sum;
}

}  // namespace kv::enhance
