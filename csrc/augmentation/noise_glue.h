// Checks of arguments that operators with noise have in common.
#pragma once

#include <span>

#include "augmentation/noise.h"
#include "glue/glue.h"

namespace kv::augmentation {

// What determines noise: keys (K,) on the CPU or on the device of the images; seeds (B,), which replace the keys; and
// the plan, which is the index of the key, the position in the chain, the index of the draw, same_on_batch, and, where
// they are not 0, the form and the number of the first sample.
struct NoiseSource {
  char const* op;
  Tensor const &images, &keys;
  std::optional<Tensor> const& seeds;
  std::span<int64_t const> plan;

  int64_t form() const { return plan.size() > 4 ? plan[4] : 0; }
  int64_t first_sample() const { return plan.size() > 5 ? plan[5] : 0; }
  bool is_on_device(Tensor const& t) const { return t.device() == images.device(); }

  void check() const {
    int64_t const batch = images.size(0);
    KV_CHECK(batch <= 65535 && images.size(1) * ((images.size(2) * images.size(3) + 3) / 4) <= UINT32_MAX, op,
             ": expected at most 65535 images, and 2^34 pixels in each");
    KV_CHECK(keys.dim() == 1 && keys.scalar_type() == ScalarType::Long && (keys.is_cpu() || is_on_device(keys)), op,
             ": expected int64 keys of shape (K,) on the CPU or on the device of images");
    if (seeds)
      KV_CHECK(seeds->dim() == 1 && (seeds->size(0) == batch || seeds->size(0) == 1) &&
                   seeds->scalar_type() == ScalarType::Long && is_on_device(*seeds),
               op, ": expected int64 seeds of shape (B,) on the device of images");
    KV_CHECK(plan.size() >= 4 && plan.size() <= 6, op, ": expected a plan of four to six numbers, got ", plan.size());
    KV_CHECK(first_sample() >= 0 && first_sample() + batch <= UINT32_MAX, op, ": first sample out of range");
    KV_CHECK(form() >= 0 && form() <= NoiseForm::all, op, ": expected a form from 0 to ", NoiseForm::all);
    KV_CHECK(seeds || (plan[0] >= 0 && plan[0] < keys.size(0)), op, ": there is no key ", plan[0]);
    KV_CHECK(plan[1] >= 0 && plan[1] <= UINT32_MAX && plan[2] >= 1 && plan[2] <= UINT16_MAX, op,
             ": position or draw out of range");
  }

  template <class T>
  void set(PixelNoise<T>& n) const {
    bool const on_host = keys.is_cpu();
    n.seeds = seeds ? data_ptr<int64_t const>(*seeds) : nullptr;
    n.seed_stride = seeds && seeds->size(0) > 1 ? seeds->stride(0) : 0;
    n.keys = on_host ? nullptr : data_ptr<int64_t const>(keys);
    n.key_stride = keys.stride(0);
    n.key = on_host && !seeds ? data_ptr<int64_t const>(keys)[plan[0] * keys.stride(0)] : plan[0];
    n.position = uint32_t(plan[1]), n.draw = uint32_t(plan[2]);
    n.same_on_batch = plan[3] != 0;
    n.first_sample = first_sample();
    n.form = int(form());
  }
};

// `x`, copied only if it is not dense.
inline Tensor dense_in_layout(Tensor const& x, Layout layout) {
  Tensor const y = as_layout(x, layout);
  int64_t const c = y.size(1), pixels = y.size(2) * y.size(3);
  bool const last = layout == Layout::channels_last;
  bool const whole = (y.size(0) == 1 || y.stride(0) == c * pixels) && (last || c == 1 || y.stride(1) == pixels) &&
                     (y.size(2) == 1 || y.stride(2) == y.size(3) * (last ? c : 1));
  return whole ? y : as_layout(dense(y), layout);
}

// `chosen` is (B,) float32; samples whose value is 0 are left unchanged.
inline void check_chosen(char const* op, std::optional<Tensor> const& chosen, Tensor const& images) {
  if (!chosen) return;
  KV_CHECK(chosen->dim() == 1 && (chosen->size(0) == images.size(0) || chosen->size(0) == 1) &&
               chosen->scalar_type() == ScalarType::Float && chosen->device() == images.device(),
           op, ": expected float32 chosen of shape (B,) on the device of images");
}
template <class T>
void set_chosen(PixelNoise<T>& n, std::optional<Tensor> const& chosen) {
  n.chosen = chosen ? data_ptr<float const>(*chosen) : nullptr;
  n.chosen_stride = chosen && chosen->size(0) > 1 ? chosen->stride(0) : 0;
}

// Sets the images x and y, which are dense and have the same layout.
template <class T>
void set_images(PixelNoise<T>& n, Tensor const& x, Tensor const& y, Layout layout) {
  bool const last = layout == Layout::channels_last;
  n.x = data_ptr<T const>(x);
  n.y = data_ptr<T>(y);
  n.batch = x.size(0), n.channels = x.size(1), n.pixels = x.size(2) * x.size(3);
  n.channel_stride = last ? 1 : n.pixels, n.step = last ? n.channels : 1;
}

// Numbers (N,) float32 that are given for the pixels of a list: so many planes of each image, one image after the
// other.
struct ListedNumbers {
  std::optional<Tensor> own;
  int64_t planes;
  std::vector<int64_t> const& sides;  // height and width of each image

  ListedNumbers(char const* op, std::optional<Tensor> const& given, int64_t planes, Tensor const& like,
                std::vector<int64_t> const& sides)
      : planes(planes), sides(sides) {
    if (!given) return;
    KV_CHECK(given->dim() == 1 && given->size(0) == before(sides.size() / 2) &&
                 given->scalar_type() == ScalarType::Float && given->device() == like.device(),
             op, ": expected float32 numbers of shape (", before(sides.size() / 2), ",) on the device of images");
    own = dense(*given);
  }
  // Those of the images before number b.
  int64_t before(size_t b) const {
    int64_t pixels = 0;
    for (size_t i = 0; i < b; ++i) pixels += sides[2 * i] * sides[2 * i + 1];
    return planes * pixels;
  }
  // Of the samples from `first` on.
  template <class T>
  void set(PixelNoise<T>& n, size_t first) const {
    n.uniform = own ? data_ptr<float const>(*own) + before(first) : nullptr;
    n.uniform_planes = planes;
  }
};

// Work items of the CPU kernel.
inline int64_t noise_units(Tensor const& x) {
  return x.numel() ? x.size(0) * ceil_div(x.size(2) * x.size(3), kNoiseChunk) : 0;
}

}  // namespace kv::augmentation
