// Shared by the entries of filter2d_separable, gaussian_blur2d and unsharp_mask.
#pragma once

#include "glue/glue.h"
#include "separable.h"

namespace kv::filters {

// The weights of a call along one axis: a tensor (B or 1, size), or a Gaussian whose sigma is a column of a tensor
// (B or 1, 2) or a number.
struct AxisWeights {
  Tensor const* tensor;
  int64_t size;
  bool gaussian = false;
  int64_t column = 0;
  double sigma = 0;

  template <class F>
  Taps<F> taps(bool same, bool transposed) const {
    int64_t const before = same ? (size - 1) / 2 : 0;
    Taps<F> taps{nullptr, 0, F(sigma), int(size), int(transposed ? size - 1 - before : before), gaussian, transposed};
    if (tensor) {
      taps.data = static_cast<F const*>(tensor->const_data_ptr()) + column * tensor->stride(1);
      taps.stride = tensor->size(0) > 1 ? tensor->stride(0) : 0;
    }
    return taps;
  }
};

// Weights or sigmas of images `x`, (B or 1, n) in the compute type of `x`.
inline void check_sample_weights(char const* op, Tensor const& rows, Tensor const& x) {
  KV_CHECK(rows.dim() == 2 && rows.size(1) > 0 && (rows.size(0) == 1 || rows.size(0) == x.size(0)), op,
           ": expected weights or sigmas of shape (B or 1, n)");
  KV_CHECK(rows.scalar_type() == compute_dtype(x) && rows.device() == x.device(), op,
           ": weights or sigmas differ in dtype or device from what the input is computed in");
}

// The same weights or sigmas, contiguous.
inline Tensor checked_weights(char const* op, Tensor const& rows, Tensor const& x) {
  check_sample_weights(op, rows, x);
  return dense(rows);
}

inline int64_t planes_of_sample(Tensor const& x, Layout layout) {
  return layout == Layout::channels_last ? 1 : x.size(1);
}

// The filter without images; `planes` are those of a sample.
template <class T>
Separable<T> separable_of(AxisWeights const& kx, AxisWeights const& ky, Border border, bool same, bool transposed,
                          int64_t planes, double alpha = 1, double beta = 0) {
  using F = Compute<T>;
  bool const accumulates = same && transposed && (border == Border::reflect || border == Border::replicate);
  return {{},
          {},
          kx.template taps<F>(same, transposed),
          ky.template taps<F>(same, transposed),
          planes,
          F(alpha),
          F(beta),
          same && !accumulates ? border : Border::constant,
          accumulates ? border : Border::constant};
}

#if defined(KV_CUDA)
inline void check_taps(char const* op, int64_t ky, int64_t kx) {
  KV_CHECK(ky <= kMaxTaps && kx <= kMaxTaps, op, ": expected a kernel of at most ", kMaxTaps,
           " weights a side on CUDA, got (", ky, ", ", kx, ")");
}
#endif

// Sigmas of a Gaussian, (B or 1, 2), of images `x`.
inline void check_sigma(char const* op, std::optional<Tensor> const& sigma, Tensor const& x) {
  if (!sigma) return;
  check_sample_weights(op, *sigma, x);
  KV_CHECK(sigma->size(1) == 2, op, ": expected sigma of shape (B or 1, 2)");
}

// Runs over the rows of `x`, whose memory format is `layout`, and writes those of `y`.
inline void separable_into(char const* op, Tensor const& x, Tensor const& y, Layout layout, AxisWeights const& kx,
                           AxisWeights const& ky, Border border, bool same, bool transposed, double alpha,
                           double beta) {
#if defined(KV_CUDA)
  check_taps(op, ky.size, kx.size);
#endif
  if (same) {
    check_border(op, border, ky.size / 2, y.size(2));
    check_border(op, border, kx.size / 2, y.size(3));
  }
  dispatch_floating_and_uint8(op, x, [&](auto type) {
    using T = typename decltype(type)::type;
    Separable<T> params = separable_of<T>(kx, ky, border, same, transposed, planes_of_sample(x, layout), alpha, beta);
    params.x = planes<T const>(x, layout), params.y = planes<T>(y, layout);
    KV_RUN(separable, x, params, params.y.rows(), params.y.row_size() * (kx.size + ky.size) / 4);
  });
}

// alpha * filtered + beta * input, or the transpose of that.
inline Tensor run_separable(char const* op, Tensor const& input, AxisWeights const& kx, AxisWeights const& ky,
                            Border border, bool same, bool transposed, double alpha = 1, double beta = 0) {
  check_images(op, "input", input);
  int64_t const grow_y = same ? 0 : transposed ? ky.size - 1 : 1 - ky.size;
  int64_t const grow_x = same ? 0 : transposed ? kx.size - 1 : 1 - kx.size;
  int64_t const height = input.size(2) + grow_y, width = input.size(3) + grow_x;
  KV_CHECK(height > 0 && width > 0, op, ": the kernel is larger than the input");
  Layout const layout = layout_of(input);
  Tensor const x = as_layout(input, layout), y = empty({x.size(0), x.size(1), height, width}, x, layout);
  separable_into(op, x, y, layout, kx, ky, border, same, transposed, alpha, beta);
  return y;
}

// alpha * Gaussian blur + beta * input, or the transpose of that. `sigma` is (B or 1, 2) in (y, x) order; without it
// sigma_y and sigma_x serve all samples.
inline Tensor run_gaussian(char const* op, Tensor const& input, std::optional<Tensor> const& sigma, int64_t ky,
                           int64_t kx, double sigma_y, double sigma_x, int64_t border, bool transposed, double alpha,
                           double beta) {
  check_window(op, ky, kx);
  check_sigma(op, sigma, input);
  Tensor const* const tensor = sigma ? &*sigma : nullptr;  // of any strides
  return run_separable(op, input, {tensor, kx, true, 1, sigma_x}, {tensor, ky, true, 0, sigma_y}, to_border(op, border),
                       true, transposed, alpha, beta);
}

}  // namespace kv::filters
