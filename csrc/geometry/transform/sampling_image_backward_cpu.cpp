// The gradient of the images on the CPU: planes [begin, end) of all images in order. One thread adds the samples that
// read a plane in their order, so that sums are the same in every run. The channels of an image are processed together.
// Compiled once per instruction set.
#include "geometry/transform/sampling_cpu.h"
#include "geometry/transform/whole_pixels_cpu.h"

namespace kv::geometry::KV_ISA {
namespace {

// Channels [begin, end) of sample b, whose gradients are added to those of one image.
struct Channels {
  int64_t b, image;
  int begin, end;
};

// The weights of a pixel's taps are computed once for all channels.
template <int K, class T>
void scatter_chunk(SampleImageBackward<T> const& p, CoordRow<T> const& coords, Channels const& channels, int64_t y,
                   int64_t first, int64_t count) {
  using F = Compute<T>;
  constexpr int N = kCoordLanes<F>;
  using V = Lanes<F, N>;
  int64_t const width = p.x_axis.size, grad_stride = p.grad.channel_stride, plane_stride = p.grad_x.channel_stride;
  T const* const grads = p.grad.row(channels.b, channels.begin, y) + first * p.grad.step;
  T* const planes = p.grad_x.row(channels.image, channels.begin, 0);
  int const channel_count = channels.end - channels.begin;
  for (int64_t e = 0; e < count; e += N) {
    int const pixels = int(min(int64_t(N), count - e));
    V u{}, v{};
    if (pixels == N) {
      u = load<N>(coords.u + e);
      v = load<N>(coords.v + e);
    } else {
      for (int i = 0; i < pixels; ++i) u[i] = coords.u[e + i], v[i] = coords.v[e + i];
    }
    TapWindow<K, N, T> window;
    window.set(p, u, v);
    if (window.outside) continue;
    V wx[K], wy[K];
    tap_weights(window.tx, wx);
    tap_weights(window.ty, wy);
    for (int n = 0; n < pixels; ++n) {
      T const* grad = grads + (e + n) * p.grad.step;
      F weights[K][K];
      for (int j = 0; j < K; ++j)
        for (int i = 0; i < K; ++i) weights[j][i] = wx[i][n] * wy[j][n];
      if (window.inside) {
        F* plane = planes + int64_t(window.y[n]) * width + window.x[n];
        F rest = 0;  // not 0 if a gradient is infinite or NaN: taps of weight 0 add nothing
        for (int c = 0; c < channel_count; ++c) rest += grad[c * grad_stride] - grad[c * grad_stride];
        if (rest == 0) {
          for (int c = 0; c < channel_count; ++c, grad += grad_stride, plane += plane_stride) {
            F const g = *grad;
            for (int j = 0; j < K; ++j)
              for (int i = 0; i < K; ++i) plane[j * width + i] += g * weights[j][i];
          }
          continue;
        }
      }
#pragma GCC unroll 1
      for (int j = 0; j < K; ++j) {
        int const row = pixel_at(p.y_axis, int(window.y[n]) + j);
        if (unsigned(row) >= unsigned(p.y_axis.size)) continue;
#pragma GCC unroll 1
        for (int i = 0; i < K; ++i) {
          int const column = pixel_at(p.x_axis, int(window.x[n]) + i);
          if (unsigned(column) >= unsigned(width) || weights[j][i] == 0) continue;
          F* const to = planes + row * width + column;
          for (int c = 0; c < channel_count; ++c) to[c * plane_stride] += grad[c * grad_stride] * weights[j][i];
        }
      }
    }
  }
}

// Whether all pixels of the result are in the image, by a map that moves whole pixels.
KV_HD bool stays_inside(Homography<double> const& map, int64_t height, int64_t width, Size source) {
  auto const is_side = [](double x, int64_t size) { return x >= 0 && x < double(size); };
  return is_side(map.m[2], source.width) && is_side(map.m[2] + map.m[0] * double(width - 1), source.width) &&
         is_side(map.m[5], source.height) && is_side(map.m[5] + map.m[4] * double(height - 1), source.height);
}

// Plane c of an image that only sample b reads, by a map that moves whole pixels: the inverse map moves the gradient.
template <class T>
void copy_plane(SampleImageBackward<T> const& p, Homography<double> const& map, int64_t b, int c) {
  Homography<double> inverse = map;
  for (int axis = 0; axis < 2; ++axis) inverse.m[3 * axis + 2] = -map.m[4 * axis] * map.m[3 * axis + 2];
  copy_rows(channel_of(p.grad, c), b, channel_of(p.grad_x, c), b, inverse, 0, p.grad_x.height,
            [&](Images<T> const& plane, int, int64_t y, int64_t first, int64_t count) {
              fill_pixels(plane, b, y, first, count, [](int) { return T(0); });
            });
}

template <int K, class T>
void scatter_planes(SampleImageBackward<T> const& p, int64_t begin, int64_t end) {
  CoordRow<T> coords;
  bool const is_one = p.is_one_sample_per_image();
  while (begin < end) {
    int64_t const image = begin / p.grad.channels, next = min(end, (image + 1) * p.grad.channels);
    Channels channels{image, image, int(begin % p.grad.channels), 0};
    channels.end = channels.begin + int(next - begin);
    begin = next;
    // Special case: copies are 4.6 times as fast as adding to taps, one thread.
    if (K <= 2 && is_one && !p.coords.has_map()) {
      Homography<double> const& map = coords.map_of(p.coords, image);
      if (moves_whole_pixels(map) &&
          (p.x_axis.padding == Padding::fill || stays_inside(map, p.grad.height, p.grad.width, p.coords.use.source))) {
        for (int c = channels.begin; c < channels.end; ++c) copy_plane(p, map, image, c);
        continue;
      }
    }
    for (int c = channels.begin; c < channels.end; ++c) {
      T* const plane = p.grad_x.row(image, c, 0);
      for (T *at = plane, *last = plane + p.grad_x.height * p.grad_x.width; at < last; ++at) *at = 0;
    }
    for (int64_t b = is_one ? image : 0, last = is_one ? image + 1 : p.grad.batch; b < last; ++b) {
      if (p.image_of(b) != image) continue;
      channels.b = b;
      for_each_row_chunk(0, p.grad.height, p.grad.height, p.grad.width,
                         [&](int64_t, int64_t y, int64_t first, int64_t count) {
                           coords.fill(p.coords, b, y, first, count);
                           scatter_chunk<K>(p, coords, channels, y, first, count);
                         });
    }
  }
}

}  // namespace

template <class T>
void sample_image_backward(SampleImageBackward<T> const& p, int64_t begin, int64_t end) {
  switch (p.interpolation) {
    case Interpolation::nearest:
      return scatter_planes<1>(p, begin, end);
    case Interpolation::bilinear:
      return scatter_planes<2>(p, begin, end);
    case Interpolation::bicubic:
      return scatter_planes<4>(p, begin, end);
  }
}

KV_INSTANTIATE_COMPUTED(sample_image_backward, SampleImageBackward)

}  // namespace kv::geometry::KV_ISA
