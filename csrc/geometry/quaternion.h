// The product of quaternions: formula of kvision.geometry.quaternion.
#pragma once

#include "geometry/formula.h"

namespace kv::geometry {

struct QuaternionProduct {
  static constexpr int kInputs = 2, kRequired = 2, kInputSize = 8, kOutputSize = 4, kScalars = 0, kOptionalLastRow = 0;
  static constexpr Extent extent(int) { return {4}; }
  static constexpr Extent result = {4};
  template <class V>
  static KV_HD void evaluate(V const* x, V* y, FormulaOptions const&) {
    V const *const p = x, *const q = x + 4;
    y[0] = p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3];
    y[1] = p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2];
    y[2] = p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1];
    y[3] = p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0];
  }
};

}  // namespace kv::geometry
