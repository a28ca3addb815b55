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
template <class T>
void run_windows([[maybe_unused]] Tensor const& x, ResizeWindows<T> const& params) {
  int64_t const work = params.y.row_size() == 0 ? 0 : params.backward ? params.y.count() : params.y.rows();
  KV_RUN(resize_windows, x, params, work, 4 * params.y.row_size() * (params.backward ? params.y.height : 1));
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
  auto const run = [&](auto type) {
    using T = typename decltype(type)::type;
    ResizeWindows<T> params{planes<T const>(x, layout),
                            planes<T>(y, layout),
                            planes_per_sample(x, layout),
                            ResizeFilter(filter),
                            align_corners,
                            backward,
                            data_ptr<Compute<T> const>(matrices),
                            matrices.size(0) > 1 ? 9 : 0};
    params.one_number = one_number;
    run_windows(x, params);
  };
  if (backward)
    dispatch_floating(op, x, run);
  else
    dispatch_floating_and_uint8(op, x, run);
  return y;
}

}  // namespace kv::geometry
