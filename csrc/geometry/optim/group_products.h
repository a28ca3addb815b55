// Sums of products of small matrices by group, of which the normal equations of least squares are made:
//
//   result[g] = sum over the pairs p of group g of  left[l]^T M right[r],   l = left_rows[p], r = right_rows[p]
//
// Group g has the pairs offsets[g] to offsets[g + 1] - 1. M is the identity or, for a Schur complement,
// middle[middle_rows[l]]. Nothing is stored for a pair, and sums have one order: the same bits every run. Rows outside
// of a tensor are those at its ends.
#pragma once

#include "core/isa.h"

namespace kv::geometry {

template <class T>
struct GroupProducts {
  T const *left, *right, *middle;  // (B, N, n, a), (B, M, n, b), (B, K, n, n); middle may be null
  int64_t left_strides[4], right_strides[4];
  int32_t const *left_rows, *right_rows, *middle_rows, *offsets;  // (P), (P), (N), (G + 1)
  int64_t batch, groups, pairs, inner, rows, columns;             // B, G, P, n, a, b
  int64_t num_left, num_right, num_middle;                        // N, M, K
  T* result;                                                      // (B, G, a, b)

  KV_HD static int64_t bounded(int64_t i, int64_t count) { return i < 0 ? 0 : i < count ? i : count - 1; }
  KV_HD int64_t first(int64_t group) const { return bounded(offsets[group], pairs + 1); }
  KV_HD int64_t left_row(int64_t pair) const { return bounded(left_rows[pair], num_left); }
  KV_HD T const* left_of(int64_t b, int64_t row) const { return left + b * left_strides[0] + row * left_strides[1]; }
  KV_HD T const* right_of(int64_t b, int64_t pair) const {
    return right + b * right_strides[0] + bounded(right_rows[pair], num_right) * right_strides[1];
  }
  KV_HD T const* middle_of(int64_t b, int64_t row) const {
    return middle + (b * num_middle + bounded(middle_rows[row], num_middle)) * inner * inner;
  }
};

KV_KERNEL(group_products, GroupProducts)

}  // namespace kv::geometry
