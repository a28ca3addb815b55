// Antialiased resizing of windows and its gradient, for the entries of operators.
#pragma once

#include "geometry/transform/resize/resize_windows.h"
#include "geometry/transform/sampling_glue.h"
#include "glue/expanded_scalar.h"

namespace kv::geometry {

inline void check_window_filter(char const* op, int64_t filter) {
  KV_CHECK(filter >= int64_t(ResizeFilter::bilinear) && filter <= int64_t(ResizeFilter::lanczos), op,
           ": filter must be 3 (bilinear), 4 (bicubic) or 5 (lanczos), got ", filter);
}
inline int64_t planes_per_sample(Tensor const& x, Layout layout) {
  return layout == Layout::channels_last ? 1 : x.size(1);
}
// Resizes windows of `x` to `y`, once `set_windows(params)` has said which ones.
template <class SetWindows>
void run_windows(char const* op, Tensor const& x, Tensor const& y, Layout layout, int64_t filter, bool align_corners,
                 bool backward, SetWindows set_windows) {
  auto const run = [&]<class T>(Type<T>) {
    ResizeWindows<T> p{planes<T const>(x, layout), planes<T>(y, layout), planes_per_sample(x, layout),
                       ResizeFilter(filter),       align_corners,        backward};
    set_windows(p);
    int64_t const work = p.y.row_size() == 0 ? 0 : backward ? p.y.count() : p.y.rows();
    KV_RUN(resize_windows, x, p, work, 4 * p.y.row_size() * (backward ? p.y.height : 1));
  };
  backward ? dispatch_floating(op, x, run) : dispatch_floating_and_uint8(op, x, run);
}

// From images to results of `size`, or from the gradient of results to that of images of `size`. They may be written to
// `memory`, of their layout.
inline Tensor windows_resized(char const* op, Tensor const& input, Tensor const& matrix,
                              std::vector<int64_t> const& sides, int64_t filter, bool align_corners, bool backward,
                              std::optional<Tensor> const& memory = {}) {
  check_images(op, backward ? "grad" : "input", input);
  Size const size = checked_size(op, sides);
  checked_size(op, input);
  check_window_filter(op, filter);
  KV_CHECK(matches_image(matrix, input, 3) && matrix.size(1) == 3 && matrix.size(2) == 3, op,
           ": matrix does not fit what is resized");
  Tensor const matrices = dense(matrix);
  Layout const layout = layout_of(input);
  bool const one_number = backward && is_expanded_scalar(input);
  Tensor const x = one_number ? input : as_layout(input, layout);
  Tensor const y = memory ? *memory : empty({x.size(0), x.size(1), size.height, size.width}, x, layout);
  run_windows(op, x, y, layout, filter, align_corners, backward, [&]<class T>(ResizeWindows<T>& p) {
    p.matrices = data_ptr<Compute<T> const>(matrices), p.matrix_stride = matrices.size(0) > 1 ? 9 : 0;
    p.one_number = one_number;
  });
  return y;
}

}  // namespace kv::geometry
