// Sharpness: schemas and entries, for CPU and CUDA.
#include "color/program_glue.h"
#include "plane_views.h"
#include "sharpness.h"

namespace kv::enhance {
namespace {

using OptionalTensor = std::optional<Tensor>;

Tensor sharpness(Tensor const& input, OptionalTensor const& factor, double number) {
  check_planes("sharpness", input);
  Layout const layout = layout_of(input);
  Tensor const x = as_layout(input, layout), y = empty_like(x, layout);
  dispatch_floating_and_uint8("sharpness", x, [&](auto type) {
    using T = typename decltype(type)::type;
    Sharpness<T> const p{channel_planes<T const>(x, layout), channel_planes<T>(y, layout),
                         plane_parameter<Compute<T>>("sharpness", "factor", x, factor, number)};
    KV_RUN(sharpness, x, p, p.x.rows(), 3 * p.x.width);
  });
  return y;
}

// The gradients of the image and of the factor of each channel. A gradient that is not needed has no elements.
std::tuple<Tensor, Tensor> sharpness_backward(Tensor const& grad, Tensor const& input, OptionalTensor const& factor,
                                              double number, bool of_image, bool of_factor) {
  constexpr char const* op = "sharpness_backward";
  check_planes(op, input);
  check_like(op, "grad", grad, input);
  Layout const layout = layout_of(input);
  Tensor const x = as_layout(input, layout), g = as_layout(grad, layout);
  int64_t const b = x.size(0), c = x.size(1);
  ScalarType const computes = x.scalar_type() == ScalarType::Double ? ScalarType::Double : ScalarType::Float;
  Tensor const grad_x = of_image ? empty_like(x, layout) : empty({b, 0}, x);
  Tensor const of_planes = empty({b, of_factor ? c : 0, 1}, x, Layout::planar, computes);
  dispatch_floating(op, x, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    auto const of_x = channel_planes<T const>(x, layout);
#if defined(KV_CUDA)
    int64_t const chunks = sharpness_tiles(of_x);
#else
    int64_t const chunks = x.size(2);
#endif
    Tensor const gradients = empty({of_factor ? b * c : 0, chunks}, of_planes);
    SharpnessBackward<T> const p{channel_planes<T const>(g, layout),
                                 of_x,
                                 of_image ? channel_planes<T>(grad_x, layout) : Planes<T>{},
                                 plane_parameter<F>(op, "factor", x, factor, number),
                                 of_factor ? static_cast<F*>(gradients.mutable_data_ptr()) : nullptr,
                                 chunks};
    KV_RUN(sharpness_backward, x, p, p.x.rows(), 6 * p.x.width);
    if (!of_factor) return;
    color::ProgramReduce<F> const sums{p.gradients, static_cast<F*>(of_planes.mutable_data_ptr()), b * c, chunks, 1};
    color::reduce_gradients(x, sums);
  });
  return {grad_x, of_planes};
}

}  // namespace

KV_OPERATOR(sharpness, "(Tensor input, Tensor? factor, float number) -> Tensor")
KV_OPERATOR(sharpness_backward,
            "(Tensor grad, Tensor input, Tensor? factor, float number, bool of_image, bool of_factor)"
            " -> (Tensor, Tensor)")

}  // namespace kv::enhance
