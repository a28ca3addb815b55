// Lens distortion: maps undistorted points to distorted ones,
//
//   (x, y) (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6) + shift(x, y)
//
// for (x, y) on the plane z = 1 in front of the camera, r^2 = x^2 + y^2. The order of the coefficients is k1, k2, p1,
// p2, k3, k4, k5, k6, s1, s2, s3, s4. The inverse map, undistortion, takes steps of a fixed-point iteration, and damped
// steps of Newton's method for points that these leave more than a thousandth of a pixel off.
#pragma once

#include "core/any_lane.h"
#include "core/ceil_div.h"
#include "core/isa.h"
#include "geometry/solvers/first_root.h"

namespace kv::geometry {

template <class T>
struct LensPoints {
  T const* points;  // (B, N, 2) in pixels; or null: the pixels of an image of that width, results (B, 2, N)
  T const *camera, *new_camera;  // (3, 3) for the points and for the result
  T const* coefficients;         // (coefficient_count): the first ones; the others are 0
  T const* tilt;                 // (3, 3), to the plane of a tilted sensor, or back from it; or null
  // Strides from a sample to the next, 0 where one lens serves all.
  int64_t camera_stride, new_camera_stride, coefficients_stride, tilt_stride;
  int coefficient_count, steps;
  int64_t batch, count;
  T* result;  // (B, N, 2)
  int64_t width;
};

// The gradients of a map with respect to its lens. One camera matrix serves the points and the result. Chunks of the
// pixels of a sample are summed first, then the chunks are added up.
constexpr int kLensSums = 25;  // focal lengths, center, 12 coefficients, tilt
constexpr int kLensChunk = 4096;
inline int64_t lens_parts(int64_t count) { return ceil_div(count, kLensChunk); }

template <class T>
struct LensBackward : LensPoints<T> {
  T const* grad;  // (B, 2, N)
  T* sums;        // (B, parts, kLensSums)
  int64_t parts;
  T *grad_camera, *grad_coefficients, *grad_tilt;  // (B, 3, 3), (B, coefficient_count), (B, 3, 3) or null

  KV_HD void set(int64_t b, int i, double sum) const {
    constexpr int entries[] = {0, 4, 2, 5};
    if (i < 4)
      grad_camera[9 * b + entries[i]] = T(sum);
    else if (i >= 16 && grad_tilt)
      grad_tilt[9 * b + i - 16] = T(sum);
    else if (i < 16 && i - 4 < this->coefficient_count)
      grad_coefficients[this->coefficient_count * b + i - 4] = T(sum);
  }
  // Constants of the map.
  KV_HD void set_zeros(int64_t b) const {
    for (int i = 0; i < 9; ++i)
      if (i != 0 && i != 2 && i != 4 && i != 5) grad_camera[9 * b + i] = 0;
    for (int i = 12; i < this->coefficient_count; ++i) grad_coefficients[this->coefficient_count * b + i] = 0;
  }
};

KV_KERNEL(undistort_points, LensPoints)
KV_KERNEL(distort_points, LensPoints)
KV_KERNEL(undistort_map_backward, LensBackward)
KV_KERNEL(reduce_lens_grads, LensBackward)

// Where a lens stops being one. With its radial factor N / D as a function of r^2, the distance r N / D from the center
// must grow with r, and D must not be 0. What lies beyond is a second image of the scene, mirrored or not.
template <class T>
struct Domain {
  T growth[7] = {}, divisor[4];  // D^2 times the derivative of r N / D, and D: polynomials in r^2 that are 1 at 0
  T falls[6];                    // neither is below 1 - falls[0] r^2 - falls[1] r^4 - ...
  T safe;                        // r^2 up to which that is positive

  KV_HD explicit Domain(T const (&c)[12]) : divisor{1, c[5], c[6], c[7]} {
    T const numerator[] = {1, c[0], c[1], c[4]};
    for (int i = 0; i < 4; ++i)
      for (int k = 0; k < 4; ++k) growth[i + k] += T(1 + 2 * i - 2 * k) * numerator[i] * divisor[k];
    for (int i = 0; i < 6; ++i) falls[i] = max(max(-growth[i + 1], i < 3 ? -divisor[i + 1] : T(0)), T(0));
    T const sum = falls[0] + falls[1] + falls[2] + falls[3] + falls[4] + falls[5];
    safe = T(.999) / max(sum, T(1));
  }
  // False is no answer: `limit` has it.
  template <class V>
  KV_HD auto surely_contains(V r2) const {
    return r2 * (falls[0] + r2 * (falls[1] + r2 * (falls[2] + r2 * (falls[3] + r2 * (falls[4] + r2 * falls[5]))))) < 1;
  }
  // The squared radius at which it ends.
  KV_HD T limit() const { return min(first_positive_root(growth), first_positive_root(divisor)); }
};

// The lens of a sample.
template <class T>
struct Lens {
  LensPoints<T> const& p;
  T const *k, *new_camera, *tilt;
  T c[12];
  T allowed;  // the square of a thousandth of a pixel, on the plane, where a focal length is at least a thousand pixels

