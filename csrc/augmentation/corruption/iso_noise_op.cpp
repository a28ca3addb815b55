// The noise of a sensor: schema and entry, for CPU and CUDA.
#include "augmentation/corruption/iso_noise.h"
#include "augmentation/lists/listed_images.h"
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

// What noise of a batch and its gradient have in common. Maps (B, 2, H, W) float32, of uniform and normal numbers, take
// the place of drawn ones.
struct IsoBatch {
  IsoArguments const& a;
  Layout layout;
  Tensor x, y, own, sums;
  std::optional<Tensor> numbers;
  int64_t chunk, chunks, units;

  IsoBatch(IsoArguments const& a, std::optional<Tensor> const& maps) : a(a) {
    a.check();
    Tensor const& images = a.source.images;
    int64_t const batch = images.size(0), pixels = images.size(2) * images.size(3);
    if (maps)
      KV_CHECK(maps->dim() == 4 && maps->size(0) == batch && maps->size(1) == 2 && maps->size(2) == images.size(2) &&
                   maps->size(3) == images.size(3) && maps->scalar_type() == ScalarType::Float &&
                   maps->device() == images.device(),
               a.source.op, ": expected float32 maps of shape (B, 2, H, W) on the device of images");
    layout = layout_of(images);
    x = dense_in_layout(images, layout), y = empty_like(x, layout), own = dense(a.parameters);
    if (maps) numbers = dense(*maps);
    chunk = iso_chunk(pixels), chunks = iso_chunks(pixels), units = x.numel() ? batch * chunks : 0;
    sums = empty({batch, chunks, 2}, x, Layout::planar, ScalarType::Double);
  }
  template <class T>
  IsoNoise<T> params() const {
    PixelNoise<T> noise = a.params<T>(own);
    set_images(noise, x, y, layout);
    noise.uniform = numbers ? data_ptr<float const>(*numbers) : nullptr, noise.uniform_planes = 2;
    return {noise, data_ptr<double>(sums), chunk, chunks};
  }
};

Tensor iso_noise(Tensor const& images, Tensor const& parameters, Tensor const& keys, std::optional<Tensor> const& seeds,
                 std::optional<Tensor> const& chosen, std::optional<Tensor> const& maps,
                 std::vector<int64_t> const& plan) {
  IsoArguments const a{{"iso_noise", images, keys, seeds, plan}, parameters, chosen};
  IsoBatch const batch(a, maps);
  dispatch_floating_and_uint8(a.source.op, images, [&]<class T>(Type<T>) {
    IsoNoise<T> const params = batch.params<T>();
    KV_RUN(sum_lightness, images, params, batch.units, 6 * batch.chunk);
    KV_RUN(iso_noise, images, params, batch.units, 64 * batch.chunk);
  });
  return batch.y;
}

// The gradient of the images.
Tensor iso_noise_backward(Tensor const& grad, Tensor const& images, Tensor const& parameters, Tensor const& keys,
                          std::optional<Tensor> const& seeds, std::optional<Tensor> const& chosen,
                          std::optional<Tensor> const& maps, std::vector<int64_t> const& plan) {
  IsoArguments const a{{"iso_noise_backward", images, keys, seeds, plan}, parameters, chosen};
  IsoBatch const batch(a, maps);
  check_like(a.source.op, "grad", grad, images);
  Tensor const g = dense_in_layout(grad, batch.layout);
  dispatch_floating(a.source.op, images, [&]<class T>(Type<T>) {
    IsoNoiseBackward<T> const params{batch.params<T>(), data_ptr<T const>(g)};
    IsoNoise<T> const& forward = params;
    KV_RUN(sum_lightness, images, forward, batch.units, 6 * batch.chunk);
    KV_RUN(iso_noise_backward, images, params, batch.units, 128 * batch.chunk);
  });
  return batch.y;
}

