// Chains of transforms for the entries of operators.
#pragma once

#include <span>

#include "augmentation/transforms.h"
#include "glue/glue.h"

namespace kv::augmentation {

// The plan has for each transform its kind and the columns of its inputs.
template <class T>
TransformMatrix<T> transform_params(char const* op, Tensor const& columns, std::span<int64_t const> plan,
                                    std::span<double const> numbers) {
  TransformMatrix<T> p;
  p.parameters = data_ptr<T const>(columns);
  p.stride = columns.stride(0);
  p.column_stride = columns.stride(1);
  p.batch = columns.size(0);
  p.columns = int(columns.size(1));
  p.count = 0;
  size_t number = 0;
  for (size_t at = 0; at < plan.size(); ++p.count) {
    KV_CHECK(p.count < kMaxTransforms, op, ": expected at most ", kMaxTransforms, " transforms");
    int64_t const kind = plan[at++];
    KV_CHECK(kind >= 0 && kind < kTransformKinds, op, ": there is no kind of transform ", kind);
    p.kinds[p.count] = TransformKind(kind);
    size_t const count = size_t(num_inputs_of(TransformKind(kind)));
    KV_CHECK(at + count <= plan.size() && number + count <= kMaxTransformNumbers, op, ": expected ", count,
             " columns of inputs, and at most ", kMaxTransformNumbers, " in all");
    for (size_t i = 0; i < count; ++i, ++at, ++number) {
      KV_CHECK(plan[at] >= -1 && plan[at] < p.columns, op, ": there is no column ", plan[at]);
      p.indices[number] = int16_t(plan[at]);
    }
  }
  KV_CHECK(numbers.size() == number, op, ": expected ", number, " numbers, got ", numbers.size());
  for (size_t i = 0; i < number; ++i) p.numbers[i] = numbers[i];
  return p;
}

// The count of numbers that a chain of transforms takes.
inline size_t count_inputs(char const* op, std::span<int64_t const> plan) {
  size_t count = 0;
  for (size_t at = 0; at < plan.size();) {
    KV_CHECK(plan[at] >= 0 && plan[at] < kTransformKinds, op, ": there is no kind of transform ", plan[at]);
    size_t const inputs = size_t(num_inputs_of(TransformKind(plan[at])));
    count += inputs;
    at += 1 + inputs;
  }
  return count;
}

// Whether the matrices of a checked plan keep rows rows, whatever the columns are: those of crops, flips and resizing.
inline bool keeps_rows(std::span<int64_t const> plan, std::span<double const> numbers) {
  // The angle and the shears, and the entries of a matrix that are neither scales nor translations.
  constexpr size_t of_affine[] = {0, 5, 6}, of_matrix[] = {1, 3, 6, 7};
  for (size_t at = 0, number = 0; at < plan.size();) {
    TransformKind const kind = TransformKind(plan[at++]);
    std::span<size_t const> zeros;
    if (kind == TransformKind::perspective) return false;
    if (kind == TransformKind::affine) zeros = of_affine;
    if (kind == TransformKind::matrix) zeros = of_matrix;
    for (size_t const i : zeros)
      if (plan[at + i] >= 0 || numbers[number + i] != 0) return false;
    size_t const count = size_t(num_inputs_of(kind));
    at += count;
    number += count;
  }
  return true;
}

inline void check_columns(char const* op, Tensor const& columns) {
  KV_CHECK(columns.dim() == 2 && columns.size(1) <= INT16_MAX, op, ": expected columns of shape (B, P)");
}

// The matrices (B, 3, 3) of a chain.
inline Tensor chain_matrix(char const* op, Tensor const& columns, std::span<int64_t const> plan,
                           std::span<double const> numbers) {
  check_columns(op, columns);
  Tensor const result = empty({columns.size(0), 3, 3}, columns);
  dispatch_floating(op, columns, [&]<class T>(Type<T>) {
    auto params = transform_params<T>(op, columns, plan, numbers);
    params.result = data_ptr<T>(result);
    KV_RUN(transform_matrix, columns, params, params.batch, 64 * params.count);
  });
  return result;
}

}  // namespace kv::augmentation
