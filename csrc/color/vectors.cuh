// Launches of kernels whose threads process vectors of adjacent pixels of a row.
#pragma once

#include "core/launch.cuh"

namespace kv::color::cuda {

// Whether all rows are vectors of N elements.
template <int N, class T>
bool has_whole_vectors(Planes<T> const& x) {
  return (x.width | x.row_stride | x.outer_stride | x.inner_stride) % N == 0 &&
         reinterpret_cast<uintptr_t>(x.data) % (N * sizeof(T)) == 0;
}

// Blocks of 32 x `rows` threads, each of which takes N neighbors of an image.
template <int N>
dim3 blocks_of_vectors(int64_t width, int64_t height, int rows, int64_t images) {
  return dim3(unsigned(ceil_div(width, 32 * N)), unsigned(ceil_div(height, rows)),
              unsigned(min(images, int64_t(65535))));
}

}  // namespace kv::color::cuda
