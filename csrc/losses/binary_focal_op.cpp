// Binary focal loss: schemas and entries, for CPU and CUDA.
#include "binary_focal.h"
#include "glue/glue.h"

namespace kv::losses {
namespace {

// Logits and targets (rows, size), and factors per row. A tensor with a single row is broadcast.
struct FocalRows {
  Tensor x, target;
  std::optional<Tensor> yes, no;
  int64_t rows, size;

  FocalRows(char const* op, Tensor const& pred, Tensor const& truth, std::optional<Tensor> const& of_yes,
            std::optional<Tensor> const& of_no, Tensor const& like)
      : x(dense(pred)), target(dense(truth)) {
    KV_CHECK(like.dim() > 0 && pred.dim() == 2 && truth.dim() == 2 && truth.size(1) == pred.size(1) &&
                 truth.scalar_type() == pred.scalar_type() && truth.device() == pred.device(),
             op, ": expected pred and target (rows, size) of one type on one device");
    rows = like.size(0), size = pred.size(1);
    KV_CHECK(serves(pred) && serves(truth), op, ": expected one row, or one for each result");
    for (auto const& [from, to] : {std::pair(&of_yes, &yes), std::pair(&of_no, &no)}) {
      if (!*from) continue;
      KV_CHECK(is_of_rows(**from) && serves(**from), op,
               ": expected one factor, or one for each row, in the type that pred is computed in");
      *to = dense(**from);
    }
  }
  bool serves(Tensor const& t) const { return t.size(0) == rows || (t.size(0) == 1 && rows > 0); }
  bool is_of_rows(Tensor const& t) const {
    return t.dim() == 1 && t.scalar_type() == compute_dtype(x) && t.device() == x.device();
  }
  // The stride of rows; 0 if a single row is broadcast.
  int64_t stride(Tensor const& t, int64_t of) const { return t.size(0) == rows ? of : 0; }
  template <class T>
  Pair<T> pair() const {
    return {data_ptr<T const>(x), data_ptr<T const>(target), stride(x, size), stride(target, size), rows, size};
  }
  template <class F>
  BinaryFocalTerms<F> terms(double of_yes, double of_no, double gamma, double ignored, bool ignores) const {
    return {yes ? data_ptr<F const>(*yes) : nullptr,
            no ? data_ptr<F const>(*no) : nullptr,
            yes ? stride(*yes, 1) : 0,
            no ? stride(*no, 1) : 0,
            F(of_yes),
            F(of_no),
            F(gamma),
            F(ignored),
            ignores};
  }
  int64_t cost() const { return 16 * min(size, kPointChunk); }
};

// The losses of all elements, or their sums over rows.
Tensor binary_focal(Tensor const& pred, Tensor const& target, std::optional<Tensor> const& yes,
                    std::optional<Tensor> const& no, double of_yes, double of_no, double gamma, double ignored,
                    bool ignores, bool summed) {
  FocalRows const r("binary_focal", pred, target, yes, no, pred);
  int64_t const chunks = max(point_chunks(r.size), int64_t(1));
  Tensor const loss = summed ? empty({r.rows}, r.x, Layout::planar, compute_dtype(r.x)) : empty({r.rows, r.size}, r.x);
  Tensor const partial = empty({summed ? r.rows : 0, chunks}, r.x, Layout::planar, compute_dtype(r.x));
  dispatch_floating("binary_focal", r.x, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    auto const terms = r.terms<F>(of_yes, of_no, gamma, ignored, ignores);
    if (summed) {
      BinaryFocalSum<T> const params{r.pair<T>(), terms, chunks, data_ptr<F>(partial), data_ptr<F>(loss)};
      KV_RUN(binary_focal_sum, r.x, params, r.rows * chunks, r.cost());
#if !defined(KV_CUDA)
      add_chunks(params.partial, r.rows, chunks, FinalizeSum<F>{F(1), F(0)}, params.sums);
#endif
    } else if (r.size > 0) {
      BinaryFocalMap<T> const params{r.pair<T>(), terms, nullptr, nullptr, false, data_ptr<T>(loss)};
      KV_RUN(binary_focal_map, r.x, params, r.rows * chunks, r.cost());
    }
  });
  return loss;
}

// The gradient with respect to `pred`, or to `target`.
Tensor binary_focal_backward(Tensor const& grad, Tensor const& pred, Tensor const& target,
                             std::optional<Tensor> const& yes, std::optional<Tensor> const& no, double of_yes,
                             double of_no, double gamma, double ignored, bool ignores, bool summed, bool by_target) {
  constexpr char const* op = "binary_focal_backward";
  FocalRows const r(op, pred, target, yes, no, grad);
  bool const fits = summed ? r.is_of_rows(grad)
                           : grad.dim() == 2 && grad.size(1) == r.size && grad.scalar_type() == pred.scalar_type() &&
                                 grad.device() == pred.device();
  KV_CHECK(fits, op, ": expected grad to be that of the loss");
  Tensor const g = dense(grad), grad_x = empty({r.rows, r.size}, r.x);
  if (r.size == 0) return grad_x;
  dispatch_floating(op, r.x, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    BinaryFocalMap<T> const params{r.pair<T>(),
                                   r.terms<F>(of_yes, of_no, gamma, ignored, ignores),
                                   summed ? nullptr : data_ptr<T const>(g),
                                   summed ? data_ptr<F const>(g) : nullptr,
                                   by_target,
                                   data_ptr<T>(grad_x)};
    KV_RUN(binary_focal_map, r.x, params, r.rows * point_chunks(r.size), r.cost());
  });
  return grad_x;
}

}  // namespace

KV_OPERATOR(binary_focal,
            "(Tensor pred, Tensor target, Tensor? yes, Tensor? no, float of_yes, float of_no, float gamma, "
            "float ignored, bool ignores, bool summed) -> Tensor")
KV_OPERATOR(
    binary_focal_backward,
    "(Tensor grad, Tensor pred, Tensor target, Tensor? yes, Tensor? no, float of_yes, float of_no, float gamma, "
    "float ignored, bool ignores, bool summed, bool by_target) -> Tensor")

}  // namespace kv::losses
