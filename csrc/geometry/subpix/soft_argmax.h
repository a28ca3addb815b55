// The soft argmax of every window of a volume (an image has depth 1). The weights of a window are
//
//   w(v) = exp(x(v) / temperature) / sum of these      over the voxels v of the window that are in the volume
//
// and the results are the means under w of the coordinates, scale * index + offset, and of x.
//
// The gradient of a voxel v is a sum over the windows that contain it. Each term depends on v and on a record of the
// window:
//
//   dx(v) = sum of w(v) (g_value + (g_coords . (v - start) + g_value x(v) + rest) / temperature)
//           rest = -(g_coords . (coords - start) + g_value value)
//
// A backward pass computes the records first, then gathers. On CUDA, windows around every pixel of images share their
// exponentials, and both steps are one pass.
#pragma once

#include "core/isa.h"

namespace kv::geometry {

struct Windows {
  int64_t volumes;
  int axes;                                              // coordinates of a result: 2, (x, y), or 3, (z, x, y)
  int size[3], out[3], window[3], stride[3], before[3];  // along z, y, x; padding is on both sides

  KV_HD int64_t voxels() const { return int64_t(size[0]) * size[1] * size[2]; }
  KV_HD int64_t area() const { return int64_t(window[0]) * window[1] * window[2]; }
  KV_HD int64_t coords() const { return int64_t(out[0]) * out[1] * out[2]; }
  // The axis (0, 1, 2 for z, y, x) of a result's coordinate.
  KV_HD int axis_of(int number) const { return axes == 3 && number == 0 ? 0 : number == axes - 1 ? 1 : 2; }
};

template <class T>
struct SoftArgmax {
  Windows windows;
  Compute<T> temperature;
  Compute<T> scale[3], offset[3];
  T const* x;          // (n, D, H, W)
  T *coords, *values;  // (n, axes, D', H', W'), (n, D', H', W') or null
};

// What the gradients of a window's voxels depend on. `maximum` is the largest x, which exponents are relative to.
template <class V>
struct WindowRecord {
  V maximum, coord[3], value, rest;  // all but `maximum` are divided by the sum of exponentials
};
constexpr int kRecord = 6;

template <class T>
struct SoftArgmaxBackward {
  Windows windows;
  Compute<T> temperature;
  Compute<T> scale[3];
  T const *grad_coords, *grad_values, *x;  // grad_values: null without a gradient of the values
  T* grad_x;
  Compute<T>* records;  // (6, n, D', H', W'); null if one pass does both steps
};

KV_KERNEL(soft_argmax, SoftArgmax)
KV_KERNEL(soft_argmax_records, SoftArgmaxBackward)
KV_KERNEL(soft_argmax_backward, SoftArgmaxBackward)

// The radius of windows of 3 x 3 or 5 x 5 around every pixel of images, else 0.
inline int radius_of(Windows const& w) {
  int const r = w.before[1];
  bool fits = w.axes == 2 && w.size[0] == 1 && w.window[0] == 1 && r <= 2;
  for (int axis = 1; axis < 3; ++axis)
    fits = fits && w.stride[axis] == 1 && w.before[axis] == r && w.window[axis] == 2 * r + 1;
  return fits ? r : 0;
}

// Of the window of output `out`: its start, and the indices [first, last) in the window that are inside an axis of n.
struct Span {
  int start, first, last;
  KV_HD Span(int out, int stride, int before, int window, int n)
      : start(out * stride - before), first(max(0, -start)), last(min(window, n - start)) {}
};

// The outputs [first, last) whose windows contain index i.
struct Readers {
  int first, last;
  KV_HD Readers(int i, int stride, int before, int window, int out)
      : first(max(0, (i + before - window) / stride + (i + before >= window))),
        last(min(out, (i + before) / stride + 1)) {}
};

// The sums of a window. `at(k, j, i)` reads x at an index of the window; exp2 depends on the device.
template <class V>
struct WindowSums {
  V maximum, total, index[3], value;

  template <class F, class At, class Exp2>
  KV_HD WindowSums(Span const& z, Span const& y, Span const& x, F sharpness, At at, Exp2 exp2) {
    maximum = at(z.first, y.first, x.first);
    for (int k = z.first; k < z.last; ++k)
      for (int j = y.first; j < y.last; ++j)
        for (int i = x.first; i < x.last; ++i) maximum = max(maximum, V(at(k, j, i)));
    total = value = index[0] = index[1] = index[2] = V{};
    for (int k = z.first; k < z.last; ++k) {
      V plane{};
      for (int j = y.first; j < y.last; ++j) {
        V row{};
        for (int i = x.first; i < x.last; ++i) {
          V const v = at(k, j, i), e = exp2(V((v - maximum) * sharpness));
          row += e;
          index[2] += e * F(i);
          value += e * v;
        }
        plane += row;
        index[1] += row * F(j);
      }
      total += plane;
      index[0] += plane * F(k);
    }
  }
};

// The record of a window. `grad` has the gradients to the coordinates, by axis.
template <class V, class F>
KV_HD WindowRecord<V> record_of(WindowSums<V> const& sums, V const (&grad)[3], V grad_value) {
  V const scale = F(1) / sums.total;
  WindowRecord<V> r;
  r.maximum = sums.maximum;
  r.rest = grad_value * sums.value;
  for (int axis = 0; axis < 3; ++axis) {
    r.coord[axis] = grad[axis] * scale;
    r.rest += grad[axis] * sums.index[axis];
  }
  r.value = grad_value * scale;
  r.rest = -(r.rest * scale) * scale;
  return r;
}

// What a window contributes to the gradient of its voxel (k, j, i), whose value is v and whose exponential is e.
template <class V, class F>
KV_HD V contribution_of(WindowRecord<V> const& r, V v, V e, F k, F j, F i, F per_temperature) {
  V const weight_grad = r.coord[0] * k + r.coord[1] * j + r.coord[2] * i + r.value * v + r.rest;
  return e * (r.value + weight_grad * per_temperature);
}

}  // namespace kv::geometry
