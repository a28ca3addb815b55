// YUV 4:2:2 and 4:2:0: schemas and entries, for CPU and CUDA.
#include <algorithm>

#include "glue/glue.h"
#include "yuv.h"

namespace kv::color {
namespace {

void check_cells(char const* op, Tensor const& x, int64_t channels, int64_t rows, std::vector<double> const& matrix) {
  check_images(op, "input", x);
  KV_CHECK(rows == 1 || rows == 2, op, ": expected cells of 1 or 2 rows, got ", rows);
  KV_CHECK(x.size(1) == channels && x.size(2) % rows == 0 && x.size(3) % 2 == 0, op, ": expected input of ", channels,
           " channels in whole cells");
  KV_CHECK(matrix.size() == 9, op, ": expected a matrix of 9 numbers, got ", matrix.size());
}

std::tuple<Tensor, Tensor> split_chroma(Tensor const& input, int64_t rows, std::vector<double> matrix) {
  check_cells("split_chroma", input, 3, rows, matrix);
  int64_t const b = input.size(0), h = input.size(2), w = input.size(3);
  Tensor const x = as_layout(input, Layout::planar), luma = empty({b, 1, h, w}, x),
               chroma = empty({b, 2, h / rows, w / 2}, x);
  dispatch_floating("split_chroma", x, [&](auto type) {
    using T = typename decltype(type)::type;
    SplitChroma<T> p{planes<T const>(x, Layout::planar),
                     planes<T>(luma, Layout::planar),
                     planes<T>(chroma, Layout::planar),
                     int(rows),
                     {}};
    std::copy(matrix.begin(), matrix.end(), p.m);
    KV_RUN(split_chroma, x, p, p.luma.count() * p.chroma.height, 4 * rows * w);
  });
  return {luma, chroma};
}

Tensor join_chroma(Tensor const& luma, Tensor const& chroma, int64_t rows, std::vector<double> matrix) {
  check_cells("join_chroma", luma, 1, rows, matrix);
  int64_t const b = luma.size(0), h = luma.size(2), w = luma.size(3);
  KV_CHECK(chroma.dim() == 4 && (chroma.size(0) == b || chroma.size(0) == 1) && chroma.size(1) == 2 &&
               chroma.size(2) == h / rows && chroma.size(3) == w / 2 && chroma.scalar_type() == luma.scalar_type() &&
               chroma.device() == luma.device(),
           "join_chroma: chroma does not fit luma");
  Tensor const y = as_layout(luma, Layout::planar), uv = as_layout(chroma, Layout::planar),
               colors = empty({b, 3, h, w}, y);
  dispatch_floating("join_chroma", y, [&](auto type) {
    using T = typename decltype(type)::type;
    JoinChroma<T> p{planes<T const>(y, Layout::planar),
                    planes<T const>(uv, Layout::planar),
                    planes<T>(colors, Layout::planar),
                    int(rows),
                    {}};
    if (uv.size(0) < b)
      p.chroma.outer = b, p.chroma.inner = 2, p.chroma.outer_stride = 0, p.chroma.inner_stride = uv.stride(1);
    std::copy(matrix.begin(), matrix.end(), p.m);
    KV_RUN(join_chroma, y, p, p.luma.count() * p.chroma.height, 4 * rows * w);
  });
  return colors;
}

}  // namespace

KV_OPERATOR(split_chroma, "(Tensor input, int rows, float[] matrix) -> (Tensor, Tensor)")
KV_OPERATOR(join_chroma, "(Tensor luma, Tensor chroma, int rows, float[] matrix) -> Tensor")

}  // namespace kv::color
