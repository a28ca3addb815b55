// Intersection over union of all pairs of boxes of two sets. Included by boxes_cpu.cpp, boxes.cu and boxes_op.cpp.
#pragma once

#include "core/isa.h"

namespace kv::metrics {

// Two corners; the first corner and the size; the center and the size. Exported graphs contain these numbers;
// python/kvision/metrics/boxes.py repeats them.
enum class BoxFormat : int { xyxy, xywh, cxcywh };

template <class T>
struct BoxIou {
  T const *a, *b;  // (batch, n, 4), (batch, m, 4)
  int64_t batch, n, m;
  BoxFormat format;
  T* result;  // (batch, n, m)
};

KV_KERNEL(box_iou, BoxIou)

template <class F>
struct Corners {
  F x0, y0, x1, y1;

  KV_HD Corners(F const (&box)[4], BoxFormat format) : x0(box[0]), y0(box[1]), x1(box[2]), y1(box[3]) {
    F const width = x1, height = y1;
    if (format == BoxFormat::xywh) x1 += x0, y1 += y0;
    if (format != BoxFormat::cxcywh) return;
    x1 = x0 + width / 2, y1 = y0 + height / 2;
    x0 -= width / 2, y0 -= height / 2;
  }
  // NaN if the box has no area.
  KV_HD F area() const {
    F const width = x1 - x0, height = y1 - y0;
    return width > 0 && height > 0 ? width * height : F(__builtin_nan(""));
  }
  // Of boxes with positive areas.
  KV_HD F overlap(Corners const& other) const {
    F const width = min(x1, other.x1) - max(x0, other.x0), height = min(y1, other.y1) - max(y0, other.y0);
    F const both = width > 0 && height > 0 ? width * height : F(0);
    return both / (area() + other.area() - both);
  }
};

}  // namespace kv::metrics