  KV_HD Lens(LensPoints<T> const& p, int64_t b)
      : p(p),
        k(p.camera + b * p.camera_stride),
        new_camera(p.new_camera + b * p.new_camera_stride),
        tilt(p.tilt ? p.tilt + b * p.tilt_stride : nullptr) {
    for (int i = 0; i < 12; ++i) c[i] = i < p.coefficient_count ? p.coefficients[b * p.coefficients_stride + i] : T(0);
    T const fx = k[0] < 0 ? -k[0] : k[0], fy = k[4] < 0 ? -k[4] : k[4], pixel = min(T(1e-3) / max(fx, fy), T(1e-6));
    allowed = pixel * pixel;
  }
  template <class V>
  KV_HD void normalize(V& x, V& y) const {
    x = (x - k[2]) / k[0];
    y = (y - k[5]) / k[4];
  }
  template <class V>
  KV_HD void to_pixels(V& x, V& y) const {
    x = x * new_camera[0] + new_camera[2];
    y = y * new_camera[4] + new_camera[5];
  }
  template <class V>
  KV_HD void apply_tilt(V& x, V& y) const {
    if (!tilt) return;
    V const w = x * tilt[6] + y * tilt[7] + tilt[8], u = (x * tilt[0] + y * tilt[1] + tilt[2]) / w;
    y = (x * tilt[3] + y * tilt[4] + tilt[5]) / w;
    x = u;
  }
  // The shift, and the radial factor as numerator and denominator. IsPlain: only the first five coefficients are not 0.
  template <bool IsPlain = false, class V>
  KV_HD void terms(V x, V y, V& numerator, V& denominator, V& dx, V& dy) const {
    V const r2 = x * x + y * y;
    numerator = 1 + r2 * (c[0] + r2 * (c[1] + r2 * c[4]));
    denominator = V{} + T(1);
    dx = 2 * c[2] * x * y + c[3] * (r2 + 2 * x * x);
    dy = c[2] * (r2 + 2 * y * y) + 2 * c[3] * x * y;
    if constexpr (IsPlain) return;
    denominator = 1 + r2 * (c[5] + r2 * (c[6] + r2 * c[7]));
    dx += r2 * (c[8] + r2 * c[9]);
    dy += r2 * (c[10] + r2 * c[11]);
  }
  // Distorts (x, y), and sets the derivatives of the result: x by x, x by y, y by x, y by y.
  template <class V>
  KV_HD void distort_with_jacobian(V& x, V& y, V& numerator, V& denominator, V (&jacobian)[4]) const {
    V dx, dy;
    terms(x, y, numerator, denominator, dx, dy);
    V const r2 = x * x + y * y, inverse = 1 / denominator, factor = numerator * inverse;
    V const slope = 2 * inverse *
                    (c[0] + r2 * (2 * c[1] + 3 * c[4] * r2) -
                     factor * (c[5] + r2 * (2 * c[6] + 3 * c[7] * r2)));  // of the factor, by r^2, twice
    V const u = 2 * (c[8] + 2 * c[9] * r2), v = 2 * (c[10] + 2 * c[11] * r2);
    V const mixed = slope * x * y + 2 * (c[2] * x + c[3] * y);
    jacobian[0] = factor + slope * x * x + 2 * c[2] * y + 6 * c[3] * x + u * x;
    jacobian[1] = mixed + u * y;
    jacobian[2] = mixed + v * x;
    jacobian[3] = factor + slope * y * y + 6 * c[2] * y + 2 * c[3] * x + v * y;
    x = x * factor + dx;
    y = y * factor + dy;
  }
  // From the pixel of a lens to that of an ideal camera; NaN where the lens shows no point at the pixel. Limit is a
  // Domain or has its members.
  template <class V, class Limit>
  KV_HD void undistort(V& x, V& y, Limit const& domain) const {
    normalize(x, y);
    apply_tilt(x, y);
    V const x0 = x, y0 = y;
    V last_x = x, last_y = y, before_x = x, before_y = y, inverse = V{} + T(1);
    for (int step = 0; step < p.steps; ++step) {
      V numerator, denominator, dx, dy;
      if (p.coefficient_count <= 5)
        terms<true>(x, y, numerator, denominator, dx, dy);
      else
        terms(x, y, numerator, denominator, dx, dy);
      inverse = denominator / numerator;
      before_x = last_x, before_y = last_y, last_x = x, last_y = y;
      x = (x0 - dx) * inverse;
      y = (y0 - dy) * inverse;
    }
    // The last step is the residual before it. An eighth of what is allowed, or rounding, is settled.
    T const rounding = T(4) * kEpsilon * kEpsilon;
    V const step = (x - last_x) * (x - last_x) + (y - last_y) * (y - last_y), r2 = x * x + y * y,
            scale = inverse * inverse;
    auto settled = (step <= max(allowed * T(1. / 64), rounding) * scale) & (r2 <= domain.safe);
    if (__builtin_expect(p.steps < 2 || any_lane(settled == 0), 0)) {
      // Or what is left by how much shorter the step was than the one before.
      V const before = (last_x - before_x) * (last_x - before_x) + (last_y - before_y) * (last_y - before_y),
              size = rounding * (x0 * x0 + y0 * y0), enough = max(V(V{} + allowed), size);
      settled = settled | (((step <= max(V(V{} + allowed * T(1. / 64)), V(4 * size)) * scale) |
                            ((step <= before) & (4 * step * step <= before * enough * scale))) &
                           domain.surely_contains(r2));
      auto const is_kept = p.steps < 2 ? (step < V{}) : settled;
      if (!any_lane(is_kept == 0)) return to_pixels(x, y);
      V solved_x = x, solved_y = y;
      solve(solved_x, solved_y, x0, y0, enough, domain.limit());
      x = is_kept ? x : solved_x;
      y = is_kept ? y : solved_y;
    }
    to_pixels(x, y);
  }
  static constexpr T kEpsilon = sizeof(T) == 4 ? T(0x1p-23) : T(0x1p-52);

