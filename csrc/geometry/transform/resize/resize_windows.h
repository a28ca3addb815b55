// Antialiased resizing of a window of each image, as RandomResizedCrop does: windows, filters and bands are those of
// resize.h, along axes that begin at the window's first pixel. Pixels around the window are not read.
//
// The window of a sample is what its matrix, from pixels of the image to pixels of the result, maps to the result. It
// is rounded to whole pixels. A negative scale mirrors the result. Without matrices it is the whole image. Where there
// are several views of each image, sample s is view s / images of image s % images, and boxes say what the windows are.
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
  Compute<T> const* matrices = nullptr;  // 3 x 3, of this stride, which is 0 where one serves all
  int64_t matrix_stride = 0;
  // Instead of matrices, forward only: x, y, width and height for each view of each image, in whole pixels.
  Compute<T> const* boxes = nullptr;
  int64_t images = 0, box_image_stride = 0, box_view_stride = 0;
  unsigned views = 1;       // of each image
  bool one_number = false;  // backward: all elements of `x` are its first one, as the gradient of a sum is

  // The samples in the order in which they are processed: those of an image, which is in the cache then, one after the
  // other.
  KV_HD int64_t sample_of(unsigned number) const {
    return boxes ? int64_t(number % views) * images + number / views : number;
  }
  KV_HD int64_t image_of(int64_t sample) const { return boxes ? unsigned(sample) % unsigned(images) : sample; }
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
  if (boxes) {
    int64_t const image = image_of(sample), view = unsigned(sample) / unsigned(images);
    Compute<T> const* const box = boxes + image * box_image_stride + view * box_view_stride;
    int const first = round_within(double(box[axis]), 0, source(axis) - 1);
    return {first, round_within(double(box[2 + axis]), 1, source(axis) - first), false};
  }
  if (!matrices) return {0, source(axis), false};
  Compute<T> const* const m = matrices + sample * matrix_stride;
  return window_of(double(m[4 * axis]), double(m[3 * axis + 2]), source(axis), result(axis), align_corners);
}

}  // namespace kv::geometry
