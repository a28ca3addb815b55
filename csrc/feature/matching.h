// The two nearest descriptors of the other set, in one direction or both, and the gradient of their distances.
//
//               b_0  b_1  ...  b_M-1
//         a_0 [ d00  d01  ...        ]  -> the two smallest of a row:    neighbors of a_0
//         a_1 [ d10  d11  ...        ]
//         ... [                      ]      d_ij = |a_i - b_j|
//               |
//               v the two smallest of a column: neighbors of b_0
//
// Distances are computed in tiles and never stored. A tile leaves the two smallest of its rows and columns; another
// kernel merges those of all tiles. Squares are sums of squared differences, so that equal descriptors have distance 0.
// Equal distances are ordered by index, so the results do not depend on the tiles. Distances that are NaN
// do not count: a descriptor with NaN has no neighbors and is no neighbor.
#pragma once

#include "core/hd.h"
#include "core/isa.h"

namespace kv::feature {

// The two nearest neighbors of a descriptor, by squared distances; index -1 where there is none.
template <class F>
struct Neighbors {
  F square[2];
  int index[2];

  static KV_HD Neighbors none() { return {{F(__builtin_inf()), F(__builtin_inf())}, {-1, -1}}; }
  KV_HD static bool precedes(F square, int index, F other_square, int other_index) {
    return square < other_square || (square == other_square && index < other_index);
  }
  KV_HD void insert(F candidate, int at) {
    if (!precedes(candidate, at, square[1], index[1])) return;
    bool const first = precedes(candidate, at, square[0], index[0]);
    square[1] = first ? square[0] : candidate;
    index[1] = first ? index[0] : at;
    if (first) square[0] = candidate, index[0] = at;
  }
  KV_HD void merge(Neighbors const& other) {
    if (other.index[0] >= 0) insert(other.square[0], other.index[0]);
    if (other.index[1] >= 0) insert(other.square[1], other.index[1]);
  }
};

// Rows of a chunk that one thread of the CPU processes, and of a tile that one block of CUDA does.
constexpr int kMatchingCpuRows = 256;
template <class T>
constexpr int kMatchingTile = sizeof(T) == 4 ? 128 : 64;

// The three nearest descriptors of a tile; matching_candidates.cu says how they are encoded.
struct Candidates {
  int v[3];
  static KV_HD Candidates none() { return {{INT32_MAX, INT32_MAX, INT32_MAX}}; }
};

// The count of bfloat16 of a descriptor whose components are sums of two of them, padded to 32 components.
KV_HD int64_t split_width(int width) { return (int64_t(width) + 31) / 32 * 64; }

// Descriptors of one of the two sets: (batch, count, width).
template <class T>
struct DescriptorSet {
  T const* values;
  bool const* mask;    // (batch, count), false for those to leave out; null: there are none
  T const* positions;  // (batch, count, 2); null unless pairs with near positions are left out
  int count;
  // Results:
  int splits;             // a row of partial results for each part of the other set
  Neighbors<T>* partial;  // (batch, splits, count); null if the neighbors are not requested
  bool pairs;             // whether the results are those of the nearest only, see store_neighbors
  T* distances;           // (batch, count, 2), or 1 for pairs
  int64_t* indices;       // (batch, count, 2)
  // Working memory of matching_candidates.cu, else null:
  T* half_squares;         // (batch, count)
  BFloat16* split;         // (batch, count, split_width(width))
  Candidates* candidates;  // (batch, count, tiles of the other set); null if the neighbors are not requested

  KV_HD unsigned tiles() const { return unsigned((count + kMatchingTile<T> - 1) / kMatchingTile<T>); }
};

template <class T>
struct TwoNearest {
  DescriptorSet<T> first, second;
  int64_t batch;
  int width;
  bool both;         // whether the neighbors of the second set are requested
  T radius_squared;  // a pair of which the positions are nearer does not count

