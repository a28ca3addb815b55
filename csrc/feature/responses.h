// Responses of corners and blobs: a score of each pixel of an image that is high at corners or blobs.
//
//   corner   first derivatives dx, dy -> the structure tensor M, their products in a 7 x 7 Gaussian window of sigma 1
//            Harris: det M - k trace(M)^2. Shi and Tomasi: the smaller eigenvalue of M.
//   hessian  second derivatives -> the determinant of the Hessian
//   dog      a Gaussian blur in a window of 13 x 13 minus one in a window of 9 x 9
//
// The derivatives have the border kDerivativeBorder, and the windows the reflect border. W, the sum in a window along
// an axis, is not symmetric at the ends, but D W is, where D halves the two ends. The transpose of W is therefore D W
// D^-1, so the gradient uses the windows of the response.
#pragma once

#include "core/border.h"
#include "core/isa.h"
#include "core/view.h"
#include "filters/edges/spatial_gradient.h"

namespace kv::feature {

// The numbers are stable: exported graphs contain them.
enum class CornerKind : int { harris = 0, gftt = 1 };

constexpr Border kDerivativeBorder = Border::replicate;  // of first derivatives

// The reach of the window, and of a gradient through derivatives and windows.
constexpr int kWindowReach = 3, kCornerGradientReach = 2 * kWindowReach + 1;

// One value for each sample, or one for all samples (stride 0), or a constant (no data).
template <class F>
struct SampleValues {
  F const* data;
  int64_t stride;
  F constant;
  KV_HD F at(int64_t sample) const { return data ? data[sample * stride] : constant; }
};

// The arguments of responses besides the pixels. Responses are multiplied by the fourth powers of the sigmas.
template <class F>
struct ResponseArguments {
  SampleValues<F> k, sigmas;
  int64_t planes_of_sample;
  CornerKind kind;
  bool sobel;  // else central differences

