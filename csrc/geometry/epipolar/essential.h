// Essential matrices E = [t]x R, by their singular value decomposition E = U diag(s1, s2, s3) V^T with rotations U, V:
//
//   motions   R = U Z V^T for Z = (0, -1, 0), (1, 0, 0), (0, 0, 1) and its transpose, t = u3 of either sign
//   nearest   U diag(s, s, 0) V^T, where s is the mean of s1 and s2
//   choice    the motion with the most points in front of both cameras, and these points
//
// R, the nearest matrix and their gradients do not depend on the choice of singular vectors if s1 = s2. With dU = U X,
// dV = V Y and A = U^T dE V, gradients need only X12 - Y12 = (A12 - A21) / (s1 + s2), X_i3 and Y_i3.
#pragma once

#include "geometry/epipolar/triangulation.h"
#include "geometry/thread_group.h"

namespace kv::geometry {

template <class T>
struct Essential {
  Reals matrix;  // (B, 3, 3)
  int64_t batch;
  bool nearest;                 // whether to compute the nearest essential matrix, else the motions
  Reals rotations, directions;  // (B, 4, 3, 3), (B, 4, 3)
  Reals projected;              // (B, 3, 3)
  Reals grad, grad_directions,
      grad_matrix;  // for the gradient: to rotations or to the nearest matrix, to directions, and to the matrix
};

template <class T>
struct MotionChoice {
  Reals matrix, camera1, camera2;  // (B, 3, 3)
  Reals points1, points2;          // (B, N, 2)
  bool const* mask;                // (B, N), or null
  int64_t batch, count;
  double min_weight;                  // as in triangulation.h
  Reals rotation, direction, points;  // (B, 3, 3), (B, 3), (B, N, 3)
  int64_t *in_front, *motion_index;   // (B): the number of points in front, the index of the motion, 0 to 3
};

KV_KERNEL(essential, Essential)
KV_KERNEL(essential_backward, Essential)
KV_KERNEL(motion_choice, MotionChoice)

namespace small {

// One-sided Jacobi: rotations make the columns orthogonal (M. Hestenes, 1958). The third value is the smallest one, and
// has the sign of the determinant.
struct SingularVectors {
  double u[3][3], v[3][3], s[3];  // vectors as rows

  KV_CALLED void set(double const* e) {
    for (int k = 0; k < 3; ++k)
      for (int i = 0; i < 3; ++i) u[k][i] = e[3 * i + k], v[k][i] = i == k;
    for (int sweep = 0; sweep < 30; ++sweep) {
      bool has_rotated = false;
      for (int p = 0; p < 2; ++p)
        for (int q = p + 1; q < 3; ++q) {
          double const a = dot3(u[p], u[p]), b = dot3(u[q], u[q]), projection = dot3(u[p], u[q]);
          if (!(projection * projection > 1e-31 * a * b)) continue;
          has_rotated = true;
          double const cotangent = (b - a) / (2 * projection);
          double const t = (cotangent < 0 ? -1 : 1) / (magnitude(cotangent) + sqrt(cotangent * cotangent + 1));
          double const c = 1 / sqrt(t * t + 1);
          rotate(u[p], u[q], c, t * c);
          rotate(v[p], v[q], c, t * c);
        }
      if (!has_rotated) break;
    }
    for (int k = 0; k < 3; ++k) s[k] = sqrt(dot3(u[k], u[k]));
    for (int k = 0; k < 2; ++k)
      if (s[k] < s[k + 1]) exchange(k);
    if (s[0] < s[1]) exchange(0);
    for (int k = 0; k < 2; ++k)
      for (double& x : u[k]) x /= s[k];
    if (s[0] == 0) u[0][0] = 1, u[0][1] = u[0][2] = 0;
    if (s[1] <= 1e-15 * s[0]) {  // any direction orthogonal to the first
      int const smallest = magnitude(u[0][0]) < magnitude(u[0][1]) ? 0 : 1;
      double axis[3] = {};
      axis[smallest] = 1;
      cross3(u[0], axis, u[1]);
      double const size = sqrt(dot3(u[1], u[1]));
      for (double& x : u[1]) x /= size;
    }
    double last[3];
    cross3(u[0], u[1], u[2]);
    cross3(v[0], v[1], v[2]);
    for (int i = 0; i < 3; ++i) last[i] = dot3(e + 3 * i, v[2]);
    s[2] = dot3(u[2], last);
  }
  static KV_HD void rotate(double* a, double* b, double c, double sine) {
    for (int i = 0; i < 3; ++i) {
      double const x = a[i], y = b[i];
      a[i] = c * x - sine * y, b[i] = sine * x + c * y;
    }
  }
  KV_HD void exchange(int k) {
    rotate(u[k], u[k + 1], 0, 1);
    rotate(v[k], v[k + 1], 0, 1);
    double const t = s[k];
    s[k] = s[k + 1], s[k + 1] = t;
  }

