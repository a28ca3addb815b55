// Warps of volumes by a matrix: trilinear or nearest, with the rules of sampling.h along each of the three axes, and
// 0 around the volume for the fill. Coordinates and matrices are (x, y, z).
#pragma once

#include "geometry/transform/sampling.h"

namespace kv::geometry {

struct Size3 {
  int64_t depth, height, width;
  KV_HD int64_t along(int axis) const { return axis == 0 ? width : axis == 1 ? height : depth; }
};

// The meaning of a caller's matrix, as MatrixUse.
struct MatrixUse3 {
  int rows;  // 4, or 3 for an affine one
  bool inverse, normalized, align_corners;
  Size3 source, output;
};

// The parameters of all three kernels, of dense volumes (B, C, D, H, W). `x` has the size of the source, `y` that of
// the output; which of them is read and which is written differs.
template <class T>
struct Warp3d {
  Interpolation interpolation;
  Padding padding;
  Compute<T> const* matrices;
  int64_t matrix_stride;  // 0 where one serves the batch
  MatrixUse3 use;
  T *x, *y;
  int64_t batch, channels;
  double* sums;                // of the gradient to the matrices: 16 for each of `parts` of a sample
  int64_t parts, part_voxels;  // CUDA: a block takes a part, of at most `part_voxels` voxels

  KV_HD int64_t source_voxels() const { return use.source.depth * use.source.height * use.source.width; }
  KV_HD int64_t output_voxels() const { return use.output.depth * use.output.height * use.output.width; }
  KV_HD Axis<Compute<T>> axis(int i) const { return {int(use.source.along(i)), padding, use.align_corners}; }
};

// The value; in the compute type, the gradient of the volume and the partial sums of the gradient of the matrices.
template <class T>
struct Warp3dForward : Warp3d<T> {
  MatrixFormula formula{};
};
template <class T>
struct Warp3dVolumeBackward : Warp3d<T> {};
template <class T>
struct Warp3dCoordsBackward : Warp3d<T> {};

// Adds up the parts and computes the gradients of the matrices from them.
template <class T>
struct Warp3dMatrixBackward : Warp3d<T> {
  T* grad;  // (B, rows, 4)
};

KV_KERNEL(warp3d, Warp3dForward)
KV_KERNEL(warp3d_volume_backward, Warp3dVolumeBackward)
KV_KERNEL(warp3d_coords_backward, Warp3dCoordsBackward)
KV_KERNEL(warp3d_matrix_backward, Warp3dMatrixBackward)

// --- the map ---------------------------------------------------------------------------------------------------------

namespace matrix {

// By the determinants of pairs of rows: Laplace's expansion along the first two.
KV_HD void invert4(double const* m, double* inverse) {
  double s[6], c[6];
  constexpr int pairs[6][2] = {{0, 1}, {0, 2}, {0, 3}, {1, 2}, {1, 3}, {2, 3}};
  for (int k = 0; k < 6; ++k) {
    int const i = pairs[k][0], j = pairs[k][1];
    s[k] = m[i] * m[4 + j] - m[4 + i] * m[j];
    c[k] = m[8 + i] * m[12 + j] - m[12 + i] * m[8 + j];
  }
  double const scale = 1 / (s[0] * c[5] - s[1] * c[4] + s[2] * c[3] + s[3] * c[2] - s[4] * c[1] + s[5] * c[0]);
  double const cofactors[16] = {m[5] * c[5] - m[6] * c[4] + m[7] * c[3],     -m[1] * c[5] + m[2] * c[4] - m[3] * c[3],
                                m[13] * s[5] - m[14] * s[4] + m[15] * s[3],  -m[9] * s[5] + m[10] * s[4] - m[11] * s[3],
                                -m[4] * c[5] + m[6] * c[2] - m[7] * c[1],    m[0] * c[5] - m[2] * c[2] + m[3] * c[1],
                                -m[12] * s[5] + m[14] * s[2] - m[15] * s[1], m[8] * s[5] - m[10] * s[2] + m[11] * s[1],
                                m[4] * c[4] - m[5] * c[2] + m[7] * c[0],     -m[0] * c[4] + m[1] * c[2] - m[3] * c[0],
                                m[12] * s[4] - m[13] * s[2] + m[15] * s[0],  -m[8] * s[4] + m[9] * s[2] - m[11] * s[0],
                                -m[4] * c[3] + m[5] * c[1] - m[6] * c[0],    m[0] * c[3] - m[1] * c[1] + m[2] * c[0],
                                -m[12] * s[3] + m[13] * s[1] - m[14] * s[0], m[8] * s[3] - m[9] * s[1] + m[10] * s[0]};
  for (int i = 0; i < 16; ++i) inverse[i] = cofactors[i] * scale;
}

// The gradient of m from that of its inverse: -inverse^T g inverse^T.
KV_HD void invert4_vjp(double const* inverse, double const* g, double* grad) {
  double product[16];
  for (int i = 0; i < 4; ++i)
    for (int k = 0; k < 4; ++k) {
      double sum = 0;
      for (int e = 0; e < 4; ++e) sum += inverse[4 * e + i] * g[4 * e + k];
      product[4 * i + k] = sum;
    }
  for (int i = 0; i < 4; ++i)
    for (int k = 0; k < 4; ++k) {
      double sum = 0;
      for (int e = 0; e < 4; ++e) sum += product[4 * i + e] * inverse[4 * k + e];
      grad[4 * i + k] = -sum;
    }
}

// m, from [-1, 1] to [-1, 1], as a map from voxels to voxels, and back with gradients.
KV_HD void to_voxels(double* m, MatrixUse3 const& use) {
  for (int i = 0; i < 3; ++i) {
    Unit const from(use.output.along(i), use.align_corners);
    for (int row = 0; row < 16; row += 4) {
      m[row + i] = from.scale > 0 ? m[row + i] / from.scale : 0;  // the only voxel of an axis is at 0
      m[row + 3] -= m[row + i] * from.offset;
    }
  }
  for (int i = 0; i < 3; ++i) {
    Unit const to(use.source.along(i), use.align_corners);
    for (int k = 0; k < 4; ++k) m[4 * i + k] = m[4 * i + k] * to.scale + m[12 + k] * to.offset;
  }
}
KV_HD void to_voxels_vjp(double* g, MatrixUse3 const& use) {
  for (int i = 0; i < 3; ++i) {
    Unit const to(use.source.along(i), use.align_corners);
    for (int k = 0; k < 4; ++k) {
      g[12 + k] += g[4 * i + k] * to.offset;
      g[4 * i + k] *= to.scale;
    }
  }
  for (int i = 0; i < 3; ++i) {
    Unit const from(use.output.along(i), use.align_corners);
    for (int row = 0; row < 16; row += 4) {
      g[row + i] -= g[row + 3] * from.offset;
      g[row + i] = from.scale > 0 ? g[row + i] / from.scale : 0;
    }
  }
}

}  // namespace matrix

// (x, y, z, 1) goes to m (x, y, z, 1), divided by its last number.
template <class F>
struct Homography3 {
  F m[16];

