// Noise: schemas and entries, for CPU and CUDA alike.
#include "augmentation/noise.h"
#include "glue/glue.h"

namespace kv::augmentation {
namespace {

using OptionalTensor = std::optional<Tensor>;

// `x`, copied only if it is not dense.
Tensor dense_images(Tensor const& x, Layout layout) {
  Tensor const y = as_layout(x, layout);
  int64_t const c = y.size(1), pixels = y.size(2) * y.size(3);
  bool const last = layout == Layout::channels_last;
  bool const whole = (y.size(0) == 1 || y.stride(0) == c * pixels) && (last || c == 1 || y.stride(1) == pixels) &&
                     (y.size(2) == 1 || y.stride(2) == y.size(3) * (last ? c : 1));
  return whole ? y : as_layout(dense(y), layout);
}

// Of images (B, C, H, W); parameters (B, 2) of the type that is computed in; keys (K,) on the CPU or the device of the
// images; seeds (B,); chosen (B,) float32, whose zeros leave samples unchanged. The plan: the index of the key, the
// position in the chain, the index of the draw, same_on_batch.
struct NoiseArguments {
  char const* op;
  Tensor const &images, &parameters, &keys;
  OptionalTensor const &seeds, &chosen;
  std::vector<int64_t> const& plan;

  void check() const {
    check_images(op, "images", images);
    int64_t const batch = images.size(0);
    ScalarType const computed = compute_dtype(images);
    auto const on_device = [&](Tensor const& t) { return t.device() == images.device(); };
    KV_CHECK(batch <= 65535 && images.size(1) * ((images.size(2) * images.size(3) + 3) / 4) <= UINT32_MAX, op,
             ": expected at most 65535 images, and 2^34 pixels in each");
    KV_CHECK(parameters.dim() == 2 && (parameters.size(0) == batch || parameters.size(0) == 1) &&
                 parameters.size(1) == 2 && parameters.scalar_type() == computed && on_device(parameters),
             op, ": expected parameters of shape (B, 2), of the type that is computed in, on the device of images");
    KV_CHECK(keys.dim() == 1 && keys.scalar_type() == ScalarType::Long && (keys.is_cpu() || on_device(keys)), op,
             ": expected int64 keys of shape (K,) on the CPU or on the device of images");
    if (seeds)
      KV_CHECK(seeds->dim() == 1 && (seeds->size(0) == batch || seeds->size(0) == 1) &&
                   seeds->scalar_type() == ScalarType::Long && on_device(*seeds),
               op, ": expected int64 seeds of shape (B,) on the device of images");
    if (chosen)
      KV_CHECK(chosen->dim() == 1 && (chosen->size(0) == batch || chosen->size(0) == 1) &&
                   chosen->scalar_type() == ScalarType::Float && on_device(*chosen),
               op, ": expected float32 chosen of shape (B,) on the device of images");
    KV_CHECK(plan.size() == 4, op, ": expected a plan of four numbers, got ", plan.size());
    KV_CHECK(seeds || (plan[0] >= 0 && plan[0] < keys.size(0)), op, ": there is no key ", plan[0]);
    KV_CHECK(plan[1] >= 0 && plan[1] <= UINT32_MAX && plan[2] >= 1 && plan[2] <= UINT16_MAX, op,
             ": position or draw out of range");
  }

