// Antialiased resizing of a window of each image, as RandomResizedCrop does: windows, filters and bands are those of
// resize.h, along axes that begin at the window's first pixel. Pixels around the window are not read. Included by
// resize_windows*.cpp, resize_windows.cu and resize_windows_glue.h.
//
// The window of a sample is what its matrix, from pixels of the image to pixels of the result, maps to the result. It
// is rounded to whole pixels. A negative scale mirrors the result.
#pragma once

#include "core/window.h"
#include "geometry/transform/resize/resize.h"

namespace kv::geometry {

template <class T>
struct ResizeWindows {
  Planes<T const> x;    // the images or, backward, the gradient of the results
  Planes<T> y;          // the results or, backward, the gradient of the images
  int64_t planes;       // of a sample
  ResizeFilter filter;  // bilinear, bicubic or lanczos
  bool align_corners, backward;
  Compute<T> const* matrices;  // 3 x 3, of this stride, which is 0 where one serves all
  int64_t matrix_stride;

  // Of samples: 0 along x, 1 along y.
  KV_HD int source(int axis) const { return backward ? size(y, axis) : size(x, axis); }
  KV_HD int result(int axis) const { return backward ? size(x, axis) : size(y, axis); }
  KV_HD Window window(int64_t sample, int axis) const;
  KV_HD ResizeAxis resize_axis(Window const& window, int axis) const {
    return {filter, window.size, result(axis), align_corners, true, backward};
  }

 private:
  template <class U>
  static KV_HD int size(Planes<U> const& images, int axis) {
    return int(axis ? images.height : images.width);
  }
};

KV_KERNEL(resize_windows, ResizeWindows)

template <class T>
KV_HD Window ResizeWindows<T>::window(int64_t sample, int axis) const {
  Compute<T> const* const m = matrices + sample * matrix_stride;
  return window_of(double(m[4 * axis]), double(m[3 * axis + 2]), source(axis), result(axis), align_corners);
}

}  // namespace kv::geometry
