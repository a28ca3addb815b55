// The gradients of antialiased sampling on the CPU: to the images, planes [begin, end) of all of them in order, and to
// sampling coordinates, rows of the output. One thread adds what reads a plane in its order, so that sums are the same
// in every run. Compiled once per instruction set.
#include "geometry/transform/antialiased/antialiased_cpu.h"

namespace kv::geometry::KV_ISA {
namespace {

// Adds the gradients of a pixel to channels [first, last) of an image.
template <class T, class F>
KV_HD void scatter(SampleImageBackward<T> const& p, CoveredPixel<F> const& pixel, int64_t image, int first, int last,
                   T const* grad) {
  CoveredTaps<F> const& window = pixel.window;
  if (window.is_outside(p)) return;
  using Pixel = CoveredPixel<F>;
  F weights[kRowTaps];
  typename Pixel::V sums{};
  for (int j = window.first_y; j <= window.last_y; ++j) pixel.row_weights(j, weights, sums);
  F const total = sum_of_lanes<Pixel::N>(sums);
  int const columns = pixel.columns();
  bool const inside = window.is_inside(p);
  for (int j = window.first_y; j <= window.last_y; ++j) {
    int const row = padded_pixel(p.y_axis, j);
    if (row < 0) continue;
    pixel.row_weights(j, weights, sums);
    for (int c = first; c < last; ++c) {
      F const g = grad[c * p.grad.channel_stride] / total;
      F* const to = p.grad_x.row(image, c, row);
      if (inside && g - g == 0) {
        for (int i = 0; i < columns; ++i) to[window.first_x + i] += g * weights[i];
        continue;
      }
      for (int i = 0; i < columns; ++i) {
        int const column = padded_pixel(p.x_axis, window.first_x + i);
        if (column >= 0 && weights[i] > 0) to[column] += g * weights[i];
      }
    }
  }
}

}  // namespace

template <class T>
void sample_antialiased_image_backward(SampleImageBackward<T> const& p, int64_t begin, int64_t end) {
  CoordRow<T> coords;
  bool const is_one = p.is_one_sample_per_image();
  while (begin < end) {
    int64_t const image = begin / p.grad.channels, next = min(end, (image + 1) * p.grad.channels);
    int const first = int(begin % p.grad.channels), last = first + int(next - begin);
    begin = next;
    for (int c = first; c < last; ++c) {
      T* const plane = p.grad_x.row(image, c, 0);
      for (T *at = plane, *stop = plane + p.grad_x.height * p.grad_x.width; at < stop; ++at) *at = 0;
    }
    for (int64_t b = is_one ? image : 0, stop = is_one ? image + 1 : p.grad.batch; b < stop; ++b) {
      if (p.image_of(b) != image) continue;
      for_each_row_chunk(0, p.grad.height, p.grad.height, p.grad.width,
                         [&](int64_t, int64_t y, int64_t x, int64_t count) {
                           T const* const grads = p.grad.row(b, 0, y) + x * p.grad.step;
                           for_each_covered(p, coords, b, y, x, count, [&](int64_t i, auto const& pixel) KV_INLINE {
                             scatter(p, pixel, image, first, last, grads + i * p.grad.step);
                           });
                         });
    }
  }
}

template <class T>
void sample_antialiased_coords_backward(AntialiasedCoordsBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const height = p.grad.height;
  if (p.sums)
    for (double *sum = p.sums + 9 * begin, *last = p.sums + 9 * end; sum < last; ++sum) *sum = 0;
  CoordRow<F> coords;
  for_each_row_chunk(begin, end, height, p.grad.width, [&](int64_t b, int64_t y, int64_t first, int64_t count) {
    T const* const grads = p.grad.row(b, 0, y) + first * p.grad.step;
    for_each_covered(p, coords, b, y, first, count, [&](int64_t i, CoveredPixel<F> const& pixel) KV_INLINE {
      CoveredTaps<F> const& window = pixel.window;
      T const* const grad = grads + i * p.grad.step;
      F by_u = 0, by_v = 0;
      Jacobian<F> by_j{};
      if (!window.is_outside(p)) {
        TapSums<F> sums;
        for (int j = window.first_y; j <= window.last_y; ++j) {
          int const row = padded_pixel(p.y_axis, j);
          for (int k = window.first_x; k <= window.last_x; ++k) {
            int const column = padded_pixel(p.x_axis, k);
            F x = 0;
            for (int c = 0; c < p.x.channels; ++c) {
              F const value = row < 0 || column < 0 ? p.fill_value(b, c)
                                                    : load<1>(p.x.row(p.image_of(b), c, row) + column * p.x.step);
              x += load<1>(grad + c * p.grad.channel_stride) * value;
            }
            sums.add(pixel.footprint, F(k) - window.u, F(j) - window.v, x);
          }
        }
        sums.gradients(Shrink<F>(pixel.slopes), pixel.footprint, by_u, by_v, by_j);
        if (CoveredTaps<F>::is_fixed(p.x_axis, coords.u[i])) by_u = 0;
        if (CoveredTaps<F>::is_fixed(p.y_axis, coords.v[i])) by_v = 0;
      }
      if (p.sums) {
        Homography<double> const& map = coords.map_of(p.coords, b);
        double const x = double(first + i), v = double(coords.v[i]), u = double(coords.u[i]);
        jacobian_vjp<double>(map, map.weight(x, double(y)), x, double(y), u, v,
                             jacobian<double>(map, x, double(y), u, v), double(by_u), double(by_v),
                             {double(by_j.ux), double(by_j.uy), double(by_j.vx), double(by_j.vy)},
                             p.sums + 9 * (b * height + y));
        return;
      }
      p.grad_x.row(b, 0, y)[first + i] = by_u * p.coords.scale[0];
      p.grad_y.row(b, 0, y)[first + i] = by_v * p.coords.scale[1];
      F const by_slopes[] = {by_j.ux * p.coords.scale[0], by_j.uy * p.coords.scale[0], by_j.vx * p.coords.scale[1],
                             by_j.vy * p.coords.scale[1]};
      for (int k = 0; k < 4; ++k) p.grad_jacobian.row(b, k, y)[first + i] = by_slopes[k];
    });
  });
}

template <class F>
void map_differences_backward(MapDifferencesBackward<F> const& p, int64_t begin, int64_t end) {
  int64_t const height = p.grad_x.height;
  for (int64_t row = begin; row < end; ++row)
    for (int64_t x = 0; x < p.grad_x.width; ++x) p.add(row / height, row % height, x);
}

KV_INSTANTIATE_COMPUTED(sample_antialiased_image_backward, SampleImageBackward)
KV_INSTANTIATE(sample_antialiased_coords_backward, AntialiasedCoordsBackward)
KV_INSTANTIATE_COMPUTED(map_differences_backward, MapDifferencesBackward)

}  // namespace kv::geometry::KV_ISA
