// Sobel edge magnitude: sqrt(gx^2 + gy^2 + eps) with the 3x3 gradients
//
//        -1 0 1             -1 -2 -1
//   gx = -2 0 2 * scale  gy =  0  0  0 * scale     scale = 1/8 when normalized, else 1
//        -1 0 1              1  2  1
//
// and the border kSobelBorder.
#pragma once

#include "core/border.h"
#include "core/isa.h"
#include "core/view.h"
#include "derivative.h"

namespace kv::filters {

constexpr Border kSobelBorder = Border::replicate;

template <class T>
struct Sobel {
  Planes<T const> x;
  Planes<DerivativeOf<T>> y;
  Compute<T> scale, eps;
};

template <class T>
struct SobelBackward {
  Planes<T const> grad, x;
  Planes<T> grad_x;
  Compute<T> scale, eps;
};

KV_KERNEL(sobel, Sobel)
KV_KERNEL(sobel_backward, SobelBackward)

// The contributions of a column of three pixels a, b, c (from top to bottom) to the two gradients.
template <class V>
struct SobelColumn {
  V smooth, difference;
};
template <class V>
KV_HD SobelColumn<V> sobel_column(V a, V b, V c) {
  return {a + b * 2 + c, c - a};
}
// The gradients of the pixel in the middle of three columns.
template <class V, class S>
KV_HD void sobel_gradients(SobelColumn<V> left, SobelColumn<V> middle, SobelColumn<V> right, S scale, V& gx, V& gy) {
  gx = (right.smooth - left.smooth) * scale;
  gy = (left.difference + middle.difference * 2 + right.difference) * scale;
}

// The transpose: the gradient of a pixel from u = dL/dgx and v = dL/dgy of its neighbors, row by row.
//
// Out of bounds u and v are 0, and a position there adds its gradient to the pixel that it is read from. CUDA has a
// shorter form for the replicate border: there u and v are extended instead, where a position out of bounds has the
// value of the border pixel, with its sign changed along the axis that is differentiated. So u is odd in x and even in
// y; v is even in x and odd in y.
template <class V>
struct SobelRow {
  V across, along;
};
template <class V>
KV_HD SobelRow<V> sobel_row_vjp(V u_left, V u_right, V v_left, V v_middle, V v_right) {
  return {u_left - u_right, v_left + v_middle * 2 + v_right};
}
template <class V, class S>
KV_HD V sobel_gradients_vjp(SobelRow<V> above, SobelRow<V> middle, SobelRow<V> below, S scale) {
  return (above.across + middle.across * 2 + below.across + above.along - below.along) * scale;
}

// With eps = 0 a flat image has magnitude 0 and no direction. Its gradient is 0, like that of |x| at 0.

}  // namespace kv::filters
