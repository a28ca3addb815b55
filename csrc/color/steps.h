// The steps of color programs. Their formulas are in hue.h, cie.h and adjustments.h, by subject. They take a pixel c of
// a value type V: a number, Lanes, or Duals of either, whose derivatives are those of the step. Parameters that can be
// learned have a type U: a number, or V to differentiate along one of them. Included by program_cpu.cpp and
// program.cuh, which first define, for numbers and Lanes, log2_of and exp2_of of normal numbers, floor_of, absolute,
// reciprocal, quotient, and nan_max and nan_min, which return NaN if either argument is NaN.
//
// Results and derivatives stay finite, also of denormal numbers: `quotient` divides by them, and in a branch that is
// not taken, divisors and bases of powers are replaced first. Derivatives follow the rules of docs/conventions.md for
// ties and for bounds.
//
// The Jacobian of three channels by Duals contains many zeros. The steps used most have a vjp right below their
// formula: f_vjp(c, g) turns g, the gradient of the result of f(c), into that of c.
#pragma once

#include "adjustments.h"
#include "cie.h"
#include "hue.h"
#include "program.h"

namespace kv::color {

// The steps of most augmentations. Kernels for programs that have no other steps are smaller.
constexpr uint64_t kFrequentSteps = uint64_t(1) << int(Step::scale_shift) | uint64_t(1) << int(Step::standardize) |
                                    uint64_t(1) << int(Step::contrast) | uint64_t(1) << int(Step::scale_shift_rgb) |
                                    uint64_t(1) << int(Step::standardize_rgb) | uint64_t(1) << int(Step::saturation) |
                                    uint64_t(1) << int(Step::saturation_gray) | uint64_t(1) << int(Step::hue);
constexpr int kFrequentStepCount = 8;
constexpr Step frequent_step(int i) {
  int step = 0;
  for (; !(kFrequentSteps >> step & 1) || i-- > 0; ++step) {
  }
  return Step(step);
}
static_assert(kFrequentSteps >> (int(frequent_step(kFrequentStepCount - 1)) + 1) == 0);
// Whether P supports only frequent steps.
template <class P>
constexpr bool takes_frequent_steps_only() {
  if constexpr (requires { P::kFrequentOnly; })
    return P::kFrequentOnly;
  else
    return false;
}

// The reciprocal of a deviation, which kernels for frequent steps have instead of it.
template <class P, class U>
KV_HD U inverse_deviation(U const& x) {
  if constexpr (takes_frequent_steps_only<P>())
    return x;
  else
    return reciprocal(x);
}

// Applies a step to all pixels. `pixels.each(f)` calls f(c, p, n) for each pixel, with the step's parameters p, which
// may carry a derivative, and n, the same parameters as numbers. For steps that do not mix channels
// `pixels.each_value(f)` calls f(x, i, p, n) for each channel i, with one derivative instead of three. For steps with a
// vjp `pixels.each_vjp(f)` calls f(c, g, n), and `pixels.each_value_vjp(f)` calls f(x, g, i, n). Branches between
// formulas are the same for all pixels. Every step of step_list.h has its case here.
template <class P>
KV_HD void run_step(Step step, P& pixels) {
#define KV_VALUES(name, formula)                                                                 \
  case Step::name:                                                                               \
    return pixels.each_value([](auto& x, [[maybe_unused]] int i, [[maybe_unused]] auto const* p, \
                                [[maybe_unused]] auto const* n) __attribute__((always_inline)) { x = formula; });
#define KV_VALUES_VJP(name, vjp, formula)                                                                           \
  case Step::name:                                                                                                  \
    if constexpr (P::kInputGradient)                                                                                \
      return pixels.each_value_vjp([]([[maybe_unused]] auto const& x, auto& g, [[maybe_unused]] int i,              \
                                      [[maybe_unused]] auto const* n) __attribute__((always_inline)) { g = vjp; }); \
    else                                                                                                            \
      return pixels.each_value([](auto& x, [[maybe_unused]] int i, [[maybe_unused]] auto const* p,                  \
                                  [[maybe_unused]] auto const* n) __attribute__((always_inline)) { x = formula; });
#define KV_PIXELS(name, ...)                                                                                        \
  case Step::name:                                                                                                  \
    return pixels.each([]([[maybe_unused]] auto& c, [[maybe_unused]] auto const* p, [[maybe_unused]] auto const* n) \
                           __attribute__((always_inline)) { __VA_ARGS__; });
#define KV_PIXELS_VJP(name, vjp, ...)                                                                                 \
  case Step::name:                                                                                                    \
    if constexpr (P::kInputGradient)                                                                                  \
      return pixels.each_vjp([]([[maybe_unused]] auto& c, auto& g, [[maybe_unused]] auto const* n)                    \
                                 __attribute__((always_inline)) { vjp; });                                            \
    else                                                                                                              \
      return pixels.each([]([[maybe_unused]] auto& c, [[maybe_unused]] auto const* p, [[maybe_unused]] auto const* n) \
                             __attribute__((always_inline)) { __VA_ARGS__; });
  switch (step) {
    KV_VALUES_VJP(scale_shift, scale_shift_vjp(x, g, n[0], n[1], n[2] != 0), clip(x * p[0] + p[1], n[2] != 0))
    KV_VALUES_VJP(contrast, blend_vjp(x, g, n[1], n[0]), blend(x, p[1], p[0]))
    KV_VALUES_VJP(standardize, g * inverse_deviation<P>(n[1]), (x - p[0]) * inverse_deviation<P>(p[1]))
    default:
      break;
  }
  if constexpr (P::kChannels == 3) {
    switch (step) {
      KV_VALUES_VJP(scale_shift_rgb, scale_shift_vjp(x, g, n[i], n[3 + i], n[6] != 0),
                    clip(x * p[i] + p[3 + i], n[6] != 0))
      KV_VALUES_VJP(standardize_rgb, g * inverse_deviation<P>(n[3 + i]), (x - p[i]) * inverse_deviation<P>(p[3 + i]))
      KV_PIXELS_VJP(saturation, adjust_saturation_vjp(c, g, n[0]), adjust_saturation(c, p[0]))
      KV_PIXELS_VJP(saturation_gray, saturation_gray_vjp(c, g, n[0]), saturation_gray(c, p[0]))
      KV_PIXELS_VJP(hue, adjust_hue_vjp(c, g, n[0]), adjust_hue(c, p[0]))
      default:
        break;
    }
  }
  if constexpr (!takes_frequent_steps_only<P>()) {
    switch (step) {
      KV_VALUES(gamma, clip(power_from_zero(x, p[0]) * p[1], true))
      KV_VALUES(log, clip(logarithm(x, p[0], n[1] != 0), n[2] != 0))
      KV_VALUES(sigmoid, sigmoid(x, p[0], p[1], n[2] != 0))
      KV_VALUES(solarize, solarize(x, p[0], p[1], n[2] != 0))
      KV_VALUES(posterize, posterize(x, n[0], n[1]))
      KV_VALUES(threshold, threshold(x, p[0], p[1], p[2], n[3] != 0, n[4] != 0))
      default:
        break;
    }
    if constexpr (P::kChannels == 3) {
      switch (step) {
        KV_PIXELS_VJP(weighted_sum, auto const grad_sum = g[0]; for (int i = 0; i < 3; ++i) g[i] = grad_sum * n[i],
                                                                c[0] = c[0] * p[0] + c[1] * p[1] + c[2] * p[2])
        KV_PIXELS(saturation_raw, c[1] = scale_saturation(c[1], p[0]))
        KV_PIXELS(hue_raw, c[0] = rotate_hue(c[0], p[0]))
        KV_PIXELS(lightness_raw, c[1] = lighten(c[1], p[0], p[1]))
        default:
          break;
      }
      if constexpr (!P::kParameterGradient) {
        switch (step) {
          KV_VALUES(rgb_to_linear_rgb, SrgbToLinear()(x))
          KV_VALUES(linear_rgb_to_rgb, LinearToSrgb()(x))
          KV_PIXELS_VJP(affine, affine_vjp(c, g, n), affine(c, n); for (auto& x : c) x = clip(x, n[12] != 0))
          KV_PIXELS_VJP(rgb_to_hsv, rgb_to_hsv_vjp(c, g, n[0]), rgb_to_hsv(c, n[0]))
          KV_PIXELS_VJP(hsv_to_rgb, hsv_to_rgb_vjp(c, g), hsv_to_rgb(c))
          KV_PIXELS(rgb_to_hls, rgb_to_hls(c, n[0]))
          KV_PIXELS(hls_to_rgb, hls_to_rgb(c))
          KV_PIXELS_VJP(rgb_to_lab, rgb_to_lab_vjp(c, g), rgb_to_lab(c))
          KV_PIXELS_VJP(lab_to_rgb, lab_to_rgb_vjp(c, g, n[0] != 0), lab_to_rgb(c);
                        for (auto& x : c) x = clip(x, n[0] != 0))
          KV_PIXELS(rgb_to_luv, rgb_to_luv(c, n[0]))
          KV_PIXELS(luv_to_rgb, luv_to_rgb(c, n[0]))
          KV_PIXELS(luma_u8_fixed_point, luma_u8_fixed_point(c, n))
          KV_PIXELS(hsv_u8, hsv_u8(c))
          KV_PIXELS(luma_u8, luma_u8(c, n))
          default:
            break;
        }
      }
    }
  }
#undef KV_PIXELS_VJP
#undef KV_PIXELS
#undef KV_VALUES_VJP
#undef KV_VALUES
}

}  // namespace kv::color
