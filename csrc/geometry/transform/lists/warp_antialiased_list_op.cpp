// Antialiased warps by a matrix of lists of images of different sizes: schemas and entries, for CPU and CUDA.
#include "geometry/transform/lists/warp_list_gradients_glue.h"
#include "geometry/transform/warp_glue.h"

namespace kv::geometry {
namespace {

Tensors warp_antialiased_list(Tensors const& images, Tensor const& matrix, std::optional<Tensor> const& fill,
                              std::vector<int64_t> const& sides, int64_t padding, bool align_corners, bool inverse,
                              bool normalized) {
  char const* const op = "warp_antialiased_list";
  check_image_list(op, "images", images);
  int64_t const batch = int64_t(images.size());
  Tensor const like = as_batch(images[0]);
  SamplingOptions const a{op,   Interpolation::bilinear,     parse_padding(op, padding), align_corners, like,
                          fill, {op, {}, batch, batch, like}};
  Matrix const m(op, matrix, like, batch, inverse, normalized, align_corners, {1, 1}, {1, 1});
  return warped_list(images, a, m, sides, true);
}

Tensors warp_antialiased_list_backward(Tensors const& grads, Tensor const& matrix, std::vector<int64_t> const& sides,
                                       int64_t padding, bool align_corners, bool inverse, bool normalized) {
  ListedGradients const all("warp_antialiased_list_backward", grads, sides.size() / 2);
  return image_gradients(all, all.options(Interpolation::bilinear, padding, align_corners),
                         all.matrices(matrix, inverse, normalized, align_corners), sides, true);
}

Tensors warp_antialiased_list_matrix_backward(Tensors const& images_and_grads, Tensor const& matrix,
                                              std::optional<Tensor> const& fill, int64_t padding, bool align_corners,
                                              bool inverse, bool normalized) {
  char const* const op = "warp_antialiased_list_matrix_backward";
  auto const [images, grads] = split_gradients(op, images_and_grads);
  ListedGradients const all(op, grads, images.size());
  return {matrix_gradient<true>(images, all, all.options(Interpolation::bilinear, padding, align_corners, fill),
                                all.matrices(matrix, inverse, normalized, align_corners))};
}

}  // namespace

#define KV_ANTIALIASED_LIST_OPTIONS "int padding, bool align_corners, bool inverse, bool normalized) -> Tensor[]"

// The arguments of `warp_list` and of its gradients, without an interpolation.
KV_OPERATOR(warp_antialiased_list,
            "(Tensor[] images, Tensor matrix, Tensor? fill, SymInt[] size, " KV_ANTIALIASED_LIST_OPTIONS)
KV_OPERATOR(warp_antialiased_list_backward,
            "(Tensor[] grads, Tensor matrix, SymInt[] size, " KV_ANTIALIASED_LIST_OPTIONS)
KV_OPERATOR(warp_antialiased_list_matrix_backward,
            "(Tensor[] images_and_grads, Tensor matrix, Tensor? fill, " KV_ANTIALIASED_LIST_OPTIONS)

#undef KV_ANTIALIASED_LIST_OPTIONS

}  // namespace kv::geometry
