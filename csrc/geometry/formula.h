// Formulas: small matrices and vectors, computed for every sample of a batch in one launch, in double.
//
// A formula is a struct with the sizes of its inputs and its result, and a function for any value type:
//
//   struct Cross {
//     static constexpr int kInputs = 2, kRequired = 2;          // tensors; the required ones come first
//     static constexpr int kInputSize = 6, kOutputSize = 3;     // numbers of a sample
//     static constexpr int kScalars = 0;                        // scalar arguments
//     static constexpr int kOptionalLastRow = 0;                // 1 if the number of rows is one more scalar argument
//     static constexpr Extent extent(int i) { return {3}; }     // of each tensor, without the batch
//     static constexpr Extent result = {3};
//     template <class V>
//     static KV_HD void evaluate(V const* x, V* y, FormulaOptions const&);  // x: all inputs, one after another
//   };
//
// The gradient evaluates the formula on Duals (core/dual.h), several times if the inputs have many numbers. A formula
// with many inputs may define a `vjp` next to `evaluate` instead. An input may have one row for all samples. An
// optional input may be missing: its numbers are then those of `default_value`. formulas.h lists the formulas and their
// operators.
#pragma once

#include "core/dtype.h"
#include "core/dual.h"
#include "core/isa.h"

namespace kv::geometry {

// The axes of a sample's input or result: none for a number, one for a vector, two for a matrix.
struct Extent {
  int rows = 0, columns = 0;
  constexpr int count() const { return (rows ? rows : 1) * (columns ? columns : 1); }
};

// Floating-point numbers of any type, read and written as double.
struct TypedPointer {
  void const* data = nullptr;
  DType type = DType::float32;
};

// The arguments of a formula that are not tensors.
struct FormulaOptions {
  double min_normal, eps;  // of the type that references compute in: float64 for float64 inputs, else float32
  double scalars[4];       // the scalar arguments of its operator
};

// The matrix of a warp, computed by the kernel of the warp from the first inputs of a formula. Only CUDA kernels do so.
// formulas.h lists the formulas that they support; transform/matrix_formula.cuh has the code.
enum class WarpFormula : int;  // 0 for a matrix that is a tensor
struct MatrixFormula {
  static constexpr int kInputs = 6;
  WarpFormula id{};
  TypedPointer inputs[kInputs];  // of the compute type
  int64_t strides[kInputs];
  FormulaOptions options;
};

template <class F>
struct FormulaParams {
  TypedPointer inputs[F::kInputs];
  int64_t strides[F::kInputs];  // between samples; 0 if all samples share a row
  int64_t batch;
  FormulaOptions options;
  int output_size;      // of a sample; fewer than kOutputSize for the first rows of a matrix
  TypedPointer result;  // (B, output_size)
  // For the gradient only: that to the result, and those to the numbers of all inputs that are present, one after
  // another.
  TypedPointer grad, grad_inputs;  // (B, output_size), (B, n)
  uint64_t present;                // a bit for each number
};

KV_KERNEL(formula, FormulaParams)
KV_KERNEL(formula_backward, FormulaParams)

template <class F, class V>
concept HasVjp = requires(V* v, FormulaOptions const& s) { F::vjp(v, v, v, s); };

// The index of the first number of input i.
template <class F>
constexpr int input_offset(int i) {
  int sum = 0;
  for (int k = 0; k < i; ++k) sum += F::extent(k).count();
  return sum;
}

// Derivatives of one evaluation. Each one takes an additional register for every number.
template <class F>
constexpr int kDirections = F::kInputSize <= 4       ? F::kInputSize
                            : F::kInputSize >= 16    ? 2
                            : F::kInputSize % 3 == 0 ? 3
                                                     : 2;

// Reads the inputs. Row reads and writes the rows of one sample, or of several samples as vectors Row::Value. `p` has
// the inputs and strides of all tensors, or of the first ones.
template <class F, int I = 0, class P, class Row>
KV_HD void read_inputs(P const& p, Row const& row, typename Row::Value* x) {
  using V = typename Row::Value;
  if constexpr (I < F::kInputs) {
    constexpr int first = input_offset<F>(I), count = F::extent(I).count(),
                  num_inputs = sizeof(P::inputs) / sizeof(TypedPointer);
    bool is_present = true;
    if constexpr (I >= F::kRequired) {
      if constexpr (I < num_inputs)
        is_present = p.inputs[I].data;
      else
        is_present = false;
      if (!is_present)
#pragma unroll
        for (int i = first; i < first + count; ++i) x[i] = V{} + F::default_value(i, p.options);
    }
    if constexpr (I < num_inputs)
      if (is_present) row.template read<count>(p.inputs[I], p.strides[I], x + first);
    read_inputs<F, I + 1>(p, row, x);
  }
}

template <class F, class Row>
KV_HD void evaluate_formula(FormulaParams<F> const& p, Row const& row) {
  typename Row::Value x[F::kInputSize], y[F::kOutputSize];
  read_inputs<F>(p, row, x);
  F::evaluate(x, y, p.options);
  row.template write<F::kOutputSize>(p.result, p.output_size, y);
}

template <class F, class Row>
KV_HD void formula_vjp(FormulaParams<F> const& p, Row const& row) {
  using V = typename Row::Value;
  constexpr int directions = kDirections<F>;
  V x[F::kInputSize], g[F::kOutputSize];
  read_inputs<F>(p, row, x);
  row.template read_first<F::kOutputSize>(p.grad, p.output_size, g);
  int64_t const width = __builtin_popcountll(p.present);
  int column = 0;
  if constexpr (HasVjp<F, V>) {
    V grads[F::kInputSize];
    F::vjp(x, g, grads, p.options);
#pragma unroll
    for (int i = 0; i < F::kInputSize; ++i)
      if (p.present >> i & 1) row.write_one(p.grad_inputs, width, column++, grads[i]);
  } else {
#pragma unroll 1
    for (int first = 0; first < F::kInputSize; first += directions) {
      unsigned const active = unsigned(p.present >> first) & ((1u << directions) - 1);
      if (!active) continue;
      Dual<V, directions> duals[F::kInputSize], y[F::kOutputSize];
#pragma unroll
      for (int i = 0; i < F::kInputSize; ++i) {
        duals[i].value = x[i];
#pragma unroll
        for (int k = 0; k < directions; ++k) duals[i].d[k] = V{} + double(i == first + k);
      }
      F::evaluate(duals, y, p.options);
#pragma unroll
      for (int k = 0; k < directions; ++k) {
        if (!(active >> k & 1)) continue;
        V sum = {};
#pragma unroll
        for (int i = 0; i < F::kOutputSize; ++i) sum = sum + g[i] * y[i].d[k];
        row.write_one(p.grad_inputs, width, column++, sum);
      }
    }
  }
}

// --- common input layouts --------------------------------------------------------------------------------------------

// A formula of one vector.
template <int N, int Rows, int Columns = 0>
struct VectorInput {
  static constexpr int kInputs = 1, kRequired = 1, kInputSize = N, kOutputSize = Columns ? Rows * Columns : Rows,
                       kScalars = 0, kOptionalLastRow = 0;
  static constexpr Extent extent(int) { return {N}; }
  static constexpr Extent result = {Rows, Columns};
};

// A formula of N numbers, each a tensor.
template <int N>
struct ScalarInputs {
  static constexpr int kInputs = N, kRequired = N, kInputSize = N, kScalars = 0, kOptionalLastRow = 0;
  static constexpr Extent extent(int) { return {}; }
};

}  // namespace kv::geometry
