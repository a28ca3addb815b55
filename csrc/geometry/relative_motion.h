// The motion from one camera to another, whose poses take points of the world to their coordinates.
#pragma once

#include "core/matrix3.h"

namespace kv::geometry {

// R = R2 R1^T and t = t2 - R t1.
template <class V>
KV_HD void relative_motion(V const* R1, V const* t1, V const* R2, V const* t2, V* R, V* t) {
  multiply3<false, true>(R2, R1, R);
  for (int i = 0; i < 3; ++i) t[i] = t2[i] - dot3(R + 3 * i, t1);
}

// The gradients to R1, t1 and R2 from those to R and t; that to t2 is that to t.
template <class V>
KV_HD void relative_motion_vjp(V const* R1, V const* t1, V const* R2, V const* R, V const* grad_R, V const* grad_t,
                               V* grad_R1, V* grad_t1, V* grad_R2) {
  V grad[9];  // to R, also by t
  for (int i = 0; i < 9; ++i) grad[i] = grad_R[i] - grad_t[i / 3] * t1[i % 3];
  multiply3<true>(grad, R2, grad_R1);
  multiply3(grad, R1, grad_R2);
  for (int i = 0; i < 3; ++i) grad_t1[i] = -(R[i] * grad_t[0] + R[3 + i] * grad_t[1] + R[6 + i] * grad_t[2]);
}

}  // namespace kv::geometry
