// Antialiased resizing of a window of each image, as RandomResizedCrop does: windows, filters and bands are those of
// resize.h, along axes that begin at the window's first pixel. Pixels around the window are not read. Included by
// resize_windows*.cpp, resize_windows.cu and resize_windows_glue.h.
//
// The window of a sample is what its matrix, from pixels of the image to pixels of the result, maps to the result. It
// is rounded to whole pixels. A negative scale mirrors the result.
#pragma once

#include "geometry/transform/resize/resize.h"

namespace kv::geometry {

// The window along one axis.
struct Window {
  int first, size;
  bool mirrored;
};

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

// The nearest whole number in [low, high]; `low` for NaN.
KV_HD int round_within(double x, int low, int high) { return x > double(low) ? int(min(x, double(high)) + 0.5) : low; }

template <class T>
KV_HD Window ResizeWindows<T>::window(int64_t sample, int axis) const {
  Compute<T> const* const m = matrices + sample * matrix_stride;
  double const scale = double(m[4 * axis]), offset = double(m[3 * axis + 2]), length = scale < 0 ? -scale : scale;
  int const to = result(axis), from = source(axis);
  bool const mirrored = scale < 0;
  Window window{0, 1, mirrored};
  if (align_corners) {  // the centers of the outermost pixels correspond; a single pixel of the result has one tap
    window.first = round_within(((mirrored ? to - 1 : 0) - offset) / scale, 0, from - 1);
    if (to > 1) window.size = 1 + round_within((to - 1) / length, 0, from - 1 - window.first);
  } else {
    window.first = round_within(((mirrored ? to - 0.5 : -0.5) - offset) / scale + 0.5, 0, from - 1);
    window.size = round_within(to / length, 1, from - window.first);
  }
  return window;
}

}  // namespace kv::geometry
