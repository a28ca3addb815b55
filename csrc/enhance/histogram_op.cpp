// Sums of Gaussians: schemas and entries, for CPU and CUDA alike.
#include "histogram.h"
#include "rows_glue.h"

namespace kv {
namespace {

void check_beside(char const* op, char const* name, Tensor const& t, Tensor const& x, int64_t axes) {
  KV_CHECK(t.dim() == axes && (t.size(0) == 1 || t.size(0) == x.size(0)), op, ": expected ", name, " of ", axes,
           " axes, the first of size 1 or that of x");
  KV_CHECK(t.scalar_type() == x.scalar_type() && t.device() == x.device(), op, ": ", name,
           " differs in dtype or device from x");
}

// Tensors as the kernels read them: rows one behind the other.
struct Samples {
  Tensor x, centers, bandwidth;
  int64_t rows, samples, bins;

  Samples(char const* op, Tensor const& x, Tensor const& centers, Tensor const& bandwidth) {
    check_rows(op, x);
    check_beside(op, "centers", centers, x, 2);
    check_beside(op, "bandwidth", bandwidth, x, 1);
    KV_CHECK(centers.size(1) <= INT32_MAX, op, ": expected fewer than 2^31 centers");
    this->x = dense(x);
    this->centers = dense(centers);
    this->bandwidth = dense(bandwidth);
    rows = x.size(0), samples = x.size(1), bins = centers.size(1);
  }

  template <class T>
  GaussianCounts<T> params() const {
    int64_t const piece = min(max(rows * samples / 128, int64_t(8192)), int64_t(kMostSamples));
    return {data_ptr<T>(x),
            rows,
            samples,
            data_ptr<T>(centers),
            data_ptr<T>(bandwidth),
            bins,
            centers.size(0) > 1 ? bins : 0,
            bandwidth.size(0) > 1 ? 1 : 0,
            nullptr,
            piece,
            max((samples + piece - 1) / piece, int64_t(1)),
            nullptr};
  }
};

Tensor gaussian_counts(Tensor const& x, Tensor const& centers, Tensor const& bandwidth) {
  Samples const s("gaussian_counts", x, centers, bandwidth);
  Tensor const counts = empty({s.rows, s.bins}, s.x);
  for_row_type(s.x, [&](auto type) {
    using T = typename decltype(type)::type;
    GaussianCounts<T> params = s.params<T>();
    params.counts = params.partial = data_ptr<T>(counts);
#if defined(KV_CUDA)
    Tensor memory;
    if (params.pieces > 1) {
      memory = empty({s.rows, params.pieces, s.bins}, s.x);
      params.partial = data_ptr<T>(memory);
    }
#endif
    KV_RUN(gaussian_counts, s.x, params, s.bins > 0 ? s.rows : 0, 8 * s.samples + 256 * s.bins);
  });
  return counts;
}

Tensor gaussian_counts_backward(Tensor const& grad, Tensor const& x, Tensor const& centers, Tensor const& bandwidth) {
  constexpr char const* op = "gaussian_counts_backward";
  Samples const s(op, x, centers, bandwidth);
  check_row_grad(op, grad, x, s.bins);
  KV_CHECK(s.bins > 0, op, ": expected at least one center");
  Tensor const g = dense(grad), grad_x = empty({s.rows, s.samples}, s.x);
  for_row_type(s.x, [&](auto type) {
    using T = typename decltype(type)::type;
    GaussianCountsBackward<T> const params{s.params<T>(), data_ptr<T>(g), data_ptr<T>(grad_x)};
    KV_RUN(gaussian_counts_backward, s.x, params, s.samples > 0 ? s.rows : 0, 8 * s.samples + 256 * s.bins);
  });
  return grad_x;
}

}  // namespace

KV_OPERATOR(gaussian_counts, "(Tensor x, Tensor centers, Tensor bandwidth) -> Tensor")
KV_OPERATOR(gaussian_counts_backward, "(Tensor grad, Tensor x, Tensor centers, Tensor bandwidth) -> Tensor")

}  // namespace kv
