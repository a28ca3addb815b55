// Arguments of formulas, checked.
#pragma once

#include <span>

#include "geometry/formulas.h"
#include "glue/glue.h"

namespace kv::geometry {

inline TypedPointer typed_pointer(char const* op, Tensor const& x) {
  DType const dtype = dtype_of(op, x);
  KV_CHECK(dtype != DType::uint8, op, ": no kernel for this dtype");
  return {x.const_data_ptr(), dtype};
}

inline bool has_extent(Tensor const& x, Extent extent) {
  int const axes = (extent.rows > 0) + (extent.columns > 0);
  return x.dim() == 1 + axes && (axes < 1 || x.size(1) == extent.rows) && (axes < 2 || x.size(2) == extent.columns);
}

// Whether the numbers of a sample are contiguous.
inline bool is_contiguous_row(Tensor const& x) {
  int64_t step = 1;
  for (int64_t axis = x.dim() - 1; axis > 0; step *= x.size(axis--))
    if (x.stride(axis) != step) return false;
  return true;
}

inline std::string extent_text(Extent extent) {
  std::string text = "(B";
  for (auto const number : {extent.rows, extent.columns})
    if (number) {
      text += ", ";
      text += std::to_string(number);
    }
  return text + ")";
}

// The inputs of formula F, checked: of type `type`, on the device of `like`. An input of one row serves the whole
// batch.
template <class F>
struct FormulaArguments {
  FormulaParams<F> params{};
  std::optional<Tensor> contiguous[F::kInputs];
  ScalarType type;

  FormulaArguments(char const* op, Tensor const& like, ScalarType type, std::span<std::optional<Tensor> const> inputs,
                   std::span<double const> scalars, int64_t rows)
      : type(type) {
    bool const is_double = type == ScalarType::Double;
    params.options = {is_double ? 0x1p-1022 : 0x1p-126, is_double ? 0x1p-52 : 0x1p-23, {}};
    params.batch = 1;
    KV_CHECK(scalars.size() == F::kScalars, op, ": expected ", F::kScalars, " scalars, got ", scalars.size());
    std::copy(scalars.begin(), scalars.end(), params.options.scalars);
    constexpr int columns = F::result.columns ? F::result.columns : F::result.count();
    KV_CHECK(F::kOptionalLastRow ? rows > 0 && rows <= F::result.rows : rows == 0, op, ": expected rows from 1 to ",
             F::result.rows);
    params.output_size = F::kOptionalLastRow ? int(rows) * columns : F::result.count();
    for (int i = 0; i < int(inputs.size()); ++i) {
      KV_CHECK(inputs[i] ? i < F::kInputs : i >= F::kRequired, op, ": expected ", F::kRequired, " to ", F::kInputs,
               " tensors");
      if (inputs[i]) add_input(op, i, *inputs[i], like);
    }
  }

  // The axes of a result without the batch.
  Extent extent() const {
    return {F::kOptionalLastRow ? params.output_size / F::result.columns : F::result.rows, F::result.columns};
  }

  Tensor result(char const* op, Tensor const& like) {
    int64_t const batch = params.batch;
    Extent const e = extent();
    Tensor const y = e.columns ? empty({batch, e.rows, e.columns}, like, Layout::planar, type)
                               : empty({batch, e.rows}, like, Layout::planar, type);
    params.result = typed_pointer(op, y);
    KV_RUN(formula, y, params, batch, F::kInputSize + 4 * F::kOutputSize);
    return y;
  }

 private:
  void add_input(char const* op, int i, Tensor const& x, Tensor const& like) {
    Extent const extent = F::extent(i);
    KV_CHECK(has_extent(x, extent) && x.scalar_type() == type && x.device() == like.device(), op, ": expected tensor ",
             i + 1, " of shape ", extent_text(extent), ", all of one type and device");
    KV_CHECK(params.batch == 1 || x.size(0) == 1 || x.size(0) == params.batch, op, ": expected tensor ", i + 1,
             " with 1 or ", params.batch, " rows, got ", x.size(0));
    if (x.size(0) != 1) params.batch = x.size(0);
    Tensor const rows = is_contiguous_row(x) ? x : dense(x);
    contiguous[i] = rows;
    params.inputs[i] = typed_pointer(op, rows);
    params.strides[i] = x.size(0) == 1 ? 0 : rows.stride(0);
    params.present |= ((uint64_t(1) << extent.count()) - 1) << input_offset<F>(i);
  }
};

}  // namespace kv::geometry