  // Chooses between t and -t by the convention of null vectors.
  KV_HD double sign() const { return u[2][0] + 0.7 * u[2][1] + 0.7 * 0.7 * u[2][2] < 0 ? -1 : 1; }

  // The rotation for t = u3 (sign 1) or -u3 (sign -1).
  KV_HD void rotation(double sign, double* r) const {
    for (int i = 0; i < 3; ++i)
      for (int k = 0; k < 3; ++k) r[3 * i + k] = sign * (u[1][i] * v[0][k] - u[0][i] * v[1][k]) + u[2][i] * v[2][k];
  }
  // U^T g V.
  KV_HD void to_basis(double const* g, double* h) const {
    for (int k = 0; k < 3; ++k) {
      double gv[3];
      for (int i = 0; i < 3; ++i) gv[i] = dot3(g + 3 * i, v[k]);
      for (int i = 0; i < 3; ++i) h[3 * i + k] = dot3(u[i], gv);
    }
  }
  // The gradient to E, from those to X12 - Y12 (`grad_angle`), to X_i3 and Y_i3 (x, y) and to s1 + s2 (`size`).
  KV_HD void vjp(double grad_angle, double const* x, double const* y, double size, double* grad_matrix) const {
    double const sum = s[0] + s[1], skew = sum > 0 ? grad_angle / sum : 0;
    double a[9] = {size, skew, 0, -skew, size, 0, 0, 0, 0};
    for (int i = 0; i < 2; ++i) {
      double const gap = s[2] * s[2] - s[i] * s[i], inverse = -gap > 1e-13 * s[0] * s[0] ? 1 / gap : 0;
      a[3 * i + 2] = (x[i] * s[2] + y[i] * s[i]) * inverse;
      a[6 + i] = (x[i] * s[i] + y[i] * s[2]) * inverse;
    }
    for (int i = 0; i < 3; ++i)
      for (int k = 0; k < 3; ++k) {
        grad_matrix[3 * i + k] = 0;
        for (int r = 0; r < 3; ++r)
          for (int c = 0; c < 3; ++c) grad_matrix[3 * i + k] += u[r][i] * a[3 * r + c] * v[c][k];
      }
  }
};

KV_HD void read9(Reals const& x, int64_t b, double* m) {
  for (int i = 0; i < 9; ++i) m[i] = x[9 * b + i];
}
KV_HD void write9(Reals const& x, int64_t b, double const* m) {
  for (int i = 0; i < 9; ++i) x.set(9 * b + i, m[i] + 0);  // no negative zeros
}

}  // namespace small

template <class T>
KV_HD void decompose_essential(Essential<T> const& p, int64_t b) {
  small::SingularVectors svd;
  double e[9], m[9];
  small::read9(p.matrix, b, e);
  svd.set(e);
  if (p.nearest) {
    double const size = (svd.s[0] + svd.s[1]) / 2;
    for (int i = 0; i < 9; ++i) m[i] = size * (svd.u[0][i / 3] * svd.v[0][i % 3] + svd.u[1][i / 3] * svd.v[1][i % 3]);
    small::write9(p.projected, b, m);
    return;
  }
  double const sign = svd.sign();
  for (int motion = 0; motion < 4; ++motion) {
    svd.rotation(motion < 2 ? sign : -sign, m);
    small::write9(p.rotations, 4 * b + motion, m);
    for (int i = 0; i < 3; ++i) p.directions.set(3 * (4 * b + motion) + i, (motion % 2 ? -sign : sign) * svd.u[2][i]);
  }
}

template <class T>
KV_HD void essential_vjp(Essential<T> const& p, int64_t b) {
  small::SingularVectors svd;
  double e[9], g[9], h[9], x[2], y[2], grad_matrix[9];
  small::read9(p.matrix, b, e);
  svd.set(e);
  if (p.nearest) {
    small::read9(p.grad, b, g);
    svd.to_basis(g, h);
    double const size = (svd.s[0] + svd.s[1]) / 2;
    for (int i = 0; i < 2; ++i) x[i] = -size * h[6 + i], y[i] = -size * h[3 * i + 2];
    svd.vjp(size * (h[1] - h[3]), x, y, (h[0] + h[4]) / 2, grad_matrix);
  } else {
    double grad_angle = 0;
    x[0] = x[1] = y[0] = y[1] = 0;
    for (int motion = 0; motion < 4; ++motion) {
      double const sign = motion < 2 ? svd.sign() : -svd.sign(), side = motion % 2 ? -svd.sign() : svd.sign();
      double grad_t[3];
      small::read9(p.grad, 4 * b + motion, g);
      for (int i = 0; i < 3; ++i) grad_t[i] = side * p.grad_directions[3 * (4 * b + motion) + i];
      svd.to_basis(g, h);
      grad_angle += sign * (h[0] + h[4]);
      x[0] += h[2] + sign * h[7] + dot3(grad_t, svd.u[0]);
      x[1] += h[5] - sign * h[6] + dot3(grad_t, svd.u[1]);
      y[0] += h[6] - sign * h[5];
      y[1] += h[7] + sign * h[2];
    }
    svd.vjp(grad_angle, x, y, 0, grad_matrix);
  }
  small::write9(p.grad_matrix, b, grad_matrix);
}

template <class T, class Group>
KV_HD void choose_motion(MotionChoice<T> const& p, int64_t b, Group group) {
  small::SingularVectors svd;
  double e[9], k1[9], k2[9], r[4][9], t[4][3], projections[2][12], count[4] = {};
  small::read9(p.matrix, b, e);
  small::read9(p.camera1, b, k1);
  small::read9(p.camera2, b, k2);
  svd.set(e);
  for (int motion = 0; motion < 4; ++motion) {
    svd.rotation(motion < 2 ? svd.sign() : -svd.sign(), r[motion]);
    for (int i = 0; i < 3; ++i) t[motion][i] = (motion % 2 ? -svd.sign() : svd.sign()) * svd.u[2][i];
  }
  for (int i = 0; i < 12; ++i) projections[0][i] = i % 4 == 3 ? 0 : k1[3 * (i / 4) + i % 4];
  auto const set_projection = [&](int motion) KV_INLINE {
    double KR[9];
    multiply3(k2, r[motion], KR);
    for (int i = 0; i < 12; ++i)
      projections[1][i] = i % 4 == 3 ? dot3(k2 + 3 * (i / 4), t[motion]) : KR[3 * (i / 4) + i % 4];
  };
  auto const triangulate_point = [&](int64_t i, double* point) KV_INLINE {
    double pixels[2][2];
    int64_t const at = 2 * (b * p.count + i);
    for (int k = 0; k < 2; ++k) pixels[0][k] = p.points1[at + k], pixels[1][k] = p.points2[at + k];
    small::triangulate(pixels, projections, p.min_weight, point);
  };
  for (int motion = 0; motion < 4; ++motion) {
    set_projection(motion);
    for (int64_t i = group.thread_rank(); i < p.count; i += group.num_threads()) {
      if (p.mask && !p.mask[b * p.count + i]) continue;
      double X[3];
      triangulate_point(i, X);
      count[motion] += X[2] > 0 && dot3(r[motion] + 6, X) + t[motion][2] > 0;
    }
  }
  int best = 0;
  for (int motion = 0; motion < 4; ++motion) {
    count[motion] = group.sum(count[motion]);
    if (count[motion] > count[best]) best = motion;
  }
  set_projection(best);
  for (int64_t i = group.thread_rank(); i < p.count; i += group.num_threads()) {
    double X[3];
    triangulate_point(i, X);
    for (int k = 0; k < 3; ++k) p.points.set(3 * (b * p.count + i) + k, X[k]);
  }
  if (group.thread_rank() != 0) return;
  small::write9(p.rotation, b, r[best]);
  for (int i = 0; i < 3; ++i) p.direction.set(3 * b + i, t[best][i]);
  p.in_front[b] = int64_t(count[best]);
  p.motion_index[b] = best;
}

}  // namespace kv::geometry