  KV_HD bool is_valid(DescriptorSet<T> const& set, int64_t b, int i) const {
    return i < set.count && (!set.mask || set.mask[b * set.count + i]);
  }
  KV_HD bool counts(int64_t b, int i, int j) const {
    if (!first.positions) return true;
    T const *const p = first.positions + 2 * (b * first.count + i), *const q =
                                                                        second.positions + 2 * (b * second.count + j);
    T const x = p[0] - q[0], y = p[1] - q[1];
    return !(x * x + y * y < radius_squared);
  }
};

// Stores the neighbors of descriptor `at` of a sample, element `i` of the results. A pair has the indices of a
// descriptor and of its nearest one, 0 where there is none.
template <class T>
KV_HD void store_neighbors(DescriptorSet<T> const& set, int64_t i, int64_t at, Neighbors<T> const& neighbors) {
  if (set.pairs) {
    set.distances[i] = sqrt(neighbors.square[0]);
    set.indices[2 * i] = at, set.indices[2 * i + 1] = neighbors.index[0] < 0 ? 0 : neighbors.index[0];
    return;
  }
  for (int k = 0; k < 2; ++k) {
    set.distances[2 * i + k] = sqrt(neighbors.square[k]);
    set.indices[2 * i + k] = neighbors.index[k];
  }
}

// Merges the partial results of element `i` of the results of a set, and stores them.
template <class T>
KV_HD void merge_neighbors(DescriptorSet<T> const& set, int64_t i) {
  int64_t const b = i / set.count, at = i - b * set.count;
  Neighbors<T> merged = Neighbors<T>::none();
  for (int s = 0; s < set.splits; ++s) merged.merge(set.partial[(b * set.splits + s) * set.count + at]);
  store_neighbors(set, i, at, merged);
}

// The gradient to both sets. With unit vectors u from the neighbor to the descriptor,
//
//   grad_a_i = sum over neighbors j of a_i: grad_ij u + sum over b_j with neighbor a_i: grad_ji u
template <class T>
struct NeighborGradient {
  T const* values;         // (batch, count, width)
  T const* grad;           // (batch, listed, neighbors), to the distances of the neighbors of this set
  int64_t const* indices;  // (batch, listed, 2), of which the last `neighbors` are those of neighbors
  int count, listed;       // listed: count, or 0 if these neighbors were not requested
  int neighbors;           // 2, or 1 for pairs
  T* grad_values;          // (batch, count, width)

  // Entry `at` of grad, as an entry of indices.
  KV_HD int64_t index(int64_t at) const { return indices[neighbors == 2 ? at : 2 * at + 1]; }
};

template <class T>
struct TwoNearestBackward {
  NeighborGradient<T> first, second;
  int64_t batch;
  int width;
};

// The weight of x - y in the gradient to x from the gradient to |x - y|. The gradient at 0 is taken as 0. The weight of
// descriptors that have no finite distance, which are no neighbors, is 0 as well: the caller leaves them out.
template <class F>
KV_HD F distance_vjp(F grad, F square) {
  return square > 0 ? grad / sqrt(square) : F(0);
}

// The list of matches of each sample. A descriptor of the first set and its nearest neighbor are a match if they are
// mutual nearest neighbors, where the neighbors of the second set are given, and, with `ratios`, if the ratios of the
// nearest distance to the second nearest are at most `threshold`. Matches are in the order of the first set. Free slots
// after the last match have score 0 and indices -1.
template <class T>
struct SelectMatches {
  T const *distances1,
      *distances2;  // (batch, count, 2); those of the second set are null if matches need not be mutual
  int64_t const *indices1, *indices2;
  int64_t batch;
  int count1, count2;
  bool ratios;
  T threshold;
  T* scores;         // (batch, count1): the larger ratio, or the distance
  int64_t* indices;  // (batch, count1, 2)
  int64_t* sizes;    // (batch)

