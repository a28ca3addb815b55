// What the functions of all modules share: sizes, choices, numbers that may be tensors, and checks.
#pragma once

#include <ATen/Functions.h>
#include <ATen/TensorOperators.h>
#include <torch/arg.h>
#include <torch/expanding_array.h>

#include <cmath>
#include <optional>
#include <string>
#include <tuple>
#include <vector>

#include "kvision/numbers.h"
#include "kvision/ops/operator.h"

namespace kvision {

// (y, x) and (z, y, x): one number for all axes, or a list.
using Size2d = torch::ExpandingArray<2>;
using Size3d = torch::ExpandingArray<3>;
using Pair = torch::ExpandingArray<2, double>;

enum class Padding { same, valid };
enum class PaddingMode { zeros, border, reflection, fill };
enum class Reduction { none, mean, sum };

// A number for all images, or a tensor of one for each, which may have a gradient.
struct Parameter {
  Parameter(double number) : number(number) {}
  Parameter(Tensor tensor) : tensor(std::move(tensor)) {}
  std::optional<Tensor> tensor;
  double number = 0;
};

// Standard deviations along y and x: a number, {y, x}, or a tensor (B or 1, 2).
struct Sigma {
  Sigma(double both) : y(both), x(both) {}
  Sigma(double y, double x) : y(y), x(x) {}
  Sigma(Tensor tensor) : tensor(std::move(tensor)) {}
  std::optional<Tensor> tensor;
  double y = 0, x = 0;
};

namespace detail {

// The index of a name, which is its number in operators.
template <size_t N>
int64_t index_of(char const* op, char const* argument, std::string const& name, char const* const (&names)[N]) {
  for (size_t i = 0; i < N; ++i)
    if (name == names[i]) return int64_t(i);
  TORCH_CHECK_VALUE(false, op, ": there is no ", argument, " '", name, "'");
}
// A padding as operators take it: zeros are a fill, of 0.
inline int64_t padding_number(PaddingMode x) { return x == PaddingMode::fill ? 0 : int64_t(x); }

// The type that an image is computed in, which matrices, sigmas and weights of it have.
inline at::ScalarType computed_type(Tensor const& image) {
  return image.scalar_type() == at::kDouble ? at::kDouble : at::kFloat;
}
inline Tensor computed(Tensor const& x, Tensor const& image) { return x.to(computed_type(image)); }
inline std::optional<Tensor> computed(std::optional<Tensor> const& x, Tensor const& image) {
  return x ? std::optional(computed(*x, image)) : std::nullopt;
}

inline Tensor floats(Tensor const& x) { return x.is_floating_point() ? x : x.to(at::kFloat); }
// Of operators that have kernels for bytes.
inline Tensor floats_or_bytes(Tensor const& x) { return x.scalar_type() == at::kByte ? x : floats(x); }

// Checks of shapes; they give the tensor back.
inline Tensor const& shaped(char const* op, char const* name, Tensor const& x, int64_t axes, char const* shape) {
  TORCH_CHECK_VALUE(x.dim() == axes, op, ": expected ", name, " of shape ", shape, ", got ", x.sizes());
  return x;
}
inline Tensor const& images(char const* op, char const* name, Tensor const& x) {
  return shaped(op, name, x, 4, "(B, C, H, W)");
}
inline Tensor const& volumes(char const* op, char const* name, Tensor const& x) {
  return shaped(op, name, x, 5, "(B, C, D, H, W)");
}
inline Tensor const& colors(char const* op, char const* name, Tensor const& x) {
  TORCH_CHECK_VALUE(x.dim() == 4 && x.size(1) == 3, op, ": expected ", name, " of shape (B, 3, H, W), got ", x.sizes());
  return x;
}
inline void same_shape(char const* op, char const* name, Tensor const& x, Tensor const& like) {
  TORCH_CHECK_VALUE(x.sizes() == like.sizes(), op, ": expected ", name, " of shape ", like.sizes(), ", got ",
                    x.sizes());
}

inline Tensor reduced(Tensor const& x, Reduction reduction) {
  return reduction == Reduction::mean ? x.mean() : reduction == Reduction::sum ? x.sum() : x;
}
// What terms are multiplied by before they are summed.
inline double mean_factor(Reduction reduction, int64_t count) {
  return reduction == Reduction::mean ? 1.0 / count : 1.0;
}

inline std::vector<int64_t> list(at::IntArrayRef x) { return x.vec(); }
inline std::vector<int64_t> image_size(Tensor const& x) { return x.sizes().slice(2).vec(); }

}  // namespace detail
}  // namespace kvision
