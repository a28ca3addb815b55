// Noise: schemas and entries, for CPU and CUDA.
#include "augmentation/lists/list_steps.h"
#include "augmentation/noise_glue.h"
#include "color/lists/program_list_glue.h"
#include "geometry/transform/lists/list_glue.h"

namespace kv::augmentation {
namespace {

// Of images (B, C, H, W); parameters (B, 2) of the type that is computed in; keys, seeds, chosen and plan as in
// noise_glue.h.
struct NoiseArguments {
  char const* op;
  Tensor const &images, &parameters, &keys;
  OptionalTensor const &seeds, &chosen;
  std::vector<int64_t> const& plan;
  OptionalTensor const* uniform = nullptr;  // of photons
  Tensor const* values = nullptr;           // (C,) or (1,), of pixels that are hit

  NoiseSource source() const { return {op, images, keys, seeds, plan}; }
  void check() const {
    check_images(op, "images", images);
    int64_t const batch = images.size(0);
    KV_CHECK(parameters.dim() == 2 && (parameters.size(0) == batch || parameters.size(0) == 1) &&
                 parameters.size(1) == 2 && parameters.scalar_type() == compute_dtype(images) &&
                 parameters.device() == images.device(),
             op, ": expected parameters of shape (B, 2), of the type that is computed in, on the device of images");
    source().check();
    check_chosen(op, chosen, images);
    if (values)
      KV_CHECK(values->dim() == 1 && (values->size(0) == 1 || values->size(0) == images.size(1)) &&
                   values->scalar_type() == compute_dtype(images) && values->device() == images.device(),
               op, ": expected values of shape (C,) or (1,), of the type that is computed in, on the device of images");
    if (!uniform || !*uniform) return;
    Tensor const& u = **uniform;
    bool fits = u.dim() == 4 && u.scalar_type() == ScalarType::Float && u.device() == images.device();
    for (int i = 0; fits && i < 4; ++i) fits = u.size(i) == images.size(i);
    KV_CHECK(fits, op, ": expected float32 uniform of the shape and device of images");
  }

