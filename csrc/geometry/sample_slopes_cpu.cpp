// The gradient to the places, and to the matrices they come from, on the CPU. Compiled once per instruction set.
#include "sample_cpu.h"

namespace kv::KV_ISA {
namespace {

// The derivatives of one channel's value along both axes.
template <int K, int N, class T>
struct Slope : Window<K, N, T> {
  using typename Window<K, N, T>::F;
  using typename Window<K, N, T>::V;
  V wx[K], wy[K], dx[K], dy[K];

  KV_HD Slope(SampleSlopes<T> const& p, V u, V v) : Window<K, N, T>(p, u, v, p.x.row_stride, p.x.step) {
    tap_weights(this->tx, wx);
    tap_weights(this->ty, wy);
    tap_slopes(this->tx, dx);
    tap_slopes(this->ty, dy);
  }
  KV_HD void at(Images<T const> const& image, T const* plane, F fill, V& along_x, V& along_y) const {
    if (this->inside)
      add([&](int j, int i) { return this->read(image, plane, j, i); }, along_x, along_y);
    else
      add([&](int j, int i) { return this->find(image, plane, fill, j, i); }, along_x, along_y);
  }

 private:
  template <class Tap>
  KV_HD void add(Tap tap, V& along_x, V& along_y) const {
    along_x = along_y = V{};
#pragma GCC unroll 1
    for (int j = 0; j < K; ++j) {
      V across{}, row{};
#pragma GCC unroll 1
      for (int i = 0; i < K; ++i) {
        V const value = tap(j, i);
        row += value * wx[i];
        across += value * dx[i];
      }
      along_x += across * wy[j];
      along_y += row * dy[j];
    }
  }
};

// d loss / d place for a row of the output.
template <int K, class T, class F>
void slope_row(SampleSlopes<T> const& p, PlaceRow<F> const& places, int64_t b, int64_t y, F* to_u, F* to_v) {
  for_each_place(p.x, p.grad.width, [&](auto lanes, int64_t e) {
    constexpr int N = decltype(lanes)::value;
    using V = Lanes<F, N>;
    Slope<K, N, T> const slope(p, load<N>(places.u + e), load<N>(places.v + e));
    V sum_x{}, sum_y{};
    for (int c = 0; c < p.x.channels; ++c) {
      T const* const from = p.grad.row(b, c, y) + e * p.grad.step;
      V grad{}, along_x, along_y;
      if (N == 1 || p.grad.step == 1) {
        grad = load<N>(from);
      } else if constexpr (N > 1) {
        for (int i = 0; i < N; ++i) grad[i] = load<1>(from + i * p.grad.step);
      }
      slope.at(p.x, p.x.row(b, c, 0), p.fill_of(b, c), along_x, along_y);
      sum_x += grad * along_x;
      sum_y += grad * along_y;
    }
    store<N>(to_u + e, sum_x);
    store<N>(to_v + e, sum_y);
  });
}

template <class T, class F>
void slope_row(SampleSlopes<T> const& p, PlaceRow<F> const& places, int64_t b, int64_t y, F* to_u, F* to_v) {
  switch (p.interpolation) {
    case Interpolation::bilinear:
      return slope_row<2>(p, places, b, y, to_u, to_v);
    case Interpolation::bicubic:
      return slope_row<4>(p, places, b, y, to_u, to_v);
    case Interpolation::nearest:
      for (int64_t x = 0; x < p.grad.width; ++x) to_u[x] = to_v[x] = 0;
  }
}

// What a row gives to the nine numbers of its matrix.
template <class F>
void add_row(Homography<F> const& map, PlaceRow<F> const& places, int64_t y, F const* to_u, F const* to_v,
             double* sums) {
  double plain[3] = {}, by_x[3] = {};
  for (int64_t x = 0; x < places.width; ++x) {
    F const scale = 1 / map.weight(F(x), F(y));
    F const g[] = {to_u[x] * scale, to_v[x] * scale, -(to_u[x] * places.u[x] + to_v[x] * places.v[x]) * scale};
    for (int i = 0; i < 3; ++i) {
      F const kept = g[i] - g[i] == 0 ? g[i] : F(0);  // a place at infinity has no slope
      plain[i] += kept;
      by_x[i] += kept * F(x);
    }
  }
  for (int i = 0; i < 3; ++i) {
    sums[3 * i] = by_x[i];
    sums[3 * i + 1] = plain[i] * double(y);
    sums[3 * i + 2] = plain[i];
  }
}

}  // namespace

template <class T>
void sample_slopes(SampleSlopes<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const height = p.grad.height, width = p.grad.width;
  PlaceRow<F> places(width);
  Scratch<F> slopes(p.sums ? 2 * width : 0);
  for (int64_t r = begin; r < end; ++r) {
    int64_t const b = r / height, y = r % height;
    places.fill(p.places, b, y);
    F* const to_u = p.sums ? slopes.data : p.grad_x.row(b, 0, y);
    F* const to_v = p.sums ? to_u + width : p.grad_y.row(b, 0, y);
    slope_row(p, places, b, y, to_u, to_v);
    if (p.sums) {
      auto const map = homography(p.places.matrices + b * p.places.matrix_stride, p.places.use);
      add_row(map, places, y, to_u, to_v, p.sums + 9 * r);
    } else {
      for (int64_t x = 0; x < width; ++x) {
        to_u[x] *= p.places.scale[0];
        to_v[x] *= p.places.scale[1];
      }
    }
  }
}

template <class T>
void matrix_gradient(MatrixGradient<T> const& p, int64_t begin, int64_t end) {
  MatrixUse const& use = p.places.use;
  for (int64_t b = begin; b < end; ++b) {
    double sums[9] = {};
    for (double const *part = p.sums + b * p.parts * 9, *last = part + p.parts * 9; part < last; part += 9)
      for (int i = 0; i < 9; ++i) sums[i] += part[i];
    homography_vjp(p.places.matrices + b * p.places.matrix_stride, use, sums, p.grad + b * 3 * use.rows);
  }
}

KV_INSTANTIATE(sample_slopes, SampleSlopes)
KV_INSTANTIATE_COMPUTED(matrix_gradient, MatrixGradient)

}  // namespace kv::KV_ISA
