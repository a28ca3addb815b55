// Masks of images of different sizes as one tensor of whole numbers, which tell objects apart.
#pragma once

#include "core/half.h"
#include "core/image_list.h"
#include "core/isa.h"

namespace kv::augmentation {

enum class MaskType : int { uint8, int8, int16, int32, int64, float16, bfloat16, float32, float64 };

// T is the type of the numbers, int64.
template <class T>
struct MaskNumbers {
  ListedImage masks[kMaxListed];
  int mask_channels[kMaxListed];
  int8_t types[kMaxListed];  // MaskType
  T *y, *widths;             // (B, N, H, W), 0 beyond each mask; (B,)
  int count, channels, height, width;

  KV_HD int64_t pixels() const { return channels * int64_t(height) * width; }

  // Floats by their bits: -0 is 0.
  static KV_HD T of_float(float x) { return x == 0 ? 0 : T(int32_t(float_to_bits(x))); }
  static KV_HD T number(MaskType type, void const* data, int64_t at) {
    switch (type) {
      case MaskType::uint8:
        return static_cast<uint8_t const*>(data)[at];
      case MaskType::int8:
        return static_cast<int8_t const*>(data)[at];
      case MaskType::int16:
        return static_cast<int16_t const*>(data)[at];
      case MaskType::int32:
        return static_cast<int32_t const*>(data)[at];
      case MaskType::int64:
        return static_cast<int64_t const*>(data)[at];
      case MaskType::float16:
        return of_float(to_float(static_cast<Half const*>(data)[at]));
      case MaskType::bfloat16:
        return of_float(to_float(static_cast<BFloat16 const*>(data)[at]));
      case MaskType::float32:
        return of_float(static_cast<float const*>(data)[at]);
      case MaskType::float64:
        break;
    }
    double const x = static_cast<double const*>(data)[at];
    return x == 0 ? 0 : T(int32_t(float_to_bits(float(x))));
  }
  // Writes number i of image b.
  KV_HD void write(int b, int64_t i) const {
    ListedImage const& mask = masks[b];
    int64_t const column = i % width, row = i / width % height, channel = i / width / height;
    int64_t const at = channel * mask.channel_stride + row * mask.row_stride + column * mask.step;
    bool const exists = channel < mask_channels[b] && row < mask.height && column < mask.width;
    y[b * pixels() + i] = exists ? number(MaskType(types[b]), mask.data, at) : 0;
  }
};

// On the CPU an item is an image.
KV_KERNEL(number_masks, MaskNumbers)

}  // namespace kv::augmentation
