// Images of blocks: schema and entry, for CPU and CUDA.
#include "augmentation/corruption/pixelate.h"
#include "glue/glue.h"

namespace kv::augmentation {
namespace {

// Images (B, C, H, W), numbers of blocks down and across (B, 2) float32.
Tensor pixelate(Tensor const& images, Tensor const& counts, int64_t value) {
  constexpr char const* op = "pixelate";
  check_images(op, "images", images);
  int64_t const batch = images.size(0);
  KV_CHECK(counts.dim() == 2 && (counts.size(0) == batch || counts.size(0) == 1) && counts.size(1) == 2 &&
               counts.scalar_type() == ScalarType::Float && counts.device() == images.device(),
           op, ": expected float32 counts of shape (B, 2) on the device of images");
  KV_CHECK(value >= 0 && value < kBlockValues, op, ": there is no value of blocks ", value);
  Layout const layout = layout_of(images);
  int64_t const row = images.size(3) * (layout == Layout::channels_last ? images.size(1) : 1);
  KV_CHECK(images.size(2) <= kMaxPixelateSide && images.size(3) <= kMaxPixelateSide &&
               (images.is_cpu() || row <= kMaxPixelateRow),
           op, ": expected sides of at most ", kMaxPixelateSide, ", on CUDA ", kMaxPixelateRow, " elements of a row");
  Tensor const x = as_layout(images, layout), y = empty_like(x, layout), own = dense(counts);
  dispatch_floating_and_uint8(op, x, [&]<class T>(Type<T>) {
    Pixelate<T> const params{planes<T const>(x, layout),
                             planes<T>(y, layout),
                             data_ptr<float const>(own),
                             own.size(0) > 1 ? 2 : 0,
                             layout == Layout::channels_last ? 1 : x.size(1),
                             BlockValue(value)};
    KV_RUN(pixelate, x, params, x.numel() ? params.y.rows() : 0, 4 * params.y.row_size());
  });
  return y;
}

}  // namespace

KV_OPERATOR(pixelate, "(Tensor images, Tensor counts, int value) -> Tensor")

}  // namespace kv::augmentation
