// Snow: schema and entry, for CPU and CUDA.
#include "augmentation/corruption/snow.h"
#include "glue/glue.h"

namespace kv::augmentation {
namespace {

// Images (B, C, H, W); flakes (B, 1, H, W) of the type that is computed in.
Tensor add_snow(Tensor const& images, Tensor const& flakes, double weight) {
  constexpr char const* op = "add_snow";
  check_images(op, "images", images);
  int64_t const batch = images.size(0), height = images.size(2), width = images.size(3);
  KV_CHECK(flakes.dim() == 4 && flakes.size(0) == batch && flakes.size(1) == 1 && flakes.size(2) == height &&
               flakes.size(3) == width && flakes.scalar_type() == compute_dtype(images) &&
               flakes.device() == images.device(),
           op, ": expected flakes of shape (B, 1, H, W), of the type that is computed in, on the device of images");
  KV_CHECK(images.is_cpu() || (batch <= 65535 && height * width <= INT32_MAX / 2), op,
           ": expected at most 65535 images, and 2^30 pixels in each");
  Tensor const y = empty_like(images, layout_of(images)), own = dense(flakes);
  dispatch_floating_and_uint8(op, images, [&]<class T>(Type<T>) {
    using F = Compute<T>;
    AddSnow<T> params{};
    params.x = data_ptr<T const>(images), params.y = data_ptr<T>(y), params.flakes = data_ptr<F const>(own);
    params.batch = batch, params.channels = images.size(1), params.height = height, params.width = width;
    for (int i = 0; i < 4; ++i) params.x_strides[i] = images.stride(i), params.y_strides[i] = y.stride(i);
    params.weight = F(weight), params.full_range = sizeof(T) == 1 ? 255 : 1, params.scale = 1 / params.full_range;
    KV_RUN(add_snow, images, params, images.numel() ? batch * height : 0, 16 * params.channels * width);
  });
  return y;
}

}  // namespace

KV_OPERATOR(add_snow, "(Tensor images, Tensor flakes, float weight) -> Tensor")

}  // namespace kv::augmentation
