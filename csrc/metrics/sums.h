// How what the blocks or threads of a sum have found becomes its result. Included by operators that return sums.
#pragma once

#include <math.h>

#include "core/hd.h"

namespace kv {

// factor * sum, or where there are `decibels` that many times its logarithm to base 10.
template <class F>
struct Finish {
  F factor, decibels;

  KV_HD F operator()(double sum) const {
    double const found = double(factor) * sum;
    return F(decibels == 0 ? found : double(decibels) * ::log10(found));
  }
};

// partial (rows, pieces) to sums (rows), on the CPU; sums.cuh does it on CUDA.
template <class F>
void add_pieces(F const* partial, int64_t rows, int64_t pieces, Finish<F> const& finish, F* sums) {
  for (int64_t row = 0; row < rows; ++row) {
    double sum = 0;
    for (int64_t piece = 0; piece < pieces; ++piece) sum += partial[row * pieces + piece];
    sums[row] = finish(sum);
  }
}

}  // namespace kv
