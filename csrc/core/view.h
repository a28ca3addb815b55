// A batch of planes, the view of image tensors that kernels take. Included by every operator's header.
//
// One view serves both memory layouts. A contiguous (B, C, H, W) tensor is B*C planes whose rows hold W elements. A
// channels-last tensor is B planes whose rows hold W*C elements, and the next element of the same channel is C = `step`
// elements away. A stencil written with `step` serves both.
#pragma once

#include "hd.h"

namespace kv {

template <class T>
struct Planes {
  T* data;
  int64_t outer, inner;                            // plane p is (p / inner, p % inner)
  int64_t outer_stride, inner_stride, row_stride;  // in elements
  int64_t height, width;                           // in pixels
  int64_t step;                                    // elements from a pixel to the next one in the same row and channel

  KV_HD int64_t count() const { return outer * inner; }
  KV_HD int64_t rows() const { return count() * height; }
  KV_HD int64_t row_size() const { return width * step; }
  KV_HD T* plane(int64_t p) const {
    if (inner == 1) return data + p * outer_stride;  // dense images: no 64-bit division on the GPU
    return data + (p / inner) * outer_stride + (p % inner) * inner_stride;
  }
  KV_HD T* row(int64_t p, int64_t y) const { return plane(p) + y * row_stride; }
};

}  // namespace kv
