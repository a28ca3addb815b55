// Images behind a layer: schema and entry, for CPU and CUDA.
#include "augmentation/corruption/layer.h"
#include "glue/glue.h"

namespace kv::augmentation {
namespace {

// Images (B, C, H, W); layer (B or 1, C or 1, H, W), or layers of any number and size with windows (B, 3) int64;
// factors (B or 1, C or 1, 4). Layers and factors are of the type that is computed in.
Tensor add_layer(Tensor const& images, Tensor const& layer, std::optional<Tensor> const& windows,
                 Tensor const& factors) {
  constexpr char const* op = "add_layer";
  check_images(op, "images", images);
  int64_t const batch = images.size(0), channels = images.size(1);
  auto const is_one_or = [](int64_t size, int64_t all) { return size == all || size == 1; };
  auto const fits = [&](Tensor const& t) {
    return t.scalar_type() == compute_dtype(images) && t.device() == images.device() &&
           is_one_or(t.size(1), channels) && (windows || is_one_or(t.size(0), batch));
  };
  KV_CHECK(factors.dim() == 3 && fits(factors) && is_one_or(factors.size(0), batch) && factors.size(2) == 4, op,
           ": expected factors of shape (B, C, 4), of the type that is computed in, on the device of images");
  bool const is_whole = layer.dim() == 4 && fits(layer) && layer.numel() > 0;
  KV_CHECK(images.numel() == 0 || (is_whole && layer.size(2) >= images.size(2) && layer.size(3) >= images.size(3) &&
                                   (windows || (layer.size(2) == images.size(2) && layer.size(3) == images.size(3)))),
           op, ": expected a layer of the size of images, of the type that is computed in, on the device of images");
  if (windows)
    KV_CHECK(windows->dim() == 2 && windows->size(0) == batch && windows->size(1) == 3 &&
                 windows->scalar_type() == ScalarType::Long && windows->device() == images.device(),
             op, ": expected int64 windows of shape (B, 3) on the device of images");
  KV_CHECK(images.is_cpu() || (batch <= 65535 && images.size(2) * images.size(3) <= INT32_MAX / 2), op,
           ": expected at most 65535 images, and 2^30 pixels in each");
  Tensor const y = empty_like(images, layout_of(images)), own = dense(factors);
  std::optional<Tensor> const rows = windows ? std::optional<Tensor>(dense(*windows)) : std::nullopt;
  dispatch_floating_and_uint8(op, images, [&]<class T>(Type<T>) {
    using F = Compute<T>;
    AddLayer<T> params{};
    params.x = data_ptr<T const>(images), params.y = data_ptr<T>(y);
    params.batch = batch, params.channels = channels, params.height = images.size(2), params.width = images.size(3);
    params.layer = data_ptr<F const>(layer), params.factors = data_ptr<F const>(own);
    params.windows = rows ? data_ptr<int64_t const>(*rows) : nullptr;
    if (images.numel()) {
      params.layers = layer.size(0), params.layer_height = layer.size(2), params.layer_width = layer.size(3);
      for (int i = 0; i < 4; ++i) params.layer_strides[i] = layer.stride(i);
      if (layer.size(1) == 1) params.layer_strides[1] = 0;
    }
    for (int i = 0; i < 4; ++i) params.x_strides[i] = images.stride(i), params.y_strides[i] = y.stride(i);
    params.factor_strides[0] = own.size(0) > 1 ? 4 * own.size(1) : 0;
    params.factor_strides[1] = own.size(1) > 1 ? 4 : 0;
    params.full_range = sizeof(T) == 1 ? 255 : 1;
    KV_RUN(add_layer, images, params, images.numel() ? batch * channels * params.height : 0, 4 * params.width);
  });
  return y;
}

}  // namespace

KV_OPERATOR(add_layer, "(Tensor images, Tensor layer, Tensor? windows, Tensor factors) -> Tensor")

}  // namespace kv::augmentation
