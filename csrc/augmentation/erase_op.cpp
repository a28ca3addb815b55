// Erased rectangles and grids: schemas and entries, for CPU and CUDA.
#include "augmentation/erase.h"
#include "glue/glue.h"

namespace kv::augmentation {
namespace {

// Images (B, C, H, W); parts (B or 1, ...) float32; values (B, C), or (B, 1) for all channels, of the type that is
// computed in. run(x, y, erase) gets the parameters that all parts have.
template <class Run>
Tensor erase(char const* op, Tensor const& images, Tensor const& parts, bool are_parts, char const* expected,
             Tensor const& values, Run run) {
  check_images(op, "images", images);
  int64_t const batch = images.size(0), channels = images.size(1);
  auto const fits = [&](Tensor const& t, ScalarType type) {
    return (t.size(0) == batch || t.size(0) == 1) && t.scalar_type() == type && t.device() == images.device();
  };
  KV_CHECK(are_parts && fits(parts, ScalarType::Float), op, ": expected float32 ", expected,
           " on the device of images");
  KV_CHECK(
      values.dim() == 2 && fits(values, compute_dtype(images)) && (values.size(1) == channels || values.size(1) == 1),
      op, ": expected values of shape (B, C) or (B, 1), of the type that is computed in, on the device of images");
  Layout const layout = layout_of(images);
  Tensor const x = as_layout(images, layout), y = empty_like(x, layout);
  dispatch_floating_and_uint8(op, x, [&]<class T>(Type<T>) {
    run(x, Erase<T>{planes<T const>(x, layout), planes<T>(y, layout), data_ptr<Compute<T> const>(values), batch,
                    layout == Layout::channels_last ? 1 : channels, values.size(0) > 1 ? values.stride(0) : 0,
                    values.size(1) > 1 ? values.stride(1) : 0});
  });
  return y;
}

// Boxes (B, N, 4).
Tensor erase_rectangles(Tensor const& images, Tensor const& boxes, Tensor const& values) {
  bool const are_boxes = boxes.dim() == 3 && boxes.size(2) == 4;
  // Columns of drawn parameters are read where they are.
  Tensor const rectangles = !are_boxes || (boxes.stride(1) == 4 && boxes.stride(2) == 1) ? boxes : dense(boxes);
  return erase("erase_rectangles", images, boxes, are_boxes, "boxes of shape (B, N, 4)", values,
               [&]<class T>(Tensor const& x, Erase<T> const& erase) {
                 EraseRectangles<T> const params{erase, data_ptr<float const>(rectangles), boxes.size(1),
                                                 boxes.size(0) > 1 ? rectangles.stride(0) : 0};
                 KV_RUN(erase_rectangles, x, params, x.numel() ? params.x.rows() : 0, params.x.row_size());
               });
}

// Grids (B, 5): the width of lines, the angle, offsets along x and y, the number of cells.
Tensor erase_grid(Tensor const& images, Tensor const& grids, Tensor const& values) {
  bool const are_grids = grids.dim() == 2 && grids.size(1) == kGridNumbers;
  Tensor const own = are_grids ? dense(grids) : grids;
  return erase("erase_grid", images, grids, are_grids, "grids of shape (B, 5)", values,
               [&]<class T>(Tensor const& x, Erase<T> const& erase) {
                 EraseGrid<T> const params{erase, data_ptr<float const>(own), own.size(0) > 1 ? own.stride(0) : 0};
                 KV_CHECK(params.x.width <= INT32_MAX / 4 && params.x.height <= INT32_MAX / 4, "erase_grid",
                          ": expected smaller images");
                 KV_RUN(erase_grid, x, params, x.numel() ? params.x.rows() : 0, 8 * params.x.row_size());
               });
}

}  // namespace

KV_OPERATOR(erase_rectangles, "(Tensor images, Tensor boxes, Tensor values) -> Tensor")
KV_OPERATOR(erase_grid, "(Tensor images, Tensor grids, Tensor values) -> Tensor")

}  // namespace kv::augmentation
