// Subvoxel peaks: schemas and entries, for CPU and CUDA. Volumes (B, C, D, H, W) are read contiguous.
#include "geometry/subpix/quad_interp3d.h"
#include "glue/batch.h"

namespace kv::geometry {
namespace {

// The arguments, checked and contiguous.
struct Peaks {
  Tensor x;
  std::optional<Tensor> chosen;
  int64_t steps, radius;
  double largest_shift;
  bool along_scale;

  Peaks(char const* op, Tensor const& input, int64_t batch, std::optional<Tensor> const& which, int64_t steps,
        double largest_shift, int64_t radius, bool along_scale)
      : x(input), steps(steps), radius(radius), largest_shift(largest_shift), along_scale(along_scale) {
    check_volumes(op, "input", input);
    KV_CHECK(steps >= 0 && steps <= INT32_MAX && radius >= 0 && radius <= INT32_MAX, op,
             ": steps and radius must not be negative");
    KV_CHECK(input.size(2) * input.size(3) * input.size(4) <= INT32_MAX, op, ": volumes are too large");
    check_sizes(op, "input", input, input, {batch, input.size(1), input.size(2), input.size(3), input.size(4)});
    x = expand_batch(input, batch);
    if (!which) return;
    KV_CHECK(which->scalar_type() == ScalarType::Byte && which->device() == input.device() && which->dim() == 5, op,
             ": chosen does not fit the input");
    check_sizes(op, "chosen", *which, *which, {batch, x.size(1), x.size(2), x.size(3), x.size(4)});
    chosen = expand_batch(*which, batch);
  }
  template <class T>
  ConvQuadInterp3d<T> of(T* coords, T* values) const {
    return {data_ptr<T const>(x),
            chosen ? data_ptr<uint8_t const>(*chosen) : nullptr,
            coords,
            values,
            x.size(0) * x.size(1),
            {int(x.size(2)), int(x.size(3)), int(x.size(4))},
            int(steps),
            int(radius),
            along_scale,
            Compute<T>(largest_shift)};
  }
};

std::tuple<Tensor, Tensor> conv_quad_interp3d(Tensor const& input, std::optional<Tensor> const& chosen, int64_t steps,
                                              double largest_shift, int64_t radius, bool along_scale) {
  check_volumes("conv_quad_interp3d", "input", input);
  Peaks const peaks("conv_quad_interp3d", input, input.size(0), chosen, steps, largest_shift, radius, along_scale);
  Tensor const& x = peaks.x;
  Tensor const coords = empty({x.size(0), x.size(1), 3, x.size(2), x.size(3), x.size(4)}, x);
  Tensor const values = empty({x.size(0), x.size(1), x.size(2), x.size(3), x.size(4)}, x);
  dispatch_floating("conv_quad_interp3d", x, [&](auto type) {
    using T = typename decltype(type)::type;
    auto const params = peaks.of<T>(data_ptr<T>(coords), data_ptr<T>(values));
    KV_RUN(conv_quad_interp3d, x, params, params.volumes * params.size[0] * params.size[1], 16 * x.size(4));
  });
  return {coords, values};
}

// The gradient is in the compute type.
Tensor conv_quad_interp3d_backward(Tensor const& grad_coords, Tensor const& grad_values, Tensor const& input,
                                   std::optional<Tensor> const& chosen, int64_t steps, double largest_shift,
                                   int64_t radius, bool along_scale) {
  char const* const op = "conv_quad_interp3d_backward";
  KV_CHECK(grad_coords.dim() == 6, op, ": expected grad_coords of 6 axes, got ", grad_coords.dim());
  int64_t const batch = grad_coords.size(0);
  Peaks const peaks(op, input, batch, chosen, steps, largest_shift, radius, along_scale);
  Tensor const& x = peaks.x;
  check_sizes(op, "grad_coords", grad_coords, x, {batch, x.size(1), 3, x.size(2), x.size(3), x.size(4)});
  check_sizes(op, "grad_values", grad_values, x, {batch, x.size(1), x.size(2), x.size(3), x.size(4)});
  Tensor const to_coords = expand_batch(grad_coords, batch), to_values = expand_batch(grad_values, batch);
  bool const is_double = x.scalar_type() == ScalarType::Double;
  Tensor const grad_x = empty({x.size(0), x.size(1), x.size(2), x.size(3), x.size(4)}, x, Layout::planar,
                              is_double ? ScalarType::Double : ScalarType::Float);
  dispatch_floating(op, x, [&](auto type) {
    using T = typename decltype(type)::type;
    ConvQuadInterp3dBackward<T> const params{peaks.of<T>(nullptr, nullptr), data_ptr<T const>(to_coords),
                                             data_ptr<T const>(to_values), data_ptr<Compute<T>>(grad_x)};
    KV_RUN(conv_quad_interp3d_backward, x, params, params.forward.volumes, 16 * x.size(2) * x.size(3) * x.size(4));
  });
  return grad_x;
}

}  // namespace

#define KV_PEAK_OPTIONS "Tensor? chosen, int steps, float largest_shift, int radius, bool along_scale"

KV_OPERATOR(conv_quad_interp3d, "(Tensor input, " KV_PEAK_OPTIONS ") -> (Tensor, Tensor)")
KV_OPERATOR(conv_quad_interp3d_backward,
            "(Tensor grad_coords, Tensor grad_values, Tensor input, " KV_PEAK_OPTIONS ") -> Tensor")

#undef KV_PEAK_OPTIONS

}  // namespace kv::geometry
