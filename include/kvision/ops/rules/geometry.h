// Gradients of warps, splines, registration and depth that are no single call.
#pragma once

#include <ATen/Functions.h>
#include <ATen/TensorOperators.h>

#include "kvision/numbers.h"
#include "kvision/ops/operator.h"

namespace kvision::ops {

namespace detail {

// Generated.
inline variable_list resize_backward_gradients(Backward const&);
inline variable_list apply_nms_mask_gradients(Backward const&);

}  // namespace detail

namespace detail::rules {

// To the fill of what is outside: the fraction of each pixel that is outside of the image.
template <class Inside>
Tensor to_fill(Backward const& b, Tensor const& fill, Inside const& inside) {
  Tensor const x = b.tensor(0), weights = inside(x.new_ones({1, 1, x.size(2), x.size(3)}));
  return ((1 - weights) * b.grad()).to(fill.scalar_type()).sum({2, 3});
}

inline Tensor cast(Tensor const& x, Tensor const& like) { return x.to(like.scalar_type()); }

template <Name forward, Name to_image, Name to_matrix>
inline constexpr Rule by_matrix{[](Backward const& b) -> variable_list {
  Tensor const fill = b.tensor(2);
  auto const inside = [&](Tensor const& ones) {
    return b.call(forward.text, {{"image", ones}, {"fill", {}}, {"image_index", {}}},
                  by_matrix<forward, to_image, to_matrix>)[0];
  };
  return {b.needs(0) ? b.call(to_image.text, {{"size", b.batch_size()}})[0] : Tensor(),
          b.needs(1) ? b.call(to_matrix.text)[0] : Tensor(), b.needs(2) ? to_fill(b, fill, inside) : Tensor()};
}};
template <Name forward, Name to_image, Name to_maps>
inline constexpr Rule by_maps{[](Backward const& b) -> variable_list {
  variable_list gradients{b.needs(0) ? b.call(to_image.text, {{"size", b.batch_size()}})[0] : Tensor()};
  variable_list const maps = b.needs(1) || b.needs(2) ? b.call(to_maps.text) : variable_list(2);
  gradients.insert(gradients.end(), maps.begin(), maps.end());
  auto const inside = [&](Tensor const& ones) {
    return b.call(forward.text, {{"image", ones}, {"fill", {}}, {"image_index", {}}},
                  by_maps<forward, to_image, to_maps>)[0];
  };
  gradients.push_back(b.needs(3) ? to_fill(b, b.tensor(3), inside) : Tensor());
  return gradients;
}};
inline constexpr Rule warp{by_matrix<"warp", "warp_image_backward", "warp_matrix_backward">};
inline constexpr Rule remap{by_maps<"remap", "remap_image_backward", "remap_map_backward">};
inline constexpr Rule warp_antialiased{
    by_matrix<"warp_antialiased", "warp_antialiased_image_backward", "warp_antialiased_matrix_backward">};
inline constexpr Rule remap_antialiased{
    by_maps<"remap_antialiased", "remap_antialiased_image_backward", "remap_antialiased_map_backward">};

inline constexpr char const* kLinks[] = {"a", "b", "c", "d", "e", "f", "g", "h"};

// The gradients to the links of a chain, arguments `first` and on, from those of the coordinates that they compose to.
inline variable_list link_gradients(Backward const& b, Tensor const& grad, size_t first) {
  Ints needs_grad;
  for (size_t i = 0; i < std::size(kLinks); ++i)
    needs_grad.push_back(b.tensor(first + i).defined() && b.needs(first + i));
  variable_list gradients = b.call("composed_coords_backward", {{"grad", grad}, {"needs_grad", needs_grad}});
  for (size_t i = 0; i < std::size(kLinks); ++i)
    gradients[i] = needs_grad[i] ? at::sum_to(gradients[i], b.tensor(first + i).sizes()) : Tensor();
  return gradients;
}

inline constexpr Rule composed_coords{
    [](Backward const& b) -> variable_list { return link_gradients(b, b.grad().contiguous(), 0); }};
inline constexpr Rule composed_warp{[](Backward const& b) -> variable_list {
  constexpr size_t fill = 1 + std::size(kLinks);
  Tensor const coords = b.call("composed_coords")[0], x = coords.select(1, 0), y = coords.select(1, 1);
  variable_list gradients(fill + 1);
  auto const remap_by = [&](char const* op, std::pair<std::string_view, c10::IValue> const& other) {
    return b.call(op,
                  {{"map_x", x}, {"map_y", y}, {"image_index", {}}, {"normalized", false}, {"moves", false}, other});
  };
  if (b.needs(0)) gradients[0] = remap_by("remap_image_backward", {"size", b.batch_size()})[0];
  bool needs_links = false;
  for (size_t i = 1; i < fill; ++i) needs_links = needs_links || b.needs(i);
  if (needs_links) {
    variable_list const maps = remap_by("remap_map_backward", {"fill", b.optional(fill)});
    variable_list const links = link_gradients(b, at::stack({maps[0], maps[1]}, 1), 1);
    std::copy(links.begin(), links.end(), gradients.begin() + 1);
  }
  if (b.needs(fill)) {
    auto const inside = [&](Tensor const& ones) {
      return b.call("remap", {{"image", ones},
                              {"map_x", x},
                              {"map_y", y},
                              {"fill", {}},
                              {"image_index", {}},
                              {"normalized", false},
                              {"moves", false}})[0];
    };
    gradients[fill] = to_fill(b, b.tensor(fill), inside);
  }
  return gradients;
}};
inline constexpr Rule warp3d{[](Backward const& b) -> variable_list {
  Tensor const x = b.tensor(0), m = b.tensor(1), grad = cast(b.grad(), m);
  return {b.needs(0) ? b.call("warp3d_volume_backward", {{"grad", grad}, {"size", b.image_size()}})[0] : Tensor(),
          b.needs(1) ? b.call("warp3d_matrix_backward", {{"grad", grad}, {"volumes", cast(x, m)}})[0] : Tensor()};
}};

// A warp by the matrix of a formula: the gradients to image and matrix, and from the matrix to the tensors a to f of
// the formula.
template <Name image_gradient, Name matrix_gradient, int64_t rows>
inline constexpr Rule by_formula{[](Backward const& b) -> variable_list {
  auto const& names = b.op.schema().arguments();
  auto const value = [&](std::string_view name) {
    auto const is_it = [&](c10::Argument const& a) { return a.name() == name; };
    return b.arguments[std::find_if(names.begin(), names.end(), is_it) - names.begin()];
  };
  auto const formula = find(kvision::detail::kWarpFormulas[value("formula").toInt()]);
  auto const numbers = value("numbers").toDoubleVector();
  size_t next_tensor = 1, next_number = 0;
  Arguments arguments;
  for (c10::Argument const& argument : formula.schema().arguments()) {
    if (argument.type()->kind() == c10::TypeKind::FloatType)
      arguments.push_back(numbers.at(next_number++));
    else if (argument.type()->kind() == c10::TypeKind::IntType)
      arguments.push_back(rows);
    else
      arguments.push_back(next_tensor <= 6 ? b.arguments[next_tensor++] : c10::IValue());
  }
  // A translation by numbers alone.
  auto const type = b.grad().scalar_type() == at::kDouble ? at::kDouble : at::kFloat;
  if (arguments[0].isNone()) arguments[0] = at::zeros({1, int64_t(numbers.size())}, b.grad().options().dtype(type));
  Tensor const matrix = run(formula, side_by_side, arguments)[0];
  Tensor const grad = rows == 3 ? cast(b.grad(), matrix) : b.grad();
  Ints const size = rows == 3 ? b.image_size() : b.batch_size();
  variable_list gradients{
      b.needs(0) ? b.call(image_gradient.text, {{"grad", grad}, {"matrix", matrix}, {"size", size}})[0] : Tensor()};
  bool needs_matrix = false;
  for (size_t i = 1; i <= 6; ++i) needs_matrix = needs_matrix || b.needs(i);
  if (!needs_matrix) return gradients;
  Tensor const x = b.tensor(0);
  Tensor const to_matrix =
      b.call(matrix_gradient.text, {{"grad", grad}, {"volumes", cast(x, matrix)}, {"matrix", matrix}, {"fill", {}}})[0];
  auto const needs = [&](size_t i) { return b.needs(i + 1); };
  auto const tensors = side_by_side.gradients({formula, {to_matrix}, arguments, {}, {}, needs});
  gradients.insert(gradients.end(), tensors.begin(), tensors.begin() + std::min<size_t>(6, tensors.size()));
  return gradients;
}};

inline constexpr Rule warp_by_formula{by_formula<"warp_image_backward", "warp_matrix_backward", 2>};
inline constexpr Rule warp3d_by_formula{by_formula<"warp3d_volume_backward", "warp3d_matrix_backward", 3>};

inline constexpr Rule pyramid_detail{
    [](Backward const& b) -> variable_list {
      c10::IValue const size = b.image_size();
      return {b.needs(0) ? -b.call("resize_backward", {{"size", size}, {"filter", kPyrUp}, {"antialias", false}},
                                   {resize_backward_gradients, 0, false})[0]
                         : Tensor(),
              b.grad()};
    },
    0, false};

// The system is symmetric, and what it multiplies is the spline at its own centers, and its weights' sums.
inline constexpr Rule thin_plate_weights{[](Backward const& b) -> variable_list {
  Tensor const x = b.tensor(0);
  int64_t const n = x.size(1);
  Tensor const to_right = b.call("thin_plate_weights", {{"rhs", b.grad()}}, thin_plate_weights)[0];
  if (!b.needs(0)) return {Tensor(), to_right};
  Tensor const both = b.call("thin_plate_weights", {}, thin_plate_weights)[0], weights = both.narrow(1, 0, n);
  variable_list const to =
      call("thin_plate_points_backward", {to_right.narrow(1, 0, n), x, x, weights, both.narrow(1, n, 3)});
  return {-(to[0] + to[1] + weights.matmul(to_right.narrow(1, n + 1, 2).mT())), to_right};
}};

// Functions of Python give roots their gradient; the operators alone have none.
inline constexpr Rule real_roots = no_gradient;
inline constexpr Rule first_root = no_gradient;

inline constexpr Rule nms_mask = non_differentiable;
inline constexpr Rule nms_minmax_masks = non_differentiable;
// The flags of maxima that the operator was not asked for are computed here.
inline constexpr Rule nms{[](Backward const& b) -> variable_list {
                            Tensor const flags = b.results[0].numel() > 0 ? b.results[0] : b.call("nms_mask")[0];
                            return b.call("apply_nms_mask", {{"input", b.grad()}, {"flags", flags}},
                                          {apply_nms_mask_gradients, 0, false});
                          },
                          1};

// Their gradients are saved with the loss.
inline constexpr Rule photometric{[](Backward const& b) -> variable_list {
                                    Tensor const to_matrix = b.grad().view({-1, 1, 1}) * b.results[0];
                                    return {Tensor(), Tensor(),
                                            once("photometric", to_matrix, {b.grad(), b.tensor(2)})};
                                  },
                                  1};
inline constexpr Rule photometric_depth{[](Backward const& b) -> variable_list {
                                          Tensor const& grad = b.grad();
                                          variable_list const tensors{grad, b.tensor(2), b.tensor(3)};
                                          Tensor const to_depth =
                                              (grad * b.results[1]).view({-1, 1, 1, 1}) * b.results[0];
                                          Tensor const to_projections = grad.view({-1, 1, 1, 1}) * b.results[2];
                                          return {Tensor(), Tensor(), once("photometric_depth", to_depth, tensors),
                                                  once("photometric_depth", to_projections, tensors)};
                                        },
                                        3};

// Of the points of depth, from their gradient (B, 3, H, W).
inline variable_list depth_points_gradients(Backward const& b, Tensor const& grad) {
  return {b.needs(0) ? b.call("depth_points_backward", {{"grad", grad}})[0] : Tensor(),
          b.needs(1) ? b.call("depth_points_camera_backward", {{"grad", grad}})[0] : Tensor()};
}

inline constexpr Rule depth_points{[](Backward const& b) -> variable_list {
  return depth_points_gradients(b, b.arguments[3].toBool() ? b.grad().movedim(-1, 1) : b.grad());
}};
inline constexpr Rule depth_normals{[](Backward const& b) -> variable_list {
  if (!b.needs(1)) return b.call("depth_normals_backward");
  return depth_points_gradients(b, b.call("depth_normals_points_backward")[0]);
}};
inline constexpr Rule depth_warp{[](Backward const& b) -> variable_list {
  auto const type = b.grad().scalar_type() == at::kDouble ? at::kDouble : at::kFloat;
  variable_list const maps = b.needs(1) || b.needs(2) ? b.call("depth_warp_coords_backward") : variable_list(2);
  return {b.needs(0) ? b.call("depth_warp_image_backward", {{"grad", b.grad().to(type)}, {"size", b.image_size()}})[0]
                     : Tensor(),
          maps[0], maps[1]};
}};

}  // namespace detail::rules
}  // namespace kvision::ops
