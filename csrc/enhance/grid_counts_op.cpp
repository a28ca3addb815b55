// Counts in bins: schemas and entries, for CPU and CUDA alike.
#include "grid_counts.h"
#include "rows_glue.h"

namespace kv {
namespace {

constexpr int64_t kSamplesAtOnce = 1 << 14;  // in one piece: fixed-point counts then fit 32 bits

CountKernel kernel_of(char const* op, std::string const& name) {
  if (name == "triangular") return CountKernel::triangular;
  if (name == "epanechnikov") return CountKernel::epanechnikov;
  KV_CHECK(name == "uniform", op, ": kernel must be one of triangular, epanechnikov, uniform; got '", name, "'");
  return CountKernel::uniform;
}

template <class T>
GridCounts<T> params_of(char const* op, Tensor const& x, double low, double width, int64_t bins,
                        std::string const& kernel) {
  int64_t const samples = x.size(1);
  return {data_ptr<T>(x),
          x.size(0),
          samples,
          bins,
          T(low),
          T(1 / width),
          kernel_of(op, kernel),
          nullptr,
          kSamplesAtOnce,
          max((samples + kSamplesAtOnce - 1) / kSamplesAtOnce, int64_t(1)),
          nullptr};
}

void check(char const* op, Tensor const& x, double width, int64_t bins) {
  check_rows(op, x);
  KV_CHECK(bins > 0 && bins < (1 << 24), op, ": expected 1 to 2^24 - 1 bins, got ", bins);
  KV_CHECK(width > 0, op, ": expected a width above 0, got ", width);
}

Tensor grid_counts(Tensor const& input, double low, double width, int64_t bins, std::string kernel) {
  constexpr char const* op = "grid_counts";
  check(op, input, width, bins);
  kernel_of(op, kernel);
  Tensor const x = dense(input), counts = empty({x.size(0), bins}, x);
  for_row_type(x, [&](auto type) {
    using T = typename decltype(type)::type;
    GridCounts<T> params = params_of<T>(op, x, low, width, bins, kernel);
    params.counts = params.partial = data_ptr<T>(counts);
#if defined(KV_CUDA)
    Tensor memory;
    if (params.pieces > 1) {
      memory = empty({params.rows, params.pieces, bins}, x);
      params.partial = data_ptr<T>(memory);
    }
#endif
    KV_RUN(grid_counts, x, params, params.rows, 4 * params.samples);
  });
  return counts;
}

Tensor grid_counts_backward(Tensor const& grad, Tensor const& input, double low, double width, int64_t bins,
                            std::string kernel) {
  constexpr char const* op = "grid_counts_backward";
  check(op, input, width, bins);
  kernel_of(op, kernel);
  check_row_grad(op, grad, input, bins);
  Tensor const x = dense(input), g = dense(grad), grad_x = empty({x.size(0), x.size(1)}, x);
  for_row_type(x, [&](auto type) {
    using T = typename decltype(type)::type;
    GridCountsBackward<T> const params{params_of<T>(op, x, low, width, bins, kernel), data_ptr<T>(g),
                                       data_ptr<T>(grad_x)};
    KV_RUN(grid_counts_backward, x, params, x.size(1) > 0 ? x.size(0) : 0, 4 * x.size(1));
  });
  return grad_x;
}

}  // namespace

KV_OPERATOR(grid_counts, "(Tensor x, float low, float width, int bins, str kernel) -> Tensor")
KV_OPERATOR(grid_counts_backward, "(Tensor grad, Tensor x, float low, float width, int bins, str kernel) -> Tensor")

}  // namespace kv
