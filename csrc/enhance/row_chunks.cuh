// Rows that several blocks count. Included by *.cu files.
#pragma once

#include "core/launch.cuh"

namespace kv {

// partial (rows, chunks, bins) summed over chunks, always in the same order. Blocks of 256 threads, one a count.
template <class T>
__global__ void add_chunks(T const* partial, int64_t rows, int64_t chunks, int64_t bins, T* counts) {
  int64_t const i = blockIdx.x * int64_t(256) + threadIdx.x, row = i / bins, k = i - row * bins;
  if (row >= rows) return;
  T sum = 0;
  for (int64_t chunk = 0; chunk < chunks; ++chunk) sum += partial[(row * chunks + chunk) * bins + k];
  counts[i] = sum;
}

}  // namespace kv