  // The ratio of descriptor i; NaN, which passes no test, if it has fewer than two neighbors.
  static KV_HD T ratio(T const* distances, int64_t const* indices, int64_t i) {
    return indices[2 * i + 1] >= 0 ? distances[2 * i] / distances[2 * i + 1] : T(__builtin_nan(""));
  }
  // Whether descriptor i of a sample has a match, and its score.
  KV_HD bool is_match(int64_t sample, int i, T& score) const {
    int64_t const own = sample * count1 + i, nearest = indices1[2 * own], back = sample * count2 + nearest;
    if (nearest < 0 || nearest >= count2) return false;
    if (indices2 && indices2[2 * back] != i) return false;
    score = ratios ? ratio(distances1, indices1, own) : distances1[2 * own];
    if (!ratios) return true;
    T const other = indices2 ? ratio(distances2, indices2, back) : score;
    bool const passes = score <= threshold && other <= threshold;
    score = score < other ? other : score;
    return passes;
  }
  KV_HD void store(int64_t sample, int64_t slot, int i, T score) const {
    int64_t const at = sample * count1 + slot;
    scores[at] = score;
    indices[2 * at] = i, indices[2 * at + 1] = indices1[2 * (sample * count1 + i)];
  }
  KV_HD void clear(int64_t sample, int64_t slot) const {
    int64_t const at = sample * count1 + slot;
    scores[at] = 0, indices[2 * at] = -1, indices[2 * at + 1] = -1;
  }
};

// The gradient of the distances from that of the scores. A descriptor is in at most one match, so nothing is summed.
// The gradient goes to the larger of the two ratios, and half of it to each where they are equal.
template <class T>
struct SelectMatchesBackward {
  T const* grad;           // (batch, count1)
  int64_t const* indices;  // (batch, count1, 2)
  T const *distances1, *distances2;
  T *grad_distances1, *grad_distances2;  // zeros
  int64_t batch;
  int count1, count2;
  bool ratios;

  static KV_HD void ratio_vjp(T grad, T const* distances, T* grad_distances) {
    T const inverse = 1 / distances[1];
    grad_distances[0] = grad * inverse, grad_distances[1] = -grad * distances[0] * inverse * inverse;
  }
  // `slot` counts the slots of all samples.
  KV_HD void store(int64_t slot) const {
    int64_t const sample = slot / count1, i = indices[2 * slot], j = indices[2 * slot + 1];
    if (i < 0 || i >= count1 || j < 0 || j >= count2) return;
    int64_t const own = 2 * (sample * count1 + i), back = 2 * (sample * count2 + j);
    if (!ratios) {
      grad_distances1[own] = grad[slot];
    } else if (!distances2) {
      ratio_vjp(grad[slot], distances1 + own, grad_distances1 + own);
    } else {
      T const one = distances1[own] / distances1[own + 1], other = distances2[back] / distances2[back + 1];
      T const weight = one > other ? T(1) : one < other ? T(0) : T(0.5);
      if (weight > 0) ratio_vjp(grad[slot] * weight, distances1 + own, grad_distances1 + own);
      if (weight < 1) ratio_vjp(grad[slot] * (1 - weight), distances2 + back, grad_distances2 + back);
    }
  }
};

KV_KERNEL(two_nearest, TwoNearest)
KV_KERNEL(two_nearest_merge, TwoNearest)
KV_KERNEL(two_nearest_backward, TwoNearestBackward)
KV_KERNEL(select_matches, SelectMatches)
KV_KERNEL(select_matches_backward, SelectMatchesBackward)

namespace cuda {
bool has_matching_candidates();  // on the current GPU
// Replace two_nearest and two_nearest_merge for sets with half_squares.
int find_matching_candidates(TwoNearest<float> const& p, CUstream_st* stream);
int choose_matching_neighbors(TwoNearest<float> const& p, CUstream_st* stream);
// Replaces both for small sets, with the same results.
int find_matching_neighbors(TwoNearest<float> const& p, CUstream_st* stream);
}  // namespace cuda

}  // namespace kv::feature
