// Elementwise losses of two tensors and their sums over rows: robust losses of the difference d = x - y, its square,
// and divergences of probabilities. The loss is a run-time argument.
//
//   charbonnier    sqrt(d^2 + 1) - 1          kl   y log(y / x)
//   welsch         1 - exp(-d^2 / 2)          js   (x log(x / m) + y log(y / m)) / 2 with m = (x + y) / 2
//   cauchy         log(d^2 / 2 + 1)
//   geman_mcclure  2 d^2 / (d^2 + 4)          a probability of 0 adds nothing
//   square         d^2
#pragma once

#include "core/isa.h"
#include "core/row_sums.h"

namespace kv::metrics {

// Exported graphs contain these numbers.
enum class PointLoss : int { charbonnier, welsch, cauchy, geman_mcclure, square, kl, js };
constexpr int kPointLosses = 7;

// Two tensors (rows, size). A stride of 0 broadcasts a single row.
template <class T>
struct Pair {
  T const *x, *y;
  int64_t x_stride, y_stride, rows, size;
};

constexpr int64_t kPointChunk = 8192;  // elements per partial sum
constexpr int64_t point_chunks(int64_t size) { return (size + kPointChunk - 1) / kPointChunk; }

template <class T>
struct PointwiseSum {
  Pair<T> pair;
  PointLoss kind;
  int64_t chunks;       // of a row
  Compute<T>* partial;  // (rows, chunks)
  FinalizeSum<Compute<T>> finalize;
  Compute<T>* sums;  // (rows), written by the CUDA kernel; on the CPU the operator adds the chunks
};

// The output of every element: the loss; or its derivative by x, or by y if `by_other`, times a gradient.
template <class T>
struct PointwiseMap {
  Pair<T> pair;
  PointLoss kind;
  T const* grad;                  // per element, or null
  Compute<T> const* grad_of_sum;  // per row, or null
  Compute<T> const* sums;         // per row, for the gradient of decibels
  FinalizeSum<Compute<T>> finalize;
  bool by_other;
  T* out;

  // The gradient of the plain sum of a row. For decibels it is finalize.decibels / (log 10 * sum), and 0 where the rows
  // are equal.
  KV_HD Compute<T> gradient(int64_t row) const {
    using F = Compute<T>;
    F const g = grad_of_sum[row];
    if (finalize.decibels == 0) return g * finalize.factor;
    F const decibels = sums[row];
    double const derivative = double(finalize.decibels) * 0.43429448190325183;  // 1 / log 10
    return decibels - decibels == 0 ? F(g * finalize.factor * derivative / ::exp(double(decibels) / derivative)) : F(0);
  }
};

KV_KERNEL(pointwise_sum, PointwiseSum)
KV_KERNEL(pointwise_map, PointwiseMap)

// Above this bound 1 is negligible next to d^2, and d^4 is still finite.
template <class F>
constexpr F kFar = sizeof(F) == 4 ? F(1e9) : F(1e70);

template <class F, class V>
KV_HD V clamp_far(V d) {
  V const far = V{} + kFar<F>;
  return d > far ? far : d < -far ? -far : d;
}

// 1 - exp(-t) and log(1 + t) for t >= 0, accurate for small t: a rounding error of u = exp(-t) or u = 1 + t cancels
// against the same error in log u or u - 1. Math has functions of V; its divide requires divisors of at least 1.
template <class F, class Math, class V>
KV_HD V one_minus_exp(V t) {
  V const one = V{} + F(1), bound = V{} + F(80), bounded = t > bound ? bound : t, u = Math::exp(V(-bounded));
  return u == one ? bounded : V((u - one) * bounded / Math::log(u));
}
template <class F, class Math, class V>
KV_HD V log_one_plus(V t) {
  V const one = V{} + F(1), u = one + t, log_u = Math::log(u);
  V const result = u == one ? t : V(log_u * (t / (u - one)));
  return t > kFar<F> ? log_u : result;
}

// The contribution of a true probability of 0: zero, or NaN if the predicted probability is invalid.
template <class F, class V>
KV_HD V zero_if_valid(V x) {
  V const zero = V{}, nan = zero + F(__builtin_nan(""));
  return x >= zero ? zero : nan;
}

template <class F, class Math, class V>
KV_HD V point_loss(PointLoss kind, V x, V y) {
  V const zero = V{}, one = zero + F(1), half = zero + F(0.5), d = x - y;
  switch (kind) {
    case PointLoss::charbonnier: {
      V const size = d < zero ? V(-d) : d;
      return size > kFar<F> ? V(size - one) : V(d * Math::divide(d, V(Math::sqrt(V(d * d + one)) + one)));
    }
    case PointLoss::welsch:
      return one_minus_exp<F, Math>(V(half * d * d));
    case PointLoss::cauchy:
      return log_one_plus<F, Math>(V(half * d * d));
    case PointLoss::geman_mcclure: {
      V const c = clamp_far<F>(d), square = c * c;
      return Math::divide(V(square * F(2)), V(square + F(4)));
    }
    case PointLoss::square:
      return d * d;
    case PointLoss::kl:
      return y == zero ? zero_if_valid<F>(x) : V(y * (Math::log(y) - Math::log(x)));
    default: {
      V const log_m = Math::log(V(half * (x + y)));
      V const of_x = x == zero ? zero : V(x * (Math::log(x) - log_m));
      V const of_y = y == zero ? zero : V(y * (Math::log(y) - log_m));
      return half * (of_x + of_y);
    }
  }
}

// The derivative by x or by y.
template <class F, class Math, class V>
KV_HD V point_derivative(PointLoss kind, bool by_y, V x, V y) {
  V const zero = V{}, one = zero + F(1), half = zero + F(0.5), d = by_y ? V(y - x) : V(x - y);
  switch (kind) {
    case PointLoss::charbonnier: {
      V const c = clamp_far<F>(d);
      return Math::divide(c, Math::sqrt(V(c * c + one)));
    }
    case PointLoss::welsch:
      return d * Math::exp(V(-half * d * d));
    case PointLoss::cauchy:
      return Math::divide(d, V(half * d * d + one));
    case PointLoss::geman_mcclure: {
      V const c = clamp_far<F>(d), inverse = Math::divide(one, V(c * c + F(4)));
      return c * inverse * (F(16) * inverse);
    }
    case PointLoss::square:
      return F(2) * d;
    case PointLoss::kl:
      if (by_y) return y == zero ? zero : V(Math::log(y) - Math::log(x) + one);
      return y == zero ? zero_if_valid<F>(x) : V(-y / x);
    default: {
      V const a = by_y ? y : x, b = by_y ? x : y, sum = a + b;
      V const own = a == zero ? zero : V(Math::log(a) - Math::log(V(half * sum)) + one - a / sum);
      return half * (own - (b == zero ? zero : V(b / sum)));
    }
  }
}

}  // namespace kv::metrics
