// Sums of Gaussians: a smooth count of a row's samples at each center.
//
// Samples times centers would be too many exponentials, so float samples are first binned into cells of at most an
// eighth of the bandwidth. A cell keeps four moments: the number of its samples, and the sums of t, t^2 and t^3, where
// t is the offset of a sample within its cell. Each center then sums the nearby cells, in which a cubic polynomial in t
// approximates the Gaussian within 2e-6 of its height. The width of cells is a power of two, so t has no rounding
// error.
#pragma once

#include "core/isa.h"

namespace kv::enhance {

template <class T>
struct Histogram {
  T const* x;
  int64_t rows, samples;
  T const *centers, *bandwidth;
  int64_t bins, center_stride, bandwidth_stride;  // from row to row; 0 if all rows share one
  T* counts;
  int64_t chunk, chunks;  // samples of a row per CUDA block; the number of such chunks in a row
  T* partial;             // CUDA: the counts of all chunks
};

// The gradient with respect to x: for every sample the sum of grad times the derivative of the Gaussians. Cells serve
// here as well: each has a cubic polynomial in t, which is evaluated at the samples.
template <class T>
struct HistogramBackward {
  Histogram<T> forward;  // its counts are unused
  T const* grad;
  T* grad_x;
};

// Rows of counts, each divided by its sum plus eps.
template <class T>
struct NormalizeCounts {
  T const* counts;
  int64_t rows, bins;
  T eps;
  T* y;
};

// With s = sum of counts + eps, y = counts / s, and the gradient is (grad - sum of grad y) / s.
template <class T>
struct NormalizeCountsBackward {
  T const *grad, *counts;
  int64_t rows, bins;
  T eps;
  T* grad_counts;
};

KV_KERNEL(histogram, Histogram)
KV_KERNEL(histogram_backward, HistogramBackward)
KV_KERNEL(normalize_counts, NormalizeCounts)
KV_KERNEL(normalize_counts_backward, NormalizeCountsBackward)

constexpr float kReach = 6;           // in bandwidths; at larger distances a Gaussian is at most 1.5e-8
constexpr int kMaxSamples = 1 << 16;  // per chunk: fixed-point moments then fit 32 bits

struct MomentGrid {
  float bandwidth, width, inverse;
  int first, cells;  // cell i is [first + i, first + i + 1) * width; no cells: the grid would not fit

  KV_HD MomentGrid(float lowest, float highest, float h, int most_cells)
      : bandwidth(h < 0 ? -h : h),
        width(
            bits_to_float(float_to_bits(bandwidth / 8) & 0x7f800000)),  // the largest power of two that is not greater
        inverse(1 / width),
        first(0),
        cells(0) {
    float const begin = (lowest - kReach * bandwidth) * inverse, end = (highest + kReach * bandwidth) * inverse;
    float const most = float(1 << 22);  // cell indices are exact up to there
    if (!(begin > -most && end < most && end - begin < float(most_cells - 2))) return;
    first = int(begin) - (begin < 0);
    cells = int(end) + (end >= 0) - first;
  }
  KV_HD float middle(int cell) const { return (float(first + cell) + 0.5f) * width; }
  // The cells [begin, end) within reach of a center.
  KV_HD int begin(float center) const {
    return clamp(int((center - kReach * bandwidth) * inverse) - 1 - first, 0, cells);
  }
  KV_HD int end(float center) const {
    return clamp(int((center + kReach * bandwidth) * inverse) + 2 - first, 0, cells);
  }
};

// The weights of the moments m_i, the sums of (t w)^i, in the expansion of exp(-(u + t w)^2 / 2), divided by its value
// at t = 0; u and w are in bandwidths.
template <class V, class W>
KV_HD V weighted(V u, W w, V m0, V m1, V m2, V m3) {
  V const square = u * u;
  return m0 + w * (w * (w * (u * (3 - square)) * m3 * (1.f / 6) + (square - 1) * m2 * 0.5f) - u * m1);
}

// The same for the derivative of the Gaussian, as the coefficients of t^0, t^1, t^2 and t^3.
template <class V, class W>
KV_HD void derivative(V u, W w, V (&c)[4]) {
  V const square = u * u;
  c[0] = -u;
  c[1] = (square - 1) * w;
  c[2] = u * (3 - square) * (w * w / 2);
  c[3] = (square * (square - 6) + 3) * (w * w * w / 6);
}

constexpr double kHalfLog2E = 0.72134752044448170368;  // exp(-u^2 / 2) = 2^(-kHalfLog2E u^2)

}  // namespace kv::enhance
