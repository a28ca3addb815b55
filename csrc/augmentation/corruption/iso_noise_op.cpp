// The noise of a sensor: schema and entry, for CPU and CUDA.
#include "augmentation/corruption/iso_noise.h"
#include "augmentation/noise_glue.h"
#include "color/lists/program_list_glue.h"
#include "geometry/transform/lists/list_glue.h"

namespace kv::augmentation {
namespace {

// RGB images, or what stands for a list; parameters (B, 2): the deviation of hue in turns and the intensity. The others
// as those of gaussian_noise.
struct IsoArguments {
  NoiseSource source;
  Tensor const& parameters;
  std::optional<Tensor> const& chosen;

  void check() const {
    Tensor const& images = source.images;
    check_images(source.op, "images", images);
    KV_CHECK(images.size(1) == 3, source.op, ": expected images of 3 channels");
    KV_CHECK(parameters.dim() == 2 && (parameters.size(0) == images.size(0) || parameters.size(0) == 1) &&
                 parameters.size(1) == 2 && parameters.scalar_type() == compute_dtype(images) &&
                 parameters.device() == images.device(),
             source.op,
             ": expected parameters of shape (B, 2), of the type that is computed in, on the device of images");
    source.check();
    check_chosen(source.op, chosen, images);
  }
  // All but the images, of parameters that are dense.
  template <class T>
  PixelNoise<T> params(Tensor const& own) const {
    PixelNoise<T> noise{};
    source.set(noise);
    set_chosen(noise, chosen);
    noise.parameters = data_ptr<Compute<T> const>(own);
    noise.parameter_stride = own.size(0) > 1 ? 2 : 0;
    noise.full_range = sizeof(T) == 1 ? 255 : 1;
    return noise;
  }
};

// Maps (B, 2, H, W) float32, of uniform and normal numbers, take the place of drawn ones.
Tensor iso_noise(Tensor const& images, Tensor const& parameters, Tensor const& keys, std::optional<Tensor> const& seeds,
                 std::optional<Tensor> const& chosen, std::optional<Tensor> const& maps,
                 std::vector<int64_t> const& plan) {
  IsoArguments const a{{"iso_noise", images, keys, seeds, plan}, parameters, chosen};
  a.check();
  int64_t const batch = images.size(0), pixels = images.size(2) * images.size(3);
  if (maps)
    KV_CHECK(maps->dim() == 4 && maps->size(0) == batch && maps->size(1) == 2 && maps->size(2) == images.size(2) &&
                 maps->size(3) == images.size(3) && maps->scalar_type() == ScalarType::Float &&
                 maps->device() == images.device(),
             a.source.op, ": expected float32 maps of shape (B, 2, H, W) on the device of images");
  Layout const layout = layout_of(images);
  Tensor const x = dense_in_layout(images, layout), y = empty_like(x, layout), own = dense(parameters);
  std::optional<Tensor> const numbers = maps ? std::optional<Tensor>(dense(*maps)) : std::nullopt;
  int64_t const chunk = iso_chunk(pixels), chunks = iso_chunks(pixels), units = x.numel() ? batch * chunks : 0;
  Tensor const sums = empty({batch, chunks, 2}, x, Layout::planar, ScalarType::Double);
  dispatch_floating_and_uint8(a.source.op, x, [&]<class T>(Type<T>) {
    PixelNoise<T> noise = a.params<T>(own);
    set_images(noise, x, y, layout);
    noise.uniform = numbers ? data_ptr<float const>(*numbers) : nullptr;
    IsoNoise<T> const params{noise, data_ptr<double>(sums), chunk, chunks};
    KV_RUN(sum_lightness, x, params, units, 6 * chunk);
    KV_RUN(iso_noise, x, params, units, 64 * chunk);
  });
  return y;
}

// Images (C, H, W) of different sizes, to results of these.
Tensors iso_noise_list(Tensors const& images, Tensor const& parameters, Tensor const& keys,
                       std::optional<Tensor> const& seeds, std::optional<Tensor> const& chosen,
                       std::optional<Tensor> const& maps, std::vector<int64_t> const& plan) {
  geometry::KeptSizes const kept("iso_noise_list", images);
  Tensor const& like = kept.largest;
  IsoArguments const a{{kept.op, like, keys, seeds, plan}, parameters, chosen};
  a.check();
  KV_CHECK(!maps, kept.op, ": expected no maps");
  Tensor const own = dense(parameters);
  Tensors const rows = color::in_pixel_rows(images, kept.layout);
  auto const items_of = [](geometry::Size size) { return iso_chunks(size.height * size.width); };
  int64_t chunks = 0;
  for (size_t b = 0; b < images.size(); ++b) chunks += items_of({kept.sides[2 * b], kept.sides[2 * b + 1]});
  Tensor const sums = empty({chunks, 2}, like, Layout::planar, ScalarType::Double);
  dispatch_floating_and_uint8(kept.op, like, [&]<class T>(Type<T>) {
    IsoNoiseList<T> p;
    PixelNoise<T> all = a.params<T>(own);
    all.channels = 3;
    all.channel_stride = 1, all.step = kept.interleaved() ? 3 : 1;
    p.sums = data_ptr<double>(sums);
    kept.for_each_table(p.noise.list, rows, items_of, [&](size_t first) {
      p.noise.all = all;
      p.noise.all.skip(int64_t(first));
      KV_RUN(sum_lightness_list, like, p, p.noise.list.items, 6 * kIsoPixels);
      KV_RUN(iso_noise_list, like, p, p.noise.list.items, 64 * kIsoPixels);
      p.sums += 2 * p.noise.list.items;
    });
  });
  return kept.results;
}

}  // namespace

KV_OPERATOR(iso_noise,
            "(Tensor images, Tensor parameters, Tensor keys, Tensor? seeds, Tensor? chosen, Tensor? maps, int[] plan) "
            "-> Tensor")
// The same of images (C, H, W) of different sizes, as a list; without maps.
KV_OPERATOR(
    iso_noise_list,
    "(Tensor[] images, Tensor parameters, Tensor keys, Tensor? seeds, Tensor? chosen, Tensor? maps, int[] plan) "
    "-> Tensor[]")

}  // namespace kv::augmentation