  // Newton's method for the point that is distorted to (x0, y0), within r^2 <= limit, from (x, y) or, where that is no
  // better, from the center. A step that is none is halved. Where no point comes near, NaN.
  template <class V>
  KV_HD void solve(V& x, V& y, V x0, V y0, V enough, T limit) const {
    V const size = x0 * x0 + y0 * y0;
    V step_x = x, step_y = y, error = size;
    x = y = V{};
    int const trials = p.steps > kTrials ? p.steps : kTrials;
    for (int i = 0; i < trials; ++i) {
      auto const is_open = error > enough;
      if (!any_lane(is_open)) break;
      V const at_x = x + step_x, at_y = y + step_y, r2 = at_x * at_x + at_y * at_y;
      V u = at_x, v = at_y, numerator, denominator, jacobian[4];
      distort_with_jacobian(u, v, numerator, denominator, jacobian);
      u -= x0, v -= y0;
      V const residual = u * u + v * v, determinant = jacobian[0] * jacobian[3] - jacobian[1] * jacobian[2];
      auto const is_better =
          is_open & (residual < error) & (r2 <= limit) & (numerator > 0) & (denominator > 0) & (determinant > 0);
      V const inverse = -1 / determinant, halved_x = i == 0 ? x0 : V(step_x * T(.5)),
              halved_y = i == 0 ? y0 : V(step_y * T(.5));
      x = is_better ? at_x : x;
      y = is_better ? at_y : y;
      error = is_better ? residual : error;
      step_x = is_better ? V((jacobian[3] * u - jacobian[1] * v) * inverse) : halved_x;
      step_y = is_better ? V((jacobian[0] * v - jacobian[2] * u) * inverse) : halved_y;
    }
    T const nan = T(__builtin_nan("")), rounding = T(1024) * kEpsilon * kEpsilon;
    auto const is_solved = ((error <= enough) | (error <= rounding * size)) & (size - size == 0);
    x = is_solved ? x : V(V{} + nan);
    y = is_solved ? y : V(V{} + nan);
  }
  static constexpr int kTrials = 20;

