// Dilation and erosion of images with a structuring element. Its members are where `kernel` is not 0; `heights` are
// optional and 0 for a flat element:
//
//   erosion   y(q) = min over members i, j of x(q + (i, j) - origin) - height(i, j)
//   dilation  y(q) = max over members i, j of x(q - (i, j) + origin) + height(i, j)
//
// Both are computed as the maximum over a window of x(q + (i - top, j - left)) + offset(i, j): a dilation with the
// reflected element, an erosion with -x. The offset of pixels that are no members is minus infinity. A window whose
// offsets are all 0 is flat; large flat windows are computed one axis after the other. NaN propagates.
//
// The gradient of a maximum is divided evenly among the taps of its window that equal it:
//
//   dx(p) = sum over i, j with x(p) + offset(i, j) = y(q) of g(q) / ties(q), where q = p - (i - top, j - left)
//
// In a flat window x(p) <= y(q) for all these q. So the q with equality are those where y(q) is the minimum of the
// window, if that minimum is x(p): the sum is over a window again, of what belongs to its minimum.
#pragma once

#include "core/isa.h"
#include "core/shared_memory.h"
#include "core/view.h"

namespace kv::morphology {

template <class F>
struct StructuringElement {
  F const *kernel, *heights;              // heights: null for a flat element
  int64_t kernel_stride, heights_stride;  // from sample to sample
  int height, width, top, left;
  F value;  // of pixels out of bounds
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
  StructuringElement<Compute<T>> window;
  int64_t planes;  // of a sample
};

template <class T>
struct DilationBackward {
  Planes<T const> grad, x;
  Planes<T> grad_x;
  StructuringElement<Compute<T>> window;
  int64_t planes;
  Compute<T>* workspace;  // CUDA: the maximum of each window and the gradient of one tie, for all elements; or null
};

template <class F>
bool is_3x3(StructuringElement<F> const& window) {
  return window.height == 3 && window.width == 3 && window.top == 1 && window.left == 1;
}

// Shared memory of the backward pass by tiles on CUDA. It holds two numbers for each window that reads a pixel of the
// tile (in the same memory, before them, the pixels of these windows), and two numbers for each of these windows along
// y and each column of theirs. Groups of windows may exceed a row.
struct BackwardTileLayout {
  static constexpr int kRows = 30, kColumns = 64;
  int rows, rows_of_pixels, windows, pixels;  // capacities; `windows` and `pixels` are those of a row, odd
  template <class F>
  KV_HD explicit BackwardTileLayout(StructuringElement<F> const& window)
      : rows(kRows + window.height - 1),
        rows_of_pixels(kRows + 2 * (window.height - 1)),
        windows((kColumns + window.width + 14) | 1),
        pixels((kColumns + 2 * window.width + 14) | 1) {}
  // Offset of the numbers along y.
  KV_HD int64_t first_bytes() const {
    return max(int64_t(8) * rows * windows, int64_t(4) * rows_of_pixels * (pixels + 1));
  }
  KV_HD int64_t bytes() const { return first_bytes() + int64_t(8) * rows * pixels; }
};

// Whether the backward pass of planar images needs no workspace on CUDA.
template <class F>
bool needs_no_workspace(StructuringElement<F> const& window) {
  return is_3x3(window) || (sizeof(F) == 4 && BackwardTileLayout(window).bytes() <= max_shared_bytes());
}

KV_KERNEL(dilation, Dilation)
KV_KERNEL(dilation_backward, DilationBackward)

// IEEE 754 maximum: NaN propagates.
template <class V>
KV_HD V maximum(V a, V b) {
  V const larger = a > b ? a : b;  // b where one is NaN
  return a != a ? a : larger;
}

// The maximum so far, and how many taps equal it, or the sum of a number over these taps.
template <class V>
struct Ties {
  V value, count;
  KV_HD void add(V v, V one) {
    count = v > value ? one : v == value ? count + one : count;
    value = maximum(value, v);
  }
};

}  // namespace kv::morphology
