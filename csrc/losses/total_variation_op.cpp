// Total variation: schemas and entries, for CPU and CUDA.
#include "glue/glue.h"
#include "total_variation.h"

namespace kv::losses {
namespace {

Tensor total_variation(Tensor const& input, double along_y, double along_x) {
  constexpr char const* op = "total_variation";
  check_images(op, "input", input);
  Tensor const x = as_layout(input, Layout::planar);
  int64_t const height = x.size(2), width = x.size(3);
  Tensor const sums = empty({x.size(0), x.size(1)}, x, Layout::planar, compute_dtype(x));
  dispatch_floating(op, x, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    int64_t const columns = kVariationColumns<T>, rows = kVariationRows;
    int64_t const chunks = ceil_div(height, rows) * ceil_div(width, columns);
#if defined(KV_CUDA)
    Tensor const partial = empty({x.size(0), x.size(1), chunks}, x, Layout::planar, compute_dtype(x));
#else
    Tensor const& partial = sums;  // unused
#endif
    TotalVariation<T> const params{
        planes<T const>(x, Layout::planar),       F(along_y), F(along_x),
        static_cast<F*>(sums.mutable_data_ptr()), chunks,     static_cast<F*>(partial.mutable_data_ptr())};
    KV_RUN(total_variation, x, params, params.x.count(), height * width);
  });
  return sums;
}

Tensor total_variation_backward(Tensor const& grad, Tensor const& input, double along_y, double along_x) {
  constexpr char const* op = "total_variation_backward";
  check_images(op, "input", input);
  KV_CHECK(grad.dim() == 2 && grad.size(0) == input.size(0) && grad.size(1) == input.size(1) &&
               grad.scalar_type() == compute_dtype(input) && grad.device() == input.device(),
           op, ": expected grad to be that of the sums");
  Tensor const x = as_layout(input, Layout::planar), g = dense(grad), grad_x = empty_like(x, Layout::planar);
  dispatch_floating(op, x, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    TotalVariationBackward<T> const params{planes<T const>(x, Layout::planar), F(along_y), F(along_x),
                                           static_cast<F const*>(g.const_data_ptr()),
                                           planes<T>(grad_x, Layout::planar)};
    KV_RUN(total_variation_backward, x, params, params.x.rows(), params.x.width);
  });
  return grad_x;
}

}  // namespace

KV_OPERATOR(total_variation, "(Tensor input, float along_y, float along_x) -> Tensor")
KV_OPERATOR(total_variation_backward, "(Tensor grad, Tensor input, float along_y, float along_x) -> Tensor")

}  // namespace kv::losses
