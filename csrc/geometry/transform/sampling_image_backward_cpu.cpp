// The gradient of the images on the CPU: planes [begin, end) of all images in order. One thread adds the samples that
// read a plane in their order, so that sums are the same in every run. Compiled once per instruction set.
#include "geometry/transform/sampling_cpu.h"
#include "geometry/transform/whole_pixels_cpu.h"

namespace kv::geometry::KV_ISA {
namespace {

template <int K, class T>
void scatter_chunk(SampleImageBackward<T> const& p, CoordRow<T> const& coords, int64_t width, T const* grad, T* plane) {
  using F = Compute<T>;
  constexpr int N = kCoordLanes<F>;
  using V = Lanes<F, N>;
  for (int64_t e = 0; e < width; e += N) {
    int const count = int(min(int64_t(N), width - e));
    V u{}, v{};
    for (int i = 0; i < count; ++i) {
      u[i] = coords.u[e + i];
      v[i] = coords.v[e + i];
    }
    TapWindow<K, N, T> window;
    window.set(p, u, v);
    V wx[K], wy[K];
    tap_weights(window.tx, wx);
    tap_weights(window.ty, wy);
    for (int n = 0; n < count; ++n) {
      F const g = load<1>(grad + (e + n) * p.grad.step);
#pragma GCC unroll 1
      for (int j = 0; j < K; ++j) {
        int const y = pixel_at(p.y_axis, int(window.y[n]) + j);
        if (unsigned(y) >= unsigned(p.y_axis.size)) continue;
        F* const row = plane + int64_t(y) * p.x_axis.size;
#pragma GCC unroll 1
        for (int i = 0; i < K; ++i) {
          int const x = pixel_at(p.x_axis, int(window.x[n]) + i);
          F const weight = wx[i][n] * wy[j][n];
          if (unsigned(x) < unsigned(p.x_axis.size) && weight != 0) row[x] += g * weight;
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
  for (int64_t r = begin; r < end; ++r) {
    int64_t const image = r / p.grad.channels;
    int const c = int(r % p.grad.channels);
    bool const is_one = p.is_one_sample_per_image();
    if (K <= 2 && is_one && !p.coords.has_map()) {
      Homography<double> const& map = coords.map_of(p.coords, image);
      if (moves_whole_pixels(map) &&
          (p.x_axis.padding == Padding::fill || stays_inside(map, p.grad.height, p.grad.width, p.coords.use.source))) {
        copy_plane(p, map, image, c);
        continue;
      }
    }
    T* const plane = p.grad_x.row(image, c, 0);
    for (T *at = plane, *last = plane + p.grad_x.height * p.grad_x.width; at < last; ++at) *at = 0;
    for (int64_t b = is_one ? image : 0, last = is_one ? image + 1 : p.grad.batch; b < last; ++b) {
      if (p.image_of(b) != image) continue;
      for_each_row_chunk(0, p.grad.height, p.grad.height, p.grad.width,
                         [&](int64_t, int64_t y, int64_t first, int64_t count) {
                           coords.fill(p.coords, b, y, first, count);
                           scatter_chunk<K>(p, coords, count, p.grad.row(b, c, y) + first * p.grad.step, plane);
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
