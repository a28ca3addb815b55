// Endpoint errors: schemas and entries, for CPU and CUDA.
#include "endpoint_error.h"
#include "glue/glue.h"

namespace kv::metrics {
namespace {

// Shape (rows, 2, size) if planar, else (rows, size, 2). A tensor with a single row is broadcast.
struct VectorRows {
  Tensor x, y;
  bool planar;
  int64_t rows, size;

  VectorRows(char const* op, Tensor const& input, Tensor const& target, bool planar, Tensor const& like)
      : x(dense(input)), y(dense(target)), planar(planar) {
    KV_CHECK(like.dim() > 0 && input.dim() == 3 && target.dim() == 3 && input.size(planar ? 1 : 2) == 2 &&
                 target.size(1) == input.size(1) && target.size(2) == input.size(2) && input.numel() > 0 &&
                 target.numel() > 0 && target.scalar_type() == input.scalar_type() && target.device() == input.device(),
             op, ": expected input and target (rows, 2, size) or (rows, size, 2) of one type on one device");
    rows = like.size(0), size = input.size(planar ? 2 : 1);
    for (auto const& t : {x, y})
      KV_CHECK(t.size(0) == rows || t.size(0) == 1, op, ": expected one row, or one for each result");
    KV_CHECK(rows > 0, op, ": expected at least one row");
  }
  template <class T>
  VectorPairs<T> pairs() const {
    auto const stride = [&](Tensor const& t) { return t.size(0) == rows ? 2 * size : 0; };
    return {data_ptr<T const>(x), data_ptr<T const>(y), planar, stride(x), stride(y), rows, size};
  }
  int64_t chunks() const { return ceil_div(size, kEndpointChunk); }
  int64_t cost() const { return 4 * min(size, kEndpointChunk); }
};

// The endpoint errors (rows, size), or `factor` times their sums (rows).
Tensor endpoint_error(Tensor const& input, Tensor const& target, bool planar, bool summed, double factor) {
  VectorRows const r("endpoint_error", input, target, planar, input);
  Tensor const result =
      summed ? empty({r.rows}, r.x, Layout::planar, compute_dtype(r.x)) : empty({r.rows, r.size}, r.x);
  Tensor const partial = empty({summed ? r.rows : 0, r.chunks()}, r.x, Layout::planar, compute_dtype(r.x));
  dispatch_floating("endpoint_error", r.x, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    EndpointError<T> const params{r.pairs<T>(),
                                  summed ? nullptr : data_ptr<T>(result),
                                  data_ptr<F>(partial),
                                  summed ? data_ptr<F>(result) : nullptr,
                                  {F(factor), F(0)}};
    KV_RUN(endpoint_error, r.x, params, r.rows * r.chunks(), r.cost());
#if !defined(KV_CUDA)
    if (summed) add_chunks(params.partial, r.rows, r.chunks(), params.finalize, params.sums);
#endif
  });
  return result;
}

Tensor endpoint_error_backward(Tensor const& grad, Tensor const& input, Tensor const& target, bool planar, bool summed,
                               double factor) {
  constexpr char const* op = "endpoint_error_backward";
  VectorRows const r(op, input, target, planar, grad);
  auto const type = summed ? compute_dtype(input) : input.scalar_type();
  KV_CHECK(grad.dim() == (summed ? 1 : 2) && (summed || grad.size(1) == r.size) && grad.scalar_type() == type &&
               grad.device() == input.device(),
           op, ": expected grad to be that of the distances");
  Tensor const g = dense(grad), grad_x = empty({r.rows, input.size(1), input.size(2)}, r.x);
  dispatch_floating(op, r.x, [&](auto of_type) {
    using T = typename decltype(of_type)::type;
    using F = Compute<T>;
    EndpointErrorBackward<T> const params{r.pairs<T>(), summed ? nullptr : data_ptr<T const>(g),
                                          summed ? data_ptr<F const>(g) : nullptr, summed ? F(factor) : F(1),
                                          data_ptr<T>(grad_x)};
    KV_RUN(endpoint_error_backward, r.x, params, r.rows * r.chunks(), r.cost());
  });
  return grad_x;
}

}  // namespace

KV_OPERATOR(endpoint_error, "(Tensor input, Tensor target, bool planar, bool summed, float factor) -> Tensor")
KV_OPERATOR(endpoint_error_backward,
            "(Tensor grad, Tensor input, Tensor target, bool planar, bool summed, float factor) -> Tensor")

}  // namespace kv::metrics
