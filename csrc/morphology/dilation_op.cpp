// Dilation and erosion: schemas and entries, for CPU and CUDA.
#include "dilation.h"
#include "glue/glue.h"

namespace kv::morphology {
namespace {

// A structuring element as the kernels read it: (B or 1, height, width), contiguous, in the compute type of the images.
Tensor check_element(char const* op, char const* name, Tensor const& element, Tensor const& x) {
  KV_CHECK(element.dim() == 3 && (element.size(0) == 1 || element.size(0) == x.size(0)) &&
               element.scalar_type() == compute_dtype(x) && element.device() == x.device(),
           op, ": expected ", name, " (B or 1, height, width) in the type that images are computed in");
  check_window(op, element.size(1), element.size(2));
  return dense(element);
}

struct CheckedElement {
  Tensor kernel;
  std::optional<Tensor> heights;
  int64_t height, width, top, left;  // of the window
  double value;
  bool erode;

  CheckedElement(char const* op, Tensor const& x, Tensor const& members, std::optional<Tensor> const& member_heights,
                 int64_t origin_y, int64_t origin_x, double value, bool erode)
      : kernel(check_element(op, "kernel", members, x)),
        height(kernel.size(1)),
        width(kernel.size(2)),
        top(erode ? origin_y : height - 1 - origin_y),
        left(erode ? origin_x : width - 1 - origin_x),
        value(value),
        erode(erode) {
    if (member_heights) {
      heights = check_element(op, "heights", *member_heights, x);
      KV_CHECK(heights->size(1) == height && heights->size(2) == width, op, ": expected heights of the kernel's size");
    }
    KV_CHECK(top >= 0 && top < height && left >= 0 && left < width, op, ": expected the origin inside the kernel");
  }

  template <class F>
  StructuringElement<F> window() const {
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
  CheckedElement const element("dilation", input, kernel, heights, origin_y, origin_x, value, erode);
  Layout const layout = layout_of(input);
  Tensor const x = as_layout(input, layout), y = empty_like(x, layout);
  dispatch_floating_and_uint8("dilation", x, [&](auto type) {
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
  CheckedElement const element(op, input, kernel, heights, origin_y, origin_x, value, erode);
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
    if (layout == Layout::channels_last || !needs_no_workspace(all.window)) {
      // The workspace has two numbers for each element of as many samples as take no more memory than x.
      int64_t const samples = x.size(0), numbers = samples ? 2 * x.numel() / samples : 0;
      int64_t const samples_at_once = max(int64_t(samples * sizeof(T) / (2 * sizeof(F))), int64_t(1));
      Tensor const workspace = empty({samples_at_once * numbers}, x, Layout::planar, compute_dtype(x));
      for (int64_t first = 0; first < samples; first += samples_at_once) {
        DilationBackward<T> params = all;
        params.workspace = data_ptr<F>(workspace);
        params.window.kernel += first * params.window.kernel_stride;
        if (params.window.heights) params.window.heights += first * params.window.heights_stride;
        auto const slice_samples = [&](auto& planes, Tensor const& tensor) {
          planes.data += first * tensor.stride(0);
          planes.outer = planes.outer / samples * min(samples_at_once, samples - first);
        };
        slice_samples(params.grad, g), slice_samples(params.x, x), slice_samples(params.grad_x, grad_x);
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

}  // namespace kv::morphology
