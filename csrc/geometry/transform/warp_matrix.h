// The map of a warp from pixels of the output to pixels of the source, computed from the caller's matrix, and the
// gradient of that matrix. Computed in double, once per sample, so that coordinates in float are correct to their last
// bits.
#pragma once

#include "core/hd.h"
#include "core/matrix3.h"

namespace kv::geometry {

struct Size {
  int64_t height, width;
};

// The meaning of a caller's matrix.
struct MatrixUse {
  int rows;      // 3, or 2 for an affine one
  bool inverse;  // it maps source to output
  // It maps [-1, 1] to [-1, 1]: between the centers of the first and the last pixel with align_corners, between their
  // outer edges without.
  bool normalized, align_corners;
  Size source, output;
};

// 1 / x; for floats on CUDA without the slow path for values that are no valid weights.
template <class V>
KV_HD V reciprocal(V x) {
#if defined(__CUDA_ARCH__)
  if constexpr (sizeof(V) == 4) {
    float y;
    asm("rcp.approx.ftz.f32 %0, %1;" : "=f"(y) : "f"(x));
    float const rest = ::fmaf(-x, y, 1);
    return rest == rest ? ::fmaf(y, rest, y) : y;  // y is exact for 0 and inf
  }
#endif
  return 1 / x;
}

// Maps (x, y, 1) to m (x, y, 1), divided by its last entry.
template <class F>
struct Homography {
  F m[9];
  bool affine;  // the last row is 0, 0, 1

