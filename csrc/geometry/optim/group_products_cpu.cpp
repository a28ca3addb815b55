// Sums of products by group on the CPU: groups [begin, end) of all problems. Sums are in double.
#include "geometry/optim/group_products.h"

namespace kv::geometry::KV_ISA {
namespace {

constexpr int kTile = 16;  // rows and columns of a result that are summed at once

template <class T>
KV_HD void add_products(GroupProducts<T> const& p, int64_t b, int64_t pair, int64_t row, int64_t column, int height,
                        int width, double (&sums)[kTile][kTile]) {
  int64_t const l = p.left_row(pair), ls = p.left_strides[3], rs = p.right_strides[3];
  T const* left = p.left_of(b, l) + row * ls;
  T const* const right = p.right_of(b, pair) + column * rs;
  T const* middle = p.middle ? p.middle_of(b, l) : nullptr;
  for (int64_t u = 0; u < p.inner; ++u, left += p.left_strides[2]) {
    double values[kTile] = {};
    if (middle) {
      for (int64_t v = 0; v < p.inner; ++v) {
        double const factor = *middle++;
        T const* const from = right + v * p.right_strides[2];
        for (int j = 0; j < width; ++j) values[j] += factor * from[j * rs];
      }
    } else {
      T const* const from = right + u * p.right_strides[2];
      for (int j = 0; j < width; ++j) values[j] = from[j * rs];
    }
    for (int i = 0; i < height; ++i) {
      double const factor = left[i * ls];
      for (int j = 0; j < kTile; ++j) sums[i][j] += factor * values[j];
    }
  }
}

}  // namespace

template <class T>
void group_products(GroupProducts<T> const& p, int64_t begin, int64_t end) {
  for (int64_t at = begin; at < end; ++at) {
    int64_t const b = at / p.groups, g = at % p.groups, first = p.first(g), last = p.first(g + 1);
    T* const result = p.result + at * p.rows * p.columns;
    for (int64_t row = 0; row < p.rows; row += kTile)
      for (int64_t column = 0; column < p.columns; column += kTile) {
        int const height = int(p.rows - row < kTile ? p.rows - row : kTile);
        int const width = int(p.columns - column < kTile ? p.columns - column : kTile);
        double sums[kTile][kTile];
        for (int i = 0; i < height; ++i)
          for (double& sum : sums[i]) sum = 0;
        for (int64_t pair = first; pair < last; ++pair) add_products(p, b, pair, row, column, height, width, sums);
        for (int i = 0; i < height; ++i)
          for (int j = 0; j < width; ++j) result[(row + i) * p.columns + column + j] = T(sums[i][j]);
      }
  }
}

KV_INSTANTIATE_ONE(group_products, GroupProducts, float)
KV_INSTANTIATE_ONE(group_products, GroupProducts, double)

}  // namespace kv::geometry::KV_ISA
