// Sobel edge magnitude: sqrt(gx^2 + gy^2 + eps) with the 3x3 gradients
//
//        -1 0 1             -1 -2 -1
//   gx = -2 0 2 * scale  gy =  0  0  0 * scale     scale = 1/8 when normalised, else 1
//        -1 0 1              1  2  1
//
// and the replicate border. Included by sobel_cpu.cpp, sobel.cu and sobel_op.cpp.
#pragma once

#include "core/isa.h"
#include "core/view.h"

namespace kv {

template <class T>
struct Sobel {
  Planes<T const> x;
  Planes<T> y;
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

// The two gradients from the 3x3 pixels around one: a above, b beside, c below; 0 left, 1 middle, 2 right.
template <class V, class S>
KV_HD void sobel_gradients(V a0, V a1, V a2, V b0, V b2, V c0, V c1, V c2, S scale, V& gx, V& gy) {
  gx = ((a2 - a0) + (c2 - c0) + (b2 - b0) * S(2)) * scale;
  gy = ((c0 - a0) + (c2 - a2) + (c1 - a1) * S(2)) * scale;
}

// Their transpose: the gradient of a pixel from u = dL/dgx (left and right columns) and v = dL/dgy (rows above and
// below) at its neighbours. At the rim, replicating a pixel reads as: what lies outside is the rim's own value, negated
// across the axis that is differentiated. So u continues odd in x and even in y, v even in x and odd in y.
template <class V, class S>
KV_HD V sobel_gradients_vjp(V ua0, V ua2, V ub0, V ub2, V uc0, V uc2, V va0, V va1, V va2, V vc0, V vc1, V vc2,
                            S scale) {
  return ((ua0 - ua2) + (uc0 - uc2) + (ub0 - ub2) * S(2) + (va0 - vc0) + (va2 - vc2) + (va1 - vc1) * S(2)) * scale;
}

// d magnitude / d (gx, gy) times the incoming gradient g: g / magnitude, to be multiplied with gx and gy. With eps = 0
// a flat image has no direction; its gradient is 0 as for |x| at 0.
template <class V>
KV_HD V sobel_magnitude_vjp(V g, V magnitude) {
  return magnitude > V{} ? g / magnitude : V{};
}

}  // namespace kv
