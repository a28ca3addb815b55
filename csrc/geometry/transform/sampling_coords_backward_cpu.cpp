// The gradient to the places, and to the matrices they come from, on the CPU. Compiled once per instruction set.
#include "geometry/transform/sampling_cpu.h"

namespace kv::KV_ISA {
namespace {

// The derivatives of one channel's value along both axes.
template <int K, int N, class T>
struct Slope : Window<K, N, T> {
  using typename Window<K, N, T>::F;
  using typename Window<K, N, T>::V;
  V wx[K], wy[K], dx[K], dy[K];

  KV_HD Slope(SampleSlopes<T> const& p, V u, V v) {
    this->set(p, u, v, p.x.row_stride, p.x.step);
    tap_weights(this->tx, wx);
    tap_weights(this->ty, wy);
    tap_slopes(this->tx, dx);
    tap_slopes(this->ty, dy);
  }
  KV_HD void at(SampleSlopes<T> const& p, T const* plane, F fill, V& along_x, V& along_y) const {
    if (this->inside)
      add([&](int j, int i) { return this->read(p.x, plane, j, i); }, along_x, along_y);
    else if (this->outside)
      along_x = along_y = V{};
    else
      add([&](int j, int i) { return this->find(p, p.x, plane, fill, j, i); }, along_x, along_y);
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

// A piece of a row of the output, and the gradients d loss / d place there.
template <class F>
struct Piece {
  int64_t b, y, first, count;
  PlaceRow<F> places;
  F to_u[kTileColumns], to_v[kTileColumns];
};

template <int K, int N, class T, class F>
void find_slopes(SampleSlopes<T> const& p, Piece<F>& piece) {
  for (int64_t i = 0; i * N < piece.count; ++i) {
    int64_t const e = start_of<N>(i, piece.count);
    using V = Lanes<F, N>;
    Slope<K, N, T> const slope(p, load<N>(piece.places.u + e), load<N>(piece.places.v + e));
    V sum_x{}, sum_y{};
    for (int c = 0; c < p.x.channels; ++c) {
      T const* const from = p.grad.row(piece.b, c, piece.y) + (piece.first + e) * p.grad.step;
      V grad{}, along_x, along_y;
      if (N == 1 || p.grad.step == 1) {
        grad = load<N>(from);
      } else if constexpr (N > 1) {
        for (int i = 0; i < N; ++i) grad[i] = load<1>(from + i * p.grad.step);
      }
      slope.at(p, p.x.row(piece.b, c, 0), p.fill_of(piece.b, c), along_x, along_y);
      sum_x += grad * along_x;
      sum_y += grad * along_y;
    }
    store<N>(piece.to_u + e, sum_x);
    store<N>(piece.to_v + e, sum_y);
  }
}

template <int K, class T, class F>
void find_slopes(SampleSlopes<T> const& p, Piece<F>& piece) {
  with_lanes(p.x, piece.count, [&](auto lanes) { find_slopes<K, decltype(lanes)::value>(p, piece); });
}

template <class T, class F>
void find_slopes(SampleSlopes<T> const& p, Piece<F>& piece) {
  switch (p.interpolation) {
    case Interpolation::bilinear:
      return find_slopes<2>(p, piece);
    case Interpolation::bicubic:
      return find_slopes<4>(p, piece);
    case Interpolation::nearest:
      for (int64_t i = 0; i < piece.count; ++i) piece.to_u[i] = piece.to_v[i] = 0;
  }
}

// What it gives to the nine numbers of its matrix.
template <class F>
void add_to_matrix(Homography<F> const& map, Piece<F> const& piece, double* sums) {
  double plain[3] = {}, by_x[3] = {};
  for (int64_t i = 0; i < piece.count; ++i) {
    F const x = F(piece.first + i), u = piece.to_u[i], v = piece.to_v[i];
    F const scale = 1 / map.weight(x, F(piece.y));
    F const g[] = {u * scale, v * scale, -(u * piece.places.u[i] + v * piece.places.v[i]) * scale};
    for (int k = 0; k < 3; ++k) {
      F const kept = g[k] - g[k] == 0 ? g[k] : F(0);  // a place at infinity has no slope
      plain[k] += kept;
      by_x[k] += kept * x;
    }
  }
  for (int k = 0; k < 3; ++k) {
    sums[3 * k] += by_x[k];
    sums[3 * k + 1] += plain[k] * double(piece.y);
    sums[3 * k + 2] += plain[k];
  }
}

}  // namespace

template <class T>
void sample_slopes(SampleSlopes<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const height = p.grad.height, width = p.grad.width;
  if (p.sums)
    for (double *sum = p.sums + 9 * begin, *last = p.sums + 9 * end; sum < last; ++sum) *sum = 0;
  Piece<F> piece;
  for_each_piece(begin, end, height, width, [&](int64_t b, int64_t y, int64_t first, int64_t count) {
    piece.b = b;
    piece.y = y;
    piece.first = first;
    piece.count = count;
    piece.places.fill(p.places, b, y, first, count);
    find_slopes(p, piece);
    if (p.sums) {
      auto const map =
          seen_from<F>(homography(p.places.matrices + b * p.places.matrix_stride, p.places.use), 0, 0, 0, 0);
      add_to_matrix(map, piece, p.sums + 9 * (b * height + y));
    } else {
      for (int64_t i = 0; i < count; ++i) {
        p.grad_x.row(b, 0, y)[first + i] = piece.to_u[i] * p.places.scale[0];
        p.grad_y.row(b, 0, y)[first + i] = piece.to_v[i] * p.places.scale[1];
      }
    }
  });
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
