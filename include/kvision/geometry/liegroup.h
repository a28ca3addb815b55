// Exponential maps, logarithms and Jacobians of SO(3), SE(2) and SE(3), as python/kvision/geometry/liegroup has them:
// rows of one floating-point type. Rotation vectors are axes times angles in radians, quaternions are (w, x, y, z).
#pragma once

#include "kvision/ops/geometry.h"
#include "kvision/types.h"

namespace kvision {

// Tangent vectors (B, 3), the translation and the angle, to (B, 4): cos, sin, x, y; and back.
inline Tensor se2_exp(Tensor const& tangent) { return ops::se2_exp(tangent); }
inline Tensor se2_log(Tensor const& motion) { return ops::se2_log(motion); }

// Tangent vectors (B, 6), the translation and the rotation vector, to (B, 7): the quaternion and the translation; and
// back.
inline Tensor se3_exp(Tensor const& tangent) { return ops::se3_exp(tangent); }
inline Tensor se3_log(Tensor const& motion) { return ops::se3_log(motion); }

// exp(v + d) is exp(J d) exp(v) for small d: (B, 3) to (B, 3, 3), (B, 6) to (B, 6, 6). The right Jacobian is the left
// one of -v.
inline Tensor so3_left_jacobian(Tensor const& tangent) { return ops::so3_left_jacobian(tangent); }
inline Tensor so3_left_jacobian_inverse(Tensor const& tangent) { return ops::so3_left_jacobian_inverse(tangent); }
inline Tensor se3_left_jacobian(Tensor const& tangent) { return ops::se3_left_jacobian(tangent); }
inline Tensor se3_left_jacobian_inverse(Tensor const& tangent) { return ops::se3_left_jacobian_inverse(tangent); }

}  // namespace kvision
