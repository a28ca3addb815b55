// Colormaps: schema and entry, for CPU and CUDA.
#include "colormap.h"
#include "glue/glue.h"

namespace kv::color {
namespace {

// Images (B, C, H, W), the value in each of their channels that shows the last color (B, C), and tables (B or 1, 3, n),
// all of one type.
Tensor apply_colormap(Tensor const& input, Tensor const& white, Tensor const& colors) {
  constexpr char const* op = "apply_colormap";
  check_images(op, "input", input);
  int64_t const b = input.size(0), c = input.size(1), h = input.size(2), w = input.size(3);
  auto const fits = [&](Tensor const& t) {
    return t.scalar_type() == input.scalar_type() && t.device() == input.device();
  };
  KV_CHECK(white.dim() == 2 && white.size(0) == b && white.size(1) == c && fits(white), op,
           ": white does not fit input");
  KV_CHECK(colors.dim() == 3 && (colors.size(0) == 1 || colors.size(0) == b) && colors.size(1) == 3 &&
               colors.size(2) > 0 && colors.size(2) <= INT32_MAX && fits(colors),
           op, ": expected colors of shape (B, 3, n) or (1, 3, n), of the dtype and device of input");
  bool const in_double = input.scalar_type() == ScalarType::Double;
  KV_CHECK(in_double || input.scalar_type() == ScalarType::Float, op, ": no kernel for this dtype");
  Tensor const x = as_layout(input, Layout::planar);
  Tensor const whites = dense(white), table = dense(colors), y = empty({b, 3 * c, h, w}, x);
  auto const run = [&]<class T>(Type<T>) {
    Colormap<T> const p{planes<T const>(x, Layout::planar),
                        planes<T>(y, Layout::planar),
                        static_cast<T const*>(whites.const_data_ptr()),
                        static_cast<T const*>(table.const_data_ptr()),
                        int(colors.size(2)),
                        colors.size(0) == 1 ? 0 : 3 * colors.size(2),
                        c};
    KV_RUN(apply_colormap, x, p, p.x.rows(), 4 * w);
  };
  in_double ? run(Type<double>{}) : run(Type<float>{});
  return y;
}

}  // namespace

KV_OPERATOR(apply_colormap, "(Tensor input, Tensor white, Tensor colors) -> Tensor")

}  // namespace kv::color
