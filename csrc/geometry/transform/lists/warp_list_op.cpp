// Warps by a matrix of lists of images of different sizes: schemas and entries, for CPU and CUDA.
#include "geometry/transform/lists/warp_list_gradients_glue.h"
#include "geometry/transform/warp_glue.h"

namespace kv::geometry {
namespace {

Tensors warp_list(Tensors const& images, Tensor const& matrix, std::optional<Tensor> const& fill,
                  std::vector<int64_t> const& sides, int64_t interpolation, int64_t padding, bool align_corners,
                  bool inverse, bool normalized) {
  char const* const op = "warp_list";
  check_image_list(op, "images", images);
  int64_t const batch = int64_t(images.size());
  Tensor const like = as_batch(images[0]);
  SamplingOptions const a(op, interpolation, padding, align_corners, like, fill, {op, {}, batch, batch, like});
  Matrix const m(op, matrix, like, batch, inverse, normalized, align_corners, {1, 1}, {1, 1});
  return warped_list(images, a, m, sides);
}

// The gradients of images of a size each.
Tensors warp_list_backward(Tensors const& grads, Tensor const& matrix, std::vector<int64_t> const& sides,
                           int64_t interpolation, int64_t padding, bool align_corners, bool inverse, bool normalized) {
  char const* const op = "warp_list_backward";
  ListedGradients const all(op, grads, sides.size() / 2);
  return image_gradients(all, all.options(parse_interpolation(op, interpolation), padding, align_corners),
                         all.matrices(matrix, inverse, normalized, align_corners), sides);
}

// The gradients of matrices; behind the images are the gradients of their results.
Tensors warp_list_matrix_backward(Tensors const& images_and_grads, Tensor const& matrix,
                                  std::optional<Tensor> const& fill, int64_t interpolation, int64_t padding,
                                  bool align_corners, bool inverse, bool normalized) {
  char const* const op = "warp_list_matrix_backward";
  auto const [images, grads] = split_gradients(op, images_and_grads);
  ListedGradients const all(op, grads, images.size());
  return {matrix_gradient(images, all,
                          all.options(parse_interpolation(op, interpolation), padding, align_corners, fill),
                          all.matrices(matrix, inverse, normalized, align_corners))};
}

}  // namespace

// `images` (C, H, W) of different sizes, one for each sample. `size` is one height and width, of a result (B, C, h, w),
// or those of a list of results.
KV_OPERATOR(warp_list, "(Tensor[] images, Tensor matrix, Tensor? fill, SymInt[] size, " KV_WARP_OPTIONS ") -> Tensor[]")
// `size` has height and width of each image. The gradients are one tensor (B, C, h, w), or one of each result.
KV_OPERATOR(warp_list_backward, "(Tensor[] grads, Tensor matrix, SymInt[] size, " KV_WARP_OPTIONS ") -> Tensor[]")

// Behind the images are the gradients, as those of `warp_list_backward`. The result is (B, 2, 3) or (B, 3, 3).
KV_OPERATOR(warp_list_matrix_backward,
            "(Tensor[] images_and_grads, Tensor matrix, Tensor? fill, " KV_WARP_OPTIONS ") -> Tensor[]")

}  // namespace kv::geometry
