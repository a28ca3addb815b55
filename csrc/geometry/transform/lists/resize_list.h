// Resizing of lists of images of different sizes: each has axes of its own, for which the kernels of resize.h are run.
#pragma once

#include "core/image_list.h"
#include "geometry/transform/resize/resize.h"

namespace kv::geometry {

template <class T>
struct ResizeList {
  ListedSamples list;
  int channels;
  ResizeFilter filter;
  bool align_corners, antialias, backward;
};

template <class T>
KV_HD ResizeAxis resize_axis_at(ResizeList<T> const& p, int64_t from, int64_t to) {
  return {p.filter, p.backward ? to : from, p.backward ? from : to, p.align_corners, p.antialias, p.backward};
}

KV_KERNEL(resize_list, ResizeList)

// An item is some rows of a plane or of interleaved pixels on the CPU, where rows of all planes follow each other; on
// CUDA so many elements of so many rows, in all planes.
constexpr int kItemColumns = 128, kItemRows = 16;
KV_HD int64_t rows_of_resize_item(int64_t row_size) { return max(int64_t(1), kItemPixels / row_size); }
inline int64_t items_of_resize(int64_t channels, bool interleaved, int64_t height, int64_t width) {
#if defined(KV_CUDA)
  return ceil_div(width * (interleaved ? channels : 1), kItemColumns) * ceil_div(height, kItemRows);
#else
  int64_t const row_size = width * (interleaved ? channels : 1), rows = height * (interleaved ? 1 : channels);
  return ceil_div(rows, rows_of_resize_item(row_size));
#endif
}

}  // namespace kv::geometry