  template <class T>
  PixelNoise<T> params(Tensor const& x, Tensor const& y, Tensor const& p, Layout layout, double salt) const {
    bool const last = layout == Layout::channels_last, on_host = keys.is_cpu();
    PixelNoise<T> n;
    n.x = data_ptr<T const>(x);
    n.y = data_ptr<T>(y);
    n.batch = x.size(0), n.channels = x.size(1), n.pixels = x.size(2) * x.size(3);
    n.channel_stride = last ? 1 : n.pixels, n.step = last ? n.channels : 1;
    n.parameters = data_ptr<Compute<T> const>(p);
    n.parameter_stride = p.size(0) > 1 ? 2 : 0;
    n.chosen = chosen ? data_ptr<float const>(*chosen) : nullptr;
    n.chosen_stride = chosen && chosen->size(0) > 1 ? chosen->stride(0) : 0;
    n.full_range = sizeof(T) == 1 ? 255 : 1;
    n.salt = Compute<T>(salt) * n.full_range;
    n.seeds = seeds ? data_ptr<int64_t const>(*seeds) : nullptr;
    n.seed_stride = seeds && seeds->size(0) > 1 ? seeds->stride(0) : 0;
    n.keys = on_host ? nullptr : data_ptr<int64_t const>(keys);
    n.key_stride = keys.stride(0);
    n.key = on_host && !seeds ? data_ptr<int64_t const>(keys)[plan[0] * keys.stride(0)] : plan[0];
    n.position = uint32_t(plan[1]), n.draw = uint32_t(plan[2]);
    n.same_on_batch = plan[3] != 0;
    return n;
  }
};

int64_t noise_units(Tensor const& x) {
  return x.numel() ? x.size(0) * ((x.size(2) * x.size(3) + kNoiseChunk - 1) / kNoiseChunk) : 0;
}

Tensor gaussian_noise(Tensor const& images, Tensor const& parameters, Tensor const& keys, OptionalTensor const& seeds,
                      OptionalTensor const& chosen, std::vector<int64_t> const& plan) {
  constexpr char const* op = "gaussian_noise";
  NoiseArguments const arguments{op, images, parameters, keys, seeds, chosen, plan};
  arguments.check();
  Layout const layout = layout_of(images);
  Tensor const x = dense_images(images, layout), p = dense(parameters), y = empty_like(x, layout);
  dispatch_floating_and_uint8(op, x, [&]<class T>(Type<T>) {
    auto const params = arguments.params<T>(x, y, p, layout, 0);
    KV_RUN(gaussian_noise, x, params, noise_units(x), 4 * kNoiseChunk * x.size(1));
  });
  return y;
}

Tensor uniform_noise(Tensor const& images, Tensor const& parameters, Tensor const& keys, OptionalTensor const& seeds,
                     OptionalTensor const& chosen, std::vector<int64_t> const& plan) {
  constexpr char const* op = "uniform_noise";
  NoiseArguments const arguments{op, images, parameters, keys, seeds, chosen, plan};
  arguments.check();
  Layout const layout = layout_of(images);
  Tensor const x = dense_images(images, layout), p = dense(parameters), y = empty_like(x, layout);
  dispatch_floating_and_uint8(op, x, [&]<class T>(Type<T>) {
    auto const params = arguments.params<T>(x, y, p, layout, 0);
    KV_RUN(uniform_noise, x, params, noise_units(x), 4 * kNoiseChunk * x.size(1));
  });
  return y;
}

Tensor run_salt_and_pepper(NoiseArguments const& arguments, double salt) {
  arguments.check();
  Layout const layout = layout_of(arguments.images);
  Tensor const x = dense_images(arguments.images, layout), p = dense(arguments.parameters), y = empty_like(x, layout);
  dispatch_floating_and_uint8(arguments.op, x, [&]<class T>(Type<T>) {
    auto const params = arguments.params<T>(x, y, p, layout, salt);
    KV_RUN(salt_and_pepper, x, params, noise_units(x), 2 * kNoiseChunk * x.size(1));
  });
  return y;
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

}  // namespace

#define KV_NOISE "Tensor parameters, Tensor keys, Tensor? seeds, Tensor? chosen, int[] plan) -> Tensor"
KV_OPERATOR(gaussian_noise, "(Tensor images, " KV_NOISE)
KV_OPERATOR(uniform_noise, "(Tensor images, " KV_NOISE)
KV_OPERATOR(salt_and_pepper, "(Tensor images, " KV_NOISE)
KV_OPERATOR(salt_and_pepper_backward, "(Tensor grad, " KV_NOISE)
#undef KV_NOISE

}  // namespace kv::augmentation
