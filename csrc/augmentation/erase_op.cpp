// Erased rectangles: schema and entry, for CPU and CUDA.
#include "augmentation/erase.h"
#include "glue/glue.h"

namespace kv::augmentation {
namespace {

// Images (B, C, H, W), boxes (B, N, 4) float32, values (B, C), or (B, 1) for all channels, of the type that is computed
// in.
Tensor erase_rectangles(Tensor const& images, Tensor const& boxes, Tensor const& values) {
  constexpr char const* op = "erase_rectangles";
  check_images(op, "images", images);
  int64_t const batch = images.size(0), channels = images.size(1);
  auto const fits = [&](Tensor const& t, int64_t axes, ScalarType type) {
    return t.dim() == axes && (t.size(0) == batch || t.size(0) == 1) && t.scalar_type() == type &&
           t.device() == images.device();
  };
  KV_CHECK(fits(boxes, 3, ScalarType::Float) && boxes.size(2) == 4, op,
           ": expected float32 boxes of shape (B, N, 4) on the device of images");
  KV_CHECK(fits(values, 2, compute_dtype(images)) && (values.size(1) == channels || values.size(1) == 1), op,
           ": expected values of shape (B, C) or (B, 1), of the type that is computed in, on the device of images");
  Layout const layout = layout_of(images);
  Tensor const x = as_layout(images, layout), y = empty_like(x, layout);
  // Columns of drawn parameters are read where they are.
  Tensor const rectangles = boxes.stride(1) == 4 && boxes.stride(2) == 1 ? boxes : dense(boxes);
  dispatch_floating_and_uint8(op, x, [&]<class T>(Type<T>) {
    EraseRectangles<T> const params{planes<T const>(x, layout),
                                    planes<T>(y, layout),
                                    data_ptr<float const>(rectangles),
                                    data_ptr<Compute<T> const>(values),
                                    batch,
                                    boxes.size(1),
                                    layout == Layout::channels_last ? 1 : channels,
                                    boxes.size(0) > 1 ? rectangles.stride(0) : 0,
                                    values.size(0) > 1 ? values.stride(0) : 0,
                                    values.size(1) > 1 ? values.stride(1) : 0};
    KV_RUN(erase_rectangles, x, params, x.numel() ? params.x.rows() : 0, params.x.row_size());
  });
  return y;
}

}  // namespace

KV_OPERATOR(erase_rectangles, "(Tensor images, Tensor boxes, Tensor values) -> Tensor")

}  // namespace kv::augmentation
