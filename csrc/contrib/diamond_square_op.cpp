// A step of the diamond-square algorithm: schema and entry, for CPU and CUDA.
#include "contrib/diamond_square.h"
#include "glue/glue.h"

namespace kv::contrib {
namespace {

// Images (N, 1, h, w), noise (N, 1, 2 h - 1, 2 w - 1), weights (N, 1, 1, 1) of the type that is computed in.
Tensor refine_fractal(Tensor const& images, Tensor const& noise, Tensor const& weights) {
  constexpr char const* op = "refine_fractal";
  check_images(op, "images", images);
  int64_t const planes = images.size(0), h = images.size(2), w = images.size(3);
  KV_CHECK(images.size(1) == 1 && h > 0 && w > 0, op, ": expected images of shape (N, 1, H, W)");
  KV_CHECK(noise.dim() == 4 && noise.size(0) == planes && noise.size(1) == 1 && noise.size(2) == 2 * h - 1 &&
               noise.size(3) == 2 * w - 1 && noise.scalar_type() == images.scalar_type() &&
               noise.device() == images.device(),
           op, ": expected noise of shape (N, 1, 2 H - 1, 2 W - 1), of the dtype and device of images");
  KV_CHECK(weights.dim() == 4 && (weights.size(0) == planes || weights.size(0) == 1) &&
               weights.numel() == weights.size(0) && weights.scalar_type() == compute_dtype(images) &&
               weights.device() == images.device(),
           op, ": expected weights of shape (N, 1, 1, 1), of the type that is computed in, on the device of images");
  KV_CHECK(images.is_cpu() || h <= 4 * 65535, op, ": expected images of at most 262140 rows on CUDA");
  Tensor const x = dense(images), n = dense(noise), y = empty({planes, 1, 2 * h - 1, 2 * w - 1}, x);
  dispatch_floating(op, x, [&]<class T>(Type<T>) {
    RefineFractal<T> const params{data_ptr<T const>(x),
                                  data_ptr<T const>(n),
                                  data_ptr<T>(y),
                                  data_ptr<Compute<T> const>(weights),
                                  planes,
                                  h,
                                  w,
                                  weights.size(0) > 1 ? weights.stride(0) : 0};
    KV_RUN(refine_fractal, x, params, planes * params.height(), 8 * params.width());
  });
  return y;
}

}  // namespace

KV_OPERATOR(refine_fractal, "(Tensor images, Tensor noise, Tensor weights) -> Tensor")

}  // namespace kv::contrib
