// How what the blocks or threads of a sum have found becomes its result. Included by operators that return sums.
#pragma once

#include <math.h>

#include "core/hd.h"

namespace kv {

// offset + factor * sum, or with `decibels` 10 log10(factor * sum).
template <class F>
struct Finish {
  F offset, factor;
  bool decibels;

  KV_HD F operator()(double sum) const {
    return F(decibels ? 10 * ::log10(double(factor) * sum) : double(offset) + double(factor) * sum);
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
