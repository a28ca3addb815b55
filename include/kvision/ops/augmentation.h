// Random parameters, the matrices that they give, passes over images, noise and erased rectangles. Arguments are those
// of torch.ops.kvision. Written by tools/generate.py.
#pragma once

#include "kvision/ops/operator.h"
#include "kvision/ops/rules/augmentation.h"

namespace kvision::ops {

namespace detail {

inline variable_list apply_operation_gradients(Backward const& b);
inline variable_list iso_noise_gradients(Backward const& b);
inline variable_list sum_of_moved_gradients(Backward const& b);
inline variable_list sum_of_moved_backward_gradients(Backward const& b);
inline variable_list pixelate_gradients(Backward const& b);
inline variable_list pixelate_backward_gradients(Backward const& b);
inline variable_list paste_pieces_gradients(Backward const& b);
inline variable_list paste_pieces_backward_gradients(Backward const& b);
inline variable_list salt_and_pepper_gradients(Backward const& b);
inline variable_list salt_and_pepper_backward_gradients(Backward const& b);
inline variable_list transform_matrix_gradients(Backward const& b);

}  // namespace detail

// --- augmentation/auto/operations_op.cpp

inline constexpr Operator<"apply_operations", Two(Tensor images, Tensor operation, Tensor value)> apply_operations{
    no_gradient};
// A step of a policy: each image (B, C, H, W) gets the operation of its number, with its value; -1 is none. Returns the
// images and the matrices (B, 3, 3) of operations that move pixels. operation_table.py has the numbers and the values.
inline constexpr Operator<"apply_operation", Two(Tensor images, Tensor operation, Tensor value)> apply_operation{
    Rule{detail::apply_operation_gradients}};
inline constexpr Operator<"choose_operations", Two(Tensor columns, Tensor table, int64_t count, double top_level)>
    choose_operations{no_gradient};

// --- augmentation/corruption/disk_op.cpp

inline constexpr Operator<"disk_kernels", Tensor(Tensor deviations, Tensor radii, int64_t largest)> disk_kernels{
    no_gradient};

// --- augmentation/corruption/drops_op.cpp

inline constexpr Operator<"drop_depths", Tensor(Tensor layers, Tensor parameters)> drop_depths{non_differentiable};
inline constexpr Operator<"drop_reliefs", Tensor(Tensor layers, Tensor parameters, Tensor depths)> drop_reliefs{
    non_differentiable};
inline constexpr Operator<"mark_stains", Tensor(Tensor layers, Tensor parameters)> mark_stains{non_differentiable};

// --- augmentation/corruption/glass_op.cpp

inline constexpr Operator<"read_neighbors", Tensor(Tensor images, Tensor keys, OptionalTensor seeds,
                                                   OptionalTensor uniform, Ints plan, int64_t max_delta, int64_t steps)>
    read_neighbors{no_gradient};

// --- augmentation/corruption/iso_noise_op.cpp

inline constexpr Operator<"iso_noise", Tensor(Tensor images, Tensor parameters, Tensor keys, OptionalTensor seeds,
                                              OptionalTensor chosen, OptionalTensor maps, Ints plan)>
    iso_noise{Rule{detail::iso_noise_gradients}};

// --- augmentation/corruption/layer_op.cpp

inline constexpr Operator<"add_layer", Tensor(Tensor images, Tensor layer, OptionalTensor windows, Tensor factors)>
    add_layer{no_gradient};

// --- augmentation/corruption/moved_op.cpp

inline constexpr Operator<"sum_of_moved", Tensor(Tensor images, Tensor moves)> sum_of_moved{
    Rule{detail::sum_of_moved_gradients, 0, false}};

// --- augmentation/corruption/pixelate_op.cpp

inline constexpr Operator<"pixelate", Tensor(Tensor images, Tensor counts, int64_t value)> pixelate{
    Rule{detail::pixelate_gradients, 0, false}};

// --- augmentation/corruption/rain_op.cpp

inline constexpr Operator<"rain_mask", Tensor(Tensor drops, Tensor positions, Ints size, int64_t longest)> rain_mask{
    non_differentiable};

// --- augmentation/corruption/snow_op.cpp

inline constexpr Operator<"add_snow", Tensor(Tensor images, Tensor flakes, double weight)> add_snow{no_gradient};

// --- augmentation/distortion/displacement_map_op.cpp

inline constexpr Operator<"displacement_map", Tensor(Tensor rows, int64_t kind, Floats numbers, Ints size)>
    displacement_map{no_gradient};
inline constexpr Operator<"displacement_map_list",
                          Tensor(Tensor rows, OptionalTensor chosen, int64_t kind, Floats numbers, Ints size)>
    displacement_map_list{no_gradient};

// --- augmentation/draw_links_op.cpp

inline constexpr Operator<"draw_links",
                          Tensor(Tensor image, Tensor keys, OptionalTensor seeds, Tensor plan, Tensor numbers)>
    draw_links{no_gradient};

// --- augmentation/draw_warp_and_color_op.cpp

inline constexpr Operator<"draw_warp_and_color",
                          Three(Tensor image, Tensor keys, OptionalTensor seeds, Tensor plan, Tensor numbers)>
    draw_warp_and_color{no_gradient};

// --- augmentation/draws_op.cpp

inline constexpr Operator<"draw_parameters",
                          Tensor(Tensor images, Tensor keys, OptionalTensor seeds, Ints plan, Floats numbers)>
    draw_parameters{non_differentiable};
// `listed` has the numbers of each sample of the draws that are listed, which replace those among `numbers`.
inline constexpr Operator<"draw_list_parameters", Tensor(Tensor images, Tensor keys, OptionalTensor seeds, Ints plan,
                                                         Floats numbers, Floats listed, Ints draws)>
    draw_list_parameters{non_differentiable};

// --- augmentation/elastic_op.cpp

// Displacements of elastic transforms: given noise (B, 2, H, W), or noise drawn by keys, after a Gaussian blur, times
// the scales.
inline constexpr Operator<"elastic_displacements",
                          Tensor(Tensor noise, OptionalTensor keys, OptionalTensor seeds, Ints plan, int64_t ky,
                                 int64_t kx, double sigma_y, double sigma_x, double scale_x, double scale_y)>
    elastic_displacements{detail::rules::elastic_displacements};
inline constexpr Operator<"elastic_displacements_list",
                          Tensor(Tensor like, OptionalTensor noise, Tensor keys, OptionalTensor seeds,
                                 OptionalTensor chosen, Ints plan, int64_t ky, int64_t kx, double sigma_y,
                                 double sigma_x, double alpha_x, double alpha_y, bool align_corners, int64_t unit,
                                 Ints size)>
    elastic_displacements_list{no_gradient};

// --- augmentation/erase_op.cpp

inline constexpr Operator<"erase_rectangles", Tensor(Tensor images, Tensor boxes, Tensor values)> erase_rectangles{
    detail::rules::erase_rectangles};
inline constexpr Operator<"erase_grid", Tensor(Tensor images, Tensor grids, Tensor values)> erase_grid{
    detail::rules::erase_grid};

// --- augmentation/lists/drawn_layers_op.cpp

inline constexpr Operator<"spatter_layers",
                          Two(Tensor standard, Tensor keys, OptionalTensor seeds, OptionalTensor chosen, Ints plan,
                              Ints sides, OptionalTensor sigma, int64_t ky, int64_t kx, double sigma_y, double sigma_x,
                              Tensor parameters, bool is_rain, OptionalTensor soft_sigma, int64_t soft_ky,
                              int64_t soft_kx, double soft_sigma_y, double soft_sigma_x)>
    spatter_layers{no_gradient};
inline constexpr Operator<"blurred_maps",
                          Tensor(Tensor parameters, Tensor keys, OptionalTensor seeds, OptionalTensor chosen, Ints plan,
                                 Ints sides, double sigma, int64_t border)>
    blurred_maps{no_gradient};

// --- augmentation/mixing/pieces_op.cpp

inline constexpr Operator<"paste_pieces", Tensor(Tensor images, Tensor pieces, Ints size)> paste_pieces{
    Rule{detail::paste_pieces_gradients, 0, false}};
inline constexpr Operator<"mix_pieces", Tensor(Tensor columns, Ints plan, Floats numbers)> mix_pieces{no_gradient};

// --- augmentation/noise_op.cpp

inline constexpr Operator<"gaussian_noise", Tensor(Tensor images, Tensor parameters, Tensor keys, OptionalTensor seeds,
                                                   OptionalTensor chosen, Ints plan)>
    gaussian_noise{detail::rules::gaussian_noise};
inline constexpr Operator<"uniform_noise", Tensor(Tensor images, Tensor parameters, Tensor keys, OptionalTensor seeds,
                                                  OptionalTensor chosen, Ints plan)>
    uniform_noise{detail::rules::uniform_noise};
inline constexpr Operator<"shot_noise", Tensor(Tensor images, Tensor parameters, Tensor keys, OptionalTensor seeds,
                                               OptionalTensor chosen, OptionalTensor uniform, Ints plan)>
    shot_noise{non_differentiable};
inline constexpr Operator<"salt_and_pepper", Tensor(Tensor images, Tensor parameters, Tensor keys, OptionalTensor seeds,
                                                    OptionalTensor chosen, Ints plan)>
    salt_and_pepper{Rule{detail::salt_and_pepper_gradients, 0, false}};

// --- augmentation/occlusion/objects_op.cpp

inline constexpr Operator<"drop_objects", Tensor(Tensor masks, OptionalTensor components, Tensor words, Tensor counts,
                                                 OptionalTensor widths, int64_t most)>
    drop_objects{non_differentiable};

// --- augmentation/preimages/preimages_op.cpp

// Where a map of nodes reads the inside of quadrilaterals, and points. result_map.py says what the arguments are.
inline constexpr Operator<"preimage_extents", Tensor(Tensor quads, Tensor directions, Tensor coordinates, Tensor kinds,
                                                     Tensor x, Tensor y, int64_t margin)>
    preimage_extents{non_differentiable};
inline constexpr Operator<"preimage_points",
                          Two(Tensor points, Tensor coordinates, Tensor kinds, Tensor x, Tensor y, int64_t margin)>
    preimage_points{non_differentiable};
inline constexpr Operator<"preimage_extents_list", Tensor(Tensor quads, Tensor directions, Tensor coordinates,
                                                          Tensor kinds, Ints sides, Ints margins)>
    preimage_extents_list{non_differentiable};
inline constexpr Operator<"preimage_points_list",
                          Two(Tensor points, Tensor coordinates, Tensor kinds, Ints sides, Ints margins)>
    preimage_points_list{non_differentiable};

// --- augmentation/preimages/read_nodes_op.cpp

// Where nodes read images, and their kinds. result_map_list.py says what the arguments are.
inline constexpr Operator<"read_nodes_list", Two(Tensor link, OptionalTensor coordinates, OptionalTensor kinds,
                                                 Ints before, Ints moved, Ints bounded, Ints sides, Ints margins)>
    read_nodes_list{non_differentiable};

// --- augmentation/random_generator/fractal_noise_op.cpp

inline constexpr Operator<"fractal_noise",
                          Tensor(Tensor roughness, Tensor keys, OptionalTensor seeds, Ints plan, Ints size)>
    fractal_noise{non_differentiable};

// --- augmentation/transforms_op.cpp

inline constexpr Operator<"transform_matrix", Tensor(Tensor columns, Ints plan, Floats numbers)> transform_matrix{
    Rule{detail::transform_matrix_gradients}};

// --- augmentation/warp_and_color_op.cpp

// A warp by the matrices of a chain of transforms of columns (B, P), then a program of color steps: the result, the
// matrices, and the means of contrast. warp_and_color.py explains size, plan and numbers.
inline constexpr Operator<"warp_and_color", Three(Tensor image, OptionalTensor columns, OptionalTensor fill, Ints size,
                                                  Ints plan, Floats numbers)>
    warp_and_color{detail::rules::warp_and_color};
// The result and the matrices for images that are copies of pieces (B, N, 9) of the images of a batch, of their size.
inline constexpr Operator<"warp_and_color_pieces", Two(Tensor image, Tensor pieces, OptionalTensor columns,
                                                       OptionalTensor fill, Ints size, Ints plan, Floats numbers)>
    warp_and_color_pieces{no_gradient};

// --- rules

namespace detail {

inline variable_list apply_operation_gradients(Backward const& b) {
  return b.run("apply_operation_backward", {b.grads[0], b.arguments[0], b.arguments[1], b.arguments[2]}, no_gradient);
}

inline variable_list iso_noise_gradients(Backward const& b) {
  return b.run("iso_noise_backward",
               {b.grads[0], b.arguments[0], b.arguments[1], b.arguments[2], b.arguments[3], b.arguments[4],
                b.arguments[5], b.arguments[6]},
               no_gradient);
}

inline variable_list sum_of_moved_gradients(Backward const& b) {
  return b.run("sum_of_moved_backward", {b.grads[0], b.arguments[1]}, Rule{sum_of_moved_backward_gradients, 0, false});
}

inline variable_list sum_of_moved_backward_gradients(Backward const& b) {
  return b.run("sum_of_moved", {b.grads[0], b.arguments[1]}, Rule{sum_of_moved_gradients, 0, false});
}

inline variable_list pixelate_gradients(Backward const& b) {
  return b.run("pixelate_backward", {b.grads[0], b.arguments[1], b.arguments[2]},
               Rule{pixelate_backward_gradients, 0, false});
}

inline variable_list pixelate_backward_gradients(Backward const& b) {
  return b.run("pixelate", {b.grads[0], b.arguments[1], b.arguments[2]}, Rule{pixelate_gradients, 0, false});
}

inline variable_list paste_pieces_gradients(Backward const& b) {
  return b.run("paste_pieces_backward", {b.grads[0], b.arguments[1], b.image_size()},
               Rule{paste_pieces_backward_gradients, 0, false});
}

inline variable_list paste_pieces_backward_gradients(Backward const& b) {
  return b.run("paste_pieces", {b.grads[0], b.arguments[1], b.image_size()}, Rule{paste_pieces_gradients, 0, false});
}

inline variable_list salt_and_pepper_gradients(Backward const& b) {
  return b.run("salt_and_pepper_backward",
               {b.grads[0], b.arguments[1], b.arguments[2], b.arguments[3], b.arguments[4], b.arguments[5]},
               Rule{salt_and_pepper_backward_gradients, 0, false});
}

inline variable_list salt_and_pepper_backward_gradients(Backward const& b) {
  return b.run("salt_and_pepper_backward",
               {b.grads[0], b.arguments[1], b.arguments[2], b.arguments[3], b.arguments[4], b.arguments[5]},
               Rule{salt_and_pepper_backward_gradients, 0, false});
}

inline variable_list transform_matrix_gradients(Backward const& b) {
  return b.run("transform_matrix_backward", {b.grads[0], b.arguments[0], b.arguments[1], b.arguments[2]}, no_gradient);
}

}  // namespace detail

}  // namespace kvision::ops
