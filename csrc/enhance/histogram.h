// Sums of Gaussians: how many of a row's samples lie at each of some centers, counted smoothly. Included by
// histogram_cpu.cpp, histogram.cu and histogram_op.cpp.
//
// Samples times centers would be too many exponentials, so float samples are first put into cells no wider than an
// eighth of the bandwidth, of which four moments are kept: how many samples there are, and the sums of t, t^2 and t^3,
// t being the place of a sample in its cell. Then each center adds up the cells near it, where the Gaussian is a cubic
// polynomial in t within 2e-6 of its height. The width of cells is a power of two, so t has no rounding error.
#pragma once

#include "core/isa.h"

namespace kv {

template <class T>
struct Histogram {
  T const* x;
  int64_t rows, samples;
  T const *centers, *bandwidth;
  int64_t bins, center_stride, bandwidth_stride;  // from row to row; 0 where all rows have the same ones
  T* counts;
  int64_t chunk, chunks;  // samples of a row that CUDA counts in one block; how many of these a row has
  T* partial;             // on CUDA, the counts of all chunks
};

// Its gradient to x: every sample's sum of grad times the derivative of the Gaussians. By cells as well: each has a
// cubic polynomial in t, and a sample takes its value.
template <class T>
struct HistogramBackward {
  Histogram<T> forward;  // without counts
  T const* grad;
  T* grad_x;
};

KV_KERNEL(histogram, Histogram)
KV_KERNEL(histogram_backward, HistogramBackward)

constexpr float kReach = 6;           // bandwidths; beyond, a Gaussian is 1.5e-8 and less
constexpr int kMaxSamples = 1 << 16;  // in one chunk: fixed-point moments then fit 32 bits

struct MomentGrid {
  float bandwidth, width, inverse;
  int first, cells;  // cell i is [first + i, first + i + 1) * width; no cells: the grid would not fit

  KV_HD MomentGrid(float lowest, float highest, float h, int most_cells)
      : bandwidth(h < 0 ? -h : h),
        width(bits_to_float(float_to_bits(bandwidth / 8) & 0x7f800000)),  // the power of two below
        inverse(1 / width),
        first(0),
        cells(0) {
    float const begin = (lowest - kReach * bandwidth) * inverse, end = (highest + kReach * bandwidth) * inverse;
    float const most = float(1 << 22);  // places are exact up to there
    if (!(begin > -most && end < most && end - begin < float(most_cells - 2))) return;
    first = int(begin) - (begin < 0);
    cells = int(end) + (end >= 0) - first;
  }
  KV_HD float middle(int cell) const { return (float(first + cell) + 0.5f) * width; }
  // The cells [begin, end) in reach of a center.
  KV_HD int begin(float center) const {
    return clamp(int((center - kReach * bandwidth) * inverse) - 1 - first, 0, cells);
  }
  KV_HD int end(float center) const {
    return clamp(int((center + kReach * bandwidth) * inverse) + 2 - first, 0, cells);
  }
};

// What moments m_i, the sums of (t w)^i, weigh with the Gaussian exp(-(u + t w)^2 / 2), less its value at t = 0; u and
// w are in bandwidths.
template <class V, class W>
KV_HD V weighted(V u, W w, V m0, V m1, V m2, V m3) {
  V const square = u * u;
  return m0 + w * (w * (w * (u * (3 - square)) * m3 * (1.f / 6) + (square - 1) * m2 * 0.5f) - u * m1);
}

// The same for the derivative of the Gaussian: by the coefficients of t^0, t^1, t^2 and t^3.
template <class V, class W>
KV_HD void derivative(V u, W w, V (&c)[4]) {
  V const square = u * u;
  c[0] = -u;
  c[1] = (square - 1) * w;
  c[2] = u * (3 - square) * (w * w / 2);
  c[3] = (square * (square - 6) + 3) * (w * w * w / 6);
}

constexpr double kHalfLog2E = 0.72134752044448170368;  // exp(-u^2 / 2) is 2^(-u^2 times this)

}  // namespace kv
