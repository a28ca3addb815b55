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
// The response is stored, or it is the difference of adjacent levels of a pyramid, which is not: on the CPU a band of
// rows keeps three of its rows. The octaves of a scale space are volumes of several sizes that are searched together;
// the voxels of all are numbered one octave after the other.
#pragma once

#if !defined(__CUDACC__)
#include "core/lanes.h"
#endif
#include "geometry/subpix/quad_interp3d.h"

namespace kv::feature {

constexpr int64_t kPeakPixels = 1 << 16;  // of a band, about
constexpr int kMaxOctaves = 16;

template <class F>
struct ScaleSpacePeak {
  F score, value, level, x, y;
  int64_t voxel;  // the extremum, as an index into the voxels of all octaves
};

// The order of peaks: the strongest first, and of equal scores the first voxel, so that there is only one order.
template <class F>
struct PeakRank {
  F score;
  int voxel;
  KV_HD bool operator<(PeakRank const& other) const {
    return score > other.score || (score == other.score && voxel < other.voxel);
  }
};

// The rows of a band that a thread of the CPU searches. Bands of all octaves have as many pixels, so that threads have
// as much to do.
KV_HD int64_t peak_rows(int64_t width) { return max(kPeakPixels / width, int64_t(1)); }

// The tiles of pixels that blocks of CUDA search, inside of the border of a level.
constexpr int kPeakTileWidth = 30, kPeakTileHeight = 64;
KV_HD int peak_tiles_across(int width) { return (width - 2 + kPeakTileWidth - 1) / kPeakTileWidth; }
KV_HD int peak_tiles(int height, int width) {
  return peak_tiles_across(width) * ((height - 2 + kPeakTileHeight - 1) / kPeakTileHeight);
}

// The size of the sorted list that has the first `count` of at most `capacity` ranks: a power of two.
KV_HD int64_t sorted_ranks(int64_t count, int64_t capacity) {
  int64_t size = 1;
  while (size < count && size < capacity) size *= 2;
  return size;
}

template <class T>
struct PeakOctave {
  T const* levels;     // (samples, D, H, W), or (samples, D + 1, H, W) whose differences are searched
  int size[3];         // D, H, W
  int first_part = 0;  // of the octave, among the parts of a sample: bands on the CPU, tiles on CUDA
  int first_voxel = 0;
  Compute<T> to_x = 1, to_y = 1;  // the size of a pixel of the octave, in pixels of the image

  KV_HD int64_t plane() const { return int64_t(size[1]) * size[2]; }
  KV_HD T const* of_sample(int64_t sample, bool differences) const {
    return levels + sample * (size[0] + differences) * plane();
  }
};

template <class T>
struct ScaleSpacePeaks {
  PeakOctave<T> octaves[kMaxOctaves];
  int octave_count, parts_of_sample;
  Compute<T> const* weights;  // (samples, H, W) in [0, 1], of a single octave; null for 1
  Compute<T> const* scales;   // (samples): s_0; null for `scale`
  Compute<T> scale;
  T const* images;  // (samples, pixels): a constant image has no peaks; null if this is not checked
  int64_t pixels;
  // On the CPU the strongest of each band of rows are kept, on CUDA the ranks of all peaks of a sample.
  ScaleSpacePeak<Compute<T>>* bands;  // (samples, parts_of_sample, count)
  PeakRank<Compute<T>>* ranks;        // (samples, capacity), then (samples, sorted_ranks(count, capacity))
  int64_t* sizes;                     // (samples, parts_of_sample), or (samples)
  // The results are peaks and voxels of a single octave, or frames and scores of several.
  Compute<T>* peaks;                     // (samples, count, 4): level, x, y, value
  int64_t* voxels;                       // (samples, count), -1 after the last peak
  Compute<T>* frames;                    // (samples, count, 2, 3), 0 after the last peak
  Compute<T>* scores;                    // (samples, count), 0 after the last peak
  geometry::ConvQuadInterp3d<T> search;  // the parameters of the refinement; tensors and sizes are not set
  int64_t samples, capacity, count;
  bool differences, minima;
  Compute<T> levels_of_octave, margin, edge_ratio, threshold;  // n; pixels; r, 0 keeps edges

