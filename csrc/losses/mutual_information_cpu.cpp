// Mutual information on the CPU: rows [begin, end). Compiled once per instruction set.
#include "core/lanes.h"
#include "core/scratch.h"
#include "mutual_information.h"

namespace kv::losses::KV_ISA {
namespace {

template <class F>
KV_HD SignalRange<F> range_of(Signal<F> const& s, int64_t row, int64_t samples) {
  F low = F(__builtin_inf()), high = -low;
  bool nan_or_zero = false;
  for (int64_t i = 0; i < samples; ++i) {
    if (!s.counts(row, i)) continue;
    F const x = s.at(row, i);
    low = min(low, x), high = max(high, x), nan_or_zero |= x != x;
  }
  F const nan = F(__builtin_nan(""));
  return nan_or_zero ? SignalRange<F>{nan, nan} : SignalRange<F>{low, high};
}

}  // namespace

template <class F>
void mutual_information(MutualInformation<F> const& p, int64_t begin, int64_t end) {
  int64_t const bins = p.binning.bins, cells = bins * bins;
  Scratch<double> const memory(cells + 2 * bins);
  double *const joint = memory.data, *const sums = joint + cells;  // of x's bins, then of y's
  for (int64_t row = begin; row < end; ++row) {
    SignalRange<F> const of_x = range_of(p.x, row, p.samples), of_y = range_of(p.y, row, p.samples);
    F* const ranges = p.ranges + 4 * row;
    ranges[0] = of_x.low, ranges[1] = of_x.high, ranges[2] = of_y.low, ranges[3] = of_y.high;
    for (int64_t i = 0; i < cells + 2 * bins; ++i) joint[i] = 0;
    bool const finite = of_x.is_finite() && of_y.is_finite();
    for (int64_t i = 0; finite && i < p.samples; ++i) {
      if (!p.x.counts(row, i) || !p.y.counts(row, i)) continue;
      F const fraction_x = of_x.fraction(p.x.at(row, i), p.binning.epsilon);
      F const fraction_y = of_y.fraction(p.y.at(row, i), p.binning.epsilon);
      p.binning.for_each_bin(fraction_x, [&](int k, F t) {
        F const weight = p.binning.weight(t < 0 ? -t : t);
        p.binning.for_each_bin(fraction_y,
                               [&](int m, F u) { joint[k * bins + m] += weight * p.binning.weight(u < 0 ? -u : u); });
      });
    }
    double const scale = double(p.binning.top) * p.binning.top;
    double all = 0;
    for (int64_t k = 0; k < bins; ++k)
      for (int64_t m = 0; m < bins; ++m) {
        double const count = max(joint[k * bins + m] * scale, double(p.min_count));
        sums[k] += count, sums[bins + m] += count, all += count;
      }
    Entropies<F> h{0, 0, 0};
    for (int64_t i = 0; i < 2 * bins; ++i) {
      double const log_of = ::log(sums[i] / all);
      (i < bins ? h.of_x : h.of_y) -= sums[i] / all * log_of;
      sums[i] = log_of;
    }
    F* const gradients = p.gradients + row * cells;
    for (int64_t i = 0; i < cells; ++i) {
      double const fraction = max(joint[i] * scale, double(p.min_count)) / all, log_of = ::log(fraction);
      h.joint -= fraction * log_of;
      gradients[i] = F(log_of);
    }
    F const nan = F(__builtin_nan("")), loss = finite ? F(h.loss(p.normalized)) : nan;
    p.loss[row] = loss;
    for (int64_t k = 0; k < bins; ++k)
      for (int64_t m = 0; m < bins; ++m) {
        F& derivative = gradients[k * bins + m];
        F const result = h.derivative(p.normalized, loss, F(sums[k]), F(sums[bins + m]), derivative) / F(all);
        derivative = finite && joint[k * bins + m] * scale < p.min_count ? F(0) : result;
      }
  }
}

template <class F>
void mutual_information_backward(MutualInformationBackward<F> const& p, int64_t begin, int64_t end) {
  Signal<F> const& own = p.by_y ? p.y : p.x;
  F const epsilon = p.binning.epsilon;
  for (int64_t row = begin; row < end; ++row) {
    SignalRange<F> const range = p.range(row, p.by_y);
    F* const out = p.out + row * p.samples;
    if (range.is_flat(epsilon)) {
      for (int64_t i = 0; i < p.samples; ++i) out[i] = 0;
      continue;
    }
    F const inverse = 1 / (range.high - range.low);
    EndSums<F> ends{};
    for (int64_t i = 0; i < p.samples; ++i) {
      F const x = own.at(row, i), grad_fraction = p.grad_fraction_at(row, i);
      if (own.counts(row, i)) {
        ends.add(grad_fraction, range.fraction(x, epsilon));
        ends.count(x == range.low, x == range.high);
      }
      out[i] = grad_fraction * inverse;
    }
    F const grad_low = F(ends.low / ends.lowest) * inverse, grad_high = F(ends.high / ends.highest) * inverse;
    for (int64_t i = 0; i < p.samples; ++i) {
      if (!own.counts(row, i)) continue;
      F const x = own.at(row, i);
      if (x == range.low) out[i] += grad_low;
      if (x == range.high) out[i] += grad_high;
    }
  }
}

KV_INSTANTIATE_COMPUTED(mutual_information, MutualInformation)
KV_INSTANTIATE_COMPUTED(mutual_information_backward, MutualInformationBackward)

}  // namespace kv::losses::KV_ISA
