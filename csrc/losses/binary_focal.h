// Binary focal loss of logits x with targets t in [0, 1], for every element or summed over rows. With p the sigmoid of
// x, and with the factors yes and no of the two terms:
//
//   -yes (1 - p)^gamma t log p - no p^gamma (1 - t) log(1 - p)
#pragma once

#include "metrics/pointwise.h"

namespace kv::losses {

using metrics::kPointChunk;
using metrics::log_one_plus;
using metrics::Pair;
using metrics::point_chunks;

template <class F>
struct BinaryFocalTerms {
  F const *rows_yes, *rows_no;  // factors per row, or null
  int64_t yes_stride, no_stride;
  F yes, no, gamma, ignored;
  bool ignores;

  KV_HD BinaryFocalTerms of(int64_t row) const {
    BinaryFocalTerms result = *this;
    if (rows_yes) result.yes *= rows_yes[row * yes_stride];
    if (rows_no) result.no *= rows_no[row * no_stride];
    return result;
  }
};

template <class T>
struct BinaryFocalSum {
  Pair<T> pair;
  BinaryFocalTerms<Compute<T>> terms;
  int64_t chunks;             // of a row
  Compute<T>*partial, *sums;  // (rows, chunks) and (rows); see PointwiseSum
};

// The loss of every element; or its derivative with respect to x, or t if `by_target`, times a gradient.
template <class T>
struct BinaryFocalMap {
  Pair<T> pair;
  BinaryFocalTerms<Compute<T>> terms;
  T const* grad;                  // per element, or null
  Compute<T> const* grad_of_sum;  // per row, or null
  bool by_target;
  T* out;
};

KV_KERNEL(binary_focal_sum, BinaryFocalSum)
KV_KERNEL(binary_focal_map, BinaryFocalMap)

// The terms of the loss at a vector V of logits.
template <class F, class Math, class V>
struct BinaryFocalPoint {
  BinaryFocalTerms<F> const& terms;
  V p, q, log_p, log_q, p_power, q_power;  // powers of p and of q = 1 - p

  KV_HD BinaryFocalPoint(BinaryFocalTerms<F> const& terms, V x) : terms(terms) {
    V const zero{}, one = zero + F(1), size = x < zero ? V(-x) : x, u = Math::exp(V(-size)), sum = one + u;
    V const log_sum = log_one_plus<F, Math>(u), large = Math::divide(one, sum), small = Math::divide(u, sum);
    p = x < zero ? small : large, q = x < zero ? large : small;
    log_p = (x < zero ? x : zero) - log_sum, log_q = (x < zero ? zero : V(-x)) - log_sum;
    p_power = power(p, log_p), q_power = power(q, log_q);
  }
  KV_HD V power(V of, V log) const {
    if (terms.gamma == 2) return of * of;
    return terms.gamma == 0 ? V(V{} + F(1)) : Math::exp(V(log * terms.gamma));
  }
  KV_HD V counted(V t, V result) const {
    V const zero{};
    return terms.ignores ? V(t == zero + terms.ignored ? zero : result) : result;
  }
  KV_HD V loss(V t) const {
    V const one = V{} + F(1);
    return counted(t, V(-terms.yes * t * q_power * log_p - terms.no * (one - t) * p_power * log_q));
  }
  KV_HD V derivative(V t) const {
    V const one = V{} + F(1), by_yes = q_power * (q - terms.gamma * p * log_p);
    V const by_no = p_power * (terms.gamma * q * log_q - p);
    return counted(t, V(-terms.yes * t * by_yes - terms.no * (one - t) * by_no));
  }
  KV_HD V target_derivative(V t) const {
    return counted(t, V(terms.no * p_power * log_q - terms.yes * q_power * log_p));
  }
};

}  // namespace kv::losses
