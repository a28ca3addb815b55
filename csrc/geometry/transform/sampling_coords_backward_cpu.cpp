// The gradients of sampling coordinates, and of the matrices they come from, on the CPU. Compiled once per instruction
// set.
#include "geometry/transform/sampling_cpu.h"

namespace kv::geometry::KV_ISA {
namespace {

// The derivatives of one channel's value along both axes.
template <int K, int N, class T>
struct CoordDerivatives : TapWindow<K, N, T> {
  using typename TapWindow<K, N, T>::F;
  using typename TapWindow<K, N, T>::V;
  V wx[K], wy[K], dx[K], dy[K];

  KV_HD CoordDerivatives(SampleCoordsBackward<T> const& p, V u, V v) {
    this->set(p, u, v, p.x.row_stride, p.x.step);
    tap_weights(this->tx, wx);
    tap_weights(this->ty, wy);
    tap_derivatives(this->tx, dx);
    tap_derivatives(this->ty, dy);
  }
  KV_HD void at(SampleCoordsBackward<T> const& p, T const* plane, F fill, V& along_x, V& along_y) const {
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

// A chunk of a row of the output, and the gradients of its sampling coordinates.
template <class F>
struct RowChunk {
  int64_t b, image, y, first, count;
  CoordRow<F> coords;
  F grad_u[kTileColumns], grad_v[kTileColumns];
};

template <int K, int N, class T, class F>
void coord_grads(SampleCoordsBackward<T> const& p, RowChunk<F>& chunk) {
  for (int64_t i = 0; i * N < chunk.count; ++i) {
    int64_t const e = vector_start<N>(i, chunk.count);
    using V = Lanes<F, N>;
    CoordDerivatives<K, N, T> const derivatives(p, load<N>(chunk.coords.u + e), load<N>(chunk.coords.v + e));
    V sum_x{}, sum_y{};
    for (int c = 0; c < p.x.channels; ++c) {
      T const* const from = p.grad.row(chunk.b, c, chunk.y) + (chunk.first + e) * p.grad.step;
      V grad{}, along_x, along_y;
      if (N == 1 || p.grad.step == 1) {
        grad = load<N>(from);
      } else if constexpr (N > 1) {
        for (int i = 0; i < N; ++i) grad[i] = load<1>(from + i * p.grad.step);
      }
      derivatives.at(p, p.x.row(chunk.image, c, 0), p.fill_value(chunk.b, c), along_x, along_y);
      sum_x += grad * along_x;
      sum_y += grad * along_y;
    }
    store<N>(chunk.grad_u + e, sum_x);
    store<N>(chunk.grad_v + e, sum_y);
  }
}

template <int K, class T, class F>
void coord_grads(SampleCoordsBackward<T> const& p, RowChunk<F>& chunk) {
  dispatch_lanes(p.x, chunk.count, [&](auto lanes) { coord_grads<K, decltype(lanes)::value>(p, chunk); });
}

template <class T, class F>
void coord_grads(SampleCoordsBackward<T> const& p, RowChunk<F>& chunk) {
  switch (p.interpolation) {
    case Interpolation::bilinear:
      return coord_grads<2>(p, chunk);
    case Interpolation::bicubic:
      return coord_grads<4>(p, chunk);
    case Interpolation::nearest:
      for (int64_t i = 0; i < chunk.count; ++i) chunk.grad_u[i] = chunk.grad_v[i] = 0;
  }
}

// The contribution of the chunk to the nine sums of its matrix.
template <class F>
void accumulate_matrix_grad(Homography<F> const& map, RowChunk<F> const& chunk, double* sums) {
  double plain[3] = {}, by_x[3] = {};
  for (int64_t i = 0; i < chunk.count; ++i) {
    F const x = F(chunk.first + i), u = chunk.grad_u[i], v = chunk.grad_v[i];
    F const scale = 1 / map.weight(x, F(chunk.y));
    F const g[] = {u * scale, v * scale, -(u * chunk.coords.u[i] + v * chunk.coords.v[i]) * scale};
    for (int k = 0; k < 3; ++k) {
      F const kept = g[k] - g[k] == 0 ? g[k] : F(0);  // coordinates at infinity have no gradient
      plain[k] += kept;
      by_x[k] += kept * x;
    }
  }
  for (int k = 0; k < 3; ++k) {
    sums[3 * k] += by_x[k];
    sums[3 * k + 1] += plain[k] * double(chunk.y);
    sums[3 * k + 2] += plain[k];
  }
}

}  // namespace

template <class T>
void sample_coords_backward(SampleCoordsBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const height = p.grad.height, width = p.grad.width;
  if (p.sums)
    for (double *sum = p.sums + 9 * begin, *last = p.sums + 9 * end; sum < last; ++sum) *sum = 0;
  RowChunk<F> chunk;
  for_each_row_chunk(begin, end, height, width, [&](int64_t b, int64_t y, int64_t first, int64_t count) {
    chunk.b = b;
    chunk.image = p.image_of(b);
    chunk.y = y;
    chunk.first = first;
    chunk.count = count;
    chunk.coords.fill(p.coords, b, y, first, count);
    coord_grads(p, chunk);
    if (p.sums) {
      auto const map =
          bind_to_tile<F>(homography(p.coords.matrices + b * p.coords.matrix_stride, p.coords.use), 0, 0, 0, 0);
      accumulate_matrix_grad(map, chunk, p.sums + 9 * (b * height + y));
    } else {
      for (int64_t i = 0; i < count; ++i) {
        p.grad_x.row(b, 0, y)[first + i] = chunk.grad_u[i] * p.coords.scale[0];
        p.grad_y.row(b, 0, y)[first + i] = chunk.grad_v[i] * p.coords.scale[1];
      }
    }
  });
}

template <class T>
void warp_matrix_backward(WarpMatrixBackward<T> const& p, int64_t begin, int64_t end) {
  MatrixUse const& use = p.coords.use;
  for (int64_t b = begin; b < end; ++b) {
    double sums[9] = {};
    for (double const *part = p.sums + b * p.parts * 9, *last = part + p.parts * 9; part < last; part += 9)
      for (int i = 0; i < 9; ++i) sums[i] += part[i];
    homography_vjp(p.coords.matrices + b * p.coords.matrix_stride, use, sums, p.grad + b * 3 * use.rows);
  }
}

KV_INSTANTIATE(sample_coords_backward, SampleCoordsBackward)
KV_INSTANTIATE_COMPUTED(warp_matrix_backward, WarpMatrixBackward)

}  // namespace kv::geometry::KV_ISA
