// Antialiased resizing of a window of each image of a list, or of all of it: a sample of a list is a batch of one, for
// which the kernels of resize_windows.h are run.
#pragma once

#include "geometry/transform/lists/resize_list.h"
#include "geometry/transform/resize/resize_windows.h"

namespace kv::geometry {

// `all` is what the samples have in common, with the matrices of all of them and without images.
template <class T>
struct ResizeWindowsList {
  ResizeWindows<T> all;
  ListedSamples list;
  int channels;
};

template <class T>
KV_HD ResizeWindows<T> sample_at(ResizeWindowsList<T> const& p, int b) {
  ResizeWindows<T> one = p.all;
  one.x = planes_of(images_of<T>(p.list.images[b], p.channels), p.list.interleaved);
  one.y = planes_of(images_of<T>(p.list.results[b], p.channels, p.list.interleaved), p.list.interleaved);
  one.planes = one.x.outer;
  if (one.matrices) one.matrices += b * p.all.matrix_stride;
  return one;
}

// Where the window is the whole image.
template <class T>
KV_HD Resize<T> resize_at(ResizeWindowsList<T> const& p, int b) {
  ResizeWindows<T> const one = sample_at(p, b);
  return {one.x, one.y, one.resize_axis(one.window(0, 1), 1), one.resize_axis(one.window(0, 0), 0)};
}

KV_KERNEL(resize_windows_list, ResizeWindowsList)

namespace cuda {
// For windows that are whole images, which shrink; others are not served.
template <class T>
int resize_strips_list(ResizeWindowsList<T> p, CUstream_st* stream);
// Resizes the images that shrink a little, and leaves the others in the list.
template <class T>
int resize_columns_list(ResizeWindowsList<T>& p, CUstream_st* stream);
}  // namespace cuda

// On the CPU an item is some rows of a result, where rows of all planes follow each other, or backward a plane. On CUDA
// the launcher divides the results.
inline int64_t items_of_windows(int64_t channels, bool interleaved, int64_t height, int64_t width, bool backward) {
#if defined(KV_CUDA)
  return channels * height * width > 0;
#else
  if (backward) return interleaved ? 1 : channels;
  return items_of_resize(channels, interleaved, height, width);
#endif
}

}  // namespace kv::geometry
