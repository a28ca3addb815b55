// The photometric distance of views by depth on the CPU: rows [begin, end) of all targets in order. Compiled once per
// instruction set.
#include "geometry/depth/warp_cpu.h"
// Needs core/lanes.h, which the header above includes.
#include "geometry/depth/photometric.h"

namespace kv::geometry::KV_ISA {
namespace {

// N pixels: their distances, the gradients of these to the sampling coordinates, and the number of visible pixels.
template <int N, class T, class V>
KV_HD int compare(PhotometricDepth<T> const& p, DepthSampling<T> const& view, DepthCoords<N, T> const& coords,
                  int64_t b, int64_t y, int64_t x, V& distance, V& grad_u, V& grad_v) {
  auto const window = coords.window(view);
  V const right = V{} + Compute<T>(view.x_axis.size - 1), low = V{} + Compute<T>(view.y_axis.size - 1);
  auto const seen = (coords.u >= 0) & (coords.u < right) & (coords.v >= 0) & (coords.v < low);
  V const one = V(seen ? V(V{} + 1) : V{});
  V wx[2], wy[2], a[2][2];
  tap_weights(window.tx, wx);
  tap_weights(window.ty, wy);
  distance = grad_u = grad_v = V{};
  if (window.outside) return 0;
  for (int c = 0; c < p.x.channels; ++c) {
    T const* const at = p.target.row(b, c, y) + x * p.target.step;
    V target{}, derivative;
    if (N == 1 || p.target.step == 1) {
      target = load<N>(at);
    } else if constexpr (N > 1) {
      for (int n = 0; n < N; ++n) target[n] = load<1>(at + n * p.target.step);
    }
    read_taps(view, window, view.x.row(b, c, 0), a);
    V const value = (a[0][0] * wx[0] + a[0][1] * wx[1]) * wy[0] + (a[1][0] * wx[0] + a[1][1] * wx[1]) * wy[1];
    V const pixel_loss = distance_of(p.distance, V(value - target), p.eps, derivative);
    distance += seen ? pixel_loss : V{};
    grad_u += seen ? V(derivative * ((a[0][1] - a[0][0]) * wy[0] + (a[1][1] - a[1][0]) * wy[1])) : V{};
    grad_v += seen ? V(derivative * ((a[1][0] - a[0][0]) * wx[0] + (a[1][1] - a[0][1]) * wx[1])) : V{};
  }
  if constexpr (N == 1) {
    return int(one);
  } else {
    int count = 0;
    for (int n = 0; n < N; ++n) count += int(one[n]);
    return count;
  }
}

}  // namespace

template <class T>
void photometric_depth(PhotometricDepth<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const height = p.target.height, width = p.target.width, row_sums = p.views * kProjectionSums;
  for (double *sum = p.sums + row_sums * begin, *last = p.sums + row_sums * end; sum < last; ++sum) *sum = 0;
  for_each_row_chunk(begin, end, height, width, [&](int64_t b, int64_t y, int64_t first, int64_t count) {
    F* const grad_depth = p.grad_depth + (b * height + y) * width;
    for (int64_t x = first; x < first + count; ++x) grad_depth[x] = 0;
    for (int i = 0; i < p.views; ++i) {
      DepthSampling<T> const view = p.view(i);
      auto const projection = view.projection(b);
      ProjectionSums<F> sums{};
      for_each_coords(view, first, count, [&](auto lanes, int64_t x) {
        constexpr int N = decltype(lanes)::value;
        using V = Lanes<F, N>;
        DepthCoords<N, T> const coords(view, projection, b, y, x);
        V distance, grad_u, grad_v, g[3];
        sums.count += compare<N>(p, view, coords, b, y, x, distance, grad_u, grad_v);
        V const grad_d = projection.vjp(coords.x, F(y), coords.u, coords.v, coords.scale, grad_u, grad_v, g);
        store<N>(grad_depth + x, V(load<N>(grad_depth + x) + grad_d));
        sums.template add<N>(g, coords.x, coords.d);
        sums.template add_to<N>(sums.distance, distance);
      });
      sums.add_row(y, p.sums + row_sums * (b * height + y) + kProjectionSums * i);
    }
  });
}

KV_INSTANTIATE(photometric_depth, PhotometricDepth)

}  // namespace kv::geometry::KV_ISA
