// Warps by depth on the CPU: rows [begin, end) of all outputs in order; planes of the image for its gradient. Compiled
// once per instruction set.
#include "geometry/depth/warp_cpu.h"

namespace kv::geometry::KV_ISA {
namespace {

// A tap of weight 0 does not contribute, even if it is NaN or inf.
template <int N, class T>
KV_HD auto value_of(DepthSampling<T> const& p, TapWindow<2, N, T> const& window, T const* plane) {
  using F = Compute<T>;
  using V = Lanes<F, N>;
  V wx[2], wy[2], a[2][2];
  tap_weights(window.tx, wx);
  tap_weights(window.ty, wy);
  read_taps(p, window, plane, a);
  V const sum = (a[0][0] * wx[0] + a[0][1] * wx[1]) * wy[0] + (a[1][0] * wx[0] + a[1][1] * wx[1]) * wy[1];
  if (all<N>(sum - sum == 0)) return sum;
  V value{};
  for (int j = 0; j < 2; ++j)
    for (int i = 0; i < 2; ++i) {
      V const weight = wx[i] * wy[j];
      value += weight == 0 ? V{} : V(weight * a[j][i]);
    }
  return value;
}

template <int N, class V>
KV_HD auto lane_of(V const& v, int n) {
  if constexpr (N == 1)
    return v;
  else
    return v[n];
}

template <int N, class T, class V>
KV_HD void store_strided(T* to, int64_t step, V values) {
  if (N == 1 || step == 1) {
    store<N>(to, values);
  } else if constexpr (N > 1) {
    for (int n = 0; n < N; ++n) store<1>(to + n * step, values[n]);
  }
}

}  // namespace

template <class T>
void depth_warp(DepthWarp<T> const& p, int64_t begin, int64_t end) {
  for_each_row_chunk(begin, end, p.y.height, p.y.width, [&](int64_t b, int64_t y, int64_t first, int64_t count) {
    auto const projection = p.projection(b);
    for_each_coords(p, first, count, [&](auto lanes, int64_t x) {
      constexpr int N = decltype(lanes)::value;
      auto const window = DepthCoords<N, T>(p, projection, b, y, x).window(p);
      for (int c = 0; c < p.x.channels; ++c) {
        auto const value = window.outside ? Lanes<Compute<T>, N>{} : value_of(p, window, p.x.row(b, c, 0));
        store_strided<N>(p.y.row(b, c, y) + x * p.y.step, p.y.step, value);
      }
    });
  });
}

template <class T>
void depth_warp_coords_backward(DepthWarpCoordsBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  for (double *sum = p.sums + kProjectionSums * begin, *last = p.sums + kProjectionSums * end; sum < last; ++sum)
    *sum = 0;
  int64_t const height = p.grad.height, width = p.grad.width;
  for_each_row_chunk(begin, end, height, width, [&](int64_t b, int64_t y, int64_t first, int64_t count) {
    auto const projection = p.projection(b);
    ProjectionSums<F> sums{};
    for_each_coords(p, first, count, [&](auto lanes, int64_t x) {
      constexpr int N = decltype(lanes)::value;
      using V = Lanes<F, N>;
      DepthCoords<N, T> const coords(p, projection, b, y, x);
      auto const window = coords.window(p);
      V grad_u{}, grad_v{}, wx[2], wy[2];
      tap_weights(window.tx, wx);
      tap_weights(window.ty, wy);
      if (!window.outside && p.interpolation != Interpolation::nearest)
        for (int c = 0; c < p.x.channels; ++c) {
          V grad{}, a[2][2];
          T const* const from = p.grad.row(b, c, y) + x * p.grad.step;
          if (N == 1 || p.grad.step == 1) {
            grad = load<N>(from);
          } else if constexpr (N > 1) {
            for (int n = 0; n < N; ++n) grad[n] = load<1>(from + n * p.grad.step);
          }
          read_taps(p, window, p.x.row(b, c, 0), a);
          grad_u += grad * ((a[0][1] - a[0][0]) * wy[0] + (a[1][1] - a[1][0]) * wy[1]);
          grad_v += grad * ((a[1][0] - a[0][0]) * wx[0] + (a[1][1] - a[0][1]) * wx[1]);
        }
      V g[3];
      V const grad_d = projection.vjp(coords.x, F(y), coords.u, coords.v, coords.scale, grad_u, grad_v, g);
      store<N>(p.grad_depth + (b * height + y) * width + x, grad_d);
      sums.template add<N>(g, coords.x, coords.d);
    });
    sums.add_row(y, p.sums + kProjectionSums * (b * height + y));
  });
}

template <class T>
void depth_warp_image_backward(DepthWarpImageBackward<T> const& p, int64_t begin, int64_t end) {
  for (int64_t r = begin; r < end; ++r) {
    int64_t const b = r / p.grad.channels;
    int const c = int(r % p.grad.channels);
    auto const projection = p.projection(b);
    T* const plane = p.grad_x.row(b, c, 0);
    for (T *at = plane, *last = plane + p.grad_x.height * p.grad_x.width; at < last; ++at) *at = 0;
    for (int64_t y = 0; y < p.grad.height; ++y)
      for_each_coords(p, 0, p.grad.width, [&](auto lanes, int64_t x) {
        constexpr int N = decltype(lanes)::value;
        auto const window = DepthCoords<N, T>(p, projection, b, y, x).window(p);
        if (window.outside) return;
        Lanes<T, N> wx[2], wy[2];
        tap_weights(window.tx, wx);
        tap_weights(window.ty, wy);
        T const* const grad = p.grad.row(b, c, y) + x * p.grad.step;
        for (int n = 0; n < N; ++n) {
          T const g = grad[n * p.grad.step];
          for (int j = 0; j < 2; ++j) {
            int const row = pixel_at(p.y_axis, int(lane_of<N>(window.y, n)) + j);
            if (unsigned(row) >= unsigned(p.y_axis.size)) continue;
            for (int i = 0; i < 2; ++i) {
              int const column = pixel_at(p.x_axis, int(lane_of<N>(window.x, n)) + i);
              T const weight = lane_of<N>(wx[i], n) * lane_of<N>(wy[j], n);
              if (unsigned(column) < unsigned(p.x_axis.size) && weight != 0)
                plane[int64_t(row) * p.x_axis.size + column] += g * weight;
            }
          }
        }
      });
  }
}

template <class T>
void projection_total(ProjectionTotal<T> const& p, int64_t begin, int64_t end) {
  for (int64_t b = begin; b < end; ++b) {
    double const* const sums = p.sums + b * p.parts * p.views * kProjectionSums;
    double distance = 0, count = 0;
    for (int64_t i = 0; i < p.parts * p.views; ++i) {
      distance += sums[i * kProjectionSums + 12];
      count += sums[i * kProjectionSums + 13];
    }
    double const terms = count * p.channels, inverse_terms = !p.loss ? 1 : terms > 0 ? 1 / terms : 0;
    if (p.loss) {
      p.loss[b] = T(distance / terms);
      p.inverse_terms[b] = T(inverse_terms);
    }
    for (int view = 0; view < p.views; ++view)
      for (int i = 0; i < 12; ++i) {
        double sum = 0;
        for (int64_t part = 0; part < p.parts; ++part) sum += sums[(part * p.views + view) * kProjectionSums + i];
        p.grad[(b * p.views + view) * 12 + i] = T(sum * inverse_terms);
      }
  }
}

KV_INSTANTIATE(depth_warp, DepthWarp)
KV_INSTANTIATE(depth_warp_coords_backward, DepthWarpCoordsBackward)
KV_INSTANTIATE_COMPUTED(depth_warp_image_backward, DepthWarpImageBackward)
KV_INSTANTIATE_COMPUTED(projection_total, ProjectionTotal)

}  // namespace kv::geometry::KV_ISA
