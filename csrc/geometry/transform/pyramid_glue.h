// Resizing and blurring for operators that build a pyramid of contiguous planes. Included by their *_op.cpp files.
#pragma once

#include "filters/separable_glue.h"
#include "geometry/transform/resize/resize.h"

namespace kv {

// `count` contiguous planes, one after the other.
template <class T>
Planes<T> adjacent_planes(T* data, int64_t count, int64_t height, int64_t width) {
  return {data, count, 1, height * width, 0, width, height, width, 1};
}

// The level `level` of `levels` of each of `count` images.
template <class T>
Planes<T> planes_of_level(T* data, int64_t count, int64_t levels, int64_t level, int64_t height, int64_t width) {
  return {data + level * height * width, count, 1, levels * height * width, 0, width, height, width, 1};
}

}  // namespace kv

namespace kv::geometry {

// Resizes x to the size of y. `like` is a tensor on their device.
template <class T>
void resize_planes([[maybe_unused]] Tensor const& like, Planes<T const> const& x, Planes<T> const& y,
                   ResizeFilter filter, bool align_corners, Border border = Border::replicate) {
  auto const axis = [&](int64_t source, int64_t result) {
    return ResizeAxis(filter, source, result, align_corners, false, false, border);
  };
  Resize<T> const params{x, y, axis(x.height, y.height), axis(x.width, y.width)};
  KV_RUN(resize, like, params, params.y.rows(),
         params.rows.max_taps * x.row_size() + params.columns.max_taps * y.row_size());
}

}  // namespace kv::geometry

namespace kv::filters {

// Blurs x by a Gaussian with a window of `size` pixels and the reflect border.
template <class T>
void blur_planes(char const* op, [[maybe_unused]] Tensor const& like, Planes<T const> const& x, Planes<T> const& y,
                 int64_t size, double sigma) {
  check_window(op, size, size);
#if defined(KV_CUDA)
  KV_CHECK(size <= kMaxTaps, op, ": expected a kernel of at most ", kMaxTaps, " weights a side on CUDA, got ", size);
#endif
  check_border(op, Border::reflect, size / 2, x.height);
  check_border(op, Border::reflect, size / 2, x.width);
  using F = Compute<T>;
  auto const taps = AxisWeights{nullptr, size, true, 0, sigma}.template taps<F>(true, false);
  Separable<T> const params{x, y, taps, taps, 1, F(1), F(0), Border::reflect, Border::constant};
  KV_RUN(separable, like, params, y.rows(), y.row_size() * size / 2);
}

}  // namespace kv::filters