  // Distorts pixels of an image; NaN beyond the domain of the lens.
  template <class V, class Limit>
  KV_HD void distort_within(V& x, V& y, Limit const& domain) const {
    V u = x, v = y;
    normalize(u, v);
    V const r2 = u * u + v * v;
    distort(x, y);
    if (any_lane(domain.surely_contains(r2) == 0)) {
      auto const is_within = r2 <= domain.limit();
      V const nan = V{} + T(__builtin_nan(""));
      x = is_within ? x : nan;
      y = is_within ? y : nan;
    }
  }
  template <class V>
  KV_HD void distort(V& x, V& y) const {
    V numerator, denominator, dx, dy;
    normalize(x, y);
    terms(x, y, numerator, denominator, dx, dy);
    V const factor = numerator / denominator;
    x = x * factor + dx;
    y = y * factor + dy;
    apply_tilt(x, y);
    to_pixels(x, y);
  }
  // Adds to the sums the contribution of a pixel whose coordinates have the gradient (u, v).
  template <class V>
  KV_HD void accumulate_grads(V x, V y, V u, V v, V (&sums)[kLensSums]) const {
    auto const has_no_grad = (u == 0) & (v == 0);  // its coordinates may be inf
    x = has_no_grad ? V(V{} + k[2]) : x;
    y = has_no_grad ? V(V{} + k[5]) : y;
    normalize(x, y);
    V numerator, denominator, dx, dy;
    terms(x, y, numerator, denominator, dx, dy);
    V const inverse = 1 / denominator, factor = numerator * inverse, distorted_x = x * factor + dx,
            distorted_y = y * factor + dy;
    V tilted_x = distorted_x, tilted_y = distorted_y;
    apply_tilt(tilted_x, tilted_y);
    sums[0] += u * tilted_x, sums[1] += v * tilted_y, sums[2] += u, sums[3] += v;
    V grad_x = u * new_camera[0], grad_y = v * new_camera[4];
    if (tilt) {
      V const scale = 1 / (distorted_x * tilt[6] + distorted_y * tilt[7] + tilt[8]),
              rows[] = {grad_x * scale, grad_y * scale, -(grad_x * tilted_x + grad_y * tilted_y) * scale};
      grad_x = grad_y = V{};
      for (int i = 0; i < 3; ++i) {
        sums[16 + 3 * i] += rows[i] * distorted_x, sums[17 + 3 * i] += rows[i] * distorted_y,
            sums[18 + 3 * i] += rows[i];
        grad_x += rows[i] * tilt[3 * i], grad_y += rows[i] * tilt[3 * i + 1];
      }
    }
    V const r2 = x * x + y * y, r4 = r2 * r2;
    V const grad_numerator = (grad_x * x + grad_y * y) * inverse, grad_denominator = -grad_numerator * factor;
    sums[4] += grad_numerator * r2, sums[5] += grad_numerator * r4, sums[8] += grad_numerator * r4 * r2;
    sums[9] += grad_denominator * r2, sums[10] += grad_denominator * r4, sums[11] += grad_denominator * r4 * r2;
    sums[6] += grad_x * (2 * x * y) + grad_y * (r2 + 2 * y * y),
        sums[7] += grad_x * (r2 + 2 * x * x) + grad_y * (2 * x * y);
    sums[12] += grad_x * r2, sums[13] += grad_x * r4, sums[14] += grad_y * r2, sums[15] += grad_y * r4;
    V const grad_r2 = grad_numerator * (c[0] + r2 * (2 * c[1] + 3 * c[4] * r2)) +
                      grad_denominator * (c[5] + r2 * (2 * c[6] + 3 * c[7] * r2)) +
                      grad_x * (c[3] + c[8] + 2 * c[9] * r2) + grad_y * (c[2] + c[10] + 2 * c[11] * r2);
    V const grad_plane_x =
        (grad_x * (factor + 2 * c[2] * y + 4 * c[3] * x) + 2 * c[3] * grad_y * y + 2 * grad_r2 * x) * (1 / k[0]);
    V const grad_plane_y =
        (grad_y * (factor + 2 * c[3] * x + 4 * c[2] * y) + 2 * c[2] * grad_x * x + 2 * grad_r2 * y) * (1 / k[4]);
    sums[0] -= grad_plane_x * x, sums[1] -= grad_plane_y * y, sums[2] -= grad_plane_x, sums[3] -= grad_plane_y;
  }
};

}  // namespace kv::geometry
