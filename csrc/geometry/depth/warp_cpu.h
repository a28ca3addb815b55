// Sampling coordinates from depth on the CPU. Included outside of namespaces.
#pragma once

#include "geometry/transform/sampling_cpu.h"
// Needs core/lanes.h, which the header above includes.
#include "geometry/depth/warp.h"

namespace kv::geometry::KV_ISA {
namespace {

// The sampling coordinates (u, v) of N pixels, and the numbers that their gradients need.
template <int N, class T>
struct DepthCoords {
  using F = Compute<T>;
  using V = Lanes<F, N>;
  V x, d, u, v, scale;

  KV_HD DepthCoords(DepthSampling<T> const& p, Reprojection<F> const& projection, int64_t b, int64_t y,
                    int64_t column) {
    x = iota<N, F>(column);
    F const* const from = p.depth.row(b, 0, y) + column * p.depth.step;
    if (N == 1 || p.depth.step == 1) {
      d = load<N>(from);
    } else if constexpr (N > 1) {
      for (int n = 0; n < N; ++n) d[n] = from[n * p.depth.step];
    }
    projection.at(x, F(y), d, u, v, scale);
    d = d - d == 0 ? d : V{};  // without finite depth (u, v) is not valid; d must then not make gradients NaN
  }
  // The coordinate to sample at: rounded half to even for nearest, else unchanged.
  KV_HD V sampled(DepthSampling<T> const& p, V coords) const {
    constexpr F shift = sizeof(F) == 4 ? F(0x1.8p23) : F(0x1.8p52);
    return p.interpolation == Interpolation::nearest ? V((coords + shift) - shift) : coords;
  }
  KV_HD TapWindow<2, N, T> window(DepthSampling<T> const& p) const {
    TapWindow<2, N, T> w;
    w.set(p, sampled(p, u), sampled(p, v), p.x.row_stride, p.x.step);
    return w;
  }
};

// Reads the four taps of a channel.
template <int N, class T>
KV_HD void read_taps(DepthSampling<T> const& p, TapWindow<2, N, T> const& window, T const* plane,
                     Lanes<Compute<T>, N> (&a)[2][2]) {
  for (int j = 0; j < 2; ++j)
    if (window.inside)
      gather_two<N>(plane + j * p.x.row_stride, window.first, p.x.step, a[j][0], a[j][1]);
    else
      for (int i = 0; i < 2; ++i) a[j][i] = window.find(p, p.x, plane, Compute<T>(0), j, i);
}

// The sums over the pixels of a row for the gradient to a projection.
template <class F>
struct ProjectionSums {
  Lanes<F, kCoordLanes<F>> plain[3], by_d[3], by_x[3], distance;
  int64_t count;

  // Adds the numbers of N pixels.
  template <int N, class V>
  KV_HD static void add_to(Lanes<F, kCoordLanes<F>>& total, V some) {
    if constexpr (N == 1)
      total[0] += some;
    else
      total += some;
  }
  template <int N, class V>
  KV_HD void add(V const (&g)[3], V x, V d) {
    for (int k = 0; k < 3; ++k) {
      add_to<N>(plain[k], g[k]);
      add_to<N>(by_d[k], V(g[k] * d));
      add_to<N>(by_x[k], V(g[k] * d * x));
    }
  }
  KV_HD static double total_of(Lanes<F, kCoordLanes<F>> lanes) {
    double sum = 0;
    for (int i = 0; i < kCoordLanes<F>; ++i) sum += lanes[i];
    return sum;
  }
  KV_HD void add_row(int64_t y, double* sums) const {
    for (int k = 0; k < 3; ++k) {
      double const d = total_of(by_d[k]);
      sums[4 * k] += total_of(by_x[k]);
      sums[4 * k + 1] += d * double(y);
      sums[4 * k + 2] += d;
      sums[4 * k + 3] += total_of(plain[k]);
    }
    sums[12] += total_of(distance);
    sums[13] += double(count);
  }
};

// Calls f(lanes, column) for the columns of a chunk, each once: in vectors, then one by one.
template <class T, class Call>
KV_HD void for_each_coords(DepthSampling<T> const& p, int64_t first, int64_t count, Call f) {
  dispatch_lanes(p.x, count, [&](auto lanes) {
    constexpr int N = decltype(lanes)::value;
    int64_t e = 0;
    for (; e + N <= count; e += N) f(lanes, first + e);
    for (; e < count; ++e) f(Width<1>{}, first + e);
  });
}

}  // namespace
}  // namespace kv::geometry::KV_ISA
