// Structural similarity of two images, from four Gaussian means of the windows: of x, of y, of x^2 + y^2, of (x - y)^2.
//
//   A = mx^2 + my^2 + c1      a = (mx - my)^2                 luminance 1 - a / A
//   B = var x + var y + c2    b = var (x - y)                 structure 1 - b / B
//   similarity = ((A - a) (B - b) + eps) / (A B + eps)        without luminance (B - b + eps) / (B + eps)
//
// Neither factor exceeds 1, whatever is rounded, and equal images have a = b = 0. Included by ssim_cpu.cpp, ssim.cu and
// ssim_op.cpp.
//
// The gradient takes the derivatives of the similarity by the means, times the gradient g of the result, through the
// transpose of the means:
//
//   dx = M(g dmx) + 2 x M(g dsquares) + 2 (x - y) M(g dapart)
//   dy = M(g dmy) + 2 y M(g dsquares) - 2 (x - y) M(g dapart)
//
// The means are symmetric but for the border. With zeros around the image the transpose is the same, of a 'valid'
// window it has zeros around the result, and of a reflected border it is D^-1 A D, where A are the means and D doubles
// the first and the last pixel of an axis; filters/box.h has the reason.
#pragma once

#include "core/border.h"
#include "core/isa.h"
#include "core/view.h"

namespace kv {

template <class F>
struct SsimConstants {
  F c1, c2, eps;
  bool luminance;
};

// The means, or the derivatives by them.
template <class V>
struct Means {
  V x, y, squares, apart;
};

template <class V, class F>
KV_HD V ssim_of_means(Means<V> const& m, SsimConstants<F> const& c) {
  V const zero = V{}, mean_squares = m.x * m.x + m.y * m.y, difference = m.x - m.y, a = difference * difference;
  V const B = max(V(m.squares - mean_squares), zero) + c.c2, b = max(V(m.apart - a), zero);
  if (!c.luminance) return (B - b + c.eps) / (B + c.eps);
  V const A = mean_squares + c.c1;
  return ((A - a) * (B - b) + c.eps) / (A * B + c.eps);
}

template <class V, class F>
KV_HD Means<V> ssim_of_means_vjp(Means<V> const& m, SsimConstants<F> const& c, V g) {
  V const zero = V{}, mean_squares = m.x * m.x + m.y * m.y, difference = m.x - m.y, a = difference * difference;
  V const raw_B = m.squares - mean_squares, raw_b = m.apart - a;
  V const B = max(raw_B, zero) + c.c2, b = max(raw_b, zero);
  V d_A = zero, d_a = zero, d_B, d_b;
  if (c.luminance) {
    V const A = mean_squares + c.c1, inverse = V{} + 1 / V(A * B + c.eps), scale = g * inverse;
    V const similarity = ((A - a) * (B - b) + c.eps) * inverse;
    d_A = ((B - b) - similarity * B) * scale;
    d_a = -(B - b) * scale;
    d_B = ((A - a) - similarity * A) * scale;
    d_b = -(A - a) * scale;
  } else {
    V const inverse = V{} + 1 / V(B + c.eps), scale = g * inverse;
    d_B = b * inverse * scale;
    d_b = -scale;
  }
  d_B = raw_B >= zero ? d_B : zero;
  d_b = raw_b >= zero ? d_b : zero;
  V const of_both = 2 * (d_A - d_B), of_difference = 2 * (d_a - d_b) * difference;
  return {m.x * of_both + of_difference, m.y * of_both - of_difference, d_B, d_b};
}

// Two images of one layout and their window. `border` is reflect, or constant for zeros; with `valid`, where it is
// constant, no window passes the images, and the similarity is smaller by size - 1 pixels.
template <class T>
struct SsimImages {
  Planes<T const> x, y;
  Compute<T> const* weights;  // `size` of them, in host memory
  int size;
  Border border;
  bool valid;
  SsimConstants<Compute<T>> constants;

  KV_HD int before() const { return valid ? 0 : size / 2; }
};

// A loss for each row of planes, one row behind the other: the sum of 1 - similarity times `structure`, and that of
// abs(x - y) times `absolute`.
template <class F>
struct SsimLoss {
  F structure, absolute;
  int64_t planes;  // of a row
};

// Either the similarity, or where that has no data the loss.
template <class T>
struct Ssim {
  SsimImages<T> images;
  Planes<T> similarity;
  SsimLoss<Compute<T>> loss;
  Compute<T>* partial;  // what is summed: on the CPU a number for each row of the similarity, on CUDA for each warp
  Compute<T>* sums;     // CUDA: of the rows
};

template <class T>
struct SsimBackward {
  SsimImages<T> images;
  Planes<T const> grad;      // of the similarity; without data it is that of the loss
  Planes<T> grad_x, grad_y;  // grad_y.data is null where it is not needed
  SsimLoss<Compute<T>> loss;
  Compute<T> const* of_loss;  // the gradient of each row's
};

// CUDA: the most that `partial` has for a plane.
inline int64_t most_ssim_pieces(int64_t height, int64_t width) { return (width / 32 + 2) * (height / 8 + 1); }

// The windows of the CUDA kernels, which take planar images that are no smaller than the window and not of double. What
// else there is takes filter2d_separable, in Python.
constexpr bool has_ssim_kernel(int64_t size) { return size == 5 || size == 7 || size == 11; }

KV_KERNEL(ssim, Ssim)
KV_KERNEL(ssim_backward, SsimBackward)

}  // namespace kv
