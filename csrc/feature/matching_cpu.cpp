// The two nearest descriptors on the CPU: chunks [begin, end) of rows of all samples. A block of the other set is
// transposed, so that the lanes of a vector are its descriptors; 4 rows and 2 vectors of distances are in registers.
#include "core/any_lane.h"
#include "core/scratch.h"
#include "feature/matching.h"

namespace kv::feature::KV_ISA {

namespace {

constexpr int kRows = 4, kVectors = 2;

// The squared distances of kRows rows and kVectors vectors of columns. block: (width, columns), the columns adjacent.
template <class T, int N>
KV_HD void distance_tile(T const* const (&rows)[kRows], T const* block, int columns, int width,
                         Lanes<T, N> (&square)[kRows][kVectors]) {
  for (int r = 0; r < kRows; ++r)
    for (int v = 0; v < kVectors; ++v) square[r][v] = Lanes<T, N>{};
  for (int d = 0; d < width; ++d, block += columns) {
    Lanes<T, N> column[kVectors];
    for (int v = 0; v < kVectors; ++v) column[v] = load<N>(block + v * N);
    for (int r = 0; r < kRows; ++r)
      for (int v = 0; v < kVectors; ++v) {
        Lanes<T, N> const difference = rows[r][d] - column[v];
        square[r][v] += difference * difference;
      }
  }
}

}  // namespace

template <class T>
void two_nearest(TwoNearest<T> const& p, int64_t begin, int64_t end) {
  constexpr int N = kLanes<T>, kTile = N * kVectors, kColumns = 64;
  static_assert(kColumns % kTile == 0);
  DescriptorSet<T> const &first = p.first, &second = p.second;
  bool const both = second.partial != nullptr;
  int const chunks = second.splits, width = p.width;
  int const padded = (second.count + kColumns - 1) / kColumns * kColumns;
  Scratch<T> block(int64_t(width) * kColumns), none(width), farthest(padded);
  Scratch<Neighbors<T>> of_columns(padded);
  for (int d = 0; d < width; ++d) none.data[d] = T(__builtin_nan(""));

  for (int64_t unit = begin; unit < end; ++unit) {
    int64_t const b = unit / chunks;
    int const from = int(unit - b * chunks) * kMatchingCpuRows, to = min(from + kMatchingCpuRows, first.count);
    Neighbors<T>* const of_rows = first.partial + b * first.count;
    for (int i = from; i < to; ++i) of_rows[i] = Neighbors<T>::none();
    for (int j = 0; j < padded; ++j) of_columns.data[j] = Neighbors<T>::none(), farthest.data[j] = T(__builtin_inf());

    for (int start = 0; start < second.count; start += kColumns) {
      for (int c = 0; c < kColumns; ++c) {  // NaN where there is no descriptor
        T const* const x =
            p.is_valid(second, b, start + c) ? second.values + (b * second.count + start + c) * width : none.data;
        for (int d = 0; d < width; ++d) block.data[d * kColumns + c] = x[d];
      }
      for (int i = from; i < to; i += kRows) {
        T const* rows[kRows];
        for (int r = 0; r < kRows; ++r)
          rows[r] =
              i + r < to && p.is_valid(first, b, i + r) ? first.values + (b * first.count + i + r) * width : none.data;
        for (int c = 0; c < kColumns; c += kTile) {
          Lanes<T, N> square[kRows][kVectors];
          distance_tile<T, N>(rows, block.data + c, kColumns, width, square);
          for (int r = 0; r < kRows && i + r < to; ++r)
            for (int v = 0; v < kVectors; ++v) {
              int const column = start + c + v * N;
              Lanes<T, N> const candidates = square[r][v];
              Neighbors<T>& of_row = of_rows[i + r];
              bool const near_row = any_lane(candidates <= broadcast<N>(of_row.square[1]));
              bool const near_column = both && any_lane(candidates <= load<N>(farthest.data + column));
              if (!near_row && !near_column) continue;
              for (int k = 0; k < N; ++k) {
                T const candidate = candidates[k];
                int const j = column + k;
                bool const for_row = candidate <= of_row.square[1];
                bool const for_column = both && candidate <= farthest.data[j];
                if (!(for_row || for_column) || !p.counts(b, i + r, j)) continue;
                if (for_row) of_row.insert(candidate, j);
                if (for_column) {
                  of_columns.data[j].insert(candidate, i + r);
                  farthest.data[j] = of_columns.data[j].square[1];
                }
              }
            }
        }
      }
    }
    if (both)
      for (int j = 0; j < second.count; ++j) second.partial[unit * second.count + j] = of_columns.data[j];
  }
}

// Elements of the results of the first set, then of the second.
template <class T>
void two_nearest_merge(TwoNearest<T> const& p, int64_t begin, int64_t end) {
  int64_t const of_first = p.batch * p.first.count;
  for (int64_t i = begin; i < end; ++i)
    i < of_first ? merge_neighbors(p.first, i) : merge_neighbors(p.second, i - of_first);
}

// Samples: the gradients of a sample's pairs are added in order.
template <class T>
void two_nearest_backward(TwoNearestBackward<T> const& p, int64_t begin, int64_t end) {
  int const width = p.width;
  for (int64_t b = begin; b < end; ++b) {
    for (int side = 0; side < 2; ++side) {
      NeighborGradient<T> const& set = side ? p.second : p.first;
      int64_t const size = int64_t(set.count) * width;
      for (int64_t e = b * size; e < (b + 1) * size; ++e) set.grad_values[e] = 0;
    }
    for (int side = 0; side < 2; ++side) {
      NeighborGradient<T> const &own = side ? p.second : p.first, &other = side ? p.first : p.second;
      for (int64_t i = 0; i < own.listed; ++i)
        for (int k = 0; k < own.neighbors; ++k) {
          int64_t const at = own.neighbors * (b * own.listed + i) + k, j = own.index(at);
          if (j < 0 || j >= other.count) continue;
          int64_t const row = (b * own.count + i) * width, other_row = (b * other.count + j) * width;
          T const *const x = own.values + row, *const y = other.values + other_row;
          T square = 0;
          for (int e = 0; e < width; ++e) square += (x[e] - y[e]) * (x[e] - y[e]);
          T const weight = distance_vjp(own.grad[at], square);
          if (weight == 0) continue;
          for (int e = 0; e < width; ++e) {
            T const change = weight * (x[e] - y[e]);
            own.grad_values[row + e] += change;
            other.grad_values[other_row + e] -= change;
          }
        }
    }
  }
}

// Samples [begin, end).
template <class T>
void select_matches(SelectMatches<T> const& p, int64_t begin, int64_t end) {
  for (int64_t sample = begin; sample < end; ++sample) {
    int64_t size = 0;
    T score;
    for (int i = 0; i < p.count1; ++i)
      if (p.is_match(sample, i, score)) p.store(sample, size++, i, score);
    p.sizes[sample] = size;
    for (int64_t slot = size; slot < p.count1; ++slot) p.clear(sample, slot);
  }
}

// Slots [begin, end) of all samples.
template <class T>
void select_matches_backward(SelectMatchesBackward<T> const& p, int64_t begin, int64_t end) {
  for (int64_t slot = begin; slot < end; ++slot) p.store(slot);
}

KV_INSTANTIATE_COMPUTED(two_nearest, TwoNearest)
KV_INSTANTIATE_COMPUTED(two_nearest_merge, TwoNearest)
KV_INSTANTIATE_COMPUTED(two_nearest_backward, TwoNearestBackward)
KV_INSTANTIATE_COMPUTED(select_matches, SelectMatches)
KV_INSTANTIATE_COMPUTED(select_matches_backward, SelectMatchesBackward)

}  // namespace kv::feature::KV_ISA
