// Sums of Gaussians: schemas and entries, for CPU and CUDA.
#include "histogram.h"
#include "sample_rows.h"

namespace kv::enhance {
namespace {

void check_fits_rows(char const* op, char const* name, Tensor const& t, Tensor const& x, int64_t axes) {
  KV_CHECK(t.dim() == axes && (t.size(0) == 1 || t.size(0) == x.size(0)), op, ": expected ", name, " of ", axes,
           " axes, the first of size 1 or that of x");
  KV_CHECK(t.scalar_type() == x.scalar_type() && t.device() == x.device(), op, ": ", name,
           " differs in dtype or device from x");
}

// The arguments as the kernels read them: with contiguous rows.
struct Samples {
  Tensor x, centers, bandwidth;
  int64_t rows, samples, bins;

  Samples(char const* op, Tensor const& x, Tensor const& centers, Tensor const& bandwidth) {
    check_rows(op, x);
    check_fits_rows(op, "centers", centers, x, 2);
    check_fits_rows(op, "bandwidth", bandwidth, x, 1);
    KV_CHECK(centers.size(1) <= INT32_MAX, op, ": expected fewer than 2^31 centers");
    this->x = dense(x);
    this->centers = dense(centers);
    this->bandwidth = dense(bandwidth);
    rows = x.size(0), samples = x.size(1), bins = centers.size(1);
  }

  template <class T>
  Histogram<T> params() const {
    int64_t const chunk = min(max(rows * samples / 128, int64_t(8192)), int64_t(kMaxSamples));
    return {data_ptr<T>(x),
            rows,
            samples,
            data_ptr<T>(centers),
            data_ptr<T>(bandwidth),
            bins,
            centers.size(0) > 1 ? bins : 0,
            bandwidth.size(0) > 1 ? 1 : 0,
            nullptr,
            chunk,
            max(ceil_div(samples, chunk), int64_t(1)),
            nullptr};
  }
};

Tensor histogram(Tensor const& x, Tensor const& centers, Tensor const& bandwidth) {
  Samples const s("histogram", x, centers, bandwidth);
  Tensor const counts = empty({s.rows, s.bins}, s.x);
  dispatch_row_dtype(s.x, [&](auto type) {
    using T = typename decltype(type)::type;
    Histogram<T> params = s.params<T>();
    params.counts = params.partial = data_ptr<T>(counts);
#if defined(KV_CUDA)
    Tensor memory;
    if (params.chunks > 1) {
      memory = empty({s.rows, params.chunks, s.bins}, s.x);
      params.partial = data_ptr<T>(memory);
    }
#endif
    KV_RUN(histogram, s.x, params, s.bins > 0 ? s.rows : 0, 8 * s.samples + 256 * s.bins);
  });
  return counts;
}

Tensor histogram_backward(Tensor const& grad, Tensor const& x, Tensor const& centers, Tensor const& bandwidth) {
  constexpr char const* op = "histogram_backward";
  Samples const s(op, x, centers, bandwidth);
  check_row_grad(op, grad, x, s.bins);
  KV_CHECK(s.bins > 0, op, ": expected at least one center");
  Tensor const g = dense(grad), grad_x = empty({s.rows, s.samples}, s.x);
  dispatch_row_dtype(s.x, [&](auto type) {
    using T = typename decltype(type)::type;
    HistogramBackward<T> const params{s.params<T>(), data_ptr<T>(g), data_ptr<T>(grad_x)};
    KV_RUN(histogram_backward, s.x, params, s.samples > 0 ? s.rows : 0, 8 * s.samples + 256 * s.bins);
  });
  return grad_x;
}

Tensor normalize_counts(Tensor const& counts, double eps) {
  check_rows("normalize_counts", counts);
  Tensor const x = dense(counts), y = empty({x.size(0), x.size(1)}, x);
  dispatch_row_dtype(x, [&](auto type) {
    using T = typename decltype(type)::type;
    NormalizeCounts<T> const params{data_ptr<T>(x), x.size(0), x.size(1), T(eps), data_ptr<T>(y)};
    KV_RUN(normalize_counts, x, params, x.size(1) > 0 ? x.size(0) : 0, 4 * x.size(1));
  });
  return y;
}

Tensor normalize_counts_backward(Tensor const& grad, Tensor const& counts, double eps) {
  constexpr char const* op = "normalize_counts_backward";
  check_rows(op, counts);
  check_row_grad(op, grad, counts, counts.size(1));
  Tensor const x = dense(counts), g = dense(grad), grad_counts = empty({x.size(0), x.size(1)}, x);
  dispatch_row_dtype(x, [&](auto type) {
    using T = typename decltype(type)::type;
    NormalizeCountsBackward<T> const params{data_ptr<T>(g), data_ptr<T>(x), x.size(0),
                                            x.size(1),      T(eps),         data_ptr<T>(grad_counts)};
    KV_RUN(normalize_counts_backward, x, params, x.size(1) > 0 ? x.size(0) : 0, 8 * x.size(1));
  });
  return grad_counts;
}

}  // namespace

KV_OPERATOR(histogram, "(Tensor x, Tensor centers, Tensor bandwidth) -> Tensor")
KV_OPERATOR(histogram_backward, "(Tensor grad, Tensor x, Tensor centers, Tensor bandwidth) -> Tensor")
KV_OPERATOR(normalize_counts, "(Tensor counts, float eps) -> Tensor")
KV_OPERATOR(normalize_counts_backward, "(Tensor grad, Tensor counts, float eps) -> Tensor")

}  // namespace kv::enhance
