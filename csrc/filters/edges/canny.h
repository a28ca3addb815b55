// Two steps of the Canny edge detector on a blurred gray image: non-maximum suppression of the gradient magnitude, and
// hysteresis, which keeps weak edges that are connected to strong ones.
#pragma once

#include "sobel.h"

namespace kv::filters {

// magnitude: sqrt(gx^2 + gy^2 + eps) of the unnormalized Sobel gradient on ridges, else 0.
// edges: 0 below `low`, 0.5 between, 1 above `high`.
template <class T>
struct CannySuppress {
  Planes<T const> x;
  Planes<T> magnitude, edges;
  Compute<T> low, high, eps;
};

// kept: 1 where `edges` (0, 0.5 or 1) is 1 or, in 8 directions, connected to a 1 through edges; else 0.
template <class T>
struct CannyHysteresis {
  Planes<T const> edges;
  Planes<T> result;
  int32_t* labels;  // one for each pixel; CUDA only
};

KV_KERNEL(canny_suppress, CannySuppress)
KV_KERNEL(canny_hysteresis, CannyHysteresis)

// Whether a pixel is a ridge: no neighbor along its gradient, rounded to 45 degrees, is stronger. Along x and y the
// first of two equal neighbors is kept, on a diagonal neither. a, b and c are squared magnitudes in the rows above, at
// and below the pixel; 0, 1 and 2 are the columns to the left, at and to the right of it. Out of bounds they are eps.
template <class V, class S>
KV_HD auto is_ridge(V gx, V gy, V a0, V a1, V a2, V b0, V b1, V b2, V c0, V c1, V c2, S eps) {
  S const tan_22_5 = S(0.41421356237309504880);
  V const x = max(gx, -gx), y = max(gy, -gy);
  auto const mostly_x = y <= x * tan_22_5, mostly_y = x < y * tan_22_5;
  auto const falling = (gx > 0) == (gy > 0);
  V const first = mostly_x ? b0 : mostly_y ? a1 : falling ? a0 : c0;
  V const second = mostly_x ? b2 : mostly_y ? c1 : falling ? c2 : a2;
  return (b1 > first) & ((b1 > second) | ((b1 == second) & (mostly_x | mostly_y))) & (b1 > eps);
}

}  // namespace kv::filters
