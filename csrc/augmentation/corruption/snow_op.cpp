// Snow: schemas and entries, for CPU and CUDA.
#include "augmentation/corruption/snow.h"
#include "augmentation/lists/listed_images.h"

namespace kv::augmentation {
namespace {

template <class T>
void set_weight(AddSnow<T>& p, int64_t channels, double weight) {
  using F = Compute<T>;
  p.channels = channels;
  p.weight = F(weight), p.full_range = sizeof(T) == 1 ? 255 : 1, p.scale = 1 / p.full_range;
}

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
    params.batch = batch, params.height = height, params.width = width;
    for (int i = 0; i < 4; ++i) params.x_strides[i] = images.stride(i), params.y_strides[i] = y.stride(i);
    set_weight(params, images.size(1), weight);
    KV_RUN(add_snow, images, params, images.numel() ? batch * height : 0, 16 * params.channels * width);
  });
  return y;
}

// Images (C, H, W), and flakes (1, H, W) of each.
Tensors add_snow_list(Tensors const& images, OptionalTensor const& chosen, Tensors const& flakes, double weight) {
  constexpr char const* op = "add_snow_list";
  ListedImages const list(op, images, chosen, true);
  Tensor const& like = list.like();
  size_t const count = images.size();
  KV_CHECK(flakes.size() == count, op, ": expected flakes of ", count, " images, got ", flakes.size());
  Tensors own;  // dense
  own.reserve(count);
  for (size_t b = 0; b < count; ++b) {
    Tensor const &x = images[b], &layer = flakes[b];
    KV_CHECK(layer.dim() == 3 && layer.size(0) == 1 && layer.size(1) == x.size(1) && layer.size(2) == x.size(2) &&
                 layer.scalar_type() == compute_dtype(like) && layer.device() == like.device(),
             op, ": expected flakes of shape (1, H, W), of the type that is computed in, on the device of images");
    KV_CHECK(x.size(1) <= INT32_MAX / 2 / x.size(2), op, ": expected at most 2^30 pixels in each image");
    own.push_back(dense(layer));
  }
  dispatch_floating_and_uint8(op, like, [&]<class T>(Type<T>) {
    AddSnowList<T> p{};
    set_weight(p.all, list.channels(), weight);
    p.interleaved = list.kept.interleaved();
    p.chosen_stride = chosen && chosen->size(0) > 1 ? chosen->stride(0) : 0;
    for (size_t begin = 0; begin < count && list.channels() > 0; begin += kMaxListed) {
      p.count = int(std::min(count - begin, size_t(kMaxListed)));
      p.chosen = chosen ? data_ptr<float const>(*chosen) + int64_t(begin) * p.chosen_stride : nullptr;
      int64_t items = 0;
      for (int i = 0; i < p.count; ++i) {
        Tensor const &x = list.images[begin + size_t(i)], &y = list.kept.results[begin + size_t(i)];
        p.listed[i] = {x.const_data_ptr(), y.mutable_data_ptr(), own[begin + size_t(i)].const_data_ptr(),
                       int(x.size(1)),     int(x.size(2)),       int(items)};
        items += ceil_div(x.size(1), rows_of_item(x.size(2)));
        KV_CHECK(items <= INT32_MAX, op, ": expected images of less than 2^31 blocks");
      }
      p.items = int(items);
      KV_RUN(add_snow_list, like, p, p.items, 16 * list.channels() * kItemPixels);
    }
  });
  return list.kept.results;
}

}  // namespace

KV_OPERATOR(add_snow, "(Tensor images, Tensor flakes, float weight) -> Tensor")
// `chosen` (B,) float32: images whose value is 0 stay as they are.
KV_OPERATOR(add_snow_list, "(Tensor[] images, Tensor? chosen, Tensor[] flakes, float weight) -> Tensor[]")

}  // namespace kv::augmentation
