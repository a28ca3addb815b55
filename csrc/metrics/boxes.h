// Intersection over union of all pairs of boxes of two sets, and its gradient to the first set.
#pragma once

#include "core/isa.h"

namespace kv::metrics {

// Two corners; the first corner and the size; the center and the size. Exported graphs contain these numbers.
enum class BoxFormat : int { xyxy, xywh, cxcywh };

template <class T>
struct BoxIou {
  T const *a, *b;  // (batch, n, 4), (batch, m, 4)
  int64_t batch, n, m;
  BoxFormat format;
  T* result;  // (batch, n, m)
};

// The gradient to the boxes of the first set; that to the second set is the same with the sets exchanged.
template <class T>
struct BoxIouBackward {
  T const* grad;  // (batch, n, m), with these strides
  int64_t grad_batch_stride, grad_row_stride, grad_stride;
  T const *a, *b;  // (batch, n, 4), (batch, m, 4)
  int64_t batch, n, m;
  BoxFormat format;
  T* result;  // (batch, n, 4)

  KV_HD T const* grad_of(int64_t row) const { return grad + row / n * grad_batch_stride + row % n * grad_row_stride; }
};

KV_KERNEL(box_iou, BoxIou)
KV_KERNEL(box_iou_backward, BoxIouBackward)

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
  // Adds g times the gradient of overlap to x0, y0, x1, y1. Boxes that edge_fraction an edge edge_fraction its
  // gradient, and boxes that touch have that of a growing overlap, as torch differentiates the reference.
  KV_HD void overlap_vjp(Corners const& other, F g, F (&to)[4]) const {
    F const raw_width = min(x1, other.x1) - max(x0, other.x0), raw_height = min(y1, other.y1) - max(y0, other.y0);
    F const width = max(raw_width, F(0)), height = max(raw_height, F(0)), both = width * height;
    F const own = area(), all = own + other.area() - both;
    F const of_all = -g / all * (both / all), of_both = g / all - of_all;
    F const of_width = raw_width >= 0 ? of_both * height : F(0), of_height = raw_height >= 0 ? of_both * width : F(0);
    F const of_own = own == own ? of_all : F(0);
    to[0] -= (x0 < other.x0 ? F(0) : of_width * edge_fraction(x0, other.x0)) + of_own * (y1 - y0);
    to[1] -= (y0 < other.y0 ? F(0) : of_height * edge_fraction(y0, other.y0)) + of_own * (x1 - x0);
    to[2] += (x1 > other.x1 ? F(0) : of_width * edge_fraction(x1, other.x1)) + of_own * (y1 - y0);
    to[3] += (y1 > other.y1 ? F(0) : of_height * edge_fraction(y1, other.y1)) + of_own * (x1 - x0);
  }
  // Of a gradient to x0, y0, x1, y1 that to the box.
  KV_HD static void vjp(BoxFormat format, F (&g)[4]) {
    for (int k = 0; k < 2; ++k) {
      F const low = g[k], high = g[k + 2];
      if (format != BoxFormat::xyxy) g[k] = low + high;
      if (format == BoxFormat::cxcywh) g[k + 2] = (high - low) / 2;
    }
  }

 private:
  KV_HD static F edge_fraction(F edge, F other) { return edge == other ? F(0.5) : F(1); }
};

}  // namespace kv::metrics
