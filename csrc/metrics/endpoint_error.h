// Endpoint errors, the distances between two fields of 2-vectors, for every vector or summed over rows. The gradient of
// a vector is its difference divided by the distance, and 0 where the distance is 0.
#pragma once

#include "core/isa.h"
#include "core/row_sums.h"

namespace kv::metrics {

constexpr int64_t kEndpointChunk = 4096;  // vectors per partial sum

// Rows of vectors. `planar`: a row has all first components, then all second ones; otherwise components alternate.
template <class T>
struct VectorPairs {
  T const *x, *y;
  bool planar;
  int64_t x_stride, y_stride, rows, size;  // strides from row to row; 0 broadcasts one row

  KV_HD int64_t chunks() const { return (size + kEndpointChunk - 1) / kEndpointChunk; }
  // The index of the first component of vector i in a row; the second component is `adjacent` elements after it.
  KV_HD int64_t at(int64_t i) const { return planar ? i : 2 * i; }
  KV_HD int64_t adjacent() const { return planar ? size : 1; }
};

template <class T>
struct EndpointError {
  VectorPairs<T> pairs;
  T* map;                     // (rows, size); null: only sums
  Compute<T>*partial, *sums;  // (rows, chunks), and `factor` times the sums (rows), written by the CUDA kernel; on the
                              // CPU the operator adds chunks
  FinalizeSum<Compute<T>> finalize;
};

template <class T>
struct EndpointErrorBackward {
  VectorPairs<T> pairs;
  T const* grad;                  // (rows, size), or null
  Compute<T> const* grad_of_sum;  // (rows)
  Compute<T> factor;
  T* grad_x;
};

KV_KERNEL(endpoint_error, EndpointError)
KV_KERNEL(endpoint_error_backward, EndpointErrorBackward)

}  // namespace kv::metrics
