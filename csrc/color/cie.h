// Linear light (sRGB, IEC 61966-2-1) and CIE XYZ, Lab and Luv (CIE 15): formulas of color steps. Included by steps.h,
// which says how they are written.
#pragma once

#include "step_math.h"

namespace kv::color {

struct SrgbToLinear {
  template <class V>
  KV_HD V operator()(V const& x) const {
    using F = Scalar<V>;
    V const high = power((clamp_min(x, F(0.04045)) + F(0.055)) * F(1 / 1.055), F(2.4));
    return select(x > F(0.04045), high, x * F(1 / 12.92));
  }
};
struct LinearToSrgb {
  template <class V>
  KV_HD V operator()(V const& x) const {
    using F = Scalar<V>;
    V const high = power(clamp_min(x, F(0.0031308)), F(1 / 2.4)) * F(1.055) - F(0.055);
    return select(x > F(0.0031308), high, x * F(12.92));
  }
};

// A linear map of c, or its vjp.
template <bool Vjp, class V>
KV_HD void linear(V (&c)[3], Scalar<V> const* m) {
  if constexpr (Vjp)
    linear_vjp(c, m);
  else
    affine(c, m);
}
template <bool Vjp = false, class V>
KV_HD void linear_to_xyz(V (&c)[3]) {
  using F = Scalar<V>;
  constexpr F m[] = {F(0.412453), F(0.357580), F(0.180423), F(0.212671), F(0.715160), F(0.072169),
                     F(0.019334), F(0.119193), F(0.950227), 0,           0,           0};
  linear<Vjp>(c, m);
}
template <bool Vjp = false, class V>
KV_HD void xyz_to_linear(V (&c)[3]) {
  using F = Scalar<V>;
  constexpr F m[] = {F(3.240481343200526),
                     F(-1.5371515162713183),
                     F(-0.49853632616888777),
                     F(-0.9692549499965681),
                     F(1.8759900014898907),
                     F(0.04155592655829283),
                     F(0.05564663913517714),
                     F(-0.2040413383665112),
                     F(1.0573110696453443),
                     0,
                     0,
                     0};
  linear<Vjp>(c, m);
}

KV_HD constexpr double white_point(int i) { return i == 0 ? 0.95047 : i == 1 ? 1 : 1.08883; }  // D65
constexpr double kLabThreshold = 0.008856;
// CIE's f(t): the cube root, and a line for small t.
struct LabRoot {
  template <class V>
  KV_HD V operator()(V const& t) const {
    using F = Scalar<V>;
    return select(t > F(kLabThreshold), power(clamp_min(t, F(kLabThreshold)), F(1. / 3)), t * F(7.787) + F(4. / 29));
  }
};
struct Lightness {
  template <class V>
  KV_HD V operator()(V const& y) const {
    using F = Scalar<V>;
    V const high = power(clamp_min(y, F(kLabThreshold)), F(1. / 3)) * F(116) - F(16);
    return select(y > F(kLabThreshold), high, y * F(903.3));
  }
};

template <class V>
KV_HD void rgb_to_lab(V (&c)[3]) {
  using F = Scalar<V>;
  for (int i = 0; i < 3; ++i) c[i] = map_scalar(c[i], SrgbToLinear());
  linear_to_xyz(c);
  V f[3];
  for (int i = 0; i < 3; ++i) f[i] = map_scalar(c[i] * F(1 / white_point(i)), LabRoot());
  c[0] = f[1] * F(116) - F(16);
  c[1] = (f[0] - f[1]) * F(500);
  c[2] = (f[1] - f[2]) * F(200);
}

template <class V>
KV_HD void rgb_to_lab_vjp(V const (&c)[3], V (&g)[3]) {
  using F = Scalar<V>;
  V xyz[3], derivative[3];
  for (int i = 0; i < 3; ++i) {
    Dual<V, 1> const decoded = with_derivative(c[i], SrgbToLinear());
    xyz[i] = decoded.value;
    derivative[i] = decoded.d[0];
  }
  linear_to_xyz(xyz);
  V const a = g[1] * F(500), b = g[2] * F(200);
  V const grad_roots[3] = {a, g[0] * F(116) - a + b, -b};
  for (int i = 0; i < 3; ++i)
    g[i] = grad_roots[i] * with_derivative(V(xyz[i] * F(1 / white_point(i))), LabRoot()).d[0] * F(1 / white_point(i));
  linear_to_xyz<true>(g);
  for (int i = 0; i < 3; ++i) g[i] = g[i] * derivative[i];
}

// The inverse of LabRoot.
struct LabCube {
  template <class V>
  KV_HD V operator()(V const& f) const {
    using F = Scalar<V>;
    return select(f > F(0.2068966), f * f * f, (f - F(4. / 29)) * F(1 / 7.787));
  }
};
template <class V>
KV_HD void lab_to_rgb(V (&c)[3]) {
  using F = Scalar<V>;
  V const fy = (c[0] + F(16)) * F(1. / 116);
  V const f[3] = {c[1] * F(1. / 500) + fy, fy, clamp_min(fy - c[2] * F(1. / 200), F(0))};
  for (int i = 0; i < 3; ++i) c[i] = LabCube()(f[i]) * F(white_point(i));
  xyz_to_linear(c);
  for (int i = 0; i < 3; ++i) c[i] = map_scalar(c[i], LinearToSrgb());
}
template <class V>
KV_HD void lab_to_rgb_vjp(V const (&c)[3], V (&g)[3], bool clips) {
  using F = Scalar<V>;
  V const fy = (c[0] + F(16)) * F(1. / 116), fz = fy - c[2] * F(1. / 200);
  V const f[3] = {c[1] * F(1. / 500) + fy, fy, clamp_min(fz, F(0))};
  V rgb[3], derivative[3];
  for (int i = 0; i < 3; ++i) {
    Dual<V, 1> const cube = with_derivative(f[i], LabCube());
    rgb[i] = cube.value * F(white_point(i));
    derivative[i] = cube.d[0] * F(white_point(i));
  }
  xyz_to_linear(rgb);
  for (int i = 0; i < 3; ++i) {
    Dual<V, 1> const encoded = with_derivative(rgb[i], LinearToSrgb());
    g[i] = clip_vjp(encoded.value, V(g[i] * encoded.d[0]), clips);
  }
  xyz_to_linear<true>(g);
  for (int i = 0; i < 3; ++i) g[i] = g[i] * derivative[i];
  V const grad_fz = select(fz < F(0), constant<V>(F(0)), g[2]);
  V const grad_fy = g[0] + g[1] + grad_fz;
  g[1] = g[0] * F(1. / 500);
  g[0] = grad_fy * F(1. / 116);
  g[2] = grad_fz * F(-1. / 200);
}

constexpr double kWhiteU = 4 * 0.95047 / (0.95047 + 15 + 3 * 1.08883), kWhiteV = 9 / (0.95047 + 15 + 3 * 1.08883);

template <class V>
KV_HD void rgb_to_luv(V (&c)[3], Scalar<V> eps) {
  using F = Scalar<V>;
  for (int i = 0; i < 3; ++i) c[i] = map_scalar(c[i], SrgbToLinear());
  linear_to_xyz(c);
  V const l = map_scalar(c[1], Lightness());
  V const total = c[0] + c[1] * F(15) + c[2] * F(3) + eps;
  V const scale = reciprocal(select(absolute(total) < F(0x1p-100), constant<V>(F(1)), total));
  V const u = c[0] * F(4) * scale, v = c[1] * F(9) * scale;
  c[0] = l;
  c[1] = l * (u - F(kWhiteU)) * F(13);
  c[2] = l * (v - F(kWhiteV)) * F(13);
}

template <class V>
KV_HD void luv_to_rgb(V (&c)[3], Scalar<V> eps) {
  using F = Scalar<V>;
  V const l = c[0], root = (l + F(16)) * F(1. / 116);
  V const y = select(l > F(7.999625), root * root * root, l * F(1 / 903.3));
  V const scale = l * F(13) + eps;
  V const inverse_l = reciprocal(select(scale == F(0), constant<V>(F(1)), scale));
  V const a = c[1] * inverse_l + F(kWhiteU), d = c[2] * inverse_l + F(kWhiteV);
  V const y_per_v = y * reciprocal(d * F(4) + eps);
  c[0] = a * y_per_v * F(9);
  c[1] = y;
  c[2] = (F(12) - a * F(3) - d * F(20)) * y_per_v;
  xyz_to_linear(c);
  for (int i = 0; i < 3; ++i) c[i] = map_scalar(c[i], LinearToSrgb());
}

}  // namespace kv::color
