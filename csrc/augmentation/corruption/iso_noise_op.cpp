// The noise of a sensor: schema and entry, for CPU and CUDA.
#include "augmentation/corruption/iso_noise.h"
#include "augmentation/noise_glue.h"

namespace kv::augmentation {
namespace {

// RGB images; parameters (B, 2): the deviation of hue in turns and the intensity; maps (B, 2, H, W) float32, of uniform
// and normal numbers, in place of drawn ones. The others as those of gaussian_noise.
Tensor iso_noise(Tensor const& images, Tensor const& parameters, Tensor const& keys, std::optional<Tensor> const& seeds,
                 std::optional<Tensor> const& chosen, std::optional<Tensor> const& maps,
                 std::vector<int64_t> const& plan) {
  constexpr char const* op = "iso_noise";
  check_images(op, "images", images);
  int64_t const batch = images.size(0), pixels = images.size(2) * images.size(3);
  KV_CHECK(images.size(1) == 3, op, ": expected images of 3 channels");
  KV_CHECK(parameters.dim() == 2 && (parameters.size(0) == batch || parameters.size(0) == 1) &&
               parameters.size(1) == 2 && parameters.scalar_type() == compute_dtype(images) &&
               parameters.device() == images.device(),
           op, ": expected parameters of shape (B, 2), of the type that is computed in, on the device of images");
  NoiseSource const source{op, images, keys, seeds, plan};
  source.check();
  check_chosen(op, chosen, images);
  if (maps)
    KV_CHECK(maps->dim() == 4 && maps->size(0) == batch && maps->size(1) == 2 && maps->size(2) == images.size(2) &&
                 maps->size(3) == images.size(3) && maps->scalar_type() == ScalarType::Float &&
                 maps->device() == images.device(),
             op, ": expected float32 maps of shape (B, 2, H, W) on the device of images");
  Layout const layout = layout_of(images);
  Tensor const x = dense_in_layout(images, layout), y = empty_like(x, layout), own = dense(parameters);
  std::optional<Tensor> const numbers = maps ? std::optional<Tensor>(dense(*maps)) : std::nullopt;
  int64_t const chunk = kIsoPixels * max(ceil_div(pixels, kIsoPixels * kIsoChunks), int64_t(1)),
                chunks = ceil_div(pixels, chunk), units = x.numel() ? batch * chunks : 0;
  Tensor const sums = empty({batch, chunks, 2}, x, Layout::planar, ScalarType::Double);
  dispatch_floating_and_uint8(op, x, [&]<class T>(Type<T>) {
    PixelNoise<T> noise{};
    set_images(noise, x, y, layout);
    source.set(noise);
    set_chosen(noise, chosen);
    noise.parameters = data_ptr<Compute<T> const>(own);
    noise.parameter_stride = own.size(0) > 1 ? 2 : 0;
    noise.uniform = numbers ? data_ptr<float const>(*numbers) : nullptr;
    noise.full_range = sizeof(T) == 1 ? 255 : 1;
    IsoNoise<T> const params{noise, data_ptr<double>(sums), chunk, chunks};
    KV_RUN(sum_lightness, x, params, units, 6 * chunk);
    KV_RUN(iso_noise, x, params, units, 64 * chunk);
  });
  return y;
}

}  // namespace

KV_OPERATOR(iso_noise,
            "(Tensor images, Tensor parameters, Tensor keys, Tensor? seeds, Tensor? chosen, Tensor? maps, int[] plan) "
            "-> Tensor")

}  // namespace kv::augmentation
