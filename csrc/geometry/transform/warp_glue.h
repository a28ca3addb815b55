// Warps by a matrix and their gradients, for the entries of operators.
#pragma once

#include "geometry/transform/sampling_glue.h"

namespace kv::geometry {

inline Tensor warped(Tensor const& image, SamplingOptions const& a, Matrix const& m) {
  Size const source = m.use.source, output = m.use.output;
  int64_t const samples = a.images.samples, channels = image.size(1);
  Tensor const y = empty({samples, channels, output.height, output.width}, image, layout_of(image));
  dispatch_floating_and_uint8(a.op, image, [&](auto type) {
    using T = typename decltype(type)::type;
    Sample<T> const params{a.of<T>(source, m.coords<Compute<T>>()), images<T const>(image, a.images.images),
                           images<T>(y, samples), m.formula};
    check_planes(a.op, params.x);
    check_planes(a.op, params.y);
    KV_RUN(sample, image, params, y.numel() > 0 ? samples * output.height : 0, 4 * channels * output.width);
  });
  return y;
}

// The gradient of a sum is one number, expanded to all pixels: rows of a stride of 0, which kernels would read pixel by
// pixel.
inline Tensor with_rows(Tensor const& grad) { return as_layout(grad, layout_of(grad)); }

// The gradient to a batch of images, by the matrices of the samples.
inline Tensor warp_image_gradient(Tensor const& grad_output, BatchSize const& batch, SamplingOptions const& a,
                                  Matrix const& m) {
  char const* const op = a.op;
  Tensor const grad = with_rows(grad_output);
  SampledImages const& sampled = a.images;
  Size const source = m.use.source, output = m.use.output;
  int64_t const channels = grad.size(1);
  return image_gradient(op, grad, batch, a.padding == Padding::fill && sampled.is_one_sample_per_image(),
                        [&](auto type, Tensor const& from, Tensor const& to, Tensor const& sums) {
                          using T = typename decltype(type)::type;
                          SampleImageBackward<T> const params{a.of<T>(source, m.coords<Compute<T>>()),
                                                              images<T const>(from, sampled.samples),
                                                              images<T>(to, batch.images), data_ptr<Compute<T>>(sums)};
                          check_planes(op, params.grad);
                          check_planes(op, params.grad_x);
                          [[maybe_unused]] int64_t const cost =
                              8 * output.height * output.width * sampled.samples / std::max<int64_t>(batch.images, 1);
                          KV_RUN(sample_image_backward, from, params, batch.images * channels, cost);
                        });
}

// The gradient to the matrices, of samples of an image.
inline Tensor warp_matrix_gradient(Tensor const& grad_output, Tensor const& image, SamplingOptions const& a,
                                   Matrix const& m) {
  char const* const op = a.op;
  Tensor const grad = with_rows(grad_output);
  int64_t const batch = a.images.samples;
  Size const source = m.use.source, output = m.use.output;
  int64_t const parts = coords_backward_parts(output, tiles_per_block(batch, output.height, output.width));
  Tensor const sums = empty({batch, parts, 9}, grad, Layout::planar, ScalarType::Double);
  Tensor const grad_matrix = empty({batch, m.use.rows, 3}, m.tensor);
  dispatch_floating(op, image, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    SampleCoords<F> const coords = m.coords<F>();
    SampleCoordsBackward<T> const params{a.of<T>(source, coords),
                                         images<T const>(image, image.size(0)),
                                         images<T const>(grad, batch),
                                         {},
                                         {},
                                         data_ptr<double>(sums),
                                         parts};
    check_planes(op, params.x);
    check_planes(op, params.grad);
    KV_RUN(sample_coords_backward, image, params, batch * output.height, 8 * image.size(1) * output.width);
    WarpMatrixBackward<F> const gradient{coords, data_ptr<double const>(sums), parts, batch, data_ptr<F>(grad_matrix)};
    KV_RUN(warp_matrix_backward, image, gradient, batch, 9 * parts);
  });
  return grad_matrix;
}

}  // namespace kv::geometry