  KV_HD F row(int i, F x, F y, F z) const {
    return x * m[4 * i] + (y * m[4 * i + 1] + (z * m[4 * i + 2] + m[4 * i + 3]));
  }
  // The coordinates, and their divisor.
  KV_HD F apply(F x, F y, F z, F (&coords)[3]) const {
    F const weight = row(3, x, y, z);
    for (int i = 0; i < 3; ++i) coords[i] = row(i, x, y, z) / weight;
    return weight;
  }
};

namespace matrix {

template <class F>
KV_HD void load4(F const* entries, int rows, double* m) {
  for (int i = 0; i < 16; ++i) m[i] = i < 4 * rows ? double(entries[i]) : i == 15;
}

}  // namespace matrix

// From voxels of the output to voxels of the source.
template <class F>
KV_HD Homography3<F> homography3(F const* entries, MatrixUse3 const& use) {
  double m[16], inverse[16];
  matrix::load4(entries, use.rows, m);
  if (use.inverse) {
    matrix::invert4(m, inverse);
    for (int i = 0; i < 16; ++i) m[i] = inverse[i];
  }
  if (use.normalized) matrix::to_voxels(m, use);
  Homography3<F> h;
  for (int i = 0; i < 16; ++i) h.m[i] = F(m[i]);
  return h;
}

template <class F>
KV_HD void homography3_vjp(F const* entries, MatrixUse3 const& use, double* g, F* grad) {
  double m[16], inverse[16], grad_matrix[16];
  matrix::load4(entries, use.rows, m);
  if (use.normalized) matrix::to_voxels_vjp(g, use);
  if (use.inverse) {
    matrix::invert4(m, inverse);
    matrix::invert4_vjp(inverse, g, grad_matrix);
    g = grad_matrix;
  }
  for (int i = 0; i < 4 * use.rows; ++i) grad[i] = F(g[i]);
}

// Adds the contribution of an output voxel, whose coordinates have the gradient `grad_coords`, to the sums of its
// matrix.
template <class F, class Sum>
KV_HD void accumulate_matrix_grad3(F const (&grad_coords)[3], F const (&coords)[3], F weight, F x, F y, F z,
                                   Sum* sums) {
  F const at[] = {x, y, z, F(1)};
  F grad_rows[4] = {};
  for (int i = 0; i < 3; ++i) {
    grad_rows[i] = grad_coords[i] / weight;
    grad_rows[3] -= grad_rows[i] * coords[i];
  }
  for (int i = 0; i < 4; ++i) {
    F const g = grad_rows[i] - grad_rows[i] == 0 ? grad_rows[i] : F(0);  // coordinates at infinity have no gradient
    for (int k = 0; k < 4; ++k) sums[4 * i + k] += Sum(g * at[k]);
  }
}

}  // namespace kv::geometry
