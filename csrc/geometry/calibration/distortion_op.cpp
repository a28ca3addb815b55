// Lens distortion: schemas and entries, for CPU and CUDA.
#include "geometry/calibration/distortion.h"
#include "geometry/reals_glue.h"
#include "geometry/transform/sampling_glue.h"

namespace kv::geometry {
namespace {

// The checked parameters of lenses, (B, ...), or (1, ...) for all of a batch.
struct LensInputs {
  char const* op;
  Contiguous camera, new_camera, coefficients, tilt;
  int64_t batch;

  LensInputs(char const* op, int64_t batch, Tensor const& like, Tensor const& camera, Tensor const& new_camera,
             Tensor const& coefficients, std::optional<Tensor> const& tilt)
      : op(op),
        camera(op, camera),
        new_camera(op, new_camera),
        coefficients(op, coefficients),
        tilt(op, tilt),
        batch(batch) {
    auto const fits = [&](Tensor const& x) {
      return (x.size(0) == 1 || x.size(0) == batch) && x.scalar_type() == like.scalar_type() &&
             x.device() == like.device();
    };
    for (Tensor const* x : {&camera, &new_camera, tilt ? &*tilt : &camera})
      KV_CHECK(x->dim() == 3 && x->size(1) == 3 && x->size(2) == 3 && fits(*x), op,
               ": expected matrices of shape (B, 3, 3) of one type and device");
    KV_CHECK(coefficients.dim() == 2 && coefficients.size(1) <= 14 && fits(coefficients), op,
             ": expected up to 14 coefficients (B, n) of one type and device");
  }
  int coefficient_count() const { return int(coefficients.tensor.size(1)); }
  template <class T>
  LensPoints<T> of(int64_t count) const {
    auto const stride = [](Contiguous const& x, int64_t size) { return x.tensor.size(0) == 1 ? int64_t(0) : size; };
    LensPoints<T> p{};
    p.camera = data<T>(camera);
    p.new_camera = data<T>(new_camera);
    p.coefficients = data<T>(coefficients);
    p.tilt = data<T>(tilt);
    p.camera_stride = stride(camera, 9);
    p.new_camera_stride = stride(new_camera, 9);
    p.coefficients_stride = stride(coefficients, coefficient_count());
    p.tilt_stride = p.tilt ? stride(tilt, 9) : 0;
    p.coefficient_count = coefficient_count();
    p.batch = batch;
    p.count = count;
    return p;
  }
  template <class T>
  static T const* data(Contiguous const& x) {
    return static_cast<T const*>(x.reals.data);
  }
};

// Runs the kernel `run_kernel(points, params, count)` on points (B, N, 2).
template <class Run>
Tensor through_lens(char const* op, Tensor const& points, Tensor const& camera, Tensor const& new_camera,
                    Tensor const& coefficients, std::optional<Tensor> const& tilt, int64_t steps, Run run_kernel) {
  KV_CHECK(points.dim() == 3 && points.size(2) == 2, op, ": expected points of shape (B, N, 2)");
  KV_CHECK(steps >= 0 && steps <= INT32_MAX, op, ": expected steps of at least 0, got ", steps);
  int64_t const batch = points.size(0), count = points.size(1);
  LensInputs const lens(op, batch, points, camera, new_camera, coefficients, tilt);
  Contiguous const x(op, points);
  Tensor const result = empty({batch, count, 2}, x.tensor);
  dispatch_compute_dtype(op, x.tensor, [&](auto type) {
    using T = typename decltype(type)::type;
    LensPoints<T> params = lens.of<T>(count);
    params.points = LensInputs::data<T>(x);
    params.steps = int(steps);
    params.result = data_ptr<T>(result);
    run_kernel(x.tensor, params, batch * count);
  });
  return result;
}

Tensor undistort_points(Tensor const& points, Tensor const& camera, Tensor const& new_camera,
                        Tensor const& coefficients, std::optional<Tensor> const& tilt, int64_t steps) {
  auto const run = [&]([[maybe_unused]] Tensor const& x, auto const& params, int64_t count) {
    KV_RUN(undistort_points, x, params, count, 4 * (1 + steps));
  };
  return through_lens("undistort_points", points, camera, new_camera, coefficients, tilt, steps, run);
}

Tensor distort_points(Tensor const& points, Tensor const& camera, Tensor const& new_camera, Tensor const& coefficients,
                      std::optional<Tensor> const& tilt) {
  auto const run = [&]([[maybe_unused]] Tensor const& x, auto const& params, int64_t count) {
    KV_RUN(distort_points, x, params, count, 8);
  };
  return through_lens("distort_points", points, camera, new_camera, coefficients, tilt, 0, run);
}

// The batch size of a lens.
int64_t lens_batch(char const* op, Tensor const& camera, Tensor const& coefficients,
                   std::optional<Tensor> const& tilt) {
  int64_t batch = 1;
  for (Tensor const* x : {&camera, &coefficients, tilt ? &*tilt : &camera}) {
    KV_CHECK(x->dim() > 0, op, ": expected tensors of lenses (B, ...)");
    if (x->size(0) != 1) batch = x->size(0);
  }
  return batch;
}

Tensor undistort_map(Tensor const& camera, Tensor const& coefficients, std::optional<Tensor> const& tilt,
                     std::vector<int64_t> sides) {
  char const* const op = "undistort_map";
  Size const size = map_size(op, sides);
  LensInputs const lens(op, lens_batch(op, camera, coefficients, tilt), camera, camera, camera, coefficients, tilt);
  Tensor const result = empty({lens.batch, 2, size.height, size.width}, camera);
  dispatch_compute_dtype(op, camera, [&](auto type) {
    using T = typename decltype(type)::type;
    LensPoints<T> params = lens.of<T>(size.height * size.width);
    params.width = size.width;
    params.result = data_ptr<T>(result);
    KV_RUN(distort_points, result, params, lens.batch * params.count, 8);
  });
  return result;
}

// Gradients per sample, also where one lens serves all.
std::tuple<Tensor, Tensor, Tensor> undistort_map_backward(Tensor const& grad, Tensor const& camera,
                                                          Tensor const& coefficients,
                                                          std::optional<Tensor> const& tilt) {
  char const* const op = "undistort_map_backward";
  KV_CHECK(grad.dim() == 4 && grad.size(1) == 2, op, ": expected grad of shape (B, 2, H, W)");
  Size const size = map_size(op, {grad.size(2), grad.size(3)});
  int64_t const batch = grad.size(0);
  LensInputs const lens(op, batch, grad, camera, camera, coefficients, tilt);
  Contiguous const g(op, grad);
  int64_t const parts = lens_parts(size.height * size.width);
  Tensor const sums = empty({batch, parts, kLensSums}, grad), grad_camera = empty({batch, 3, 3}, grad),
               grad_coefficients = empty({batch, lens.coefficient_count()}, grad),
               grad_tilt = empty({batch, tilt ? 3 : 0, 3}, grad);
  dispatch_compute_dtype(op, g.tensor, [&](auto type) {
    using T = typename decltype(type)::type;
    LensBackward<T> params{lens.of<T>(size.height * size.width),
                           LensInputs::data<T>(g),
                           data_ptr<T>(sums),
                           parts,
                           data_ptr<T>(grad_camera),
                           data_ptr<T>(grad_coefficients),
                           tilt ? data_ptr<T>(grad_tilt) : nullptr};
    params.width = size.width;
    KV_RUN(undistort_map_backward, grad, params, batch * parts, 16 * kLensChunk);
    KV_RUN(reduce_lens_grads, grad, params, batch, kLensSums * parts);
  });
  return {grad_camera, grad_coefficients, grad_tilt};
}

}  // namespace

#define KV_LENS "Tensor points, Tensor camera, Tensor new_camera, Tensor coefficients, Tensor? tilt"

KV_OPERATOR(undistort_points, "(" KV_LENS ", int steps) -> Tensor")
KV_OPERATOR(distort_points, "(" KV_LENS ") -> Tensor")
KV_OPERATOR(undistort_map, "(Tensor camera, Tensor coefficients, Tensor? tilt, SymInt[] size) -> Tensor")
KV_OPERATOR(undistort_map_backward,
            "(Tensor grad, Tensor camera, Tensor coefficients, Tensor? tilt) -> (Tensor, Tensor, Tensor)")

#undef KV_LENS

}  // namespace kv::geometry
