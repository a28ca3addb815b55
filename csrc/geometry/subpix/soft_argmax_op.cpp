// The soft argmax of windows: schemas and entries, for CPU and CUDA. Volumes are read contiguous.
#include "geometry/subpix/soft_argmax.h"
#include "glue/batch.h"

namespace kv::geometry {
namespace {

using Ints = std::vector<int64_t>;

Windows windows_of(char const* op, Tensor const& x, Ints const& window, Ints const& stride, Ints const& padding,
                   bool scale_too) {
  check_volumes(op, "input", x);
  KV_CHECK(window.size() == 3 && stride.size() == 3 && padding.size() == 3, op,
           ": expected windows, strides and paddings of 3 sizes");
  Windows w{x.size(0) * x.size(1), scale_too ? 3 : 2, {}, {}, {}, {}, {}};
  for (int axis = 0; axis < 3; ++axis) {
    int64_t const n = x.size(2 + axis), k = window[axis], s = stride[axis], before = padding[axis];
    KV_CHECK(n <= INT32_MAX / 4, op, ": the input is too large");
    check_window(op, k, s);
    KV_CHECK(before >= 0 && 2 * before <= k && k <= n + 2 * before, op, ": padding ", before, " and window ", k,
             " do not fit an axis of ", n);
    w.size[axis] = int(n);
    w.out[axis] = int((n + 2 * before - k) / s + 1);
    w.window[axis] = int(k);
    w.stride[axis] = int(s);
    w.before[axis] = int(before);
  }
  return w;
}

template <class F>
void scales_of(Windows const& w, bool normalized, F (&scale)[3], F* offset = nullptr) {
  for (int axis = 0; axis < 3; ++axis) {
    scale[axis] = !normalized ? F(1) : w.size[axis] > 1 ? F(2) / F(w.size[axis] - 1) : F(0);
    if (offset) offset[axis] = normalized ? F(-1) : F(0);
  }
}

std::tuple<Tensor, Tensor> soft_argmax(Tensor const& input, Ints window, Ints stride, Ints padding, double temperature,
                                       bool normalized, bool scale_too, bool with_values) {
  char const* const op = "soft_argmax";
  Windows const w = windows_of(op, input, window, stride, padding, scale_too);
  KV_CHECK(temperature > 0, op, ": temperature must be positive, got ", temperature);
  Tensor const x = dense(input);
  int64_t const b = x.size(0), c = x.size(1);
  Tensor const coords = empty({b, c, w.axes, w.out[0], w.out[1], w.out[2]}, x);
  Tensor const values = empty({b, c, with_values ? w.out[0] : 0, w.out[1], w.out[2]}, x);
  dispatch_floating(op, x, [&](auto type) {
    using T = typename decltype(type)::type;
    SoftArgmax<T> params{w,
                         Compute<T>(temperature),
                         {},
                         {},
                         data_ptr<T const>(x),
                         data_ptr<T>(coords),
                         with_values ? data_ptr<T>(values) : nullptr};
    scales_of(w, normalized, params.scale, params.offset);
    KV_RUN(soft_argmax, x, params, w.volumes * w.out[0] * w.out[1], w.out[2] * w.area());
  });
  return {coords, values};
}

Tensor soft_argmax_backward(Tensor const& grad_coords, Tensor const& grad_values, Tensor const& input, Ints window,
                            Ints stride, Ints padding, double temperature, bool normalized, bool scale_too,
                            bool with_values) {
  char const* const op = "soft_argmax_backward";
  Windows w = windows_of(op, input, window, stride, padding, scale_too);
  KV_CHECK(temperature > 0, op, ": temperature must be positive, got ", temperature);
  KV_CHECK(grad_coords.dim() == 6, op, ": expected grad_coords of 6 axes, got ", grad_coords.dim());
  int64_t const b = grad_coords.size(0), c = input.size(1);
  w.volumes = b * c;
  check_sizes(op, "input", input, grad_coords, {b, c, w.size[0], w.size[1], w.size[2]});
  check_sizes(op, "grad_coords", grad_coords, input, {b, c, w.axes, w.out[0], w.out[1], w.out[2]});
  check_sizes(op, "grad_values", grad_values, input, {b, c, with_values ? w.out[0] : 0, w.out[1], w.out[2]});
  Tensor const x = expand_batch(input, b), g = expand_batch(grad_coords, b), v = expand_batch(grad_values, b);
  Tensor const grad_x = empty({b, c, w.size[0], w.size[1], w.size[2]}, x);
#if defined(KV_CUDA)
  // Special case, H200: 5.9 (soft argmax3 backward) to 8.7 (conv_soft_argmax2d backward) times as fast as records
  // first.
  bool const one_pass = x.scalar_type() != ScalarType::Double && !with_values && radius_of(w) > 0;
#else
  bool const one_pass = false;
#endif
  bool const is_double = x.scalar_type() == ScalarType::Double;
  Tensor const records = empty({one_pass ? 0 : kRecord, w.volumes, w.coords()}, x, Layout::planar,
                               is_double ? ScalarType::Double : ScalarType::Float);
  dispatch_floating(op, x, [&](auto type) {
    using T = typename decltype(type)::type;
    SoftArgmaxBackward<T> params{w,
                                 Compute<T>(temperature),
                                 {},
                                 data_ptr<T const>(g),
                                 with_values ? data_ptr<T const>(v) : nullptr,
                                 data_ptr<T const>(x),
                                 data_ptr<T>(grad_x),
                                 one_pass ? nullptr : data_ptr<Compute<T>>(records)};
    scales_of(w, normalized, params.scale);
    if (!one_pass) KV_RUN(soft_argmax_records, x, params, w.volumes * w.out[0] * w.out[1], w.out[2] * w.area());
    KV_RUN(soft_argmax_backward, x, params, w.volumes * w.size[0] * w.size[1], w.size[2] * w.area());
  });
  return grad_x;
}

}  // namespace

#define KV_WINDOW_OPTIONS \
  "int[] window, int[] stride, int[] padding, float temperature, bool normalized, bool scale_too, bool with_values"

KV_OPERATOR(soft_argmax, "(Tensor input, " KV_WINDOW_OPTIONS ") -> (Tensor, Tensor)")
KV_OPERATOR(soft_argmax_backward,
            "(Tensor grad_coords, Tensor grad_values, Tensor input, " KV_WINDOW_OPTIONS ") -> Tensor")

#undef KV_WINDOW_OPTIONS

}  // namespace kv::geometry
