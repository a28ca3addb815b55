// Distances of vectors of two from others, of each or their sums; backward a vector gets its difference over the
// distance, and nothing where that is 0. Included by endpoint_error_cpu.cpp, endpoint_error.cu and
// endpoint_error_op.cpp.
#pragma once

#include "core/isa.h"
#include "core/row_sums.h"

namespace kv {

constexpr int64_t kEndpointChunk = 4096;  // vectors that are summed together

// Rows of vectors, a row's components one after the other if `planar`, else those of a vector.
template <class T>
struct VectorPairs {
  T const *x, *y;
  bool planar;
  int64_t x_stride, y_stride, rows, size;  // strides from row to row, 0 for one that serves all

  KV_HD int64_t chunks() const { return (size + kEndpointChunk - 1) / kEndpointChunk; }
  // Of the first component of vector i in a row; the other one is `beside` it.
  KV_HD int64_t at(int64_t i) const { return planar ? i : 2 * i; }
  KV_HD int64_t beside() const { return planar ? size : 1; }
};

template <class T>
struct EndpointError {
  VectorPairs<T> pairs;
  T* map;                     // (rows, size), or null for
  Compute<T>*partial, *sums;  // (rows, chunks) and `factor` times (rows), by CUDA's kernel; the CPU's entry adds them
  FinalizeSum<Compute<T>> finalize;
};

template <class T>
struct EndpointErrorBackward {
  VectorPairs<T> pairs;
  T const* grad;                  // (rows, size), or null for
  Compute<T> const* grad_of_sum;  // (rows)
  Compute<T> factor;
  T* grad_x;
};

KV_KERNEL(endpoint_error, EndpointError)
KV_KERNEL(endpoint_error_backward, EndpointErrorBackward)

}  // namespace kv
