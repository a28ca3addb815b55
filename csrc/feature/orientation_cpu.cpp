// Dominant orientations of patches [begin, end) on the CPU. Compiled once per instruction set.
#include "orientation.h"
#include "patch_gradient_cpu.h"

namespace kv::feature::KV_ISA {
namespace {

// The working memory of a patch, and what both passes do with it. Rows of pixels end with whole vectors.
template <class F>
struct OrientationPatch {
  int n, bins, width;  // of which `width` are the pixels of a row
  F* weights;          // of the Gaussian along an axis, 0 after its end
  PaddedPatch<F> patch;
  F *magnitudes, *angles;  // of a row
  VotesOfPixels<F> votes;  // (n, width)
  F *histogram, *smoothed;

  static KV_HD int64_t size(int n, int bins) {
    return PaddedPatch<F>::size(n) + int64_t(whole_vectors<F>(n)) * (3 + 3 * n) + 2 * bins;
  }
  KV_HD OrientationPatch(int n, int bins, F* memory)
      : n(n), bins(bins), width(whole_vectors<F>(n)), weights(memory), patch(memory + width, n) {
    int64_t const pixels = int64_t(n) * width;
    magnitudes = patch.data + PaddedPatch<F>::size(n), angles = magnitudes + width;
    F* const first = angles + width;
    votes = {first, first + pixels, first + 2 * pixels};
    histogram = first + 3 * pixels, smoothed = histogram + bins;
    for (int i = 0; i < width; ++i) weights[i] = i < n ? centered_gaussian(i, n, F(n) / 6) : F(0);
    patch.clear();
  }

  template <class T>
  KV_HD void fill_row(int y, F eps) {
    for_each_gradient<T>(patch, y, sobel_stencil<F>(), [&](auto width, int64_t x, auto g) KV_INLINE {
      constexpr int N = decltype(width)::value;
      auto const polar = to_polar<F, N>(g, eps);
      store<N>(magnitudes + x, polar.magnitude);
      store<N>(angles + x, polar.angle);
    });
  }

  template <class T, class Params>
  KV_HD Peaks<F> find_peaks(T const* from, Params const& p) {
    patch.read(from);
    for (int b = 0; b < bins; ++b) histogram[b] = 0;
    constexpr int N = kLanes<T>;
    for (int y = 0; y < n; ++y)
      for (int x = 0; x < n; x += N) {
        auto polar = to_polar<F, N>(patch_gradient(sobel_stencil<F>(), neighbors<N>(patch, y, x)), p.eps);
        polar.magnitude *= load<N>(weights + x) * weights[y];
        votes.template set<N>(int64_t(y) * width + x, polar, bins, F(bins) / 2);
      }
    for (int y = 0; y < n; ++y)
      for (int64_t i = int64_t(y) * width, end = i + n; i < end; ++i) {
        int const first = int(votes.first[i]), second = first + 1 == bins ? 0 : first + 1;
        histogram[first] += votes.earlier[i];
        histogram[second] += votes.later[i];
      }
    int peak = 0;
    for (int b = 0; b < bins; ++b) {
      smoothed[b] = smoothed_bin(histogram, b, bins);
      if (smoothed[b] > smoothed[peak]) peak = b;
    }
    return Peaks<F>(smoothed, peak, bins, p.threshold);
  }
};

}  // namespace

template <class T>
void orientation(Orientation<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  Scratch<F> scratch(OrientationPatch<F>::size(p.n, p.bins));
  OrientationPatch<F> s(p.n, p.bins, scratch.data);
  for (int64_t k = begin; k < end; ++k) {
    Peaks<F> peaks = s.find_peaks(p.patches + k * p.n * p.n, p);
    for (int i = 0; i < p.peaks; ++i) store<1>(p.angles + k * p.peaks + i, peaks.next().angle(p.bins));
  }
}

template <class T>
void orientation_backward(OrientationBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int const n = p.n, bins = p.bins;
  int64_t const padded = PaddedPatch<F>::size(n), own = OrientationPatch<F>::size(n, bins);
  Scratch<F> scratch(own + 2 * padded);
  OrientationPatch<F> s(n, bins, scratch.data);
  PaddedPatch<F> const u(scratch.data + own, n), v(u.data + padded, n);
  F const per_radian = F(bins) / F(2 * kPi);
  for (int64_t k = begin; k < end; ++k) {
    Peaks<F> peaks = s.find_peaks(p.patches + k * n * n, p);
    F* const grad_bins = s.histogram;
    for (int b = 0; b < bins; ++b) grad_bins[b] = 0;
    for (int i = 0; i < p.peaks; ++i) {
      Peak<F> const peak = peaks.next();
      F d[3];
      peak.derivatives(bins, d);
      F const grad = load<1>(p.grad + k * p.peaks + i);
      for (int b = 0; b < bins; ++b) grad_bins[b] += grad * angle_derivative(peak, d, b, bins);
    }
    for (int y = 0; y < n; ++y) {
      s.template fill_row<T>(y, p.eps);
      for (int x = 0; x < n; ++x) {
        auto const vote = angular_vote(s.angles[x], bins, F(bins) / 2);
        F const weight = s.weights[y] * s.weights[x], a = grad_bins[vote.first], b = grad_bins[vote.second];
        auto const gradient = patch_gradient(sobel_stencil<F>(), neighbors<1>(s.patch, y, x));
        auto const back = to_polar_vjp(gradient, s.magnitudes[x], weight * (a + vote.t * (b - a)),
                                       weight * (b - a) * s.magnitudes[x] * per_radian);
        u.row(y)[x] = back.x, v.row(y)[x] = back.y;
      }
    }
    write_patch_gradient(p.grad_patches + k * n * n, sobel_stencil<F>(), u, v);
  }
}

KV_INSTANTIATE(orientation, Orientation)
KV_INSTANTIATE(orientation_backward, OrientationBackward)

}  // namespace kv::feature::KV_ISA
