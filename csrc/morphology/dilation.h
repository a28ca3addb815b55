// Dilation and erosion of images with a window of offsets:
//
//   y(q) = max over i, j of x(q + (i - top, j - left)) + offsets(i, j), and for an erosion min of x(...) - offsets(i,
//   j)
//
// An offset of minus infinity leaves its pixel out; where all are 0 the window is flat, and larger ones take one axis
// after the other. An erosion is computed as the dilation of -x. NaN wins.
//
// The gradient of a maximum goes in equal parts to the taps of its window that have it:
//
//   dx(p) = sum over i, j with x(p) + offsets(i, j) = y(q) of g(q) / ties(q), where q = p - (i - top, j - left)
//
// Included by dilation_cpu.cpp, dilation.cu and dilation_op.cpp.
#pragma once

#include "core/isa.h"
#include "core/view.h"

namespace kv {

template <class F>
struct Offsets {
  F const* data;  // those of sample b at data + b * stride
  int64_t stride;
  int height, width, top, left;
  F value;  // of pixels outside of the images
  bool erode;
};

template <class T>
struct Dilation {
  Planes<T const> x;
  Planes<T> y;
  Offsets<Compute<T>> window;
  int64_t planes;  // of a sample
};

template <class T>
struct DilationBackward {
  Planes<T const> grad, x;
  Planes<T> grad_x;
  Offsets<Compute<T>> window;
  int64_t planes;
  Compute<T>* found;  // CUDA: for every element of the rows in their order, its maximum and its gradient's part
};

KV_KERNEL(dilation, Dilation)
KV_KERNEL(dilation_backward, DilationBackward)

template <class V>
KV_HD V larger(V a, V b) {
  V const most = a > b ? a : b;  // b where one is NaN
  return a != a ? a : most;
}

// The maximum so far, and how many taps have it.
template <class V>
struct Ties {
  V most, count;
  KV_HD void add(V v, V one) {
    count = v > most ? one : v == most ? count + one : count;
    most = larger(most, v);
  }
};

}  // namespace kv
