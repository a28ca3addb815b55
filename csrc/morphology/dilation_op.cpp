// Dilation and erosion: schemas and entries, for CPU and CUDA alike.
#include "dilation.h"
#include "glue/glue.h"

namespace kv {
namespace {

// A structuring element as the kernels read it: (B or 1, height, width), contiguous, in the type that images are
// computed in.
Tensor checked(char const* op, char const* name, Tensor const& element, Tensor const& x) {
  KV_CHECK(element.dim() == 3 && (element.size(0) == 1 || element.size(0) == x.size(0)) &&
               element.scalar_type() == compute_dtype(x) && element.device() == x.device(),
           op, ": expected ", name, " (B or 1, height, width) in the type that images are computed in");
  check_window(op, element.size(1), element.size(2));
  return dense(element);
}

struct Element {
  Tensor kernel;
  std::optional<Tensor> heights;
  int64_t height, width, top, left;  // of the window
  double value;
  bool erode;

  Element(char const* op, Tensor const& x, Tensor const& of_kernel, std::optional<Tensor> const& of_heights, int64_t y,
          int64_t x_of_origin, double value, bool erode)
      : kernel(checked(op, "kernel", of_kernel, x)),
        height(kernel.size(1)),
        width(kernel.size(2)),
        top(erode ? y : height - 1 - y),
        left(erode ? x_of_origin : width - 1 - x_of_origin),
        value(value),
        erode(erode) {
    if (of_heights) {
      heights = checked(op, "heights", *of_heights, x);
      KV_CHECK(heights->size(1) == height && heights->size(2) == width, op, ": expected heights of the kernel's size");
    }
    KV_CHECK(top >= 0 && top < height && left >= 0 && left < width, op, ": expected the origin inside of the kernel");
  }

  template <class F>
  Window<F> window() const {
    auto const data = [](Tensor const& t) { return static_cast<F const*>(t.const_data_ptr()); };
    auto const stride = [&](Tensor const& t) { return t.size(0) > 1 ? height * width : int64_t(0); };
    return {data(kernel),   heights ? data(*heights) : nullptr,
            stride(kernel), heights ? stride(*heights) : 0,
            int(height),    int(width),
            int(top),       int(left),
            F(value),       erode};
  }
};

int64_t planes_of_sample(Tensor const& x, Layout layout) { return layout == Layout::channels_last ? 1 : x.size(1); }

Tensor dilation(Tensor const& input, Tensor const& kernel, std::optional<Tensor> const& heights, int64_t origin_y,
                int64_t origin_x, double value, bool erode) {
  check_images("dilation", "input", input);
  Element const element("dilation", input, kernel, heights, origin_y, origin_x, value, erode);
  Layout const layout = layout_of(input);
  Tensor const x = as_layout(input, layout), y = empty_like(x, layout);
  dispatch_floating("dilation", x, [&](auto type) {
    using T = typename decltype(type)::type;
    Dilation<T> const params{planes<T const>(x, layout), planes<T>(y, layout), element.window<Compute<T>>(),
                             planes_of_sample(x, layout)};
    KV_RUN(dilation, x, params, params.y.rows(), params.y.row_size());
  });
  return y;
}

Tensor dilation_backward(Tensor const& grad, Tensor const& input, Tensor const& kernel,
                         std::optional<Tensor> const& heights, int64_t origin_y, int64_t origin_x, double value,
                         bool erode) {
  constexpr char const* op = "dilation_backward";
  check_images(op, "input", input);
  check_like(op, "grad", grad, input);
  Element const element(op, input, kernel, heights, origin_y, origin_x, value, erode);
  Layout const layout = layout_of(input);
  Tensor const g = as_layout(grad, layout), x = as_layout(input, layout), grad_x = empty_like(x, layout);
  dispatch_floating(op, x, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    DilationBackward<T> const all{planes<T const>(g, layout), planes<T const>(x, layout),  planes<T>(grad_x, layout),
                                  element.window<F>(),        planes_of_sample(x, layout), nullptr};
    auto const run = [&](DilationBackward<T> const& params) {
      KV_RUN(dilation_backward, x, params, params.x.rows(), params.x.row_size() * element.height * element.width / 4);
    };
#if defined(KV_CUDA)
    if (layout == Layout::channels_last || !has_own_memory(all.window)) {
      // Two numbers an element, of so many samples at a time that they take no more memory than x.
      int64_t const samples = x.size(0), numbers = samples ? 2 * x.numel() / samples : 0;
      int64_t const together = max(int64_t(samples * sizeof(T) / (2 * sizeof(F))), int64_t(1));
      Tensor const found = empty({together * numbers}, x, Layout::planar, compute_dtype(x));
      for (int64_t first = 0; first < samples; first += together) {
        DilationBackward<T> params = all;
        params.found = data_ptr<F>(found);
        params.window.kernel += first * params.window.kernel_stride;
        if (params.window.heights) params.window.heights += first * params.window.heights_stride;
        auto const take = [&](auto& planes, Tensor const& of) {
          planes.data += first * of.stride(0);
          planes.outer = planes.outer / samples * min(together, samples - first);
        };
        take(params.grad, g), take(params.x, x), take(params.grad_x, grad_x);
        run(params);
      }
      return;
    }
#endif
    run(all);
  });
  return grad_x;
}

}  // namespace

KV_OPERATOR(dilation,
            "(Tensor input, Tensor kernel, Tensor? heights, int top, int left, float value, bool erode) -> "
            "Tensor")
KV_OPERATOR(dilation_backward,
            "(Tensor grad, Tensor input, Tensor kernel, Tensor? heights, int top, int left, float value, "
            "bool erode) -> Tensor")

}  // namespace kv
