// Antialiased resizing of windows of lists and its gradient, for the entries of operators.
#pragma once

#include "geometry/transform/lists/list_glue.h"
#include "geometry/transform/lists/resize_windows_list.h"

namespace kv::geometry {

// From images to results of one size or of a size each, or from the gradients of results, one batch or a list, to those
// of images of a size each. Without matrices windows are whole images. A batch of results may be written to `memory`,
// of their layout.
inline Tensors windows_resized(char const* op, Tensors const& inputs, std::optional<Tensor> const& matrix,
                               std::vector<int64_t> const& sides, int64_t filter, bool align_corners, bool backward,
                               std::optional<Tensor> const& memory = {}) {
  ListResizing const call(op, inputs, sides, backward);
  KV_CHECK(filter >= int64_t(ResizeFilter::bilinear) && filter <= int64_t(ResizeFilter::lanczos), op,
           ": filter must be 3 (bilinear), 4 (bicubic) or 5 (lanczos), got ", filter);
  KV_CHECK(!matrix || (matches_samples(*matrix, call.like, 3, int64_t(call.count)) && matrix->size(1) == 3 &&
                       matrix->size(2) == 3),
           op, ": matrix does not fit what is resized");
  std::optional<Tensor> const matrices = matrix ? std::optional(dense(*matrix)) : std::nullopt;
  auto const run = [&]<class T>(Type<T>, auto tables) {
    auto const* const data = matrices ? data_ptr<Compute<T> const>(*matrices) : nullptr;
    int64_t const stride = matrices && matrices->size(0) > 1 ? 9 : 0;
    ResizeWindowsList<T> p;
    p.all = {{}, {}, 0, ResizeFilter(filter), align_corners, backward, data, stride};
    p.channels = int(call.channels);
    tables(
        p.list,
        [&](Size size) { return items_of_windows(call.channels, call.interleaved, size.height, size.width, backward); },
        [&](size_t first) {
          if (data) p.all.matrices = data + int64_t(first) * stride;
          KV_RUN(resize_windows_list, call.like, p, p.list.items, 8 * kItemPixels);
        });
  };
  return call.results(run, memory);
}

}  // namespace kv::geometry
