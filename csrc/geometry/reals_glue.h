// Tensors of float32 or float64 as Reals, and constants of models. Included by operators of views, points and splines.
#pragma once

#include "geometry/solvers/minimal.h"
#include "glue/glue.h"

namespace kv::geometry {

inline Reals reals_of(char const* op, Tensor const& x) {
  KV_CHECK(x.scalar_type() == ScalarType::Float || x.scalar_type() == ScalarType::Double, op,
           ": expected float32 or float64");
  return {x.const_data_ptr(), x.scalar_type() == ScalarType::Double};
}

// The Reals of a contiguous tensor; without data for a missing optional tensor.
struct Contiguous {
  Tensor tensor;
  Reals reals = {nullptr, false};
  Contiguous(char const* op, Tensor const& x) : tensor(dense(x)), reals(reals_of(op, tensor)) {}
  Contiguous(char const* op, std::optional<Tensor> const& x) {
    if (x) *this = Contiguous(op, *x);
  }
};

// A homogeneous point is at infinity if its last coordinate is below this fraction of its length.
inline double min_homogeneous_weight(Contiguous const& x) {
  return 1e-13 + 4 * (x.reals.is_double ? 2.220446049250313e-16 : 1.1920928955078125e-07);
}

inline Model parse_model(char const* op, int64_t number) {
  KV_CHECK(number >= int64_t(Model::affine) && number <= int64_t(Model::essential), op,
           ": model must be 0 (affine), 1 (homography), 2 (lines), 3 (fundamental), 4 (fundamental8) or 5 (essential), "
           "got ",
           number);
  return Model(number);
}

}  // namespace kv::geometry
