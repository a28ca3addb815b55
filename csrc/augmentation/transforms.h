// The matrix of a chain of geometric transforms, from columns of parameters; transforms.py of kvision.augmentation says
// what the inputs of each kind are. The gradient evaluates the chain on Duals, a column at a time.
#pragma once

#include "core/isa.h"
#include "geometry/transform/matrices.h"

namespace kv::augmentation {

enum class TransformKind : uint8_t { affine, perspective, crop, matrix };
constexpr int kTransformKinds = 4;
constexpr int kAffineInputs = 9, kPerspectiveInputs = 16, kCropInputs = 7, kMatrixInputs = 9;
KV_HD constexpr int num_inputs_of(TransformKind kind) {
  return kind == TransformKind::perspective ? kPerspectiveInputs
         : kind == TransformKind::crop      ? kCropInputs
         : kind == TransformKind::affine    ? kAffineInputs
                                            : kMatrixInputs;
}
constexpr int kMaxInputs = 16, kMaxTransforms = 16;  // of a transform, of a chain
constexpr int kMaxTransformNumbers = kMaxInputs * kMaxTransforms;

template <class T>
struct TransformMatrix {
  T const* parameters;  // (B, columns), of these strides
  int64_t stride, column_stride, batch;
  int columns, count;
  TransformKind kinds[kMaxTransforms];
  int16_t indices[kMaxTransformNumbers];  // of the column of each input, -1 for the number at its position
  double numbers[kMaxTransformNumbers];
  T* result;           // (B, 3, 3)
  T const* grad;       // for the gradient only: (B, 3, 3)
  T* grad_parameters;  // (B, columns)
};

KV_KERNEL(transform_matrix, TransformMatrix)
KV_KERNEL(transform_matrix_backward, TransformMatrix)

// Replaces the side of a single pixel, which is 0, so that the matrix has an inverse.
constexpr double kMinSide = 0x1p-20;

// Inputs: a box x, y, width, height; columns and rows of the result; 1 if the centers of the outermost pixels
// correspond, 0 if their edges do.
template <class V>
KV_HD void crop_matrix(V const* x, V* m) {
  for (int i = 0; i < 9; ++i) m[i] = constant<V>(i == 8);
  auto const centers = x[6] > 0.;
  V const min_side = constant<V>(kMinSide), half = select(centers, constant<V>(0), constant<V>(.5));
  for (int i = 0; i < 2; ++i) {
    V const &first = x[i], &size = x[2 + i], &result = x[4 + i];
    V const to = select(result - 1. < kMinSide, min_side, result - 1.),
            from = select(size - 1. < kMinSide, min_side, size - 1.);
    V const scale = select(centers, to / from, result / size);
    m[4 * i] = scale;
    m[3 * i + 2] = (half - first) * scale - half;
  }
}

// Sets the value of `a`, and keeps its derivatives.
template <class M, class V>
KV_HD void set_value_where(M mask, V& a, double x) {
  if constexpr (kIsDual<V>)
    set_value_where(mask, a.value, x);
  else
    a = select(mask, constant<V>(x), a);
}

// Inputs: four source points, four destination points. Exactly the identity where they are the same, and where a side
// of the source is a single pixel: no matrix takes points that lie on one another apart.
template <class V>
KV_HD void perspective_matrix(V const* points, V* m) {
  auto const no_side =
      ((points[0] == points[2]) & (points[1] == points[3])) | ((points[2] == points[4]) & (points[3] == points[5]));
  constexpr int square[] = {0, 0, 1, 0, 1, 1, 0, 1};
  V x[kPerspectiveInputs];
  for (int i = 0; i < kPerspectiveInputs; ++i) x[i] = select(no_side, constant<V>(square[i % 8]), points[i]);
  geometry::PerspectiveMatrix::evaluate(x, m, geometry::FormulaOptions{});
  auto same = x[0] == x[8];
  for (int i = 1; i < 8; ++i) same = same & (x[i] == x[8 + i]);
  for (int i = 0; i < 9; ++i) set_value_where(same, m[i], i % 4 == 0);
}

// The product of a chain, of which the first transform is applied first. read(column, number) gives an input.
template <class V, class T, class Read>
KV_HD void evaluate_chain(TransformMatrix<T> const& p, V* m, Read const& read) {
  for (int i = 0; i < 9; ++i) m[i] = constant<V>(i % 4 == 0);
#pragma unroll 1
  for (int k = 0, input = 0; k < p.count; ++k) {
    int const num_inputs = num_inputs_of(p.kinds[k]);
    V x[kMaxInputs], next[9], product[9];
    for (int i = 0; i < kMaxInputs; ++i)
      x[i] = i < num_inputs ? read(p.indices[input + i], p.numbers[input + i]) : constant<V>(0);
    input += num_inputs;
    switch (p.kinds[k]) {
      case TransformKind::affine:
        for (int i = 5; i < 7; ++i) x[i] = x[i] * 0.017453292519943295769;  // AffineMatrix2d takes shears in radians
        geometry::AffineMatrix2d::evaluate(x, next, geometry::FormulaOptions{0, 0, {1, 0, 0, 0}});
        break;
      case TransformKind::perspective:
        perspective_matrix(x, next);
        break;
      case TransformKind::crop:
        crop_matrix(x, next);
        break;
      case TransformKind::matrix:
        for (int i = 0; i < 9; ++i) next[i] = x[i];
        break;
    }
    multiply3(next, m, product);
    for (int i = 0; i < 9; ++i) m[i] = k ? product[i] : next[i];
  }
  for (int i = 0; i < 9; ++i) m[i] = m[i] + 0.;  // no negative zeros
}

}  // namespace kv::augmentation
