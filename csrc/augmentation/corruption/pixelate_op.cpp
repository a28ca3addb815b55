// Images of blocks: schemas and entries, for CPU and CUDA.
#include "augmentation/corruption/pixelate.h"
#include "augmentation/lists/listed_images.h"

namespace kv::augmentation {
namespace {

// Images (B, C, H, W), or what stands for a list, and numbers of blocks down and across (B, 2) float32.
void check_pixelate(char const* op, Tensor const& images, Tensor const& counts, int64_t value) {
  check_images(op, "images", images);
  KV_CHECK(counts.dim() == 2 && (counts.size(0) == images.size(0) || counts.size(0) == 1) && counts.size(1) == 2 &&
               counts.scalar_type() == ScalarType::Float && counts.device() == images.device(),
           op, ": expected float32 counts of shape (B, 2) on the device of images");
  KV_CHECK(value >= 0 && value < kBlockValues, op, ": there is no value of blocks ", value);
}
void check_sides(char const* op, Tensor const& images, int64_t height, int64_t width) {
  int64_t const row = width * (layout_of(images) == Layout::channels_last ? images.size(1) : 1);
  KV_CHECK(height <= kMaxPixelateSide && width <= kMaxPixelateSide && (images.is_cpu() || row <= kMaxPixelateRow), op,
           ": expected sides of at most ", kMaxPixelateSide, ", on CUDA ", kMaxPixelateRow, " elements of a row");
}

template <class T>
void run([[maybe_unused]] Tensor const& like, Pixelate<T> const& p, bool backward) {
  int64_t const rows = like.numel() ? p.y.rows() : 0, cost = 4 * p.y.row_size();
  if constexpr (sizeof(T) > 1)
    if (backward) {
      KV_RUN(pixelate_backward, like, p, rows, 2 * cost);
      return;
    }
  KV_RUN(pixelate, like, p, rows, cost);
}
template <class T>
void run([[maybe_unused]] Tensor const& like, PixelateList<T> const& p, [[maybe_unused]] int64_t cost, bool backward) {
  if constexpr (sizeof(T) > 1)
    if (backward) {
      KV_RUN(pixelate_backward_list, like, p, p.list.items, 2 * cost);
      return;
    }
  KV_RUN(pixelate_list, like, p, p.list.items, cost);
}

// Of images, or, backward, of the gradients of results.
Tensor pixelated(char const* op, Tensor const& images, Tensor const& counts, int64_t value, bool backward) {
  check_pixelate(op, images, counts, value);
  check_sides(op, images, images.size(2), images.size(3));
  Layout const layout = layout_of(images);
  Tensor const x = as_layout(images, layout), y = empty_like(x, layout), own = dense(counts);
  auto const of_type = [&]<class T>(Type<T>) {
    Pixelate<T> const params{planes<T const>(x, layout),
                             planes<T>(y, layout),
                             data_ptr<float const>(own),
                             own.size(0) > 1 ? 2 : 0,
                             layout == Layout::channels_last ? 1 : x.size(1),
                             BlockValue(value)};
    run(x, params, backward);
  };
  backward ? dispatch_floating(op, x, of_type) : dispatch_floating_and_uint8(op, x, of_type);
  return y;
}
Tensor pixelate(Tensor const& images, Tensor const& counts, int64_t value) {
  return pixelated("pixelate", images, counts, value, false);
}
Tensor pixelate_backward(Tensor const& grad, Tensor const& counts, int64_t value) {
  return pixelated("pixelate_backward", grad, counts, value, true);
}

Tensors pixelated_list(char const* op, Tensors const& images, OptionalTensor const& chosen, Tensor const& counts,
                       int64_t value, bool backward) {
  ListedImages const list(op, images, chosen);
  Tensor const& like = list.like();
  check_pixelate(op, like, counts, value);
  for (Tensor const& x : images) check_sides(op, like, x.size(1), x.size(2));
  Tensor const own = dense(counts);
  auto const of_type = [&]<class T>(Type<T>) {
    Pixelate<T> const all{
        {}, {}, data_ptr<float const>(own), own.size(0) > 1 ? 2 : 0, list.planes(), BlockValue(value)};
    list.filter<PixelateList<T>>(all, 4, [&](auto const& p, int64_t cost) { run(like, p, cost, backward); });
  };
  backward ? dispatch_floating(op, like, of_type) : dispatch_floating_and_uint8(op, like, of_type);
  return list.kept.results;
}
Tensors pixelate_list(Tensors const& images, OptionalTensor const& chosen, Tensor const& counts, int64_t value) {
  return pixelated_list("pixelate_list", images, chosen, counts, value, false);
}
Tensors pixelate_backward_list(Tensors const& grads, OptionalTensor const& chosen, Tensor const& counts,
                               int64_t value) {
  return pixelated_list("pixelate_backward_list", grads, chosen, counts, value, true);
}

}  // namespace

KV_OPERATOR(pixelate, "(Tensor images, Tensor counts, int value) -> Tensor")
KV_OPERATOR(pixelate_backward, "(Tensor grad, Tensor counts, int value) -> Tensor")
// The same of images (C, H, W) of different sizes, as a list. `chosen` (B,) float32: images whose value is 0 stay as
// they are.
KV_OPERATOR(pixelate_list, "(Tensor[] images, Tensor? chosen, Tensor counts, int value) -> Tensor[]")
KV_OPERATOR(pixelate_backward_list, "(Tensor[] grads, Tensor? chosen, Tensor counts, int value) -> Tensor[]")

}  // namespace kv::augmentation
