// Dilation and erosion of images with a structuring element, whose members are where `kernel` is not 0 and whose
// heights are 0 unless there are some:
//
//   erosion   y(q) = min over members i, j of x(q + (i, j) - origin) - height(i, j)
//   dilation  y(q) = max over members i, j of x(q - (i, j) + origin) + height(i, j)
//
// Both are computed as the maximum over a window of x(q + (i - top, j - left)) + offset(i, j), a dilation with the
// element turned round, an erosion of -x; members are the offsets above minus infinity. Where all offsets are 0 the
// window is flat, and larger ones take one axis after the other. NaN wins.
//
// The gradient of a maximum goes in equal parts to the taps of its window that have it:
//
//   dx(p) = sum over i, j with x(p) + offset(i, j) = y(q) of g(q) / ties(q), where q = p - (i - top, j - left)
//
// In a flat window x(p) <= y(q) for all these q, so equality means that y(q) is their minimum, and that is x(p): the
// sum is one over a window again, of what belongs to the minimum.
//
// Included by dilation_cpu.cpp, dilation.cu and dilation_op.cpp.
#pragma once

#include "core/isa.h"
#include "core/view.h"

namespace kv {

template <class F>
struct Window {
  F const *kernel, *heights;              // heights: null for a flat element
  int64_t kernel_stride, heights_stride;  // from sample to sample
  int height, width, top, left;
  F value;  // of pixels outside of the images
  bool erode;

  KV_HD F offset(int64_t sample, int i) const {
    int const at = erode ? i : height * width - 1 - i;
    if (kernel[sample * kernel_stride + at] == 0) return -F(__builtin_inff());
    return heights ? heights[sample * heights_stride + at] : F(0);
  }
  KV_HD F sign() const { return erode ? F(-1) : F(1); }
};

template <class T>
struct Dilation {
  Planes<T const> x;
  Planes<T> y;
  Window<Compute<T>> window;
  int64_t planes;  // of a sample
};

template <class T>
struct DilationBackward {
  Planes<T const> grad, x;
  Planes<T> grad_x;
  Window<Compute<T>> window;
  int64_t planes;
  Compute<T>*
      found;  // CUDA: for every element of the rows in their order, its maximum and its gradient's part; or null
};

template <class F>
bool is_3x3(Window<F> const& window) {
  return window.height == 3 && window.width == 3 && window.top == 1 && window.left == 1;
}

// The gradient on CUDA by tiles of the image. Shared memory has two numbers for each of the windows that have a pixel
// of the tile, before them those pixels that these windows have, and two for each of these windows along y and as many
// columns as they have. Groups of windows may reach beyond.
struct GradientTile {
  static constexpr int kRows = 30, kColumns = 64, kMostBytes = 227 * 1024;
  int rows, rows_of_pixels, windows, pixels;  // what there is room for; `windows` and `pixels` are those of a row, odd
  template <class F>
  KV_HD explicit GradientTile(Window<F> const& window)
      : rows(kRows + window.height - 1),
        rows_of_pixels(kRows + 2 * (window.height - 1)),
        windows((kColumns + window.width + 14) | 1),
        pixels((kColumns + 2 * window.width + 14) | 1) {}
  // To what is along y.
  KV_HD int64_t first_bytes() const {
    return max(int64_t(8) * rows * windows, int64_t(4) * rows_of_pixels * (pixels + 1));
  }
  KV_HD int64_t bytes() const { return first_bytes() + int64_t(8) * rows * pixels; }
};

// Whether the gradient of planar images takes no other memory on CUDA.
template <class F>
bool has_own_memory(Window<F> const& window) {
  return is_3x3(window) || (sizeof(F) == 4 && GradientTile(window).bytes() <= GradientTile::kMostBytes);
}

KV_KERNEL(dilation, Dilation)
KV_KERNEL(dilation_backward, DilationBackward)

template <class V>
KV_HD V larger(V a, V b) {
  V const most = a > b ? a : b;  // b where one is NaN
  return a != a ? a : most;
}

// The maximum so far, and how many taps have it, or the sum of what they bring.
template <class V>
struct Ties {
  V most, count;
  KV_HD void add(V v, V one) {
    count = v > most ? one : v == most ? count + one : count;
    most = larger(most, v);
  }
};

}  // namespace kv
