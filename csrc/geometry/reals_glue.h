// What the operators of several views share at the door to torch. Included by their *_op.cpp files.
#pragma once

#include "geometry/solvers/minimal.h"
#include "glue/glue.h"

namespace kv {

inline Reals reals_of(char const* op, Tensor const& x) {
  KV_CHECK(x.scalar_type() == ScalarType::Float || x.scalar_type() == ScalarType::Double, op,
           ": expected float32 or float64");
  return {x.const_data_ptr(), x.scalar_type() == ScalarType::Double};
}

// A tensor, or none, as the kernels read it.
struct Contiguous {
  Tensor tensor;
  Reals reals = {nullptr, false};
  Contiguous(char const* op, Tensor const& x) : tensor(dense(x)), reals(reals_of(op, tensor)) {}
  Contiguous(char const* op, std::optional<Tensor> const& x) {
    if (x) *this = Contiguous(op, *x);
  }
};

// Below this share of a homogeneous point's length its last number counts as 0: the point is at infinity.
inline double least_share(Contiguous const& x) {
  return 1e-13 + 4 * (x.reals.wide ? 2.220446049250313e-16 : 1.1920928955078125e-07);
}

inline Model model_of(char const* op, std::string const& name) {
  constexpr char const* names[] = {"affine", "homography", "lines", "fundamental", "fundamental8", "essential"};
  for (int i = 0; i < 6; ++i)
    if (name == names[i]) return Model(i);
  fail(
      {op, ": model must be one of affine, homography, lines, fundamental, fundamental8, essential; got '", name, "'"});
}

}  // namespace kv
