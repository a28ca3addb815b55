// Views of the planes of an image, channel by channel, with or without rows, for statistics per plane. Included by
// *_op.cpp files.
#pragma once

#include "glue/glue.h"
#include "plane_parameter.h"

namespace kv::enhance {

// On the CPU, planes of at least kLargePlane pixels are divided among threads if there are fewer than kManyPlanes
// planes.
constexpr int64_t kLargePlane = 1 << 16, kManyPlanes = 16;

// `x`, copied only if it is not dense: all pixels of a plane then form one row.
inline Tensor dense_planes(Tensor const& x, Layout layout) {
  bool const last = layout == Layout::channels_last;
  if (last ? x.stride(2) == x.size(3) * x.size(1) : x.stride(3) == 1 && x.stride(2) == x.size(3)) return x;
  return last ? as_layout(dense(x), layout) : dense(x);
}

// The planes of an image tensor, one per channel in both layouts.
template <class T>
Planes<T> channel_planes(Tensor const& x, Layout layout) {
  Planes<T> p = planes<T>(x, layout);
  if (layout == Layout::channels_last) p.inner = p.step, p.inner_stride = 1;
  return p;
}

// The planes of a dense tensor, each as one row: pixel i is at i * step elements from the first one.
template <class T>
Planes<T> flat_planes(Tensor const& x, Layout layout) {
  Planes<T> p = channel_planes<T>(x, layout);
  p.width *= p.height;
  p.height = 1;
  p.row_stride = p.row_size();
  return p;
}

// A number, or a tensor with one for each image or channel of x.
template <class F>
PlaneParameter<F> plane_parameter(char const* op, char const* name, Tensor const& x,
                                  std::optional<Tensor> const& tensor, double number) {
  if (!tensor) return {nullptr, 0, 0, 1, F(number)};
  Tensor const& t = *tensor;
  KV_CHECK(t.dim() == 3 && (t.size(0) == 1 || t.size(0) == x.size(0)) && (t.size(1) == 1 || t.size(1) == x.size(1)) &&
               t.size(2) == 1,
           op, ": expected ", name, " of shape (B, C, 1) or with axes of size 1");
  KV_CHECK(t.scalar_type() == (sizeof(F) == 8 ? ScalarType::Double : ScalarType::Float) && t.device() == x.device(), op,
           ": expected ", name, " of the type that is computed in, on the device of input");
  return {data_ptr<F const>(t), t.size(0) > 1 ? t.stride(0) : 0, t.size(1) > 1 ? t.stride(1) : 0, x.size(1), 0};
}

// CUDA: splits planes into chunks, enough for all multiprocessors, and few enough for the block that combines them.
struct Chunks {
  int64_t size, count;
  Chunks(int64_t planes, int64_t pixels)
      : size(max(clamp(planes * pixels / 1024, int64_t(4096), int64_t(16384)), (pixels + 1023) / 1024)),
        count(ceil_div(pixels, size)) {
    size = (size + 7) / 8 * 8;
  }
};

// CUDA: working memory, in the type that T is computed in.
template <class F>
Tensor working_memory([[maybe_unused]] Tensor const& like, [[maybe_unused]] int64_t count) {
#if defined(KV_CUDA)
  return empty({count}, like, Layout::planar, sizeof(F) == 8 ? ScalarType::Double : ScalarType::Float);
#else
  return empty({0}, like, Layout::planar, ScalarType::Float);
#endif
}

// Kernels count the pixels of a plane in int.
inline void check_planes(char const* op, Tensor const& x) {
  check_images(op, "input", x);
  KV_CHECK(x.size(2) <= INT32_MAX / x.size(3), op, ": expected fewer than 2^31 pixels a plane");
}

}  // namespace kv::enhance
