// The photometric error on the CPU: rows [begin, end) of all targets in order. Compiled once per instruction set.
#include "geometry/transform/sampling_cpu.h"
// After it, for vsqrt.
#include "geometry/transform/photometric.h"

namespace kv::geometry::KV_ISA {
namespace {

template <class F>
struct Totals {
  Lanes<F, kCoordLanes<F>> plain[3], by_x[3], distance;
  int64_t count;
};

// Adds the values of N coordinates to those of a full vector.
template <int N, class V, class Some>
KV_HD void add_to(V& total, Some some) {
  if constexpr (N == 1)
    total[0] += some;
  else
    total += some;
}

// Calls channel(residual, derivatives along both axes) for N sampling coordinates that lie between pixels.
template <int N, class T, class Channel>
KV_HD bool sample_channels(Photometric<T> const& p, CoordRow<Compute<T>> const& coords, int64_t b, int64_t y,
                           int64_t first, int64_t e, Channel channel) {
  using V = Lanes<Compute<T>, N>;
  TapWindow<2, N, T> window;
  window.set(p, load<N>(coords.u + e), load<N>(coords.v + e), p.source.row_stride, p.source.step);
  if (!window.inside) return false;
  V wx[2], wy[2];
  tap_weights(window.tx, wx);
  tap_weights(window.ty, wy);
  for (int c = 0; c < p.source.channels; ++c) {
    T const* const plane = p.source.row(b, c, 0);
    V a00, a01, a10, a11, target{};
    gather_two<N>(plane, window.first, p.source.step, a00, a01);
    gather_two<N>(plane + p.source.row_stride, window.first, p.source.step, a10, a11);
    T const* const at = p.target.row(b, c, y) + (first + e) * p.target.step;
    if (N == 1 || p.target.step == 1) {
      target = load<N>(at);
    } else if constexpr (N > 1) {
      for (int n = 0; n < N; ++n) target[n] = load<1>(at + n * p.target.step);
    }
    V const value = (a00 * wx[0] + a01 * wx[1]) * wy[0] + (a10 * wx[0] + a11 * wx[1]) * wy[1];
    channel(V(value - target), V((a01 - a00) * wy[0] + (a11 - a10) * wy[1]),
            V((a10 - a00) * wx[0] + (a11 - a01) * wx[1]));
  }
  return true;
}

template <int N, class T>
KV_HD void add_gradients(Photometric<T> const& p, Homography<Compute<T>> const& map, CoordRow<Compute<T>> const& coords,
                         int64_t b, int64_t y, int64_t first, int64_t e, Totals<Compute<T>>& totals) {
  using F = Compute<T>;
  using V = Lanes<F, N>;
  V grad_u{}, grad_v{}, sum{};
  bool const inside = sample_channels<N>(p, coords, b, y, first, e, [&](V r, V along_x, V along_y) {
    V derivative;
    sum += distance_of(p.distance, r, p.eps, derivative);
    grad_u += derivative * along_x;
    grad_v += derivative * along_y;
  });
  if (!inside) {
    if constexpr (N > 1)
      for (int64_t n = 0; n < N; ++n) add_gradients<1>(p, map, coords, b, y, first, e + n, totals);
    return;
  }
  V const u = load<N>(coords.u + e), v = load<N>(coords.v + e);
  V const x = iota<N, F>(first + e), scale = 1 / map.weight(x, F(y));
  V const g[] = {grad_u * scale, grad_v * scale, -(grad_u * u + grad_v * v) * scale};
  for (int k = 0; k < 3; ++k) {
    add_to<N>(totals.plain[k], g[k]);
    add_to<N>(totals.by_x[k], V(g[k] * x));
  }
  add_to<N>(totals.distance, sum);
  totals.count += N;
}

// Sums over a row for the normal equations: six of the matrix rows times 1, x, x^2, three of the gradient times 1, x.
template <class F>
struct NormalTotals {
  Lanes<F, kCoordLanes<F>> line[6][3], gradient[3][2], distance;
  int64_t count;
};

template <int N, class F>
KV_HD void add_normals(PhotometricNormalEquations<F> const& p, F const* last_line, CoordRow<F> const& coords, int64_t b,
                       int64_t y, int64_t first, int64_t e, NormalTotals<F>& totals) {
  using V = Lanes<F, N>;
  V xx{}, xy{}, yy{}, by_x{}, by_y{}, sum{};
  bool const inside = sample_channels<N>(p, coords, b, y, first, e, [&](V r, V along_x, V along_y) {
    V derivative;
    sum += distance_of(p.distance, r, p.eps, derivative);
    V const weight = weight_of(p.distance, r, p.eps), wx = weight * along_x, wy = weight * along_y;
    xx += wx * along_x;
    xy += wx * along_y;
    yy += wy * along_y;
    by_x += wx * r;
    by_y += wy * r;
  });
  if (!inside) {
    if constexpr (N > 1)
      for (int64_t n = 0; n < N; ++n) add_normals<1>(p, last_line, coords, b, y, first, e + n, totals);
    return;
  }
  V const x = iota<N, F>(first + e) * p.x_scale + p.x_offset;
  V const u = load<N>(coords.u + e) * p.u_scale + p.u_offset, v = load<N>(coords.v + e) * p.v_scale + p.v_offset;
  V const weight = x * last_line[0] + ((F(y) * p.y_scale + p.y_offset) * last_line[1] + last_line[2]);
  V line[6], gradient[3];
  to_lines(V(xx / (p.u_scale * p.u_scale)), V(xy / (p.u_scale * p.v_scale)), V(yy / (p.v_scale * p.v_scale)),
           V(by_x / p.u_scale), V(by_y / p.v_scale), u, v, weight, line, gradient);
  for (int k = 0; k < 6; ++k) {
    add_to<N>(totals.line[k][0], line[k]);
    add_to<N>(totals.line[k][1], V(line[k] * x));
    add_to<N>(totals.line[k][2], V(line[k] * x * x));
  }
  for (int k = 0; k < 3; ++k) {
    add_to<N>(totals.gradient[k][0], gradient[k]);
    add_to<N>(totals.gradient[k][1], V(gradient[k] * x));
  }
  add_to<N>(totals.distance, sum);
  totals.count += N;
}

template <class V>
double total_of(V lanes) {
  double sum = 0;
  for (int i = 0; i < int(sizeof(V) / sizeof(lanes[0])); ++i) sum += lanes[i];
  return sum;
}

}  // namespace

template <class T>
void photometric(Photometric<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  for (double *sum = p.sums + kPhotometricSums * begin, *last = p.sums + kPhotometricSums * end; sum < last; ++sum)
    *sum = 0;
  CoordRow<F> coords;
  for_each_row_chunk(
      begin, end, p.target.height, p.target.width, [&](int64_t b, int64_t y, int64_t first, int64_t count) {
        coords.fill(p.coords, b, y, first, count);
        auto const map =
            bind_to_tile<F>(homography(p.coords.matrices + b * p.coords.matrix_stride, p.coords.use), 0, 0, 0, 0);
        Totals<F> totals{};
        dispatch_lanes(p.source, count, [&](auto lanes) {
          constexpr int N = decltype(lanes)::value;
          int64_t e = 0;
          for (; e + N <= count; e += N) add_gradients<N>(p, map, coords, b, y, first, e, totals);
          for (; e < count; ++e) add_gradients<1>(p, map, coords, b, y, first, e, totals);
        });
        double* const sums = p.sums + kPhotometricSums * (b * p.target.height + y);
        for (int k = 0; k < 3; ++k) {
          double const plain = total_of(totals.plain[k]);
          sums[3 * k] += total_of(totals.by_x[k]);
          sums[3 * k + 1] += plain * double(y);
          sums[3 * k + 2] += plain;
        }
        sums[9] += total_of(totals.distance);
        sums[10] += double(totals.count);
      });
}

template <class T>
void photometric_total(PhotometricTotal<T> const& p, int64_t begin, int64_t end) {
  for (int64_t b = begin; b < end; ++b) {
    double sums[kPhotometricSums] = {};
    for (int64_t part = 0; part < p.parts; ++part)
      for (int i = 0; i < kPhotometricSums; ++i) sums[i] += p.sums[(b * p.parts + part) * kPhotometricSums + i];
    photometric_total_of(p, b, sums);
  }
}

template <class T>
void photometric_normal_equations(PhotometricNormalEquations<T> const& p, int64_t begin, int64_t end) {
  for (double *sum = p.sums + kNormalSums * begin, *last = p.sums + kNormalSums * end; sum < last; ++sum) *sum = 0;
  CoordRow<T> coords;
  for_each_row_chunk(
      begin, end, p.target.height, p.target.width, [&](int64_t b, int64_t y, int64_t first, int64_t count) {
        coords.fill(p.coords, b, y, first, count);
        T const* const last_line = p.coords.matrices + b * p.coords.matrix_stride + 6;
        NormalTotals<T> totals{};
        dispatch_lanes(p.source, count, [&](auto lanes) {
          constexpr int N = decltype(lanes)::value;
          int64_t e = 0;
          for (; e + N <= count; e += N) add_normals<N>(p, last_line, coords, b, y, first, e, totals);
          for (; e < count; ++e) add_normals<1>(p, last_line, coords, b, y, first, e, totals);
        });
        double* const sums = p.sums + kNormalSums * (b * p.target.height + y);
        double const at = double(y) * p.y_scale + p.y_offset;
        for (int k = 0; k < 6; ++k) {
          double const one = total_of(totals.line[k][0]), x = total_of(totals.line[k][1]);
          double const products[] = {total_of(totals.line[k][2]), x * at, x, one * at * at, one * at, one};
          for (int i = 0; i < 6; ++i) sums[6 * k + i] += products[i];
        }
        for (int k = 0; k < 3; ++k) {
          double const one = total_of(totals.gradient[k][0]);
          sums[36 + 3 * k] += total_of(totals.gradient[k][1]);
          sums[36 + 3 * k + 1] += one * at;
          sums[36 + 3 * k + 2] += one;
        }
        sums[45] += total_of(totals.distance);
        sums[46] += double(totals.count);
      });
}

template <class T>
void photometric_normal_total(PhotometricNormalTotal<T> const& p, int64_t begin, int64_t end) {
  for (int64_t b = begin; b < end; ++b) {
    double sums[kNormalSums] = {};
    for (int64_t part = 0; part < p.parts; ++part)
      for (int i = 0; i < kNormalSums; ++i) sums[i] += p.sums[(b * p.parts + part) * kNormalSums + i];
    photometric_normal_total_of(p, b, sums);
  }
}

KV_INSTANTIATE(photometric, Photometric)
KV_INSTANTIATE_COMPUTED(photometric_normal_equations, PhotometricNormalEquations)
KV_INSTANTIATE_COMPUTED(photometric_normal_total, PhotometricNormalTotal)
KV_INSTANTIATE_COMPUTED(photometric_total, PhotometricTotal)

}  // namespace kv::geometry::KV_ISA
