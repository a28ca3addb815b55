// Sums of rows by chunks, and how a sum becomes a result. Included by operators that return sums.
#pragma once

#include <math.h>

#include "hd.h"

namespace kv {

// factor * sum; or, unless `decibels` is 0, that many times the logarithm of factor * sum to base 10.
template <class F>
struct FinalizeSum {
  F factor, decibels;

  KV_HD F operator()(double sum) const {
    double const result = double(factor) * sum;
    return F(decibels == 0 ? result : double(decibels) * ::log10(result));
  }
};

// partial (rows, chunks) to sums (rows), on the CPU; row_sums.cuh does it on CUDA.
template <class F>
void add_chunks(F const* partial, int64_t rows, int64_t chunks, FinalizeSum<F> const& finalize, F* sums) {
  for (int64_t row = 0; row < rows; ++row) {
    double sum = 0;
    for (int64_t chunk = 0; chunk < chunks; ++chunk) sum += partial[row * chunks + chunk];
    sums[row] = finalize(sum);
  }
}

}  // namespace kv
