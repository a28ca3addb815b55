// Cross-correlation of images (B, C, H, W) and volumes (B, C, D, H, W): schemas and entries, for CPU and CUDA.
// Volumes are read contiguous.
#include "filter2d.h"
#include "glue/glue.h"

namespace kv::filters {
namespace {

// The axes of a kernel (B or 1, z?, y, x) over images or volumes that have `sizes` before the filter.
struct Window {
  Border border;
  KernelAxis z{1, 0}, y{1, 0}, x{1, 0};

  Window(char const* op, Tensor const& kernel, std::vector<int64_t> const& sizes, int64_t border, bool same)
      : border(to_border(op, border)) {
    if (!same) this->border = Border::constant;  // 'valid' neither reads nor accumulates a border
    size_t const axes = sizes.size() - 2;
    KV_CHECK(kernel.dim() == int64_t(axes) + 1, op, ": expected kernel of ", axes + 1, " axes, got ", kernel.dim());
    KV_CHECK(kernel.size(0) == 1 || kernel.size(0) == sizes[0], op, ": expected a kernel for each of ", sizes[0],
             " samples or one for all, got ", kernel.size(0));
    int64_t const taps_z = axes == 3 ? kernel.size(1) : 1;
    check_window(op, kernel.size(axes - 1), kernel.size(axes));
    KV_CHECK(taps_z > 0 && taps_z <= INT32_MAX / (kernel.size(axes - 1) * kernel.size(axes)), op,
             ": expected a kernel of fewer than 2^31 taps, got a depth of ", taps_z);
    KernelAxis* const at[] = {&z, &y, &x};
    for (size_t axis = 0; axis < axes; ++axis) {
      int64_t const size = kernel.size(axis + 1), pixels = sizes[axis + 2];
      KV_CHECK(same || size <= pixels, op, ": a 'valid' kernel of ", size, " does not fit an axis of ", pixels);
      if (same) check_border(op, this->border, size / 2, pixels);
      *at[3 - axes + axis] = {int(size), int(same ? (size - 1) / 2 : 0)};
    }
  }
  int64_t taps() const { return int64_t(z.size) * y.size * x.size; }
};

KernelAxis flip(KernelAxis taps) { return {taps.size, taps.size - 1 - taps.before}; }

void check_weights(char const* op, Tensor const& kernel, Tensor const& x) {
  KV_CHECK(kernel.scalar_type() == compute_dtype(x), op,
           ": expected kernel of the type that the images are computed in");
  KV_CHECK(kernel.device() == x.device(), op, ": expected kernel on the device of the images");
}

// The sizes of x plus `sign` (-1, 0, 1) times (kernel size - 1) along the filtered axes.
std::vector<int64_t> sizes_with(char const* op, Tensor const& x, int64_t axes, Tensor const& kernel, int sign) {
  axes == 2 ? check_images(op, "input", x) : check_volumes(op, "input", x);
  std::vector<int64_t> sizes;
  for (int64_t axis = 0; axis < x.dim(); ++axis)
    sizes.push_back(x.size(axis) + (axis >= 2 && axis - 1 < kernel.dim() ? sign * (kernel.size(axis - 1) - 1) : 0));
  return sizes;
}

bool is_image(Tensor const& x) { return x.dim() == 4; }
Layout readable_layout(Tensor const& x) { return is_image(x) ? layout_of(x) : Layout::planar; }
Tensor readable(Tensor const& x, Layout layout) { return is_image(x) ? as_layout(x, layout) : dense(x); }
template <class T>
Planes<T> rows_of(Tensor const& x, Layout layout) {
  return is_image(x) ? planes<T>(x, layout) : stacked_planes<T>(x);
}
int depth_of(Tensor const& x) { return is_image(x) ? 1 : int(x.size(2)); }

// The filtered input, of `sizes`; transposed: the gradient to the filter's input from that to its output.
Tensor filter(char const* op, Tensor const& input, Tensor const& kernel, std::vector<int64_t> const& sizes,
              Window const& window, bool transposed, bool clamps = false) {
  check_weights(op, kernel, input);
  Layout const layout = readable_layout(input);
  Tensor const x = readable(input, layout), y = empty(sizes, x, layout),
               weights = kernel.is_contiguous() ? kernel : dense(kernel);
  auto const taps = [&](KernelAxis t) { return transposed ? flip(t) : t; };
  bool const accumulates = transposed && window.border != Border::circular;
  dispatch_floating_and_uint8(op, x, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    Filter2d<T> p{};
    p.x = rows_of<T const>(x, layout);
    p.y = rows_of<T>(y, layout);
    p.kernel = static_cast<F const*>(weights.const_data_ptr());
    p.axis_z = taps(window.z), p.axis_y = taps(window.y), p.axis_x = taps(window.x);
    p.kernel_stride = kernel.size(0) == 1 ? 0 : p.taps();
    p.sample_planes = p.y.count() / max(int64_t(1), y.size(0));
    p.depth = depth_of(x);
    p.flip = transposed;
    p.border = accumulates ? Border::constant : window.border;
    p.accumulation = accumulates ? window.border : Border::constant;
    p.clamps = clamps && sizeof(T) > 1;
    KV_RUN(filter2d, x, p, p.y.rows(), p.y.row_size() * (1 + p.taps() / 4));
  });
  return y;
}

Tensor filter_forward(char const* op, int64_t axes, Tensor const& input, Tensor const& kernel, int64_t border,
                      bool same) {
  Window const window(op, kernel, sizes_with(op, input, axes, kernel, 0), border, same);
  return filter(op, input, kernel, sizes_with(op, input, axes, kernel, same ? 0 : -1), window, false);
}

Tensor filter_backward(char const* op, int64_t axes, Tensor const& grad, Tensor const& kernel, int64_t border,
                       bool same) {
  std::vector<int64_t> const sizes = sizes_with(op, grad, axes, kernel, same ? 0 : 1);
  return filter(op, grad, kernel, sizes, Window(op, kernel, sizes, border, same), true);
}

// The gradient to the kernel of each sample; `kernel` has its sizes and type.
Tensor kernel_backward(char const* op, int64_t axes, Tensor const& kernel, Tensor const& grad, Tensor const& input,
                       int64_t border, bool same) {
  std::vector<int64_t> sizes = sizes_with(op, input, axes, kernel, 0);
  Window const window(op, kernel, sizes, border, same);
  check_weights(op, kernel, input);
  bool const fits = sizes_with(op, grad, axes, kernel, same ? 0 : 1) == sizes;
  KV_CHECK(fits && grad.scalar_type() == input.scalar_type() && grad.device() == input.device(), op,
           ": grad does not belong to input");
  Layout const layout = readable_layout(input);
  Tensor const g = readable(grad, layout), x = readable(input, layout);
  sizes.resize(axes + 1);
  for (int64_t axis = 1; axis <= axes; ++axis) sizes[axis] = kernel.size(axis);
  Tensor const grad_kernel = empty(sizes, kernel);
  // A part has twenty pixels for each tap, so that partial sums take a twentieth of an image's memory.
  int64_t const pixels = 20 * window.taps(),
                part_rows = max(int64_t(32), pixels / max(int64_t(1), g.size(g.dim() - 1)));
  dispatch_floating(op, x, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    Filter2dKernelBackward<T> p{rows_of<T const>(g, layout),
                                rows_of<T const>(x, layout),
                                nullptr,
                                part_rows,
                                depth_of(x),
                                window.z,
                                window.y,
                                window.x,
                                window.border};
    Tensor const parts = empty({p.count(), p.taps()}, kernel);
    p.parts = static_cast<F*>(parts.mutable_data_ptr());
    KV_RUN(filter2d_kernel_backward, x, p, p.count(), p.grad.row_size() * part_rows * (1 + p.taps() / 4));
    SumPartials<F> const sum{p.parts, static_cast<F*>(grad_kernel.mutable_data_ptr()), grad_kernel.numel(),
                             p.count() / max(int64_t(1), sizes[0]), p.taps()};
    KV_RUN(sum_partials, x, sum, sum.count, sum.parts);
  });
  return grad_kernel;
}

