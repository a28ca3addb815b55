// Histograms with compact kernels: schemas and entries, for CPU and CUDA.
#include "image_histogram2d.h"
#include "sample_rows.h"

namespace kv::enhance {
namespace {

constexpr int64_t kSamplesAtOnce = 1 << 14;  // per chunk: fixed-point counts then fit 32 bits

HistogramKernel check_kernel(char const* op, int64_t kernel) {
  KV_CHECK(kernel >= 0 && kernel <= 2, op,
           ": kernel must be one of 0 (triangular), 1 (epanechnikov), 2 (uniform); got ", kernel);
  return HistogramKernel(kernel);
}

template <class T>
ImageHistogram2d<T> params_of(char const* op, Tensor const& x, double low, double width, int64_t bins, int64_t kernel) {
  int64_t const samples = x.size(1);
  return {data_ptr<T>(x),
          x.size(0),
          samples,
          bins,
          T(low),
          T(1 / width),
          check_kernel(op, kernel),
          nullptr,
          kSamplesAtOnce,
          max(ceil_div(samples, kSamplesAtOnce), int64_t(1)),
          nullptr};
}

void check(char const* op, Tensor const& x, double width, int64_t bins) {
  check_rows(op, x);
  KV_CHECK(bins > 0 && bins < (1 << 24), op, ": expected 1 to 2^24 - 1 bins, got ", bins);
  KV_CHECK(width > 0, op, ": expected a width above 0, got ", width);
}

Tensor image_histogram2d(Tensor const& input, double low, double width, int64_t bins, int64_t kernel) {
  constexpr char const* op = "image_histogram2d";
  check(op, input, width, bins);
  check_kernel(op, kernel);
  Tensor const x = dense(input), counts = empty({x.size(0), bins}, x);
  dispatch_row_dtype(x, [&](auto type) {
    using T = typename decltype(type)::type;
    ImageHistogram2d<T> params = params_of<T>(op, x, low, width, bins, kernel);
    params.counts = params.partial = data_ptr<T>(counts);
#if defined(KV_CUDA)
    Tensor memory;
    if (params.chunks > 1) {
      memory = empty({params.rows, params.chunks, bins}, x);
      params.partial = data_ptr<T>(memory);
    }
#endif
    KV_RUN(image_histogram2d, x, params, params.rows, 4 * params.samples);
  });
  return counts;
}

Tensor image_histogram2d_backward(Tensor const& grad, Tensor const& input, double low, double width, int64_t bins,
                                  int64_t kernel) {
  constexpr char const* op = "image_histogram2d_backward";
  check(op, input, width, bins);
  check_kernel(op, kernel);
  check_row_grad(op, grad, input, bins);
  Tensor const x = dense(input), g = dense(grad), grad_x = empty({x.size(0), x.size(1)}, x);
  dispatch_row_dtype(x, [&](auto type) {
    using T = typename decltype(type)::type;
    ImageHistogram2dBackward<T> const params{params_of<T>(op, x, low, width, bins, kernel), data_ptr<T>(g),
                                             data_ptr<T>(grad_x)};
    KV_RUN(image_histogram2d_backward, x, params, x.size(1) > 0 ? x.size(0) : 0, 4 * x.size(1));
  });
  return grad_x;
}

}  // namespace

KV_OPERATOR(image_histogram2d, "(Tensor x, float low, float width, int bins, int kernel) -> Tensor")
KV_OPERATOR(image_histogram2d_backward,
            "(Tensor grad, Tensor x, float low, float width, int bins, int kernel) -> Tensor")

}  // namespace kv::enhance
