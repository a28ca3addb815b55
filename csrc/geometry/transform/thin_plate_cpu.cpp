// Thin-plate splines on the CPU: chunks [begin, end) of the points of all samples, by vectors; weights by sample.
// Compiled once per instruction set.
#include "core/lanes.h"
// After it, for vectors.
#include "geometry/transform/thin_plate.h"

namespace kv::geometry::KV_ISA {
namespace {

// A chunk of a sample's points, zero-padded to whole vectors.
template <class T>
struct Part {
  static constexpr int N = kLanes<T>;
  using V = Lanes<T, N>;
  int64_t b, first, count;
  T const *centers, *weights, *affine;
  alignas(64) T x[kThinPlateChunk], y[kThinPlateChunk];

  KV_HD Part(ThinPlate<T> const& p, int64_t number) {
    int64_t const parts = thin_plate_chunks(p.count);
    b = number / parts;
    first = (number - b * parts) * kThinPlateChunk;
    count = min(p.count - first, int64_t(kThinPlateChunk));
    centers = p.centers + b * p.center_stride;
    weights = p.weights + b * p.weight_stride;
    affine = p.affine + b * p.affine_stride;
    if (p.points) {
      T const* const from = p.points + b * p.point_stride + 2 * first;
      for (int64_t i = 0; i < count; ++i) x[i] = from[2 * i], y[i] = from[2 * i + 1];
    } else {
      int64_t row = first / p.width, column = first - row * p.width;
      for (int64_t i = 0; i < count; ++i) {
        x[i] = p.pixel(0, column);
        y[i] = p.pixel(1, row);
        if (++column == p.width) column = 0, ++row;
      }
    }
    end(x);
    end(y);
  }
  // Zeros to the end of the last vector.
  KV_HD void end(T* values) const {
    for (int64_t i = count; i % N != 0; ++i) values[i] = 0;
  }
};

template <class V>
KV_HD auto total(V v) {
  auto sum = v[0];
  for (int i = 1; i < int(sizeof(v) / sizeof(v[0])); ++i) sum += v[i];
  return sum;
}

template <class T>
void spline_part(ThinPlate<T> const& p, int64_t number) {
  constexpr int N = Part<T>::N;
  using V = typename Part<T>::V;
  Part<T> const part(p, number);
  T const* const a = part.affine;
  alignas(64) T to_x[kThinPlateChunk], to_y[kThinPlateChunk];
  for (int64_t i = 0; i < part.count; i += N) {
    V const x = load<N>(part.x + i), y = load<N>(part.y + i);
    V u = x * a[2] + (y * a[4] + a[0]), v = x * a[3] + (y * a[5] + a[1]);
    for (int64_t n = 0; n < 2 * p.center_count; n += 2) {
      V const dx = x - part.centers[n], dy = y - part.centers[n + 1], square = dx * dx + dy * dy;
      V const value = radial_basis<T>(square, vlog2<T, N>(square));
      u += value * part.weights[n];
      v += value * part.weights[n + 1];
    }
    store<N>(to_x + i, u);
    store<N>(to_y + i, v);
  }
  T *const x = p.result + p.at(part.b, part.first, 0), *const y = p.result + p.at(part.b, part.first, 1);
  int64_t const step = p.planar ? 1 : 2;
  for (int64_t i = 0; i < part.count; ++i) x[i * step] = to_x[i], y[i * step] = to_y[i];
}

template <class T>
void spline_part_backward(ThinPlate<T> const& p, int64_t number) {
  constexpr int N = Part<T>::N;
  using V = typename Part<T>::V;
  Part<T> const part(p, number);
  T const* const a = part.affine;
  alignas(64) T u[kThinPlateChunk], v[kThinPlateChunk], to_x[kThinPlateChunk], to_y[kThinPlateChunk];
  T const *const from_u = p.grad + p.at(part.b, part.first, 0), *const from_v = p.grad + p.at(part.b, part.first, 1);
  int64_t const step = p.planar ? 1 : 2, width = 4 * p.center_count + 6;
  for (int64_t i = 0; i < part.count; ++i) u[i] = from_u[i * step], v[i] = from_v[i * step];
  part.end(u);
  part.end(v);
  T *const grad_centers = p.sums + number * width, *const grad_weights = grad_centers + 2 * p.center_count,
           *const grad_affine = grad_weights + 2 * p.center_count;
  V affine[6] = {};
  for (int64_t i = 0; i < part.count; i += N) {
    V const x = load<N>(part.x + i), y = load<N>(part.y + i), gu = load<N>(u + i), gv = load<N>(v + i);
    affine[0] += gu;
    affine[1] += gv;
    affine[2] += gu * x;
    affine[3] += gv * x;
    affine[4] += gu * y;
    affine[5] += gv * y;
    store<N>(to_x + i, V(gu * a[2] + gv * a[3]));
    store<N>(to_y + i, V(gu * a[4] + gv * a[5]));
  }
  for (int i = 0; i < 6; ++i) grad_affine[i] = total(affine[i]);
  for (int64_t n = 0; n < 2 * p.center_count; n += 2) {
    V sums[4] = {};
    for (int64_t i = 0; i < part.count; i += N) {
      V const dx = load<N>(part.x + i) - part.centers[n], dy = load<N>(part.y + i) - part.centers[n + 1];
      V const square = dx * dx + dy * dy, log = vlog2<T, N>(square), value = radial_basis<T>(square, log);
      V const gu = load<N>(u + i), gv = load<N>(v + i);
      V const along = (gu * part.weights[n] + gv * part.weights[n + 1]) * radial_basis_derivative<T>(square, log);
      store<N>(to_x + i, V(load<N>(to_x + i) + along * dx));
      store<N>(to_y + i, V(load<N>(to_y + i) + along * dy));
      sums[0] -= along * dx;
      sums[1] -= along * dy;
      sums[2] += value * gu;
      sums[3] += value * gv;
    }
    grad_centers[n] = total(sums[0]), grad_centers[n + 1] = total(sums[1]);
    grad_weights[n] = total(sums[2]), grad_weights[n + 1] = total(sums[3]);
  }
  if (p.grad_points)
    for (int64_t i = 0; i < part.count; ++i) {
      T* const to = p.grad_points + 2 * (part.b * p.count + part.first + i);
      to[0] = to_x[i], to[1] = to_y[i];
    }
}

}  // namespace

template <class T>
void thin_plate(ThinPlate<T> const& p, int64_t begin, int64_t end) {
  for (int64_t i = begin; i < end; ++i) spline_part(p, i);
}

template <class T>
void thin_plate_backward(ThinPlate<T> const& p, int64_t begin, int64_t end) {
  for (int64_t i = begin; i < end; ++i) spline_part_backward(p, i);
}

template <class T>
void reduce_thin_plate_grads(ThinPlateReduction<T> const& p, int64_t begin, int64_t end) {
  int64_t const width = p.width();
  for (int64_t b = begin; b < end; ++b)
    for (int64_t i = 0; i < width; ++i) {
      double sum = 0;
      for (int64_t part = 0; part < p.parts; ++part) sum += p.sums[(b * p.parts + part) * width + i];
      p.set(b, i, sum);
    }
}

KV_INSTANTIATE_COMPUTED(thin_plate, ThinPlate)
KV_INSTANTIATE_COMPUTED(thin_plate_backward, ThinPlate)
KV_INSTANTIATE_COMPUTED(reduce_thin_plate_grads, ThinPlateReduction)

#if !defined(__AVX512F__)
template <class T>
void thin_plate_weights(ThinPlateWeights<T> const& p, int64_t begin, int64_t end) {
  constexpr int N = kLanes<T>;
  auto const log = [](T x) { return vlog2<T, 1>(x); };
  // By whole vectors, also of what is not read again.
  auto const subtract = [](T* row, int64_t k, int64_t rows, int64_t width) {
    T* to = row + width;
    for (int64_t i = 0; i < rows; ++i, to += width) {
      T const factor = to[k];
      for (int64_t j = (k + 1) / N * N; j < width; j += N)
        store<N>(to + j, Lanes<T, N>(load<N>(to + j) - load<N>(row + j) * factor));
    }
  };
  for (int64_t b = begin; b < end; ++b)
    solve_thin_plate_weights(p, b, p.systems + b * p.size() * p.width(), SingleThread{}, log, subtract);
}

KV_INSTANTIATE_ONE(thin_plate_weights, ThinPlateWeights, double)
#endif

}  // namespace kv::geometry::KV_ISA
