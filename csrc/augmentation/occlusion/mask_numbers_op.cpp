// Numbers of masks: schema and entry, for CPU and CUDA.
#include <algorithm>

#include "augmentation/occlusion/mask_numbers.h"
#include "glue/image_list.h"

namespace kv::augmentation {
namespace {

MaskType mask_type(char const* op, ScalarType type) {
  switch (type) {
    case ScalarType::Bool:
    case ScalarType::Byte:
      return MaskType::uint8;
    case ScalarType::Char:
      return MaskType::int8;
    case ScalarType::Short:
      return MaskType::int16;
    case ScalarType::Int:
      return MaskType::int32;
    case ScalarType::Long:
      return MaskType::int64;
    case ScalarType::Half:
      return MaskType::float16;
    case ScalarType::BFloat16:
      return MaskType::bfloat16;
    case ScalarType::Float:
      return MaskType::float32;
    case ScalarType::Double:
      return MaskType::float64;
    default:
      KV_CHECK(false, op, ": there is no kernel for the type of masks");
      return {};
  }
}

// Masks (N, h, w) or (h, w) as int64 (B, most N, height, width), 0 beyond each; and their widths (B,) int64.
std::tuple<Tensor, Tensor> number_masks(Tensors const& masks, int64_t height, int64_t width) {
  constexpr char const* op = "number_masks";
  KV_CHECK(!masks.empty() && height > 0 && width > 0 && height <= INT32_MAX && width <= INT32_MAX, op,
           ": expected masks and a size");
  Tensor const& first = masks[0];
  int64_t const batch = int64_t(masks.size());
  auto const channels_of = [](Tensor const& mask) { return mask.dim() == 3 ? mask.size(0) : 1; };
  int64_t channels = 0;
  for (Tensor const& mask : masks) {
    int64_t const axes = mask.dim();
    KV_CHECK((axes == 2 || axes == 3) && mask.size(axes - 2) <= height && mask.size(axes - 1) <= width &&
                 mask.device() == first.device(),
             op, ": expected masks of shape (N, h, w) or (h, w) on one device");
    channels = std::max(channels, channels_of(mask));
  }
  KV_CHECK(channels <= INT32_MAX, op, ": expected fewer masks");
  Tensor const y = empty({batch, channels, height, width}, first, Layout::planar, ScalarType::Long),
               widths = empty({batch}, first, Layout::planar, ScalarType::Long);
  MaskNumbers<int64_t> p;
  p.channels = int(channels), p.height = int(height), p.width = int(width);
  for (int64_t begin = 0; begin < batch && channels > 0; begin += kMaxListed) {
    p.count = int(std::min(batch - begin, int64_t(kMaxListed)));
    p.y = data_ptr<int64_t>(y) + begin * p.pixels();
    p.widths = data_ptr<int64_t>(widths) + begin;
    for (int i = 0; i < p.count; ++i) {
      Tensor const& mask = masks[size_t(begin + i)];
      int64_t const axes = mask.dim();
      p.mask_channels[i] = int(channels_of(mask));
      p.types[i] = int8_t(mask_type(op, mask.scalar_type()));
      p.masks[i] = {mask.const_data_ptr(), axes == 3 ? mask.stride(0) : 0, mask.stride(axes - 2),
                    mask.stride(axes - 1), int(mask.size(axes - 2)),       int(mask.size(axes - 1))};
    }
    KV_RUN(number_masks, first, p, p.count, p.pixels());
  }
  return {y, widths};
}

}  // namespace

KV_OPERATOR(number_masks, "(Tensor[] masks, int height, int width) -> (Tensor, Tensor)")

}  // namespace kv::augmentation
