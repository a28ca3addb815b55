// Formulas: small matrices and vectors of a sample, as what others of it give, all of a batch in one launch, in double.
//
// A formula is a struct that says how many numbers go in and come out, and computes them on any value type:
//
//   struct Cross {
//     static constexpr int kInputs = 2, kRequired = 2;    // tensors; those that are always given come first
//     static constexpr int kNumbers = 6, kOutputs = 3;    // of a sample, in and out
//     static constexpr int kPlain = 0, kCut = 0;          // plain arguments; 1 if the result's rows are one, too
//     static constexpr Extent extent(int i) { return {3}; }    // of each tensor, behind the batch
//     static constexpr Extent result = {3};
//     template <class V>
//     static KV_HD void of(V const* x, V* y, Settings const&);    // x: all inputs, one after another
//   };
//
// Its gradient is the formula on Duals (core/dual.h); one of many numbers may have a `pull` beside it, which makes that
// to x of the gradient to y: Duals take it as many times as it has numbers. An input may have one row for all samples,
// or not be given: then `missing` says what its numbers are. formulas.h has the formulas and the list of the operators
// they become.
#pragma once

#include "core/dtype.h"
#include "core/dual.h"
#include "core/isa.h"

namespace kv {

// The axes of a sample's input or result: none for a number, one for a vector, two for a matrix.
struct Extent {
  int rows = 0, columns = 0;
  constexpr int count() const { return (rows ? rows : 1) * (columns ? columns : 1); }
};

// Floating-point numbers of any type, read and written as double.
struct Numbers {
  void const* data = nullptr;
  DType type = DType::float32;
};

// What a formula is told besides its inputs.
struct Settings {
  double tiny, eps;  // of the type that the inputs would be computed in: float32, or float64 for that
  double number[4];  // the plain arguments of its operator
};

// The matrix of a warp that a formula makes of its first inputs, given as in Formulas, by the kernel that warps. Only
// CUDA's do: formulas.h lists the formulas they know, matrix_formula.cuh has the code.
enum class MatrixBy : int;  // 0 for a matrix that is given
struct MatrixFormula {
  static constexpr int kInputs = 6;
  MatrixBy by{};
  Numbers inputs[kInputs];  // of the type that computes
  int64_t strides[kInputs];
  Settings settings;
};

template <class F>
struct Formulas {
  Numbers inputs[F::kInputs];
  int64_t strides[F::kInputs];  // from a sample to the next, 0 where one serves all
  int64_t batch;
  Settings settings;
  int outputs;     // how many numbers of the result are wanted: fewer for the first rows of a matrix
  Numbers result;  // (B, outputs)
  // For the gradient only: that to the result, and that to all numbers that are given, one after another.
  Numbers grad, slopes;  // (B, outputs), (B, n)
  uint64_t given;        // a bit for each number
};

KV_KERNEL(formula, Formulas)
KV_KERNEL(formula_backward, Formulas)

template <class F, class V>
concept HasPull = requires(V* v, Settings const& s) { F::pull(v, v, v, s); };

// Where the numbers of input i begin among all.
template <class F>
constexpr int offset_of(int i) {
  int sum = 0;
  for (int k = 0; k < i; ++k) sum += F::extent(k).count();
  return sum;
}

// How many directions are followed at once: not many, as each takes a register more for every number.
template <class F>
constexpr int kDirections = F::kNumbers <= 4       ? F::kNumbers
                            : F::kNumbers >= 16    ? 2
                            : F::kNumbers % 3 == 0 ? 3
                                                   : 2;

// `At` is a sample, or some of them side by side, whose numbers are At::Value: it reads and writes rows. `p` has inputs
// and strides, those of the first inputs or of all.
template <class F, int I = 0, class P, class At>
KV_HD void read_inputs(P const& p, At const& at, typename At::Value* x) {
  using V = typename At::Value;
  if constexpr (I < F::kInputs) {
    constexpr int first = offset_of<F>(I), count = F::extent(I).count(), known = sizeof(P::inputs) / sizeof(Numbers);
    bool is_given = true;
    if constexpr (I >= F::kRequired) {
      if constexpr (I < known)
        is_given = p.inputs[I].data;
      else
        is_given = false;
      if (!is_given)
#pragma unroll
        for (int i = first; i < first + count; ++i) x[i] = V{} + F::missing(i, p.settings);
    }
    if constexpr (I < known)
      if (is_given) at.template read<count>(p.inputs[I], p.strides[I], x + first);
    read_inputs<F, I + 1>(p, at, x);
  }
}

template <class F, class At>
KV_HD void formula_of(Formulas<F> const& p, At const& at) {
  typename At::Value x[F::kNumbers], y[F::kOutputs];
  read_inputs<F>(p, at, x);
  F::of(x, y, p.settings);
  at.template write<F::kOutputs>(p.result, p.outputs, y);
}

template <class F, class At>
KV_HD void formula_vjp(Formulas<F> const& p, At const& at) {
  using V = typename At::Value;
  constexpr int directions = kDirections<F>;
  V x[F::kNumbers], g[F::kOutputs];
  read_inputs<F>(p, at, x);
  at.template read_some<F::kOutputs>(p.grad, p.outputs, g);
  int64_t const width = __builtin_popcountll(p.given);
  int column = 0;
  if constexpr (HasPull<F, V>) {
    V to[F::kNumbers];
    F::pull(x, g, to, p.settings);
#pragma unroll
    for (int i = 0; i < F::kNumbers; ++i)
      if (p.given >> i & 1) at.write_one(p.slopes, width, column++, to[i]);
  } else {
#pragma unroll 1
    for (int first = 0; first < F::kNumbers; first += directions) {
      unsigned const given = unsigned(p.given >> first) & ((1u << directions) - 1);
      if (!given) continue;
      Dual<V, directions> along[F::kNumbers], y[F::kOutputs];
#pragma unroll
      for (int i = 0; i < F::kNumbers; ++i) {
        along[i].value = x[i];
#pragma unroll
        for (int k = 0; k < directions; ++k) along[i].d[k] = V{} + double(i == first + k);
      }
      F::of(along, y, p.settings);
#pragma unroll
      for (int k = 0; k < directions; ++k) {
        if (!(given >> k & 1)) continue;
        V sum = {};
#pragma unroll
        for (int i = 0; i < F::kOutputs; ++i) sum = sum + g[i] * y[i].d[k];
        at.write_one(p.slopes, width, column++, sum);
      }
    }
  }
}

}  // namespace kv
