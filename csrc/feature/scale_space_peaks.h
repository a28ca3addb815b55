// The strongest peaks of a response over position and scale (D. Lowe, "Distinctive image features from scale-invariant
// keypoints", 2004), of volumes (D, H, W):
//
//   1. voxels above, or below, their 26 neighbors
//   2. off edges: of the Hessian H along x and y, trace^2 / det < (r + 1)^2 / r
//   3. refined between voxels as geometry/subpix/quad_interp3d.h says; a minimum has its negative value
//   4. whose frame is inside: a feature of scale s = s_0 2^(level / n) stays s / 2 and some pixels from the border
//   5. above a threshold
//   6. the strongest `count`, in order
//
// The response is stored, or it is the difference of adjacent levels of a pyramid, which is not: a band of rows keeps
// three of its rows. Included by scale_space_peaks_cpu.cpp and scale_space_peaks_op.cpp.
#pragma once

#include "geometry/subpix/quad_interp3d.h"

namespace kv::feature {

constexpr int64_t kPeakRows = 64;  // of a band

template <class F>
struct ScaleSpacePeak {
  F score, value, level, x, y;
  int64_t voxel;  // the one that is above its neighbors; the offset in its volume
};

template <class T>
struct ScaleSpacePeaks {
  T const* levels;                       // (samples, D, H, W), or (samples, D + 1, H, W) whose differences are searched
  Compute<T> const* weights;             // (samples, H, W) in [0, 1]; null for 1
  Compute<T> const* scales;              // (samples): s_0
  ScaleSpacePeak<Compute<T>>* bands;     // (samples, bands_of_sample, count): the strongest of each band
  int64_t* sizes;                        // (samples, bands_of_sample): how many these are
  Compute<T>* peaks;                     // (samples, count, 4): level, x, y, value
  int64_t* voxels;                       // (samples, count), -1 after the last peak
  geometry::ConvQuadInterp3d<T> search;  // the size of a volume and how to refine; without tensors
  int64_t samples, bands_of_sample, count;
  bool differences, minima;
  Compute<T> levels_of_octave, margin, edge_ratio, threshold;  // n; pixels; r, 0 keeps edges
};

template <class T>
struct ScaleSpacePeaksBackward {
  Compute<T> const* grad;
  T const* levels;
  int64_t const* voxels;
  Compute<T>* grad_levels;
  geometry::ConvQuadInterp3d<T> search;
  int64_t samples, count;
  bool differences;
};

KV_KERNEL(find_scale_space_peaks, ScaleSpacePeaks)
KV_KERNEL(sort_scale_space_peaks, ScaleSpacePeaks)
KV_KERNEL(scale_space_peaks_backward, ScaleSpacePeaksBackward)

// Reads the response at a voxel, of which `level` is the pixel of the level below it.
template <class T, class Load>
struct ResponseAt {
  int64_t plane;  // 0: the response is stored
  Load load;
  KV_HD auto operator()(T const& level) const { return plane ? load(&level + plane) - load(&level) : load(&level); }
};

// Whether both principal curvatures of a level have the same sign and a ratio below `ratio`. at(dy, dx) reads around
// the voxel.
template <class F, class At>
KV_HD bool is_off_edges(F ratio, At at) {
  F const middle = at(0, 0), xx = at(0, 1) - 2 * middle + at(0, -1), yy = at(1, 0) - 2 * middle + at(-1, 0);
  F const xy = (at(1, 1) - at(1, -1) - at(-1, 1) + at(-1, -1)) * F(0.25);
  F const trace = xx + yy, det = xx * yy - xy * xy;
  return det > 0 && trace * trace * ratio < (ratio + 1) * (ratio + 1) * det;
}

// Moves a score towards the worst by a weight in (0, 1].
template <class F>
KV_HD F weighted_score(F score, F weight, F lowest) {
  return score >= 0 ? score * weight : max(score / weight, lowest);
}

// The strongest of the peaks that are added, at most `capacity`: a binary heap whose root is the weakest. Of equal
// scores the first voxel is the stronger one, so that the order in which they are added does not matter.
template <class F>
struct StrongestPeaks {
  ScaleSpacePeak<F>* heap;
  int64_t capacity, size;

  static KV_HD bool is_weaker(ScaleSpacePeak<F> const& a, ScaleSpacePeak<F> const& b) {
    return a.score < b.score || (a.score == b.score && a.voxel > b.voxel);
  }
  KV_HD void add(ScaleSpacePeak<F> const& peak) {
    if (size < capacity) {
      int64_t i = size++;
      for (int64_t parent; i > 0 && is_weaker(peak, heap[parent = (i - 1) / 2]); i = parent) heap[i] = heap[parent];
      heap[i] = peak;
    } else if (capacity > 0 && is_weaker(heap[0], peak)) {
      sink(peak);
    }
  }
  // Replaces the root.
  KV_HD void sink(ScaleSpacePeak<F> const& peak) {
    int64_t i = 0;
    for (int64_t child; (child = 2 * i + 1) < size; i = child) {
      if (child + 1 < size && is_weaker(heap[child + 1], heap[child])) ++child;
      if (!is_weaker(heap[child], peak)) break;
      heap[i] = heap[child];
    }
    heap[i] = peak;
  }
  // The strongest first; nothing is added afterwards.
  KV_HD void sort() {
    while (size > 1) {
      ScaleSpacePeak<F> const weakest = heap[0], last = heap[--size];
      sink(last);
      heap[size] = weakest;
    }
  }
};

}  // namespace kv::feature
