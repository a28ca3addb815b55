// The dominant gradient orientation of square patches, and its derivative.
//
// Pixels vote with their Sobel gradients, weighted by a Gaussian of sigma n / 6, for the two bins around their angle.
// The histogram is smoothed around the circle by a Gaussian of 5 bins, and a parabola through its largest bin and the
// two adjacent ones gives the peak. The angle is counter-clockwise as seen in the image, so it is that from x to y,
// negated:
//
//   angle = pi - 2 pi (peak + 1/2 (l - r) / (l + r - 2 m)) / bins
//
// where m is the largest bin, l the one before and r the one after.
//
// Further angles of a patch are those of the next largest local maxima of the histogram that are at least `threshold`
// times the largest bin. Where there are fewer of them, the first angle is repeated.
#pragma once

#include "core/isa.h"
#include "patch_gradient.h"

namespace kv::feature {

constexpr int kMaxOrientationBins = 64;

// The weights of bins 0, 1 and 2 away: the discrete Gaussian I_k(s) of s = 1.6^2, over its sum.
constexpr int kSmoothing = 2;
template <class F>
KV_HD F smoothing_weight(int distance) {
  return F(distance == 0 ? 0.29962780949740747 : distance == 1 ? 0.2311235920177775 : 0.11906250323351877);
}

template <class T>
struct Orientation {
  T const* patches;  // (count, n, n)
  T* angles;         // (count, peaks)
  int64_t count;
  int n, bins, peaks;
  Compute<T> eps, threshold;
};

template <class T>
struct OrientationBackward {
  T const* grad;  // (count, peaks)
  T const* patches;
  T* grad_patches;
  int64_t count;
  int n, bins, peaks;
  Compute<T> eps, threshold;
};

KV_KERNEL(orientation, Orientation)
KV_KERNEL(orientation_backward, OrientationBackward)

// A bin around the circle, for one at most 64 bins away.
KV_HD int wrap_bin(int bin, int bins) {
#if defined(__CUDACC__)  // not yet measured there without divisions
  return ((bin % bins) + bins) % bins;
#else
  while (bin < 0) bin += bins;  // divisions would take a third of the time of a patch
  while (bin >= bins) bin -= bins;
  return bin;
#endif
}

template <class F>
KV_HD F smoothed_bin(F const* histogram, int bin, int bins) {
  F sum = histogram[bin] * smoothing_weight<F>(0);
  for (int d = 1; d <= kSmoothing; ++d)
    sum += (histogram[wrap_bin(bin - d, bins)] + histogram[wrap_bin(bin + d, bins)]) * smoothing_weight<F>(d);
  return sum;
}

// A bin of a smoothed histogram with its neighbors. A histogram without a peak has curvature 0.
template <class F>
struct Peak {
  int bin;
  F left, middle, right;

  KV_HD Peak(F const* smoothed, int bin, int bins)
      : bin(bin),
        left(smoothed[wrap_bin(bin - 1, bins)]),
        middle(smoothed[bin]),
        right(smoothed[wrap_bin(bin + 1, bins)]) {}
  KV_HD F curvature() const { return left + right - 2 * middle; }
  KV_HD F angle(int bins) const {
    F const b = curvature(), offset = b != 0 ? (left - right) / b / 2 : F(0);
    return F(kPi) - F(2 * kPi) * (F(bin) + offset) / F(bins);
  }
  // The derivatives of the angle along left, middle and right.
  KV_HD void derivatives(int bins, F (&d)[3]) const {
    F const b = curvature(), scale = -F(2 * kPi) / F(bins);
    F const offset = b != 0 ? (left - right) / b / 2 : F(0), inverse = b != 0 ? scale / b : F(0);
    d[0] = (F(0.5) - offset) * inverse, d[1] = 2 * offset * inverse, d[2] = (F(-0.5) - offset) * inverse;
  }
};

// The peaks of a smoothed histogram, the largest first.
template <class F>
class Peaks {
  F const* smoothed;
  int first, last, bins;  // last is -1 after the last one
  F threshold;
  bool started = false;

  // The largest local maximum after `last`; of equal ones the first.
  KV_HD int after_last() const {
    int best = -1;
    for (int b = 0; b < bins; ++b) {
      F const m = smoothed[b];
      bool const is_peak = m > smoothed[wrap_bin(b - 1, bins)] && m >= smoothed[wrap_bin(b + 1, bins)];
      bool const is_next = m < smoothed[last] || (m == smoothed[last] && b > last);
      if (is_peak && is_next && m >= threshold * smoothed[first] && (best < 0 || m > smoothed[best])) best = b;
    }
    return best;
  }

 public:
  KV_HD Peaks(F const* smoothed, int largest, int bins, F threshold)
      : smoothed(smoothed), first(largest), last(largest), bins(bins), threshold(threshold) {}
  KV_HD Peak<F> next() {
    if (started && last >= 0) last = after_last();
    started = true;
    return Peak<F>(smoothed, last < 0 ? first : last, bins);
  }
};

// The derivative of the angle along bin `bin` of the histogram before it was smoothed.
template <class F>
KV_HD F angle_derivative(Peak<F> const& peak, F const (&d)[3], int bin, int bins) {
  F sum = 0;
  for (int k = -1; k <= 1; ++k)
    for (int e = -kSmoothing; e <= kSmoothing; ++e)
      if (wrap_bin(peak.bin + k + e, bins) == bin) sum += d[k + 1] * smoothing_weight<F>(e < 0 ? -e : e);
  return sum;
}

}  // namespace kv::feature
