// The first positive root of a polynomial that is positive at 0.
#pragma once

#include "core/hd.h"

namespace kv::geometry {

constexpr double kFarthestRoot = 1e4;

// t[0] minus the falling terms of t[0] + t[1] x + ... + t[n] x^n, a lower bound for x >= 0, and the slope of what is
// subtracted.
template <int n, class T>
KV_HD T bound_from_below(T const (&t)[n], T x, T& slope) {
  T value = t[0], power = 1;
  slope = 0;
  for (int i = 1; i < n; ++i) {
    T const fall = t[i] < 0 ? -t[i] : T(0);
    slope += T(i) * fall * power;
    power *= x;
    value -= fall * power;
  }
  return value;
}

// The smallest x > 0 where p[0] + p[1] x + ... is 0, or inf where there is none up to kFarthestRoot.
//
// x starts left of all roots and never passes one: each step goes to a root of the lower bound around x. That bound is
// concave, so Newton's method comes to its root from the right, and the chord, which is the step, from the left.
template <int n, class T>
KV_HD T first_positive_root(T const (&p)[n]) {
  T largest = 0;
  for (int i = 1; i < n; ++i) largest = max(largest, p[i] < 0 ? -p[i] : p[i]);
  T x = p[0] / (p[0] + largest);
  for (int step = 0; step < 48 && x < T(kFarthestRoot); ++step) {
    T t[n], power = 1;  // p(x + x h) = t[0] + t[1] h + ...
    for (int i = 0; i < n; ++i) t[i] = p[i] * power, power *= x;
    for (int i = 0; i < n - 1; ++i)
      for (int k = n - 2; k >= i; --k) t[k] += t[k + 1];
    T left = 0, right = 1, at_left = t[0], slope, ignored;
    if (!(at_left > 0)) return x;
    for (int i = 0; i < 4; ++i) {
      T const at_right = bound_from_below(t, right, slope);
      if (at_right >= 0) {
        left = right;
        break;
      }
      left += (right - left) * at_left / (at_left - at_right);
      right += at_right / slope;
      at_left = bound_from_below(t, left, ignored);
      if (!(at_left > 0)) break;
    }
    if (left == 1 && slope == 0) return T(__builtin_inf());  // nothing falls
    x += x * left;
    if (left < (sizeof(T) == 4 ? T(0x1p-22) : T(0x1p-50))) return x;
  }
  return x < T(kFarthestRoot) ? x : T(__builtin_inf());
}

}  // namespace kv::geometry
