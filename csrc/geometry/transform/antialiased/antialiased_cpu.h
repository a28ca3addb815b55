// Windows of taps of antialiased sampling, row by row, on the CPU. Included outside of namespaces.
#pragma once

#include "geometry/transform/sampling_cpu.h"
// After core/lanes.h, whose vectors it uses.
#include "geometry/transform/antialiased/warp_antialiased.h"

namespace kv::geometry::KV_ISA {
namespace {

// Taps of a row, and those by which the last vector exceeds them.
constexpr int kRowTaps = 2 * kMaxReach + 16;

// The sum of lanes, in pairs.
template <int N, class V>
KV_HD auto sum_of_lanes(V v) {
  if constexpr (N == 1) {
    return v;
  } else {
    decltype(v[0] + v[0]) half[N];
    for (int i = 0; i < N; ++i) half[i] = v[i];
    for (int n = N / 2; n > 0; n /= 2)
      for (int i = 0; i < n; ++i) half[i] += half[i + n];
    return half[0];
  }
}

// A pixel of the output: its coordinates, the shape of its window, and its taps.
template <class F>
struct CoveredPixel {
  Jacobian<F> slopes;
  Footprint<F> footprint;
  CoveredTaps<F> window;

  template <class T>
  KV_HD CoveredPixel(Sampling<T> const& p, F u, F v, Jacobian<F> const& slopes, Footprint<F> const& f)
      : slopes(slopes), footprint(f), window(p, u, v, f) {}
  KV_HD int columns() const { return window.last_x - window.first_x + 1; }

  // The weights of row j, in vectors; 0 behind the last tap. They are added to `sum`.
  static constexpr int N = kVectorBytes / int(sizeof(F));
  using V = Lanes<F, N>;
  KV_HD void row_weights(int j, F* weights, V& sum) const {
    Footprint<F> const& f = footprint;
    F const dy = F(j) - window.v;
    V const zero{}, by_x = zero + f.xy * dy, by_y = zero + f.yy * dy;
    for (int i = 0; i < columns(); i += N) {
      V const dx = iota<N, F>(i) + (F(window.first_x) - window.u);
      V const tx = max(zero, V(1 - vabs(V(dx * f.xx + by_x)))), ty = max(zero, V(1 - vabs(V(dx * f.xy + by_y))));
      V const w = tx * ty;
      store<N>(weights + i, w);
      sum += w;
    }
  }
};

// Calls body(column of the chunk, pixel) for `count` pixels of row y of sample b, whose coordinates are in `coords`.
template <class T, class F, class Body>
KV_HD void for_each_covered(Sampling<T> const& p, CoordRow<F>& coords, int64_t b, int64_t y, int64_t first,
                            int64_t count, Body body) {
  coords.fill(p.coords, b, y, first, count);
  Jacobian<F> slopes{};
  Footprint<F> f{};
  bool const has_map = p.coords.has_map();
  bool varies = true;
  for (int64_t i = 0; i < count; ++i) {
    F const u = coords.u[i], v = coords.v[i];
    if (has_map) {
      slopes = jacobian(p.coords, b, y, first + i);
    } else if (varies) {
      Homography<double> const& map = coords.map_of(p.coords, b);
      auto const at = jacobian<double>(map, double(first + i), double(y), double(u), double(v));
      slopes = {F(at.ux), F(at.uy), F(at.vx), F(at.vy)};
    }
    if (varies) f = footprint(slopes);
    varies = has_map || !coords.map_of(p.coords, b).affine;
    body(i, CoveredPixel<F>(p, u, v, slopes, f));
  }
}

}  // namespace
}  // namespace kv::geometry::KV_ISA
