// Erased rectangles: schema and entry, for CPU and CUDA.
#include "augmentation/erase.h"
#include "glue/glue.h"

namespace kv::augmentation {
namespace {

// Images (B, C, H, W), boxes (B, 4) float32, values (B,) of the type that is computed in.
Tensor erase_rectangles(Tensor const& images, Tensor const& boxes, Tensor const& values) {
  constexpr char const* op = "erase_rectangles";
  check_images(op, "images", images);
  int64_t const batch = images.size(0);
  auto const fits = [&](Tensor const& t, int64_t axes, ScalarType type) {
    return t.dim() == axes && (t.size(0) == batch || t.size(0) == 1) && t.scalar_type() == type &&
           t.device() == images.device();
  };
  KV_CHECK(fits(boxes, 2, ScalarType::Float) && boxes.size(1) == 4, op,
           ": expected float32 boxes of shape (B, 4) on the device of images");
  KV_CHECK(fits(values, 1, compute_dtype(images)), op,
           ": expected values of shape (B,), of the type that is computed in, on the device of images");
  Layout const layout = layout_of(images);
  Tensor const x = as_layout(images, layout), y = empty_like(x, layout), four = dense(boxes);
  dispatch_floating_and_uint8(op, x, [&]<class T>(Type<T>) {
    EraseRectangles<T> const params{planes<T const>(x, layout),
                                    planes<T>(y, layout),
                                    data_ptr<float const>(four),
                                    data_ptr<Compute<T> const>(values),
                                    layout == Layout::channels_last ? 1 : x.size(1),
                                    boxes.size(0) > 1 ? 4 : 0,
                                    values.size(0) > 1 ? values.stride(0) : 0};
    KV_RUN(erase_rectangles, x, params, x.numel() ? params.x.rows() : 0, params.x.row_size());
  });
  return y;
}

}  // namespace

KV_OPERATOR(erase_rectangles, "(Tensor images, Tensor boxes, Tensor values) -> Tensor")

}  // namespace kv::augmentation
