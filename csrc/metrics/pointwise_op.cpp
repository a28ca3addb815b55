// Elementwise losses: schemas and entries, for CPU and CUDA.
#include "glue/glue.h"
#include "pointwise.h"

namespace kv::metrics {
namespace {

PointLoss kind_of(char const* op, int64_t kind) {
  KV_CHECK(kind >= 0 && kind < kPointLosses, op, ": there is no loss ", kind);
  return PointLoss(kind);
}

// Views of contiguous tensors.
template <class T>
Pair<T> pair_of(Tensor const& x, Tensor const& y, int64_t rows) {
  int64_t const size = x.size(1);
  return {data_ptr<T const>(x),
          data_ptr<T const>(y),
          x.size(0) == rows ? size : 0,
          y.size(0) == rows ? size : 0,
          rows,
          size};
}

// Checks views against the number of rows of `like`, to which they are broadcast.
int64_t check_pair(char const* op, Tensor const& x, Tensor const& y, Tensor const& like) {
  KV_CHECK(like.dim() > 0 && x.dim() == 2 && y.dim() == 2 && x.size(1) == y.size(1) &&
               x.scalar_type() == y.scalar_type() && x.device() == y.device(),
           op, ": expected input and other (rows, size) of one type on one device");
  int64_t const rows = like.size(0);
  for (int64_t n : {x.size(0), y.size(0)})
    KV_CHECK(n == rows || (n == 1 && rows > 0), op, ": expected one row, or one for each result");
  return rows;
}

void check_of_sums(char const* op, char const* name, Tensor const& g, Tensor const& x, int64_t rows) {
  KV_CHECK(g.dim() == 1 && g.size(0) == rows && g.scalar_type() == compute_dtype(x) && g.device() == x.device(), op,
           ": expected ", name, " to be that of the sums");
}

template <class T>
void run_map([[maybe_unused]] Tensor const& x, PointwiseMap<T> const& params) {
  Pair<T> const& pair = params.pair;
  if (pair.size == 0) return;
  int64_t const chunks = point_chunks(pair.size);
  KV_RUN(pointwise_map, x, params, pair.rows * chunks, 8 * min(pair.size, kPointChunk));
}

Tensor pointwise_loss(Tensor const& input, Tensor const& other, int64_t kind) {
  constexpr char const* op = "pointwise_loss";
  int64_t const rows = check_pair(op, input, other, input);
  Tensor const x = dense(input), y = dense(other), loss = empty({rows, x.size(1)}, x);
  dispatch_floating(op, x, [&](auto type) {
    using T = typename decltype(type)::type;
    run_map<T>(x, {pair_of<T>(x, y, rows), kind_of(op, kind), nullptr, nullptr, nullptr, {}, false, data_ptr<T>(loss)});
  });
  return loss;
}

// The gradient with respect to `input`, or to `other`.
Tensor pointwise_loss_backward(Tensor const& grad, Tensor const& input, Tensor const& other, int64_t kind,
                               bool by_other) {
  constexpr char const* op = "pointwise_loss_backward";
  int64_t const rows = check_pair(op, input, other, grad);
  KV_CHECK(grad.dim() == 2 && grad.size(1) == input.size(1) && grad.scalar_type() == input.scalar_type() &&
               grad.device() == input.device(),
           op, ": expected grad to be that of the loss");
  Tensor const x = dense(input), y = dense(other), g = dense(grad), grad_x = empty({rows, x.size(1)}, x);
  dispatch_floating(op, x, [&](auto type) {
    using T = typename decltype(type)::type;
    run_map<T>(x, {pair_of<T>(x, y, rows),
                   kind_of(op, kind),
                   data_ptr<T const>(g),
                   nullptr,
                   nullptr,
                   {},
                   by_other,
                   data_ptr<T>(grad_x)});
  });
  return grad_x;
}

Tensor pointwise_sum(Tensor const& input, Tensor const& other, int64_t kind, double factor, double decibels) {
  constexpr char const* op = "pointwise_sum";
  int64_t const rows = check_pair(op, input, other, input), size = input.size(1);
  Tensor const x = dense(input), y = dense(other);
  int64_t const chunks = max(point_chunks(size), int64_t(1));
  Tensor const sums = empty({rows}, x, Layout::planar, compute_dtype(x));
  Tensor const partial = empty({rows, chunks}, x, Layout::planar, compute_dtype(x));
  dispatch_floating(op, x, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    PointwiseSum<T> const params{pair_of<T>(x, y, rows), kind_of(op, kind),        chunks,
                                 data_ptr<F>(partial),   {F(factor), F(decibels)}, data_ptr<F>(sums)};
    KV_RUN(pointwise_sum, x, params, rows * chunks, 8 * min(size, kPointChunk));
#if !defined(KV_CUDA)
    add_chunks(params.partial, rows, chunks, params.finalize, params.sums);
#endif
  });
  return sums;
}

// The gradient with respect to `input`, or to `other`; `sums` are the forward results.
Tensor pointwise_sum_backward(Tensor const& grad, Tensor const& sums, Tensor const& input, Tensor const& other,
                              int64_t kind, double factor, double decibels, bool by_other) {
  constexpr char const* op = "pointwise_sum_backward";
  int64_t const rows = check_pair(op, input, other, grad);
  check_of_sums(op, "grad", grad, input, rows);
  check_of_sums(op, "sums", sums, input, rows);
  Tensor const x = dense(input), y = dense(other), g = dense(grad), s = dense(sums),
               grad_x = empty({rows, x.size(1)}, x);
  dispatch_floating(op, x, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    run_map<T>(x, {pair_of<T>(x, y, rows),
                   kind_of(op, kind),
                   nullptr,
                   data_ptr<F const>(g),
                   data_ptr<F const>(s),
                   {F(factor), F(decibels)},
                   by_other,
                   data_ptr<T>(grad_x)});
  });
  return grad_x;
}

}  // namespace

KV_OPERATOR(pointwise_loss, "(Tensor input, Tensor other, int kind) -> Tensor")
KV_OPERATOR(pointwise_loss_backward, "(Tensor grad, Tensor input, Tensor other, int kind, bool by_other) -> Tensor")
KV_OPERATOR(pointwise_sum, "(Tensor input, Tensor other, int kind, float factor, float decibels) -> Tensor")
KV_OPERATOR(pointwise_sum_backward,
            "(Tensor grad, Tensor sums, Tensor input, Tensor other, int kind, float factor, float decibels, "
            "bool by_other) -> Tensor")

}  // namespace kv::metrics
