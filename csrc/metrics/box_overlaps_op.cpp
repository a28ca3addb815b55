// Overlaps of boxes: schema and entry, for CPU and CUDA alike.
#include "box_overlaps.h"
#include "glue/batch.h"

namespace kv {
namespace {

BoxFormat format_of(std::string const& name) {
  if (name == "xyxy") return BoxFormat::xyxy;
  if (name == "xywh") return BoxFormat::xywh;
  KV_CHECK(name == "cxcywh", "box_overlaps: format must be one of xyxy, xywh, cxcywh; got '", name, "'");
  return BoxFormat::cxcywh;
}

// One of either may serve a batch.
Tensor box_overlaps(Tensor const& boxes, Tensor const& others, std::string const& format) {
  constexpr char const* op = "box_overlaps";
  KV_CHECK(boxes.dim() == 3 && others.dim() == 3 && boxes.size(2) == 4, op, ": expected boxes (batch, n, 4)");
  int64_t const batch = boxes.size(0) == 1 ? others.size(0) : boxes.size(0), n = boxes.size(1), m = others.size(1);
  check_sizes(op, "boxes", boxes, boxes, {batch, n, 4});
  check_sizes(op, "others", others, boxes, {batch, m, 4});
  BoxFormat const kind = format_of(format);
  Tensor const a = expand_batch(boxes, batch), b = expand_batch(others, batch), found = empty({batch, n, m}, boxes);
  dispatch_floating(op, boxes, [&](auto type) {
    using T = typename decltype(type)::type;
    BoxOverlaps<T> const params{data_ptr<T const>(a), data_ptr<T const>(b), batch, n, m, kind, data_ptr<T>(found)};
    KV_RUN(box_overlaps, boxes, params, m > 0 ? batch * n : 0, 16 * m);
  });
  return found;
}

}  // namespace

KV_OPERATOR(box_overlaps, "(Tensor boxes, Tensor others, str format) -> Tensor")

}  // namespace kv
