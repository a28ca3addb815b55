// Dilation and erosion: schemas and entries, for CPU and CUDA alike.
#include "dilation.h"
#include "glue/glue.h"

namespace kv {
namespace {

// The offsets as the kernels read them: (B or 1, height, width), contiguous, in the type that images are computed in.
Tensor checked(char const* op, Tensor const& offsets, Tensor const& x, int64_t top, int64_t left) {
  auto const computed = x.scalar_type() == ScalarType::Double ? ScalarType::Double : ScalarType::Float;
  KV_CHECK(offsets.dim() == 3 && (offsets.size(0) == 1 || offsets.size(0) == x.size(0)) &&
               offsets.scalar_type() == computed && offsets.device() == x.device(),
           op, ": expected offsets (B or 1, height, width) in the type that images are computed in");
  check_window(op, offsets.size(1), offsets.size(2));
  KV_CHECK(top >= 0 && top < offsets.size(1) && left >= 0 && left < offsets.size(2), op,
           ": expected top and left inside of the window");
  return torch::stable::contiguous(offsets);
}

template <class F>
Offsets<F> window_of(Tensor const& offsets, int64_t top, int64_t left, double value, bool erode) {
  int64_t const height = offsets.size(1), width = offsets.size(2);
  return {static_cast<F const*>(offsets.const_data_ptr()),
          offsets.size(0) > 1 ? height * width : 0,
          int(height),
          int(width),
          int(top),
          int(left),
          F(value),
          erode};
}

int64_t planes_of_sample(Tensor const& x, Layout layout) { return layout == Layout::channels_last ? 1 : x.size(1); }

Tensor dilation(Tensor const& input, Tensor const& offsets, int64_t top, int64_t left, double value, bool erode) {
  check_images("dilation", "input", input);
  Tensor const window = checked("dilation", offsets, input, top, left);
  Layout const layout = layout_of(input);
  Tensor const x = conform(input, layout), y = empty_like(x, layout);
  for_floats("dilation", x, [&](auto type) {
    using T = typename decltype(type)::type;
    Dilation<T> const params{planes<T const>(x, layout), planes<T>(y, layout),
                             window_of<Compute<T>>(window, top, left, value, erode), planes_of_sample(x, layout)};
    KV_RUN(dilation, x, params, params.y.rows(), params.y.row_size());
  });
  return y;
}

Tensor dilation_backward(Tensor const& grad, Tensor const& input, Tensor const& offsets, int64_t top, int64_t left,
                         double value, bool erode) {
  constexpr char const* op = "dilation_backward";
  check_images(op, "input", input);
  check_like(op, "grad", grad, input);
  Tensor const window = checked(op, offsets, input, top, left);
  Layout const layout = layout_of(input);
  Tensor const g = conform(grad, layout), x = conform(input, layout), grad_x = empty_like(x, layout);
  for_floats(op, x, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
#if defined(KV_CUDA)
    Tensor const found =
        torch::stable::new_empty(x, {2 * x.numel()}, sizeof(F) == 8 ? ScalarType::Double : ScalarType::Float);
    F* const memory = static_cast<F*>(found.mutable_data_ptr());
#else
    F* const memory = nullptr;
#endif
    DilationBackward<T> const params{planes<T const>(g, layout),  planes<T const>(x, layout),
                                     planes<T>(grad_x, layout),   window_of<F>(window, top, left, value, erode),
                                     planes_of_sample(x, layout), memory};
    KV_RUN(dilation_backward, x, params, params.x.rows(), params.x.row_size() * offsets.size(1) * offsets.size(2) / 4);
  });
  return grad_x;
}

}  // namespace

KV_OPERATOR(dilation, "(Tensor input, Tensor offsets, int top, int left, float value, bool erode) -> Tensor")
KV_OPERATOR(dilation_backward,
            "(Tensor grad, Tensor input, Tensor offsets, int top, int left, float value, bool erode) -> Tensor")

}  // namespace kv
