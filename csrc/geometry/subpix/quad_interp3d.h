// Subvoxel peaks of a volume: the stationary point of the quadratic through the 3 x 3 x 3 voxels around a voxel c,
// whose gradient g and Hessian H are finite differences,
//
//   x(c + s) = x(c) + g . s + s . H s / 2           s = -H^-1 g, x(c + s) = x(c) + g . s / 2
//
// If the peak is farther than `largest_shift` along an axis, the center c moves one voxel in that direction and the fit
// is repeated. There are at most `steps` fits; c stays inside the volume and at most `radius` voxels from the start. If
// the search does not converge, or H is singular, the result is the voxel itself.
#pragma once

#include "core/isa.h"

namespace kv::geometry {

template <class T>
struct ConvQuadInterp3d {
  T const* x;             // (n, D, H, W)
  uint8_t const* chosen;  // (n, D, H, W), the voxels to refine; null for the strict maxima
  T *coords, *values;     // coordinates (n, 3, D, H, W): scale (z), x, y; values (n, D, H, W)
  int64_t volumes;
  int size[3];  // D, H, W
  int steps, radius;
  bool along_scale;  // whether the center may move along z
  Compute<T> largest_shift;
};

// Gradients to the voxels: those to a peak's coordinates and value go to the 19 voxels of its fit.
template <class T>
struct ConvQuadInterp3dBackward {
  ConvQuadInterp3d<T> forward;  // without its results
  T const *grad_coords, *grad_values;
  Compute<T>* grad_x;
};

KV_KERNEL(conv_quad_interp3d, ConvQuadInterp3d)
KV_KERNEL(conv_quad_interp3d_backward, ConvQuadInterp3dBackward)

// The quadratic around a voxel. Axes are in the order x, y, z.
template <class F>
struct Quadratic {
  F g[3];                   // the gradient
  F diagonal[3], mixed[3];  // of H: xx, yy, zz; yz, xz, xy, index a without axis a
  F shift[3];
  bool solved;

  // at(dx, dy, dz) reads the voxel at this offset from the center.
  template <class At>
  KV_HD explicit Quadratic(At at) {
    F const center = at(0, 0, 0);
    for (int a = 0; a < 3; ++a) {
      F const before = at(-(a == 0), -(a == 1), -(a == 2)), after = at(a == 0, a == 1, a == 2);
      g[a] = (after - before) * F(0.5);
      diagonal[a] = after - 2 * center + before;
    }
    auto const twist = [&](int left_out) {
      auto const corner = [&](int first, int second) {
        return left_out == 0 ? at(0, first, second) : left_out == 1 ? at(first, 0, second) : at(first, second, 0);
      };
      return (corner(1, 1) - corner(-1, 1) - corner(1, -1) + corner(-1, -1)) * F(0.25);
    };
    for (int a = 0; a < 3; ++a) mixed[a] = twist(a);
    solve(g, shift, solved);
    for (int a = 0; a < 3; ++a) shift[a] = -shift[a];
  }

  // s = H^-1 r, by the cofactors of H over its largest magnitude. Sets `done` to false if H is singular up to rounding.
  KV_HD void solve(F const (&r)[3], F (&s)[3], bool& done) const {
    F largest = 0;
    for (int a = 0; a < 3; ++a) {
      largest = max(largest, diagonal[a] < 0 ? -diagonal[a] : diagonal[a]);
      largest = max(largest, mixed[a] < 0 ? -mixed[a] : mixed[a]);
    }
    F const unit = 1 / largest, xx = diagonal[0] * unit, yy = diagonal[1] * unit, zz = diagonal[2] * unit;
    F const yz = mixed[0] * unit, xz = mixed[1] * unit, xy = mixed[2] * unit;
    F const c00 = yy * zz - yz * yz, c01 = xz * yz - xy * zz, c02 = xy * yz - xz * yy;
    F const c11 = xx * zz - xz * xz, c12 = xy * xz - xx * yz, c22 = xx * yy - xy * xy;
    F const det = xx * c00 + xy * c01 + xz * c02;
    done = det > F(1e-7) || det < F(-1e-7);  // false for NaN
    F const scale = done ? unit / det : F(0);
    s[0] = (c00 * r[0] + c01 * r[1] + c02 * r[2]) * scale;
    s[1] = (c01 * r[0] + c11 * r[1] + c12 * r[2]) * scale;
    s[2] = (c02 * r[0] + c12 * r[1] + c22 * r[2]) * scale;
    if (!done) s[0] = s[1] = s[2] = 0;
  }
  KV_HD F rise() const { return (g[0] * shift[0] + g[1] * shift[1] + g[2] * shift[2]) * F(0.5); }