  KV_HD F k_of(int64_t plane) const { return k.at(plane / planes_of_sample); }
  KV_HD F scale_of(int64_t plane) const {
    F const sigma = sigmas.at(plane / planes_of_sample), square = sigma * sigma;
    return square * square;
  }
};

template <class T>
struct Response {
  Planes<T const> x;
  Planes<T> y;
  ResponseArguments<Compute<T>> arguments;
};

template <class T>
struct ResponseBackward {
  Planes<T const> grad, x;
  Planes<T> grad_x;
  ResponseArguments<Compute<T>> arguments;
};

// The difference of two blurs, or its transpose. Weight d is that of pixels at distance d along an axis.
constexpr int kFineReach = 4, kCoarseReach = 6;
template <class T>
struct DifferenceOfGaussians {
  Planes<T const> x;
  Planes<T> y;
  Compute<T> fine[kFineReach + 1], coarse[kCoarseReach + 1];
  bool transposed;
};

KV_KERNEL(difference_of_gaussians, DifferenceOfGaussians)
KV_KERNEL(corner_response, Response)
KV_KERNEL(corner_response_backward, ResponseBackward)
KV_KERNEL(hessian_response, Response)
KV_KERNEL(hessian_response_backward, ResponseBackward)

// Weight t of the window, exp(-d^2 / 2) divided by the sum; the middle is t = kWindowReach.
template <class F>
KV_HD constexpr F window_weight(int t) {
  constexpr double w1 = 0.60653065971263342, w2 = 0.13533528323661270, w3 = 0.011108996538242306;
  constexpr double sum = 1 + 2 * (w1 + w2 + w3);
  constexpr F w[] = {F(w3 / sum), F(w2 / sum), F(w1 / sum), F(1 / sum), F(w1 / sum), F(w2 / sum), F(w3 / sum)};
  return w[t];
}

// The pixel at position i of an axis of n > 1 pixels, reflected as often as needed.
template <class Int>
KV_HD Int reflected(Int i, Int n) {
  Int const period = 2 * (n - 1);
  i = (i < 0 ? -i : i) % period;
  return i < n ? i : period - i;
}

// `end` for the first and the last pixel of an axis of n pixels, 1 for the others: D or its inverse.
template <class F, class Int>
KV_HD F end_factor(Int i, Int n, F end) {
  return n > 1 && (i == 0 || i == n - 1) ? end : F(1);
}

// --- responses and their gradients -----------------------------------------------------------------------------------

template <class V>
struct SymmetricMatrix {
  V xx, yy, xy;
};

template <class V, class F>
KV_HD V harris(SymmetricMatrix<V> m, F k) {
  V const trace = m.xx + m.yy;
  return m.xx * m.yy - m.xy * m.xy - trace * trace * k;
}
template <class V, class F>
KV_HD SymmetricMatrix<V> harris_vjp(SymmetricMatrix<V> m, F k, V grad) {
  V const trace_factor = (m.xx + m.yy) * (2 * k);
  return {grad * (m.yy - trace_factor), grad * (m.xx - trace_factor), grad * m.xy * F(-2)};
}

// The discriminant is a sum of squares, so it is never negative. Where it is 0, the gradient of its root is taken as 0.
template <class V>
KV_HD V gftt(SymmetricMatrix<V> m, V root) {
  return (m.xx + m.yy - root) / 2;
}
template <class V>
KV_HD V gftt_discriminant(SymmetricMatrix<V> m) {
  V const difference = m.xx - m.yy;
  return difference * difference + m.xy * m.xy * 4;
}
// `inverse_root` is 0 where the root is 0.
template <class V>
KV_HD SymmetricMatrix<V> gftt_vjp(SymmetricMatrix<V> m, V inverse_root, V grad) {
  V const half = grad / 2, grad_difference = half * (m.xx - m.yy) * inverse_root;
  return {half - grad_difference, half + grad_difference, grad * m.xy * inverse_root * -2};
}

template <class V>
KV_HD V determinant(SymmetricMatrix<V> m) {
  return m.xx * m.yy - m.xy * m.xy;
}
template <class V>
KV_HD SymmetricMatrix<V> determinant_vjp(SymmetricMatrix<V> m, V grad) {
  return {grad * m.yy, grad * m.xx, grad * m.xy * -2};
}

// --- first derivatives -----------------------------------------------------------------------------------------------

// First derivatives, a column of three pixels at a time. Pixels with weight 0 are not read, so that NaN does not spread
// beyond the stencil.
template <class V>
struct GradientColumn {
  V smooth, difference;
};
template <class V>
KV_HD GradientColumn<V> gradient_column(V above, V middle, V below, bool sobel) {
  return {sobel ? above + middle * 2 + below : middle, below - above};
}
template <class F>
KV_HD F gradient_scale(bool sobel) {
  return sobel ? F(0.125) : F(0.5);
}
template <class V, class F>
KV_HD void gradient(GradientColumn<V> left, GradientColumn<V> middle, GradientColumn<V> right, bool sobel, F scale,
                    V& dx, V& dy) {
  dx = (right.smooth - left.smooth) * scale;
  dy = (sobel ? left.difference + middle.difference * 2 + right.difference : middle.difference) * scale;
}

// The transpose, row by row: the gradient of a pixel from u = dL/d(dx) and v = dL/d(dy) of its neighbors, which
// filters/edges/sobel.h explains.
template <class V>
struct GradientRow {
  V across, along;
};
template <class V>
KV_HD GradientRow<V> gradient_row_vjp(V u_left, V u_right, V v_left, V v_middle, V v_right, bool sobel) {
  return {u_left - u_right, sobel ? v_left + v_middle * 2 + v_right : v_middle};
}
template <class V, class F>
KV_HD V gradient_vjp(GradientRow<V> above, GradientRow<V> middle, GradientRow<V> below, bool sobel, F scale) {
  V const across = sobel ? above.across + middle.across * 2 + below.across : middle.across;
  return (across + above.along - below.along) * scale;
}
// The row out of bounds next to the first or the last row.
template <class V>
KV_HD GradientRow<V> row_out_of_bounds(GradientRow<V> row) {
  return {row.across, -row.along};
}

// --- second derivatives ----------------------------------------------------------------------------------------------

// Calls f with the kernel of second derivatives.
template <class F>
KV_HD auto dispatch_second_derivatives(bool sobel, F f) {
  if (sobel)
    f(filters::Sobel2{});
  else
    f(filters::Diff2{});
}

// Derivatives that are not divided by their units. The units of xx, yy and xy are powers of two, so that a factor of
// the determinant gives the same bits as three of its derivatives.
template <class Kernel, class F>
struct SecondDerivatives {
  F const unit_xx = filters::Channel<Kernel, 0>::template scale<F>(true),
          unit_xy = filters::Channel<Kernel, 1>::template scale<F>(true);
  F const factor = unit_xx * unit_xx, relative_xy = unit_xy / unit_xx;

  template <class V>
  KV_HD SymmetricMatrix<V> hessian(V xx, V xy, V yy) const {
    return {xx, yy, xy * relative_xy};
  }
  // The gradient of the derivatives.
  template <class V>
  KV_HD SymmetricMatrix<V> hessian_vjp(SymmetricMatrix<V> grad) const {
    return {grad.xx, grad.yy, grad.xy * relative_xy};
  }
};

}  // namespace kv::feature