Tensor filter2d_clamped(Tensor const& input, Tensor const& kernel, int64_t border) {
  constexpr char const* op = "filter2d_clamped";
  std::vector<int64_t> const sizes = sizes_with(op, input, 2, kernel, 0);
  return filter(op, input, kernel, sizes, Window(op, kernel, sizes, border, true), false, true);
}

#define KV_FILTER(axes, name, backward_name, kernel_backward_name)                                           \
  Tensor name(Tensor const& input, Tensor const& kernel, int64_t border, bool same) {                        \
    return filter_forward(#name, axes, input, kernel, border, same);                                         \
  }                                                                                                          \
  Tensor backward_name(Tensor const& grad, Tensor const& kernel, int64_t border, bool same) {                \
    return filter_backward(#backward_name, axes, grad, kernel, border, same);                                \
  }                                                                                                          \
  Tensor kernel_backward_name(Tensor const& kernel, Tensor const& grad, Tensor const& input, int64_t border, \
                              bool same) {                                                                   \
    return kernel_backward(#kernel_backward_name, axes, kernel, grad, input, border, same);                  \
  }
KV_FILTER(2, filter2d, filter2d_backward, filter2d_kernel_backward)
KV_FILTER(3, filter3d, filter3d_backward, filter3d_kernel_backward)

}  // namespace

// The same as filter2d, clamped to [0, 1].
KV_OPERATOR(filter2d_clamped, "(Tensor input, Tensor kernel, int border) -> Tensor")
KV_OPERATOR(filter2d, "(Tensor input, Tensor kernel, int border, bool same) -> Tensor")
KV_OPERATOR(filter2d_backward, "(Tensor grad, Tensor kernel, int border, bool same) -> Tensor")
KV_OPERATOR(filter2d_kernel_backward, "(Tensor kernel, Tensor grad, Tensor input, int border, bool same) -> Tensor")
KV_OPERATOR(filter3d, "(Tensor input, Tensor kernel, int border, bool same) -> Tensor")
KV_OPERATOR(filter3d_backward, "(Tensor grad, Tensor kernel, int border, bool same) -> Tensor")
KV_OPERATOR(filter3d_kernel_backward, "(Tensor kernel, Tensor grad, Tensor input, int border, bool same) -> Tensor")

}  // namespace kv::filters
