// Intersection over union of boxes: schema and operator, for CPU and CUDA.
#include "boxes.h"
#include "glue/batch.h"

namespace kv::metrics {
namespace {

BoxFormat check_format(int64_t format) {
  KV_CHECK(format >= 0 && format <= 2, "box_iou: format must be one of 0 (xyxy), 1 (xywh), 2 (cxcywh); got ", format);
  return BoxFormat(format);
}

// A batch of size 1 is broadcast.
Tensor box_iou(Tensor const& boxes, Tensor const& others, int64_t format) {
  constexpr char const* op = "box_iou";
  KV_CHECK(boxes.dim() == 3 && others.dim() == 3 && boxes.size(2) == 4, op, ": expected boxes (batch, n, 4)");
  int64_t const batch = boxes.size(0) == 1 ? others.size(0) : boxes.size(0), n = boxes.size(1), m = others.size(1);
  check_sizes(op, "boxes", boxes, boxes, {batch, n, 4});
  check_sizes(op, "others", others, boxes, {batch, m, 4});
  BoxFormat const kind = check_format(format);
  Tensor const a = expand_batch(boxes, batch), b = expand_batch(others, batch), result = empty({batch, n, m}, boxes);
  dispatch_floating(op, boxes, [&](auto type) {
    using T = typename decltype(type)::type;
    BoxIou<T> const params{data_ptr<T const>(a), data_ptr<T const>(b), batch, n, m, kind, data_ptr<T>(result)};
    KV_RUN(box_iou, boxes, params, m > 0 ? batch * n : 0, 16 * m);
  });
  return result;
}

}  // namespace

KV_OPERATOR(box_iou, "(Tensor boxes, Tensor others, int format) -> Tensor")

}  // namespace kv::metrics