  // All but the images.
  template <class T>
  PixelNoise<T> params(Tensor const& p, double salt) const {
    PixelNoise<T> n{};
    source().set(n);
    set_chosen(n, chosen);
    n.parameters = data_ptr<Compute<T> const>(p);
    n.parameter_stride = p.size(0) > 1 ? 2 : 0;
    n.uniform = nullptr;
    n.values = values ? data_ptr<Compute<T> const>(*values) : nullptr;
    n.value_stride = values && values->size(0) > 1 ? values->stride(0) : 0;
    n.full_range = sizeof(T) == 1 ? 255 : 1;
    n.salt = Compute<T>(salt) * n.full_range;
    if (salt == 0) n.form &= ~NoiseForm::random;  // of gradients
    return n;
  }
};

// Adds noise to the images: `run` calls the kernel.
template <class Run>
Tensor run_noise(NoiseArguments const& arguments, double salt, Run const& run) {
  arguments.check();
  Layout const layout = layout_of(arguments.images);
  Tensor const x = dense_in_layout(arguments.images, layout), p = dense(arguments.parameters),
               y = empty_like(x, layout);
  OptionalTensor const u =
      arguments.uniform && *arguments.uniform ? OptionalTensor(dense(**arguments.uniform)) : std::nullopt;
  dispatch_floating_and_uint8(arguments.op, x, [&]<class T>(Type<T>) {
    PixelNoise<T> params = arguments.params<T>(p, salt);
    set_images(params, x, y, layout);
    if (u) params.uniform = data_ptr<float const>(*u), params.uniform_planes = x.size(1);
    run(x, params);
  });
  return y;
}

Tensor gaussian_noise(Tensor const& images, Tensor const& parameters, Tensor const& keys, OptionalTensor const& seeds,
                      OptionalTensor const& chosen, std::vector<int64_t> const& plan) {
  return run_noise({"gaussian_noise", images, parameters, keys, seeds, chosen, plan}, 0,
                   [](Tensor const& x, auto const& params) {
                     KV_RUN(gaussian_noise, x, params, noise_units(x), 4 * kNoiseChunk * x.size(1));
                   });
}

Tensor uniform_noise(Tensor const& images, Tensor const& parameters, Tensor const& keys, OptionalTensor const& seeds,
                     OptionalTensor const& chosen, std::vector<int64_t> const& plan) {
  return run_noise({"uniform_noise", images, parameters, keys, seeds, chosen, plan}, 0,
                   [](Tensor const& x, auto const& params) {
                     KV_RUN(uniform_noise, x, params, noise_units(x), 4 * kNoiseChunk * x.size(1));
                   });
}

Tensor shot_noise(Tensor const& images, Tensor const& parameters, Tensor const& keys, OptionalTensor const& seeds,
                  OptionalTensor const& chosen, OptionalTensor const& uniform, std::vector<int64_t> const& plan) {
  return run_noise({"shot_noise", images, parameters, keys, seeds, chosen, plan, &uniform}, 0,
                   [](Tensor const& x, auto const& params) {
                     KV_RUN(shot_noise, x, params, noise_units(x), 32 * kNoiseChunk * x.size(1));
                   });
}

Tensor run_salt_and_pepper(NoiseArguments const& arguments, double salt) {
  return run_noise(arguments, salt, [](Tensor const& x, auto const& params) {
    KV_RUN(salt_and_pepper, x, params, noise_units(x), 2 * kNoiseChunk * x.size(1));
  });
}

Tensor salt_and_pepper(Tensor const& images, Tensor const& parameters, Tensor const& keys, OptionalTensor const& seeds,
                       OptionalTensor const& chosen, std::vector<int64_t> const& plan) {
  return run_salt_and_pepper({"salt_and_pepper", images, parameters, keys, seeds, chosen, plan}, 1);
}

// The pixels that are hit have no gradient: the same with salt of 0.
Tensor salt_and_pepper_backward(Tensor const& grad, Tensor const& parameters, Tensor const& keys,
                                OptionalTensor const& seeds, OptionalTensor const& chosen,
                                std::vector<int64_t> const& plan) {
  return run_salt_and_pepper({"salt_and_pepper_backward", grad, parameters, keys, seeds, chosen, plan}, 0);
}

// The same on images (C, H, W) of different sizes: `run` calls the kernel for the samples of a table. `by_pixel`: a
// thread has all channels of its pixels.
template <class Run>
void run_noise_list(geometry::KeptSizes const& kept, Tensors const& images, Tensor const& parameters,
                    Tensor const& keys, OptionalTensor const& seeds, OptionalTensor const& chosen,
                    std::vector<int64_t> const& plan, double salt, [[maybe_unused]] bool by_pixel, Run const& run,
                    int further_form = 0, Tensor const* values = nullptr, OptionalTensor const& uniform = {}) {
  char const* const op = kept.op;
  Tensor const& like = kept.largest;
  NoiseArguments const arguments{op, like, parameters, keys, seeds, chosen, plan, nullptr, values};
  arguments.check();
  Tensor const p = dense(parameters);
  Tensors const rows = color::in_pixel_rows(images, kept.layout);
  int64_t const channels = like.size(1);
  ListedNumbers const numbers(op, uniform, channels, like, kept.sides);
  auto const items_of = [&](geometry::Size size) {
    int64_t const pixels = size.height * size.width;
#if defined(KV_CUDA)
    return ceil_div((by_pixel ? 1 : channels) * ceil_div(pixels, 4), kListedRuns * kNoiseThreads);
#else
    return ceil_div(pixels, kNoiseChunk);
#endif
  };
  dispatch_floating_and_uint8(op, like, [&]<class T>(Type<T>) {
    PixelNoiseList<T> list;
    PixelNoise<T> all = arguments.params<T>(p, salt);
    all.form |= further_form;
    all.channels = channels;
    all.channel_stride = 1, all.step = kept.interleaved() ? channels : 1;
    kept.for_each_table(list.list, rows, items_of, [&](size_t first) {
      list.all = all;
      list.all.skip(int64_t(first));
      numbers.set(list.all, first);
      run(like, list, kNoiseChunk * channels);
    });
  });
}
template <class Run>
Tensors run_noise_list(char const* op, Tensors const& images, Tensor const& parameters, Tensor const& keys,
                       OptionalTensor const& seeds, OptionalTensor const& chosen, std::vector<int64_t> const& plan,
                       double salt, bool by_pixel, Run const& run, bool in_block = false) {
  geometry::KeptSizes const kept(op, images, in_block);
  run_noise_list(kept, images, parameters, keys, seeds, chosen, plan, salt, by_pixel, run);
  return kept.results;
}

void run_gaussian_list([[maybe_unused]] Tensor const& like, auto const& p, [[maybe_unused]] int64_t elements) {
  KV_RUN(gaussian_noise_list, like, p, p.list.items, 4 * elements);
}
void run_uniform_list([[maybe_unused]] Tensor const& like, auto const& p, [[maybe_unused]] int64_t elements) {
  KV_RUN(uniform_noise_list, like, p, p.list.items, 4 * elements);
}

Tensors gaussian_noise_list(Tensors const& images, Tensor const& parameters, Tensor const& keys,
                            OptionalTensor const& seeds, OptionalTensor const& chosen,
                            std::vector<int64_t> const& plan) {
  return run_noise_list("gaussian_noise_list", images, parameters, keys, seeds, chosen, plan, 0, false,
                        [](auto const&... list) { run_gaussian_list(list...); });
}

Tensors uniform_noise_list(Tensors const& images, Tensor const& parameters, Tensor const& keys,
                           OptionalTensor const& seeds, OptionalTensor const& chosen,
                           std::vector<int64_t> const& plan) {
  return run_noise_list("uniform_noise_list", images, parameters, keys, seeds, chosen, plan, 0, false,
                        [](auto const&... list) { run_uniform_list(list...); });
}

void run_hits_list([[maybe_unused]] Tensor const& like, auto const& p, [[maybe_unused]] int64_t elements) {
  KV_RUN(salt_and_pepper_list, like, p, p.list.items, 2 * elements);
}

Tensors salt_and_pepper_list(Tensors const& images, Tensor const& parameters, Tensor const& keys,
                             OptionalTensor const& seeds, OptionalTensor const& chosen,
                             std::vector<int64_t> const& plan) {
  return run_noise_list("salt_and_pepper_list", images, parameters, keys, seeds, chosen, plan, 1, true,
                        [](auto const&... list) { run_hits_list(list...); });
}

// Pixels that salt_and_pepper_list hits are set to values, in the units of the images, of each channel or one of all.
Tensors fill_pixels_list(Tensors const& images, Tensor const& parameters, Tensor const& values, Tensor const& keys,
                         OptionalTensor const& seeds, OptionalTensor const& chosen, std::vector<int64_t> const& plan) {
  geometry::KeptSizes const kept("fill_pixels_list", images);
  run_noise_list(
      kept, images, parameters, keys, seeds, chosen, plan, 1, true, [](auto const&... list) { run_hits_list(list...); },
      0, &values);
  return kept.results;
}

Tensors shot_noise_list(Tensors const& images, Tensor const& parameters, Tensor const& keys,
                        OptionalTensor const& seeds, OptionalTensor const& chosen, OptionalTensor const& uniform,
                        std::vector<int64_t> const& plan) {
  geometry::KeptSizes const kept("shot_noise_list", images);
  run_noise_list(
      kept, images, parameters, keys, seeds, chosen, plan, 0, false,
      []([[maybe_unused]] Tensor const& like, auto const& p, [[maybe_unused]] int64_t elements) {
        KV_RUN(shot_noise_list, like, p, p.list.items, 32 * elements);
      },
      0, nullptr, uniform);
  return kept.results;
}

}  // namespace

Tensors steps::drawn_noise(Tensor const& like, int64_t channels, std::vector<int64_t> const& sides, bool normal,
                           Tensor const& parameters, Tensor const& keys, OptionalTensor const& seeds,
                           OptionalTensor const& chosen, std::vector<int64_t> const& plan) {
  constexpr char const* op = "drawn_noise";
  size_t const count = sides.size() / 2;
  KV_CHECK(count > 0, op, ": expected height and width of each image");
  Tensor block;
  Tensors const zeros = geometry::list_in_block(like, channels, {op, sides, count}, count, ScalarType::Float, &block);
  torch::stable::zero_(block);
  auto const noise = [&](auto run) {
    return run_noise_list(op, zeros, parameters, keys, seeds, chosen, plan, 0, false, run, true);
  };
  return normal ? noise([](auto const&... list) { run_gaussian_list(list...); })
                : noise([](auto const&... list) { run_uniform_list(list...); });
}

void steps::fill_with_noise(geometry::KeptSizes const& kept, Tensor const& parameters, Tensor const& keys,
                            OptionalTensor const& seeds, std::vector<int64_t> const& plan) {
  run_noise_list(
      kept, kept.results, parameters, keys, seeds, {}, plan, 0, false,
      [](auto const&... list) { run_uniform_list(list...); }, NoiseForm::alone);
}

#define KV_NOISE "Tensor parameters, Tensor keys, Tensor? seeds, Tensor? chosen, int[] plan) -> Tensor"
KV_OPERATOR(gaussian_noise, "(Tensor images, " KV_NOISE)
KV_OPERATOR(uniform_noise, "(Tensor images, " KV_NOISE)
KV_OPERATOR(shot_noise,
            "(Tensor images, Tensor parameters, Tensor keys, Tensor? seeds, Tensor? chosen, Tensor? uniform, "
            "int[] plan) -> Tensor")
KV_OPERATOR(salt_and_pepper, "(Tensor images, " KV_NOISE)
KV_OPERATOR(salt_and_pepper_backward, "(Tensor grad, " KV_NOISE)
#undef KV_NOISE
// The same of images (C, H, W) of different sizes, as a list.
#define KV_NOISE_LIST \
  "(Tensor[] images, Tensor parameters, Tensor keys, Tensor? seeds, Tensor? chosen, int[] plan) -> Tensor[]"
KV_OPERATOR(gaussian_noise_list, KV_NOISE_LIST)
KV_OPERATOR(uniform_noise_list, KV_NOISE_LIST)
KV_OPERATOR(salt_and_pepper_list, KV_NOISE_LIST)
KV_OPERATOR(fill_pixels_list,
            "(Tensor[] images, Tensor parameters, Tensor values, Tensor keys, Tensor? seeds, Tensor? chosen, "
            "int[] plan) -> Tensor[]")
KV_OPERATOR(shot_noise_list,
            "(Tensor[] images, Tensor parameters, Tensor keys, Tensor? seeds, Tensor? chosen, Tensor? uniform, "
            "int[] plan) -> Tensor[]")
#undef KV_NOISE_LIST

}  // namespace kv::augmentation
