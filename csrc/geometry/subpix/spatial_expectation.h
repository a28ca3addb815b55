// The mean coordinates of the pixels of planes, weighted by their values p, or by the softmax p of `scale` times them.
// In the backward pass a pixel at X gets g X from the gradient g, or scale p (g X - g mean) with the softmax. Included
// by spatial_expectation_cpu.cpp, spatial_expectation.cu and spatial_expectation_op.cpp.
#pragma once

#include "core/isa.h"

namespace kv::geometry {

constexpr int64_t kExpectationChunk = 8192;  // pixels of a chunk, or one row if that has more

// The coordinates of the pixels along an axis.
template <class F>
struct CoordAxis {
  F first, step;

  KV_HD static CoordAxis of(int64_t size, bool normalized) {
    if (!normalized) return {F(0), F(1)};
    return {F(-1), size > 1 ? F(2. / double(size - 1)) : F(0)};
  }
  template <class V>
  KV_HD V at(V pixel) const {
    return first + step * pixel;
  }
};

template <class T>
struct HeatMaps {
  using F = Compute<T>;
  T const* data;                        // (planes, height, width)
  int64_t planes, height, width, rows;  // rows of a chunk
  CoordAxis<F> along_x, along_y;
  bool softmax;
  F scale;

  KV_HD int64_t chunks() const { return (height + rows - 1) / rows; }
};

// Sums over pixels: of their weights, and of the weights times the coordinates. The weights of a softmax are
// exponentials relative to that of `maximum`.
template <class F>
struct ExpectationSums {
  F maximum, sum, x, y;

  KV_HD static ExpectationSums nothing(bool softmax) {
    return {softmax ? (sizeof(F) == 4 ? F(-3.4e38) : F(-1.7e308)) : F(0), F(0), F(0), F(0)};
  }
  // Makes the sums relative to `largest`. exp(d) is the exponential of the softmax scale times d.
  template <class Exp>
  KV_HD void rescale(F largest, Exp exp) {
    F const factor = exp(maximum - largest);
    maximum = largest, sum *= factor, x *= factor, y *= factor;
  }
  template <class Exp>
  KV_HD void add(ExpectationSums other, bool softmax, Exp exp) {
    if (softmax) {
      F const largest = other.maximum > maximum ? other.maximum : maximum;
      rescale(largest, exp), other.rescale(largest, exp);
    }
    sum += other.sum, x += other.x, y += other.y;
  }
  // Stores a plane's coordinates, and the largest number and the sum of its softmax.
  KV_HD void store(F* coords, F* parts, bool softmax) const {
    coords[0] = softmax ? x / sum : x, coords[1] = softmax ? y / sum : y;
    parts[0] = maximum, parts[1] = sum;
  }
};

template <class T>
struct SpatialExpectation {
  HeatMaps<T> maps;
  ExpectationSums<Compute<T>>* partial;  // (planes, chunks)
  Compute<T>*coords, *parts;             // (planes, 2), set by the CUDA kernel; on the CPU the operator sets them
};

template <class T>
struct SpatialExpectationBackward {
  HeatMaps<T> maps;
  Compute<T> const *grad, *coords, *parts;  // (planes, 2)
  T* grad_input;
};

KV_KERNEL(spatial_expectation, SpatialExpectation)
KV_KERNEL(spatial_expectation_backward, SpatialExpectationBackward)

// The gradient of the pixels of a plane, from their values and their coordinates x and y.
template <class T>
struct ExpectationGradient {
  using F = Compute<T>;
  bool softmax;
  F of_x, of_y, of_mean, maximum, factor;

  KV_HD ExpectationGradient(SpatialExpectationBackward<T> const& p, int64_t plane)
      : softmax(p.maps.softmax),
        of_x(p.grad[2 * plane]),
        of_y(p.grad[2 * plane + 1]),
        of_mean(0),
        maximum(0),
        factor(1) {
    if (!softmax) return;
    of_mean = of_x * p.coords[2 * plane] + of_y * p.coords[2 * plane + 1];
    maximum = p.parts[2 * plane], factor = p.maps.scale / p.parts[2 * plane + 1];
  }
  template <class V, class Exp>
  KV_HD V at(V value, V x, V y, Exp exp) const {
    V const gradient = of_x * x + of_y * y - of_mean;
    return softmax ? V(gradient * factor * exp(V(value - maximum))) : gradient;
  }
};

}  // namespace kv::geometry
