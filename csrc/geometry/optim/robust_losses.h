// Robust kernels rho(s) of s, the squared norm of a block of residuals, with their derivatives. kvision's
// geometry/optim/_losses.py has the same as torch functions.
#pragma once

#include "core/hd.h"

namespace kv::geometry {

enum class RobustLoss : int {
  linear = 0,
  huber = 1,
  soft_l1 = 2,
  cauchy = 3,
  arctan = 4,
  geman_mcclure = 5,
  welsch = 6,
  tukey = 7
};

struct LossValue {
  double rho, slope, curvature;  // rho(s), rho'(s), rho''(s)
};

// Of C^2 rho(s / C^2), where `square` is C^2.
KV_HD LossValue robust_loss(RobustLoss loss, double s, double square) {
  double const x = s / square;
  LossValue v = {x, 1, 0};
  switch (loss) {
    case RobustLoss::linear:
      return {s, 1, 0};
    case RobustLoss::huber:
      if (x > 1) v = {2 * sqrt(x) - 1, 1 / sqrt(x), -0.5 / (x * sqrt(x))};
      break;
    case RobustLoss::soft_l1: {
      double const root = sqrt(1 + x);
      v = {2 * (root - 1), 1 / root, -0.5 / (root * root * root)};
      break;
    }
    case RobustLoss::cauchy:
      v = {__builtin_log1p(x), 1 / (1 + x), -1 / ((1 + x) * (1 + x))};
      break;
    case RobustLoss::arctan: {
      double const slope = 1 / (1 + x * x);
      v = {__builtin_atan(x), slope, -2 * x * slope * slope};
      break;
    }
    case RobustLoss::geman_mcclure: {
      double const inverse = 1 / (1 + x);
      v = {x * inverse, inverse * inverse, -2 * inverse * inverse * inverse};
      break;
    }
    case RobustLoss::welsch: {
      double const slope = __builtin_exp(-x);
      v = {-__builtin_expm1(-x), slope, -slope};
      break;
    }
    case RobustLoss::tukey: {
      double const rest = x < 1 ? 1 - x : 0;
      v = {(1 - rest * rest * rest) / 3, rest * rest, -2 * rest};
      if (!(x == x)) v.rho = x;
      break;
    }
  }
  return {square * v.rho, v.slope, v.curvature / square};
}

}  // namespace kv::geometry
