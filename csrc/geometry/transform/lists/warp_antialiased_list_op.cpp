// Antialiased warps by a matrix of lists of images of different sizes: schema and entry, for CPU and CUDA.
#include "geometry/transform/lists/warp_list_glue.h"
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

}  // namespace

// The arguments of `warp_list` without an interpolation.
KV_OPERATOR(warp_antialiased_list,
            "(Tensor[] images, Tensor matrix, Tensor? fill, SymInt[] size, int padding, bool align_corners, "
            "bool inverse, bool normalized) -> Tensor[]")

}  // namespace kv::geometry
