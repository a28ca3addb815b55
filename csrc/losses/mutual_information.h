// Mutual information of two signals, by a joint histogram that is differentiable in both. A sample x adds w(|(x - low)
// / (high - low) * (bins - 1) - k| / radius) to bin k of its signal; low and high are the minimum and maximum within
// its mask, and w is 0 for arguments above 1. The product of both signals' weights is added to bin J_ij. With p = J /
// S, where S is the sum of J and p is at least `min_count`, and with the entropies H of p and of its two marginals:
//
//   loss = H(p) - H(px) - H(py), with the gradients dloss/dJ_ij = (log px_i + log py_j - log p_ij - loss) / S
//   or, normalized, -(H(px) + H(py)) / H(p), with (log px_i + log py_j + loss log p_ij) / (H(p) S)
//
// The operator returns these gradients, and its backward pass reads them. The loss is NaN if a signal is not finite or
// has no sample.
#pragma once

#include <math.h>

#include "core/isa.h"

namespace kv::losses {

// Exported graphs contain these numbers.
enum class BinKernel : int { xu, rectangular, truncated_gaussian };

// Rows of samples and their mask. A stride of 0 broadcasts a single row.
template <class F>
struct Signal {
  F const* samples;
  uint8_t const* mask;  // or null
  int64_t stride, mask_stride;

  KV_HD bool counts(int64_t row, int64_t i) const { return !mask || mask[row * mask_stride + i]; }
  KV_HD F at(int64_t row, int64_t i) const { return samples[row * stride + i]; }
};

// The assignment of samples to bins.
template <class F>
struct Binning {
  int bins;
  BinKernel kernel;
  F radius, inverse;  // in bins; 1 / it
  F top;              // the factor of all weights
  F epsilon;          // a signal with a range of at most epsilon is flat

  // The weight at a distance t of at most 1.
  KV_HD F weight(F t) const {
    if (kernel == BinKernel::rectangular) return 1;
    if (kernel == BinKernel::truncated_gaussian) return F(::exp(-t * t / 2));
    return t < F(0.5) ? (F(-1.8) * t - F(0.1)) * t + 1 : (F(1.8) * t - F(3.7)) * t + F(1.9);
  }
  KV_HD F derivative(F t) const {
    if (kernel == BinKernel::rectangular) return 0;
    if (kernel == BinKernel::truncated_gaussian) return F(-t * ::exp(-t * t / 2));
    return t < F(0.5) ? F(-3.6) * t - F(0.1) : F(3.6) * t - F(3.7);
  }
  // Calls f(bin, signed distance in radii) for the bins to which a sample at fraction `fraction` of its range adds.
  template <class Call>
  KV_HD void for_each_bin(F fraction, Call f) const {
    F const position = fraction * F(bins - 1);
    int const first = int(max(F(0), position - radius)), end = int(min(F(bins), position + radius + 2));
    for (int k = first; k < end; ++k) {
      F const t = (position - F(k)) * inverse;
      if (t <= 1 && t >= -1) f(k, t);
    }
  }
};

// The minimum and maximum of a row of a signal.
template <class F>
struct SignalRange {
  F low, high;

  KV_HD bool is_flat(F epsilon) const { return !(high - low > epsilon); }
  // There are samples, and all are finite.
  KV_HD bool is_finite() const { return (high - low) - (high - low) == 0; }
  KV_HD F fraction(F x, F epsilon) const { return is_flat(epsilon) ? F(0) : (x - low) / (high - low); }
};

template <class F>
struct Entropies {
  double joint, of_x, of_y;

  KV_HD double loss(bool normalized) const { return normalized ? -(of_x + of_y) / joint : joint - of_x - of_y; }
  // S dloss/dJ.
  KV_HD F derivative(bool normalized, F loss, F log_x, F log_y, F log_p) const {
    return normalized ? (log_x + log_y + loss * log_p) / F(joint) : log_x + log_y - log_p - loss;
  }
};

template <class F>
struct MutualInformation {
  Signal<F> x, y;
  int64_t rows, samples;
  Binning<F> binning;
  F min_count;
  bool normalized;
  F *loss, *gradients, *ranges;  // (rows), (rows, bins of x, bins of y), (rows, 4): low and high of x, then of y
  // CUDA: chunks of a row, ranges of all chunks, joint histograms in fixed point, their marginals.
  int64_t chunks;
  F* partial;                  // (rows, chunks, 4)
  unsigned long long* counts;  // (rows, bins, bins)
  int bits;                    // fractional bits
  F* sums;                     // (rows, 2, bins)
};

// The gradient with respect to x, or to y if `by_y`.
template <class F>
struct MutualInformationBackward {
  Signal<F> x, y;
  int64_t rows, samples;
  Binning<F> binning;
  bool by_y;
  F const *grad, *gradients, *ranges;
  F* out;
  int64_t chunks;  // CUDA
  F* partial;      // CUDA: (rows, chunks, 4)

  KV_HD SignalRange<F> range(int64_t row, bool of_y) const {
    F const* const result = ranges + 4 * row + 2 * of_y;
    return {result[0], result[1]};
  }
  // The gradient with respect to the position of sample i, a fraction in [0, 1] of its range.
  KV_HD F grad_fraction_at(int64_t row, int64_t i) const {
    if (!x.counts(row, i) || !y.counts(row, i)) return 0;
    SignalRange<F> const of_x = range(row, false), of_y = range(row, true);
    F const fraction_x = of_x.fraction(x.at(row, i), binning.epsilon),
            fraction_y = of_y.fraction(y.at(row, i), binning.epsilon);
    F const own = by_y ? fraction_y : fraction_x, other = by_y ? fraction_x : fraction_y;
    F const* const table = gradients + row * binning.bins * binning.bins;
    int const step = by_y ? binning.bins : 1, other_step = by_y ? 1 : binning.bins;
    F sum = 0;
    binning.for_each_bin(own, [&](int k, F t) KV_INLINE {
      F of_bin = 0;
      binning.for_each_bin(other, [&](int m, F u) KV_INLINE {
        of_bin += binning.weight(u < 0 ? -u : u) * table[int64_t(k) * other_step + int64_t(m) * step];
      });
      sum += t == 0 ? F(0) : (t < 0 ? -binning.derivative(-t) : binning.derivative(t)) * of_bin;
    });
    return grad[row] * binning.top * binning.top * F(binning.bins - 1) * binning.inverse * sum;
  }
};

// The gradients of a range's minimum and maximum: the sums over all samples of the gradient by its fraction u, times u
// - 1 and times -u. They are split among the samples that equal the minimum or the maximum.
template <class F>
struct EndSums {
  double low, high, lowest, highest;

  KV_HD void add(F grad_fraction, F fraction) {
    low += grad_fraction * (fraction - 1), high -= grad_fraction * fraction;
  }
  KV_HD void count(bool is_lowest, bool is_highest) { lowest += is_lowest, highest += is_highest; }
};

KV_KERNEL(mutual_information, MutualInformation)
KV_KERNEL(mutual_information_backward, MutualInformationBackward)

}  // namespace kv::losses
