// Responses of corners and blobs: schemas and entries, for CPU and CUDA.
#include <cmath>

#include "glue/glue.h"
#include "responses.h"

namespace kv::feature {
namespace {

using OptionalTensor = std::optional<Tensor>;

// The values of samples, in the compute type. `storage` owns their memory until kernels are launched.
template <class F>
SampleValues<F> sample_values(char const* op, char const* name, Tensor const& x, OptionalTensor const& values,
                              F constant, Tensor& storage) {
  if (!values) return {nullptr, 0, constant};
  KV_CHECK(values->dim() == 1 && (values->size(0) == 1 || values->size(0) == x.size(0)), op, ": expected ", name,
           " of shape (1,) or (", x.size(0), ",)");
  KV_CHECK(values->scalar_type() == compute_dtype(x), op, ": expected ", name, " in the type that is computed in");
  KV_CHECK(values->device() == x.device(), op, ": expected ", name, " on the device of input");
  storage = dense(*values);
  return {data_ptr<F const>(storage), values->size(0) == 1 ? 0 : 1, constant};
}

// Sizes at which the window reflects at most once.
void check_size(char const* op, Tensor const& x) {
  KV_CHECK(x.size(2) > kWindowReach && x.size(3) > kWindowReach, op, ": expected images of at least ", kWindowReach + 1,
           " pixels along each side");
}

filters::DerivativeMode checked_mode(char const* op, int64_t mode) {
  KV_CHECK(mode == 0 || mode == 1, op, ": mode must be 0 (sobel) or 1 (diff), got ", mode);
  return filters::DerivativeMode(mode);
}
CornerKind checked_kind(char const* op, int64_t kind) {
  KV_CHECK(kind == 0 || kind == 1, op, ": kind must be 0 (harris) or 1 (gftt), got ", kind);
  return CornerKind(kind);
}

// Calls run(type, arguments) with the storage type, and the arguments in the compute type.
template <class Run>
void with_arguments(char const* op, Tensor const& x, Layout layout, OptionalTensor const& k,
                    OptionalTensor const& sigmas, double fixed_k, CornerKind kind, filters::DerivativeMode mode,
                    Run run) {
  dispatch_floating(op, x, [&](auto type) {
    using F = Compute<typename decltype(type)::type>;
    Tensor k_storage, sigma_storage;
    ResponseArguments<F> const arguments{sample_values<F>(op, "k", x, k, F(fixed_k), k_storage),
                                         sample_values<F>(op, "sigmas", x, sigmas, F(1), sigma_storage),
                                         layout == Layout::planar ? x.size(1) : 1, kind,
                                         mode == filters::DerivativeMode::sobel};
    run(type, arguments);
  });
}

Tensor corner_response(Tensor const& input, OptionalTensor const& k, OptionalTensor const& sigmas, double fixed_k,
                       int64_t kind, int64_t mode) {
  constexpr char const* op = "corner_response";
  check_images(op, "input", input);
  check_size(op, input);
  Layout const layout = layout_of(input);
  Tensor const x = as_layout(input, layout), y = empty_like(x, layout);
  with_arguments(op, x, layout, k, sigmas, fixed_k, checked_kind(op, kind), checked_mode(op, mode),
                 [&](auto type, auto const& arguments) {
                   using T = typename decltype(type)::type;
                   Response<T> const params{planes<T const>(x, layout), planes<T>(y, layout), arguments};
                   KV_RUN(corner_response, x, params, params.x.rows(), 12 * params.x.row_size());
                 });
  return y;
}

Tensor corner_response_backward(Tensor const& grad, Tensor const& input, OptionalTensor const& k,
                                OptionalTensor const& sigmas, double fixed_k, int64_t kind, int64_t mode) {
  constexpr char const* op = "corner_response_backward";
  check_images(op, "input", input);
  check_like(op, "grad", grad, input);
  check_size(op, input);
  Layout const layout = layout_of(input);
  Tensor const g = as_layout(grad, layout), x = as_layout(input, layout), grad_x = empty_like(x, layout);
  with_arguments(op, x, layout, k, sigmas, fixed_k, checked_kind(op, kind), checked_mode(op, mode),
                 [&](auto type, auto const& arguments) {
                   using T = typename decltype(type)::type;
                   ResponseBackward<T> const params{planes<T const>(g, layout), planes<T const>(x, layout),
                                                    planes<T>(grad_x, layout), arguments};
                   KV_RUN(corner_response_backward, x, params, params.x.rows(), 30 * params.x.row_size());
                 });
  return grad_x;
}

Tensor hessian_response(Tensor const& input, OptionalTensor const& sigmas, int64_t mode) {
  constexpr char const* op = "hessian_response";
  check_images(op, "input", input);
  Layout const layout = layout_of(input);
  Tensor const x = as_layout(input, layout), y = empty_like(x, layout);
  with_arguments(op, x, layout, {}, sigmas, 0, CornerKind::harris, checked_mode(op, mode),
                 [&](auto type, auto const& arguments) {
                   using T = typename decltype(type)::type;
                   Response<T> const params{planes<T const>(x, layout), planes<T>(y, layout), arguments};
                   KV_RUN(hessian_response, x, params, params.x.rows(), 3 * params.x.row_size());
                 });
  return y;
}

Tensor hessian_response_backward(Tensor const& grad, Tensor const& input, OptionalTensor const& sigmas, int64_t mode) {
  constexpr char const* op = "hessian_response_backward";
  check_images(op, "input", input);
  check_like(op, "grad", grad, input);
  Layout const layout = layout_of(input);
  Tensor const g = as_layout(grad, layout), x = as_layout(input, layout), grad_x = empty_like(x, layout);
  with_arguments(op, x, layout, {}, sigmas, 0, CornerKind::harris, checked_mode(op, mode),
                 [&](auto type, auto const& arguments) {
                   using T = typename decltype(type)::type;
                   ResponseBackward<T> const params{planes<T const>(g, layout), planes<T const>(x, layout),
                                                    planes<T>(grad_x, layout), arguments};
                   KV_RUN(hessian_response_backward, x, params, params.x.rows(), 8 * params.x.row_size());
                 });
  return grad_x;
}

// The weights of a Gaussian at distances up to `Reach`. The weights of the window sum to 1.
template <int Reach, class F>
void gaussian_weights(char const* op, double sigma, F (&weights)[Reach + 1]) {
  KV_CHECK(sigma > 0 && std::isfinite(sigma), op, ": expected sigmas above 0, got ", sigma);
  double w[Reach + 1], sum = 1;
  for (int d = 0; d <= Reach; ++d) w[d] = d == 0 ? 1 : std::exp(-0.5 * (d / sigma) * (d / sigma));
  for (int d = 1; d <= Reach; ++d) sum += 2 * w[d];
  for (int d = 0; d <= Reach; ++d) weights[d] = F(w[d] / sum);
}

Tensor run_difference(char const* op, Tensor const& input, double sigma1, double sigma2, bool transposed) {
  check_images(op, "input", input);
  KV_CHECK(input.size(2) > kCoarseReach && input.size(3) > kCoarseReach, op, ": expected images of at least ",
           kCoarseReach + 1, " pixels along each side");
  Layout const layout = layout_of(input);
  Tensor const x = as_layout(input, layout), y = empty_like(x, layout);
  dispatch_floating(op, x, [&](auto type) {
    using T = typename decltype(type)::type;
    DifferenceOfGaussians<T> params{planes<T const>(x, layout), planes<T>(y, layout), {}, {}, transposed};
    gaussian_weights<kFineReach>(op, sigma1, params.fine);
    gaussian_weights<kCoarseReach>(op, sigma2, params.coarse);
    KV_RUN(difference_of_gaussians, x, params, params.x.rows(), 10 * params.x.row_size());
  });
  return y;
}

Tensor difference_of_gaussians(Tensor const& input, double sigma1, double sigma2) {
  return run_difference("difference_of_gaussians", input, sigma1, sigma2, false);
}
Tensor difference_of_gaussians_backward(Tensor const& grad, double sigma1, double sigma2) {
  return run_difference("difference_of_gaussians_backward", grad, sigma1, sigma2, true);
}

}  // namespace

KV_OPERATOR(difference_of_gaussians, "(Tensor input, float sigma1, float sigma2) -> Tensor")
KV_OPERATOR(difference_of_gaussians_backward, "(Tensor grad, float sigma1, float sigma2) -> Tensor")
KV_OPERATOR(corner_response, "(Tensor input, Tensor? k, Tensor? sigmas, float fixed_k, int kind, int mode) -> Tensor")
KV_OPERATOR(corner_response_backward,
            "(Tensor grad, Tensor input, Tensor? k, Tensor? sigmas, float fixed_k, int kind, int mode) -> Tensor")
KV_OPERATOR(hessian_response, "(Tensor input, Tensor? sigmas, int mode) -> Tensor")
KV_OPERATOR(hessian_response_backward, "(Tensor grad, Tensor input, Tensor? sigmas, int mode) -> Tensor")

}  // namespace kv::feature
