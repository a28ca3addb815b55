// The transpose of derivatives of an image on CUDA; warps go down strips as in spatial_gradient.cu.
#include "core/launch.cuh"
#include "spatial_gradient.h"

namespace kv::filters::cuda {
namespace {

template <class Kernel>
constexpr int kRows = Kernel::reach == 1 ? 16 : 32;

// In the same order as the forward pass: along the rows of each channel, then along y.
template <class Kernel, class T, bool Aligned>
__global__ void __launch_bounds__(256) backward_strip(SpatialGradientBackward<T> p, Strips<> strips) {
  constexpr int R = Kernel::reach, channels = Kernel::order + 1;
  using F = Compute<T>;
  int64_t plane;
  int x, y0;
  if (!strips.locate(plane, x, y0)) return;
  int const width = int(p.grad_x.width), height = int(p.grad_x.height), y1 = min(y0 + int(strips.rows), height);
  using Strip = Strip<R, Aligned>;
  Strip const strip(x, width, Border::constant);
  int64_t const channel_stride = p.grad.outer_stride;
  T const* const grad = p.grad.plane(plane * channels);
  T* out = p.grad_x.row(plane, y0);

  int next_y = y0 - R;
  typename Strip::FetchedRow<T> prefetched[channels];
  auto const fetch = [&] {  // out of bounds the gradient is 0
#pragma unroll
    for (int c = 0; c < channels; ++c) {
      prefetched[c] = {};
      if (next_y >= 0 && next_y < height)
        prefetched[c] = strip.fetch(grad + c * channel_stride + next_y * p.grad.row_stride);
    }
    ++next_y;
  };
  F along[2 * R + 1][channels][4];  // rows y - R ... y + R
  auto const next = [&](F(&to)[channels][4]) {
    F v[channels][4 + 2 * R];
#pragma unroll
    for (int c = 0; c < channels; ++c) strip.spread(prefetched[c], v[c]);
    fetch();
    for_each_channel<Kernel>([&](auto c) {
#pragma unroll
      for (int i = 0; i < 4; ++i) {
        bool const first = i == 0 && x == 0, last = (i == 3 || !Aligned) && x + i == width - 1;
        to[c.value][i] = c.along().dot_vjp([&](int k) { return v[c.value][i + k]; }, first, last);
      }
    });
  };
  fetch();
#pragma unroll
  for (int k = 0; k < 2 * R; ++k) next(along[k]);
#pragma unroll 1
  for (int y = y0; y < y1; ++y) {
    next(along[2 * R]);
    F result[4]{};
    for_each_channel<Kernel>([&](auto c) {
#pragma unroll
      for (int i = 0; i < 4; ++i)
        result[i] += c.down().dot_vjp([&](int k) { return along[k][c.value][i]; }, y == 0, y == height - 1) *
                     c.template scale<F>(p.normalized);
    });
    strip.store_in_stripes(out, result);
    out += p.grad_x.row_stride;
#pragma unroll
    for (int k = 0; k < 2 * R; ++k)
#pragma unroll
      for (int c = 0; c < channels; ++c)
#pragma unroll
        for (int i = 0; i < 4; ++i) along[k][c][i] = along[k + 1][c][i];
  }
}

}  // namespace

template <class T>
int spatial_gradient_backward(SpatialGradientBackward<T> const& p, CUstream_st* stream) {
  dispatch_kernel(p.kind, [&](auto kernel) {
    using Kernel = decltype(kernel);
    Strips<> const strips(p.grad_x.count(), p.grad_x.height, p.grad_x.width, kRows<Kernel>);
    with_alignment<T>(is_vectorizable<4>(p.grad) && is_vectorizable<4>(p.grad_x), [&](auto aligned) {
      backward_strip<Kernel, T, aligned.value><<<strips.blocks(), 256, 0, stream>>>(p, strips);
    });
  });
  return cudaGetLastError();
}

KV_INSTANTIATE(spatial_gradient_backward, SpatialGradientBackward)

}  // namespace kv::filters::cuda
