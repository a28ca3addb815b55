// The photometric distance on the CPU: rows [begin, end) of all targets in order. Compiled once per instruction set.
#include "sample_cpu.h"
// After it, for vsqrt.
#include "photometric.h"

namespace kv::KV_ISA {
namespace {

template <class F>
struct Totals {
  Lanes<F, kPlaces<F>> plain[3], by_x[3], distance;
  int64_t count;
};

// Adds numbers of N places to those of a whole vector.
template <int N, class V, class Some>
KV_HD void add_to(V& total, Some some) {
  if constexpr (N == 1)
    total[0] += some;
  else
    total += some;
}

template <int N, class T>
KV_HD void add_places(Photometric<T> const& p, Homography<Compute<T>> const& map, PlaceRow<Compute<T>> const& places,
                      int64_t b, int64_t y, int64_t first, int64_t e, Totals<Compute<T>>& totals) {
  using F = Compute<T>;
  using V = Lanes<F, N>;
  V const u = load<N>(places.u + e), v = load<N>(places.v + e);
  Window<2, N, T> window;
  window.set(p, u, v, p.source.row_stride, p.source.step);
  if (!window.inside) {
    if constexpr (N > 1)
      for (int64_t n = 0; n < N; ++n) add_places<1>(p, map, places, b, y, first, e + n, totals);
    return;
  }
  V wx[2], wy[2], to_u{}, to_v{}, sum{};
  tap_weights(window.tx, wx);
  tap_weights(window.ty, wy);
  for (int channel = 0; channel < p.source.channels; ++channel) {
    T const* const plane = p.source.row(b, channel, 0);
    V a00, a01, a10, a11, target{}, slope;
    gather_two<N>(plane, window.first, p.source.step, a00, a01);
    gather_two<N>(plane + p.source.row_stride, window.first, p.source.step, a10, a11);
    T const* const at = p.target.row(b, channel, y) + (first + e) * p.target.step;
    if (N == 1 || p.target.step == 1) {
      target = load<N>(at);
    } else if constexpr (N > 1) {
      for (int n = 0; n < N; ++n) target[n] = load<1>(at + n * p.target.step);
    }
    V const value = (a00 * wx[0] + a01 * wx[1]) * wy[0] + (a10 * wx[0] + a11 * wx[1]) * wy[1];
    sum += distance_of(p.distance, V(value - target), p.eps, slope);
    to_u += slope * ((a01 - a00) * wy[0] + (a11 - a10) * wy[1]);
    to_v += slope * ((a10 - a00) * wx[0] + (a11 - a01) * wx[1]);
  }
  V const x = count_from<N, F>(first + e), scale = 1 / map.weight(x, F(y));
  V const g[] = {to_u * scale, to_v * scale, -(to_u * u + to_v * v) * scale};
  for (int k = 0; k < 3; ++k) {
    add_to<N>(totals.plain[k], g[k]);
    add_to<N>(totals.by_x[k], V(g[k] * x));
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
  PlaceRow<F> places;
  for_each_piece(begin, end, p.target.height, p.target.width, [&](int64_t b, int64_t y, int64_t first, int64_t count) {
    places.fill(p.places, b, y, first, count);
    auto const map = seen_from<F>(homography(p.places.matrices + b * p.places.matrix_stride, p.places.use), 0, 0, 0, 0);
    Totals<F> totals{};
    with_lanes(p.source, count, [&](auto lanes) {
      constexpr int N = decltype(lanes)::value;
      int64_t e = 0;
      for (; e + N <= count; e += N) add_places<N>(p, map, places, b, y, first, e, totals);
      for (; e < count; ++e) add_places<1>(p, map, places, b, y, first, e, totals);
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

KV_INSTANTIATE(photometric, Photometric)
KV_INSTANTIATE_COMPUTED(photometric_total, PhotometricTotal)

}  // namespace kv::KV_ISA
