// Thin-plate splines. A point p is mapped to
//
//   a_0 + p_x a_1 + p_y a_2 + sum of w_c U(|p - c|^2) over the centers c,     U(s) = s log(s) / 2
#pragma once

#include "core/ceil_div.h"
#include "core/isa.h"
#include "geometry/small_matrix.h"
#include "geometry/thread_group.h"

namespace kv::geometry {

template <class T>
struct ThinPlate {
  T const* points;                      // (B, count, 2), or null: the pixels of an image, in [-1, 1]
  T const *centers, *weights, *affine;  // (B, centers, 2), (B, centers, 2), (B, 3, 2)
  int64_t point_stride, center_stride, weight_stride, affine_stride;  // 0 where one serves all samples
  int64_t width;                                                      // of that image
  T middle[2], scale[2];                                              // of a pixel x: (x - middle) * scale
  int64_t batch, count, center_count;
  bool planar;  // results are (B, 2, count), not (B, count, 2)
  T* result;
  // For the gradient only: that to the result; those to points; and those to the rest, of parts of the points of each
  // sample, (B, parts, 4 * centers + 6).
  T const* grad;
  T* grad_points;
  T* sums;

  KV_HD int64_t at(int64_t b, int64_t i, int axis) const {
    return planar ? (2 * b + axis) * count + i : 2 * (b * count + i) + axis;
  }
  KV_HD T pixel(int axis, int64_t i) const { return (T(i) - middle[axis]) * scale[axis]; }
};

// The number of points in one partial sum.
constexpr int kThinPlateChunk = 1024;
inline int64_t thin_plate_chunks(int64_t count) { return ceil_div(count, kThinPlateChunk); }

// Adds the parts up: to (B, centers, 2), (B, centers, 2), (B, 3, 2).
template <class T>
struct ThinPlateReduction {
  T const* sums;
  int64_t batch, parts, center_count;
  T *grad_centers, *grad_weights, *grad_affine;

  KV_HD int64_t width() const { return 4 * center_count + 6; }
  KV_HD void set(int64_t b, int64_t i, double value) const {
    int64_t const n = 2 * center_count;
    T* const to = i < n       ? grad_centers + b * n + i
                  : i < 2 * n ? grad_weights + b * n + i - n
                              : grad_affine + b * 6 + i - 2 * n;
    *to = T(value);
  }
};

// The weights with which a spline has the values `right` at its centers, and three sums of them; in double.
template <class T>
struct ThinPlateWeights {
  Reals centers, rhs, result;  // (B, centers, 2), (B, centers + 3, 2) twice
  int64_t center_stride, rhs_stride;
  int64_t batch, center_count;
  T* systems;  // (B, size, width): workspace

  KV_HD int64_t size() const { return center_count + 3; }
  KV_HD int64_t width() const { return (size() + 2 + 7) / 8 * 8; }  // whole vectors
};

KV_KERNEL(thin_plate, ThinPlate)
KV_KERNEL(thin_plate_backward, ThinPlate)
KV_KERNEL(reduce_thin_plate_grads, ThinPlateReduction)
KV_KERNEL(thin_plate_weights, ThinPlateWeights)

// --- U ---------------------------------------------------------------------------------------------------------------

// For smaller squares U is negligible, and the logarithms of the kernels are undefined.
template <class F>
constexpr F kMinSquare = sizeof(F) == 4 ? F(1e-36) : F(1e-300);

// U(s), and its derivative with respect to p divided by p - c, from s and log2(s).
template <class F, class V>
KV_HD V radial_basis(V square, V log2) {
  return square > kMinSquare<F> ? V(square * log2 * F(0.34657359027997265)) : V{};
}
template <class F, class V>
KV_HD V radial_basis_derivative(V square, V log2) {
  return square > kMinSquare<F> ? V(log2 * F(0.69314718055994531) + 1) : V{};
}

// --- weights ---------------------------------------------------------------------------------------------------------

// Calls f(i, j) for all of so many rows and columns, by one thread or by those of a block, all of which then wait for
// one another.
template <class F>
KV_HD void each(SingleThread, int64_t rows, int64_t columns, F f) {
  for (int64_t i = 0; i < rows; ++i)
    for (int64_t j = 0; j < columns; ++j) f(i, j);
}
#if defined(__CUDACC__)
template <class F>
__device__ __forceinline__ void each(ThreadBlock, int rows, int columns, F f) {
  for (int at = threadIdx.x; at < rows * columns; at += blockDim.x) f(at / columns, at % columns);
  __syncthreads();
}
#endif

//   | U(|c_i - c_j|^2)  1  c_i |  | w |
//   |        1          0   0  |  |   |  =  right,
//   |       c_j         0   0  |  | a |
//
// by elimination with the largest pivot of each column. `subtract(row, k, rows, width)` subtracts a row with a 1 at k
// from that many rows below it so that they have a 0 there; of these nothing up to k is read again.
template <class T, class Group, class Log, class Subtract>
KV_HD void solve_thin_plate_weights(ThinPlateWeights<T> const& p, int64_t b, T* system, Group group, Log log2,
                                    Subtract subtract) {
  int64_t const n = p.size(), width = p.width();
  auto const center = [&](int64_t i, int axis) { return p.centers[b * p.center_stride + 2 * i + axis]; };
  each(group, n, width, [&](int64_t i, int64_t j) {
    int64_t const low = min(i, j), high = max(i, j);
    T value = 0;
    if (j >= n) {
      if (j < n + 2) value = p.rhs[b * p.rhs_stride + 2 * i + j - n];
    } else if (low >= p.center_count) {
    } else if (high >= p.center_count) {
      value = high == p.center_count ? 1 : center(low, int(high - p.center_count - 1));
    } else {
      T const dx = center(i, 0) - center(j, 0), dy = center(i, 1) - center(j, 1), square = dx * dx + dy * dy;
      value = radial_basis<T>(square, log2(square));
    }
    system[i * width + j] = value;
  });
  for (int64_t k = 0; k < n; ++k) {
    int64_t chosen = k;
    T pivot = system[k * width + k];
    for (int64_t i = k + 1; i < n; ++i) {
      T const other = system[i * width + k];
      if (small::magnitude(other) > small::magnitude(pivot)) {
        chosen = i;
        pivot = other;
      }
    }
    each(group, 0, 1, [](int64_t, int64_t) {});  // all threads have read the pivot
    T *const first = system + k * width, *const other = system + chosen * width;
    each(group, 1, n + 2 - k, [&](int64_t, int64_t j) {
      T const value = other[k + j] / pivot;
      other[k + j] = first[k + j];
      first[k + j] = value;
    });
    subtract(first, k, n - k - 1, width);
  }
  for (int64_t k = n - 1; k > 0; --k)
    each(group, k, 2,
         [&](int64_t i, int64_t j) { system[i * width + n + j] -= system[i * width + k] * system[k * width + n + j]; });
  each(group, n, 2, [&](int64_t i, int64_t j) { p.result.set(2 * (b * n + i) + j, system[i * width + n + j]); });
}

}  // namespace kv::geometry
