// Keys' cubic convolution kernel (R. Keys, 1981) of a parameter a: -3/4 in OpenCV and torch, -1/2 in Pillow. V is a
// number or Lanes. Included by the headers of warps and resizing.
//
//   |x| <= 1        (a + 2) |x|^3 - (a + 3) |x|^2 + 1
//   1 < |x| < 2     a (|x|^3 - 5 |x|^2 + 8 |x| - 4) = a (|x| - 1) (2 - |x|)^2
#pragma once

#include "hd.h"

namespace kv {

template <class A, class V>
KV_HD V cubic_inner(A a, V x) {
  return (x * (a + 2) - (a + 3)) * x * x + 1;
}
// Of |x| = 1 + t = 2 - s.
template <class A, class V>
KV_HD V cubic_outer(A a, V t, V s) {
  return t * s * s * a;
}

// The derivatives by |x|.
template <class A, class V>
KV_HD V cubic_inner_derivative(A a, V x) {
  return (x * (3 * (a + 2)) - 2 * (a + 3)) * x;
}
template <class A, class V>
KV_HD V cubic_outer_derivative(A a, V t, V s) {
  return s * (s - t * 2) * a;
}

}  // namespace kv