// Images (C, H, W) of different sizes, to results of these.
Tensors iso_noise_list(Tensors const& images, Tensor const& parameters, Tensor const& keys,
                       std::optional<Tensor> const& seeds, std::optional<Tensor> const& chosen,
                       std::optional<Tensor> const& maps, std::vector<int64_t> const& plan) {
  geometry::KeptSizes const kept("iso_noise_list", images);
  Tensor const& like = kept.largest;
  IsoArguments const a{{kept.op, like, keys, seeds, plan}, parameters, chosen};
  a.check();
  ListedNumbers const numbers(kept.op, maps, 2, like, kept.sides);
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
      numbers.set(p.noise.all, first);
      KV_RUN(sum_lightness_list, like, p, p.noise.list.items, 6 * kIsoPixels);
      KV_RUN(iso_noise_list, like, p, p.noise.list.items, 64 * kIsoPixels);
      p.sums += 2 * p.noise.list.items;
    });
  });
  return kept.results;
}

// The gradients of images. The list has the images, and behind them the gradients of the results.
Tensors iso_noise_list_backward(Tensors const& images_and_grads, Tensor const& parameters, Tensor const& keys,
                                std::optional<Tensor> const& seeds, std::optional<Tensor> const& chosen,
                                std::optional<Tensor> const& maps, std::vector<int64_t> const& plan) {
  constexpr char const* op = "iso_noise_list_backward";
  auto const [images, given] = halves(op, images_and_grads);
  std::optional<Tensor> const all_images;
  ListedImages const list(op, images, all_images, true);
  Tensor const& like = list.like();
  IsoArguments const a{{op, like, keys, seeds, plan}, parameters, chosen};
  a.check();
  ListedNumbers const numbers(op, maps, 2, like, list.kept.sides);
  Tensor const own = dense(parameters);
  Tensors const grads = list.in_layout_of_images(given, true);
  auto const items_of = [](Tensor const& x) { return iso_chunks(x.size(1) * x.size(2)); };
  dispatch_floating(op, like, [&]<class T>(Type<T>) {
    IsoNoiseBackward<T> all{};
    all.noise = a.params<T>(own);
    all.noise.channels = 3;
    all.noise.channel_stride = 1, all.noise.step = list.kept.interleaved() ? 3 : 1;
    list.for_each_gradient_table<IsoNoiseBackwardList<T>>(all, grads, items_of, [&](auto& p, size_t first) {
      numbers.set(p.all.noise, first);
      Tensor const sums = empty({p.items, 2}, like, Layout::planar, ScalarType::Double);
      p.sums = data_ptr<double>(sums);
      KV_RUN(sum_lightness_again, like, p, p.items, 6 * kIsoPixels);
      KV_RUN(iso_noise_list_backward, like, p, p.items, 128 * kIsoPixels);
    });
  });
  return list.kept.results;
}

}  // namespace

KV_OPERATOR(iso_noise,
            "(Tensor images, Tensor parameters, Tensor keys, Tensor? seeds, Tensor? chosen, Tensor? maps, int[] plan) "
            "-> Tensor")
KV_OPERATOR(iso_noise_backward,
            "(Tensor grad, Tensor images, Tensor parameters, Tensor keys, Tensor? seeds, Tensor? chosen, Tensor? maps,"
            " int[] plan) -> Tensor")
// The same of images (C, H, W) of different sizes, as a list. Maps are packed, (N,): two planes of each image, one
// after the other.
KV_OPERATOR(
    iso_noise_list,
    "(Tensor[] images, Tensor parameters, Tensor keys, Tensor? seeds, Tensor? chosen, Tensor? maps, int[] plan) "
    "-> Tensor[]")
KV_OPERATOR(iso_noise_list_backward,
            "(Tensor[] images_and_grads, Tensor parameters, Tensor keys, Tensor? seeds, Tensor? chosen, Tensor? maps,"
            " int[] plan) -> Tensor[]")

}  // namespace kv::augmentation