  // Calls add(dx, dy, dz, grad) for the gradient to each voxel, from that to the shift and to the value:
  //   d(shift) = -H^-1 (dg + dH shift)         d(value) = dx(c) + shift . dg + shift . dH shift / 2
  template <class Add>
  KV_HD void vjp(F const (&grad_shift)[3], F grad_value, Add add) const {
    F u[3];
    bool done;
    solve(grad_shift, u, done);
    F grad_g[3];
    for (int a = 0; a < 3; ++a) grad_g[a] = grad_value * shift[a] - u[a];
    F grad_center = grad_value;
    for (int a = 0; a < 3; ++a) {
      F const grad_h = (grad_value * shift[a] * F(0.5) - u[a]) * shift[a];
      int const x = a == 0, y = a == 1, z = a == 2;
      add(x, y, z, grad_h + grad_g[a] * F(0.5));
      add(-x, -y, -z, grad_h - grad_g[a] * F(0.5));
      grad_center -= 2 * grad_h;
    }
    add(0, 0, 0, grad_center);
    for (int a = 0; a < 3; ++a) {
      int const i = (a + 1) % 3, j = (a + 2) % 3;
      F const grad_h = (grad_value * shift[i] * shift[j] - u[i] * shift[j] - u[j] * shift[i]) * F(0.25);
      for (int sign_i = -1; sign_i <= 1; sign_i += 2)
        for (int sign_j = -1; sign_j <= 1; sign_j += 2) {
          int d[3] = {};
          d[i] = sign_i, d[j] = sign_j;
          add(d[0], d[1], d[2], sign_i * sign_j > 0 ? grad_h : -grad_h);
        }
    }
  }
};

// Searches for the peak from a voxel. Calls use(center, fit) with the last center (x, y, z) and its Quadratic, or does
// nothing if there is no peak. `read` converts an element to a number.
template <class T, class Read, class Use>
KV_HD void find_peak(ConvQuadInterp3d<T> const& p, T const* volume, int z, int y, int x, Read read, Use use) {
  using F = Compute<T>;
  int const plane = p.size[1] * p.size[2], row = p.size[2], start[3] = {x, y, z}, ends[3] = {row, p.size[1], p.size[0]};
  int c[3] = {x, y, z};
  for (int step = 0; step < p.steps; ++step) {
    for (int a = 0; a < 3; ++a)
      if (c[a] < 1 || c[a] > ends[a] - 2 || c[a] - start[a] > p.radius || start[a] - c[a] > p.radius) return;
    T const* const center = volume + int64_t(c[2]) * plane + c[1] * row + c[0];
    Quadratic<F> const q([&](int dx, int dy, int dz) { return F(read(center[dz * plane + dy * row + dx])); });
    if (!q.solved) return;
    bool moved = false;
    int next[3];
    for (int a = 0; a < 3; ++a) {
      int const by = a == 2 && !p.along_scale ? 0 : (q.shift[a] > p.largest_shift) - (q.shift[a] < -p.largest_shift);
      next[a] = c[a] + by;
      moved = moved || by != 0;
    }
    if (!moved) {
      for (int a = 0; a < 3; ++a)
        if (!(q.shift[a] <= F(1.5) && q.shift[a] >= F(-1.5))) return;
      use(c, q);
      return;
    }
    for (int a = 0; a < 3; ++a) c[a] = next[a];
  }
}

// Whether a voxel is above its 26 neighbors.
template <class T, class Read>
KV_HD bool is_peak(T const* volume, int const (&size)[3], int z, int y, int x, Read read) {
  if (z < 1 || z > size[0] - 2 || y < 1 || y > size[1] - 2 || x < 1 || x > size[2] - 2) return false;
  int const plane = size[1] * size[2], row = size[2];
  T const* const at = volume + int64_t(z) * plane + y * row + x;
  auto const v = read(*at);
  for (int k = -1; k <= 1; ++k)
    for (int j = -1; j <= 1; ++j)
      for (int i = -1; i <= 1; ++i)
        if ((i != 0 || j != 0 || k != 0) && !(v > read(at[k * plane + j * row + i]))) return false;
  return true;
}

}  // namespace kv::geometry
