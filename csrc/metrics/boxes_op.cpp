// Intersection over union of boxes: schemas and entries, for CPU and CUDA.
#include "boxes.h"
#include "glue/batch.h"

namespace kv::metrics {
namespace {

BoxFormat check_format(char const* op, int64_t format) {
  KV_CHECK(format >= 0 && format <= 2, op, ": format must be one of 0 (xyxy), 1 (xywh), 2 (cxcywh); got ", format);
  return BoxFormat(format);
}

// (batch, n, m) of the result. A batch of size 1 is broadcast.
std::vector<int64_t> check_boxes(char const* op, Tensor const& boxes, Tensor const& others) {
  KV_CHECK(boxes.dim() == 3 && others.dim() == 3 && boxes.size(2) == 4, op, ": expected boxes (batch, n, 4)");
  int64_t const batch = boxes.size(0) == 1 ? others.size(0) : boxes.size(0), n = boxes.size(1), m = others.size(1);
  check_sizes(op, "boxes", boxes, boxes, {batch, n, 4});
  check_sizes(op, "others", others, boxes, {batch, m, 4});
  return {batch, n, m};
}

Tensor box_iou(Tensor const& boxes, Tensor const& others, int64_t format) {
  constexpr char const* op = "box_iou";
  std::vector<int64_t> const sizes = check_boxes(op, boxes, others);
  int64_t const batch = sizes[0], n = sizes[1], m = sizes[2];
  BoxFormat const kind = check_format(op, format);
  Tensor const a = expand_batch(boxes, batch), b = expand_batch(others, batch), result = empty({batch, n, m}, boxes);
  dispatch_floating(op, boxes, [&](auto type) {
    using T = typename decltype(type)::type;
    BoxIou<T> const params{data_ptr<T const>(a), data_ptr<T const>(b), batch, n, m, kind, data_ptr<T>(result)};
    KV_RUN(box_iou, boxes, params, m > 0 ? batch * n : 0, 16 * m);
  });
  return result;
}

// The gradient to `boxes`, for every sample of the batch.
Tensor box_iou_backward(Tensor const& grad, Tensor const& boxes, Tensor const& others, int64_t format) {
  constexpr char const* op = "box_iou_backward";
  std::vector<int64_t> const sizes = check_boxes(op, boxes, others);
  int64_t const batch = sizes[0], n = sizes[1], m = sizes[2];
  check_sizes(op, "grad", grad, boxes, sizes);
  BoxFormat const kind = check_format(op, format);
  Tensor const a = expand_batch(boxes, batch), b = expand_batch(others, batch), result = empty({batch, n, 4}, boxes);
  dispatch_floating(op, boxes, [&](auto type) {
    using T = typename decltype(type)::type;
    BoxIouBackward<T> const params{data_ptr<T const>(grad),
                                   grad.size(0) == 1 ? 0 : grad.stride(0),
                                   grad.stride(1),
                                   grad.stride(2),
                                   data_ptr<T const>(a),
                                   data_ptr<T const>(b),
                                   batch,
                                   n,
                                   m,
                                   kind,
                                   data_ptr<T>(result)};
    KV_RUN(box_iou_backward, boxes, params, batch * n, 32 * m);
  });
  return result;
}

}  // namespace

// Either set of boxes may have a batch of one that serves all of the other's.
KV_OPERATOR(box_iou, "(Tensor boxes, Tensor others, int format) -> Tensor")
KV_OPERATOR(box_iou_backward, "(Tensor grad, Tensor boxes, Tensor others, int format) -> Tensor")

}  // namespace kv::metrics