  template <class V>
  KV_HD void apply(V x, F y, V& u, V& v) const {
    u = x * m[0] + (y * m[1] + m[2]);
    v = x * m[3] + (y * m[4] + m[5]);
    if (affine) return;
    V const scale = reciprocal(weight(x, y));
    u = u * scale;
    v = v * scale;
  }
  template <class V>
  KV_HD V weight(V x, F y) const {
    return x * m[6] + (y * m[7] + m[8]);
  }
};

namespace matrix {

// x in pixels is scale * n + offset, n in [-1, 1].
struct Unit {
  double scale, offset;
  KV_HD Unit(int64_t size, bool align_corners)
      : scale((align_corners ? double(size - 1) : double(size)) / 2), offset(double(size - 1) / 2) {}
};

// m, from [-1, 1] to [-1, 1], as a map from pixels to pixels.
KV_HD void to_pixels(double* m, MatrixUse const& use) {
  Unit const from[] = {{use.output.width, use.align_corners}, {use.output.height, use.align_corners}};
  Unit const to[] = {{use.source.width, use.align_corners}, {use.source.height, use.align_corners}};
  for (int row = 0; row < 9; row += 3)
    for (int i = 0; i < 2; ++i) {
      m[row + i] = from[i].scale > 0 ? m[row + i] / from[i].scale : 0;  // the only pixel of an axis is at 0
      m[row + 2] -= m[row + i] * from[i].offset;
    }
  for (int k = 0; k < 3; ++k)
    for (int i = 0; i < 2; ++i) m[3 * i + k] = m[3 * i + k] * to[i].scale + m[6 + k] * to[i].offset;
}
KV_HD void to_pixels_vjp(double* g, MatrixUse const& use) {
  Unit const from[] = {{use.output.width, use.align_corners}, {use.output.height, use.align_corners}};
  Unit const to[] = {{use.source.width, use.align_corners}, {use.source.height, use.align_corners}};
  for (int k = 0; k < 3; ++k)
    for (int i = 0; i < 2; ++i) {
      g[6 + k] += g[3 * i + k] * to[i].offset;
      g[3 * i + k] *= to[i].scale;
    }
  for (int row = 0; row < 9; row += 3)
    for (int i = 0; i < 2; ++i) {
      g[row + i] -= g[row + 2] * from[i].offset;
      g[row + i] = from[i].scale > 0 ? g[row + i] / from[i].scale : 0;
    }
}

template <class F>
KV_HD void load(F const* entries, int rows, double* m) {
  for (int i = 0; i < 9; ++i) m[i] = i < 3 * rows ? double(entries[i]) : i == 8;
}

// A factor that keeps coordinates in the range of float; neither the map nor its gradient depends on it. The last entry
// becomes 1 where possible, so that affine maps stay affine and integers stay integers.
KV_HD double scale_of(double const* m) {
  double largest = 0;
  for (int i = 0; i < 9; ++i) largest = max(largest, m[i] < 0 ? -m[i] : m[i]);
  double const last = m[8] < 0 ? -m[8] : m[8];
  double const chosen = last > 1e-6 * largest ? m[8] : largest;
  return chosen != 0 ? 1 / chosen : 1;
}

}  // namespace matrix

// From pixels of the output to pixels of the source.
template <class F>
KV_HD Homography<double> homography(F const* entries, MatrixUse const& use) {
  double m[9], a[9];
  matrix::load(entries, use.rows, m);
  if (use.inverse) {
    adjugate3(m, a);  // the inverse up to a factor, which does not matter for a homography
    for (int i = 0; i < 9; ++i) m[i] = a[i];
  }
  if (use.normalized) matrix::to_pixels(m, use);
  double const scale = matrix::scale_of(m);
  Homography<double> h;
  for (int i = 0; i < 9; ++i) h.m[i] = m[i] * scale;
  if (h.m[8] > 1 - 1e-15 && h.m[8] < 1 + 1e-15) h.m[8] = 1;  // m[8] times its reciprocal
  h.affine = h.m[6] == 0 && h.m[7] == 0 && h.m[8] == 1;
  return h;
}

// The inverse map of the same matrix, from pixels of the source to pixels of the output.
KV_HD MatrixUse inverse_use(MatrixUse use) {
  use.inverse = !use.inverse;
  Size const source = use.source;
  use.source = use.output;
  use.output = source;
  return use;
}

// The same map between coordinates relative to (x, y) and to (u, v). In float their error is a few millionths of the
// distance from there; relative to the corner of a large image it would be half a thousandth of a pixel.
template <class F>
KV_HD Homography<F> bind_to_tile(Homography<double> const& h, double x, double y, double u, double v) {
  double m[9];
  for (int i = 0; i < 9; i += 3) {
    m[i] = h.m[i];
    m[i + 1] = h.m[i + 1];
    m[i + 2] = h.m[i] * x + (h.m[i + 1] * y + h.m[i + 2]);
  }
  for (int i = 0; i < 3; ++i) {
    m[i] -= u * m[6 + i];
    m[3 + i] -= v * m[6 + i];
  }
  Homography<F> near;
  for (int i = 0; i < 9; ++i) near.m[i] = F(m[i]);
  near.affine = h.affine;
  return near;
}

// The origin of relative coordinates on an axis of that size, near a coordinate. It is even, so that halves are rounded
// to the same even pixel.
KV_HD int origin_near(double coord, int64_t size) { return 2 * int((coord > 0 ? min(coord, double(size)) : 0) / 2); }

// The gradient of the caller's matrix, from that of the entries of homography(entries, use).
template <class F>
KV_HD void homography_vjp(F const* entries, MatrixUse const& use, double* g, F* grad) {
  double m[9], a[9], grad_matrix[9];
  matrix::load(entries, use.rows, m);
  if (use.inverse)
    adjugate3(m, a);
  else
    for (int i = 0; i < 9; ++i) a[i] = m[i];
  double pixels[9];
  for (int i = 0; i < 9; ++i) pixels[i] = a[i];
  if (use.normalized) matrix::to_pixels(pixels, use);
  double const scale = matrix::scale_of(pixels);
  for (int i = 0; i < 9; ++i) g[i] *= scale;
  if (use.normalized) matrix::to_pixels_vjp(g, use);
  if (use.inverse)
    adjugate3_vjp(m, g, grad_matrix);
  else
    for (int i = 0; i < 9; ++i) grad_matrix[i] = g[i];
  for (int i = 0; i < 3 * use.rows; ++i) grad[i] = F(grad_matrix[i]);
}

}  // namespace kv::geometry