  KV_HD PeakOctave<T> const& octave_of_part(int part) const {
    int o = 0;
    while (o + 1 < octave_count && part >= octaves[o + 1].first_part) ++o;
    return octaves[o];
  }
  KV_HD PeakOctave<T> const& octave_of_voxel(int64_t voxel) const {
    int o = 0;
    while (o + 1 < octave_count && voxel >= octaves[o + 1].first_voxel) ++o;
    return octaves[o];
  }
  KV_HD geometry::ConvQuadInterp3d<T> search_in(PeakOctave<T> const& octave) const {
    geometry::ConvQuadInterp3d<T> s = search;
    for (int a = 0; a < 3; ++a) s.size[a] = octave.size[a];
    return s;
  }
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

template <class F>
KV_HD F exp2_of(F x) {
#if defined(__CUDACC__)
  return exp2(x);
#else
  return vexp2<F, 1>(x);
#endif
}

// Whether the weights of the four pixels around a point are above 0.
template <class F>
KV_HD bool is_allowed(F const* weights, int width, F x, F y) {
  int const left = int(x), top = int(y), right = left + (x > F(left)), bottom = top + (y > F(top));
  F const *const upper = weights + int64_t(top) * width, *const lower = weights + int64_t(bottom) * width;
  return upper[left] > 0 && upper[right] > 0 && lower[left] > 0 && lower[right] > 0;
}

// The peak that an extremum is refined to. read(level) is the response at a voxel of the sample's levels.
template <class T, class Read>
KV_HD ScaleSpacePeak<Compute<T>> refine_extremum(geometry::ConvQuadInterp3d<T> const& search, T const* levels, int z,
                                                 int y, int x, bool is_maximum, Read read) {
  using F = Compute<T>;
  int const width = search.size[2];
  int64_t const plane = int64_t(search.size[1]) * width, voxel = z * plane + int64_t(y) * width + x;
  F const response = F(read(levels[voxel]));
  ScaleSpacePeak<F> peak{0, is_maximum ? response : -response, F(z), F(x), F(y), voxel};
  find_peak(search, levels, z, y, x, read, [&](int const(&c)[3], geometry::Quadratic<F> const& q) {
    F const value = F(read(levels[c[2] * plane + int64_t(c[1]) * width + c[0]])) + q.rise();
    peak.value = is_maximum ? value : -value;
    peak.x = F(c[0]) + q.shift[0], peak.y = F(c[1]) + q.shift[1], peak.level = F(c[2]) + q.shift[2];
  });
  return peak;
}

// Calls use(peak) with the refined extremum and its score, if it is a peak. around(dy, dx) is the response near it.
template <class T, class Read, class Around, class Use>
KV_HD void refine_peak(ScaleSpacePeaks<T> const& p, PeakOctave<T> const& octave, int64_t sample, T const* levels, int z,
                       int y, int x, bool is_maximum, Read read, Around around, Use use) {
  using F = Compute<T>;
  int const height = octave.size[1], width = octave.size[2];
  F const* const weights = p.weights ? p.weights + sample * height * width : nullptr;
  F const weight = weights ? weights[int64_t(y) * width + x] : F(1);
  if (!(weight > 0)) return;
  if (p.edge_ratio > 0 && !is_off_edges(p.edge_ratio, around)) return;
  ScaleSpacePeak<F> peak = refine_extremum(p.search_in(octave), levels, z, y, x, is_maximum, read);
  // The refinement may move the value of a minimum across 0.
  if (!is_maximum && !(peak.value > around(0, 0))) return;
  F const scale = p.scales ? p.scales[sample] : p.scale;
  F const room = p.margin + scale * exp2_of(peak.level / p.levels_of_octave) / 2;
  if (!(peak.x >= room && peak.y >= room && peak.x + room <= F(width - 1) && peak.y + room <= F(height - 1))) return;
  if (weights && !is_allowed(weights, width, peak.x, peak.y)) return;
  constexpr F lowest = sizeof(F) == 4 ? F(-__FLT_MAX__) : F(-__DBL_MAX__);
  peak.score = weights ? weighted_score(peak.value, weight, lowest) : peak.value;
  peak.voxel += octave.first_voxel;
  if (peak.score > p.threshold) use(peak);
}

// Stores the peak of a slot. Voxel -1: there is none.
template <class T>
KV_HD void store_peak(ScaleSpacePeaks<T> const& p, int64_t slot, ScaleSpacePeak<Compute<T>> const& peak) {
  using F = Compute<T>;
  if (!p.frames) {
    F* const numbers = p.peaks + 4 * slot;
    numbers[0] = peak.level, numbers[1] = peak.x, numbers[2] = peak.y, numbers[3] = peak.value;
    p.voxels[slot] = peak.voxel;
    return;
  }
  PeakOctave<T> const& octave = p.octave_of_voxel(peak.voxel);
  F const scale = peak.voxel < 0 ? F(0) : p.scale * exp2_of(peak.level / p.levels_of_octave);
  F* const laf = p.frames + 6 * slot;
  laf[0] = scale * octave.to_x, laf[1] = 0, laf[2] = peak.x * octave.to_x;
  laf[3] = 0, laf[4] = scale * octave.to_y, laf[5] = peak.y * octave.to_y;
  p.scores[slot] = peak.value;
}

// Whether the extremum at a voxel inside the volume is a maximum.
template <class T, class Read>
KV_HD bool is_maximum_at(T const* levels, int64_t voxel, Read read) {
  return read(levels[voxel]) > read(levels[voxel + 1]);
}

// Calls add(voxel, number) for the gradient of slot k, whose sample has these levels, to the response.
template <class T, class Read, class Add>
KV_HD void peak_vjp(ScaleSpacePeaksBackward<T> const& p, int64_t k, T const* levels, Read read, Add add) {
  using F = Compute<T>;
  int const depth = p.search.size[0], height = p.search.size[1], width = p.search.size[2];
  int64_t const voxel = p.voxels[k], plane = int64_t(height) * width;
  if (voxel < 0 || voxel >= depth * plane) return;
  int const z = int(voxel / plane), y = int(voxel / width % height), x = int(voxel % width);
  if (z < 1 || z > depth - 2 || y < 1 || y > height - 2 || x < 1 || x > width - 2) return;
  F const grad_shift[] = {p.grad[4 * k + 1], p.grad[4 * k + 2], p.grad[4 * k]};
  F const grad_value = is_maximum_at(levels, voxel, read) ? p.grad[4 * k + 3] : -p.grad[4 * k + 3];
  bool moves = false;
  find_peak(p.search, levels, z, y, x, read, [&](int const(&c)[3], geometry::Quadratic<F> const& q) {
    int64_t const center = c[2] * plane + int64_t(c[1]) * width + c[0];
    q.vjp(grad_shift, grad_value,
          [&](int dx, int dy, int dz, F number) { add(center + dz * plane + dy * width + dx, number); });
    moves = true;
  });
  if (!moves) add(voxel, grad_value);
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
