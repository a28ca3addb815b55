// Smoothness of inverse depth: schemas and entries, for CPU and CUDA.
#include "core/row_sums.h"
#include "glue/glue.h"
#include "smoothness.h"

namespace kv::losses {
namespace {

void check_depth(char const* op, Tensor const& depth, Tensor const& image) {
  check_images(op, "depth", depth);
  check_images(op, "image", image);
  KV_CHECK(depth.size(1) == 1 && image.size(1) > 0 && depth.size(0) == image.size(0) &&
               depth.size(2) == image.size(2) && depth.size(3) == image.size(3) &&
               depth.scalar_type() == image.scalar_type() && depth.device() == image.device(),
           op, ": expected depth (B, 1, H, W) and image (B, C, H, W) of one dtype and device");
}

template <class T>
DepthAndImage<T> depth_and_image(Tensor const& depth, Tensor const& image, double along_y, double along_x) {
  using F = Compute<T>;
  return {planes<T const>(depth, Layout::planar), planes<T const>(image, Layout::planar), image.size(1), F(along_y),
          F(along_x)};
}

Tensor smoothness(Tensor const& depth, Tensor const& image, double along_y, double along_x) {
  constexpr char const* op = "smoothness";
  check_depth(op, depth, image);
  Tensor const d = as_layout(depth, Layout::planar), x = as_layout(image, Layout::planar);
  int64_t const samples = d.size(0), height = d.size(2), width = d.size(3);
#if defined(KV_CUDA)
  int64_t const chunks = ceil_div(ceil_div(height, kSmoothRows) * width, kSmoothThreads);
#else
  int64_t const chunks = height;
#endif
  Tensor const sums = empty({samples}, x, Layout::planar, compute_dtype(x));
  Tensor const partial = empty({samples, chunks}, x, Layout::planar, compute_dtype(x));
  dispatch_floating(op, x, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    Smoothness<T> const params{depth_and_image<T>(d, x, along_y, along_x), chunks, data_ptr<F>(partial),
                               data_ptr<F>(sums)};
    KV_RUN(smoothness, x, params, samples * height, (image.size(1) + 1) * width);
#if !defined(KV_CUDA)
    add_chunks(params.partial, samples, chunks, FinalizeSum<F>{F(1), F(0)}, params.sums);
#endif
  });
  return sums;
}

Tensor smoothness_backward(Tensor const& grad, Tensor const& depth, Tensor const& image, double along_y, double along_x,
                           bool of_image) {
  constexpr char const* op = "smoothness_backward";
  check_depth(op, depth, image);
  KV_CHECK(grad.dim() == 1 && grad.size(0) == depth.size(0) && grad.scalar_type() == compute_dtype(depth) &&
               grad.device() == depth.device(),
           op, ": expected grad to be that of the sums");
  Tensor const d = as_layout(depth, Layout::planar), x = as_layout(image, Layout::planar), g = dense(grad);
  Tensor const out = empty_like(of_image ? x : d, Layout::planar);
  dispatch_floating(op, x, [&](auto type) {
    using T = typename decltype(type)::type;
    SmoothnessBackward<T> const params{depth_and_image<T>(d, x, along_y, along_x), data_ptr<Compute<T> const>(g),
                                       planes<T>(out, Layout::planar), of_image};
    KV_RUN(smoothness_backward, x, params, params.of.depth.rows(), (image.size(1) + 1) * d.size(3));
  });
  return out;
}

}  // namespace

KV_OPERATOR(smoothness, "(Tensor depth, Tensor image, float along_y, float along_x) -> Tensor")
KV_OPERATOR(smoothness_backward,
            "(Tensor grad, Tensor depth, Tensor image, float along_y, float along_x, bool of_image) -> Tensor")

}  // namespace kv::losses
