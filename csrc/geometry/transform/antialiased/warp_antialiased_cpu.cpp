// Antialiased sampling on the CPU: rows [begin, end) of all outputs in order. A vector holds adjacent taps of a pixel.
// Compiled once per instruction set.
#include "geometry/transform/antialiased/antialiased_cpu.h"

namespace kv::geometry::KV_ISA {
namespace {

// Whether a matrix keeps all pixels, so that the plain warp serves.
template <class T>
KV_HD bool shrinks_nothing(Sample<T> const& p, int64_t b) {
  if (p.coords.has_map()) return false;
  auto const map = homography(p.coords.matrices + b * p.coords.matrix_stride, p.coords.use);
  return map.affine && footprint(jacobian<double>(map, 0, 0, 0, 0)).is_plain();
}

// C channels of a pixel, from `first` on.
template <int C, class T, class F>
KV_HD void mean_of_taps(Sample<T> const& p, CoveredPixel<F> const& pixel, int64_t b, int first, T* to) {
  constexpr int N = kLanes<T>;
  using V = Lanes<F, N>;
  CoveredTaps<F> const& window = pixel.window;
  int const columns = pixel.columns(), padded = (columns + N - 1) / N * N;
  bool const reads_rows = p.x.step == 1 && window.is_inside(p) && window.first_x + padded <= p.x_axis.size;
  T const* const plane = p.x.row(p.image_of(b), first, 0);
  F weights[kRowTaps], taps[kRowTaps];
  V total{};
  V sums[C] = {};
  for (int j = window.first_y; j <= window.last_y; ++j) {
    pixel.row_weights(j, weights, total);
    int const row = padded_pixel(p.y_axis, j);
    for (int c = 0; c < C; ++c) {
      auto const add = [&](auto const* values) KV_INLINE {
        for (int i = 0; i < columns; i += N) {
          V const w = load<N>(weights + i), x = load<N>(values + i);
          sums[c] += w > 0 ? V(w * x) : V{};  // a tap of weight 0 contributes nothing, even if it is inf or NaN
        }
      };
      T const* const from = plane + c * p.x.channel_stride + (row < 0 ? 0 : row) * p.x.row_stride;
      if (reads_rows) {
        add(from + window.first_x);
        continue;
      }
      F const fill = p.fill_value(b, first + c);
      for (int i = 0; i < columns; ++i) {
        int const column = padded_pixel(p.x_axis, window.first_x + i);
        taps[i] = row < 0 || column < 0 ? fill : load<1>(from + column * p.x.step);
      }
      for (int i = columns; i < padded; ++i) taps[i] = 0;
      add(static_cast<F const*>(taps));
    }
  }
  F const scale = 1 / sum_of_lanes<N>(total);
  for (int c = 0; c < C; ++c) store<1>(to + c * p.y.channel_stride, sum_of_lanes<N>(sums[c]) * scale);
}

}  // namespace

template <class T>
void sample_antialiased(Sample<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const height = p.y.height;
  CoordRow<F> coords;
  while (begin < end) {
    int64_t const b = begin / height, last = min(end, (b + 1) * height);
    if (shrinks_nothing(p, b))
      sample(p, begin, last);
    else
      for_each_row_chunk(begin, last, height, p.y.width, [&](int64_t, int64_t y, int64_t first, int64_t count) {
        T* const row = p.y.row(b, 0, y) + first * p.y.step;
        for_each_covered(p, coords, b, y, first, count, [&](int64_t i, CoveredPixel<F> const& pixel) KV_INLINE {
          T* const to = row + i * p.y.step;
          int c = 0;
          if (pixel.window.is_outside(p)) {
            for (; c < p.x.channels; ++c) store<1>(to + c * p.y.channel_stride, p.fill_value(b, c));
            return;
          }
          for (; c + 3 <= p.x.channels; c += 3) mean_of_taps<3>(p, pixel, b, c, to + c * p.y.channel_stride);
          for (; c < p.x.channels; ++c) mean_of_taps<1>(p, pixel, b, c, to + c * p.y.channel_stride);
        });
      });
    begin = last;
  }
}

KV_INSTANTIATE_WITH_BYTES(sample_antialiased, Sample)

}  // namespace kv::geometry::KV_ISA
