// Min-max normalization: schemas and entries, for CPU and CUDA.
#include "min_max.h"
#include "plane_views.h"

namespace kv::enhance {
namespace {

std::tuple<Tensor, Tensor> normalize_min_max(Tensor const& input, double low, double high, double eps, bool clamps,
                                             bool keeps_flat) {
  check_planes("normalize_min_max", input);
  Layout const layout = layout_of(input);
  Tensor const x = dense_planes(input, layout), y = empty_like(x, layout), range = empty({x.size(0), x.size(1), 2}, x);
  dispatch_floating("normalize_min_max", x, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    Chunks const chunks(x.size(0) * x.size(1), x.size(2) * x.size(3));
    Tensor const memory = working_memory<F>(x, 2 * x.size(0) * x.size(1) * chunks.count);
    MinMax<T> const params{flat_planes<T const>(x, layout),
                           flat_planes<T>(y, layout),
                           static_cast<T*>(range.mutable_data_ptr()),
                           F(low),
                           F(high - low),
                           F(eps),
                           chunks.size,
                           chunks.count,
                           static_cast<F*>(memory.mutable_data_ptr()),
                           clamps,
                           keeps_flat};
    KV_RUN(min_max, x, params, params.x.count(), params.x.width);
  });
  return {y, range};
}

Tensor normalize_min_max_backward(Tensor const& grad, Tensor const& input, Tensor const& range, double low, double high,
                                  double eps, [[maybe_unused]] bool clamps, bool keeps_flat) {
  constexpr char const* op = "normalize_min_max_backward";
  check_planes(op, input);
  check_like(op, "grad", grad, input);
  KV_CHECK(range.dim() == 3 && range.size(0) == input.size(0) && range.size(1) == input.size(1) && range.size(2) == 2 &&
               range.scalar_type() == input.scalar_type() && range.device() == input.device(),
           op, ": expected range to be that of input's planes");
  Layout const layout = layout_of(input);
  Tensor const x = dense_planes(input, layout), g = dense_planes(as_layout(grad, layout), layout),
               grad_x = empty_like(x, layout), r = dense(range);
  dispatch_floating(op, x, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    Chunks const chunks(x.size(0) * x.size(1), x.size(2) * x.size(3));
    Tensor const memory = working_memory<F>(x, 4 * x.size(0) * x.size(1) * chunks.count);
    MinMaxBackward<T> const params{flat_planes<T const>(g, layout),
                                   flat_planes<T const>(x, layout),
                                   static_cast<T const*>(r.const_data_ptr()),
                                   flat_planes<T>(grad_x, layout),
                                   F(high - low),
                                   F(eps),
                                   chunks.size,
                                   chunks.count,
                                   static_cast<F*>(memory.mutable_data_ptr()),
                                   keeps_flat};
    KV_RUN(min_max_backward, x, params, params.x.count(), 2 * params.x.width);
  });
  return grad_x;
}

}  // namespace

KV_OPERATOR(normalize_min_max,
            "(Tensor input, float low, float high, float eps, bool clamps, bool keeps_flat)"
            " -> (Tensor output, Tensor range)")
KV_OPERATOR(normalize_min_max_backward,
            "(Tensor grad, Tensor input, Tensor range, float low, float high, float eps, bool clamps, bool keeps_flat)"
            " -> Tensor")

}  // namespace kv::enhance
