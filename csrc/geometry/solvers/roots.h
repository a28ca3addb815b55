// Real roots of polynomials (B, n + 1), the highest power first: n of them, ascending, NaN for missing ones. And the
// first positive root of polynomials, the lowest power first.
#pragma once

#include "core/isa.h"
#include "geometry/small_matrix.h"
#include "geometry/solvers/first_root.h"

namespace kv::geometry {

template <class T>
struct RealRoots {
  Reals coefficients;
  int64_t batch;
  int degree;  // at most small::kMaxRoots
  Reals roots;
};

KV_KERNEL(real_roots, RealRoots)
KV_KERNEL(first_root, RealRoots)

constexpr int kMaxFirstRootDegree = 6;

template <class T>
KV_HD void set_first_root(RealRoots<T> const& p, int64_t b) {
  double coefficients[kMaxFirstRootDegree + 1] = {};
  for (int i = 0; i <= p.degree; ++i) coefficients[i] = p.coefficients[b * (p.degree + 1) + i];
  p.roots.set(b, first_positive_root(coefficients));
}

template <class T>
KV_HD void sorted_real_roots(RealRoots<T> const& p, int64_t b) {
  double coefficients[small::kMaxRoots + 1], roots[small::kMaxRoots];
  for (int i = 0; i <= p.degree; ++i) coefficients[i] = p.coefficients[b * (p.degree + 1) + i];
  int const count = small::real_roots(coefficients, p.degree, roots);
  for (int i = 1; i < count; ++i)
    for (int k = i; k > 0 && roots[k] < roots[k - 1]; --k) {
      double const t = roots[k];
      roots[k] = roots[k - 1];
      roots[k - 1] = t;
    }
  for (int i = 0; i < p.degree; ++i) p.roots.set(b * p.degree + i, i < count ? roots[i] : small::nan());
}

}  // namespace kv::geometry
