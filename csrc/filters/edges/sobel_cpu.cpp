// Sobel on the CPU: rows [begin, end) of all planes in order. Compiled once per instruction set.
#include "core/stream.h"
#include "neighborhoods_cpu.h"
#include "sobel.h"

namespace kv::filters::KV_ISA {
namespace {

// Calls pixel(width, element, gx, gy) over row y of a plane.
template <class T, class F>
KV_HD void for_each_gradient(Neighborhoods<kSobelBorder, T> const& x, int64_t plane, int64_t y, Compute<T> scale,
                             F pixel) {
  x.for_each(plane, y, [&](auto width, int64_t e, auto left, auto middle, auto right) KV_INLINE {
    auto const column = [](auto const& c) { return sobel_column(c.above, c.middle, c.below); };
    Lanes<Compute<T>, decltype(width)::value> gx, gy;
    sobel_gradients(column(left), column(middle), column(right), scale, gx, gy);
    pixel(width, e, gx, gy);
  });
}

}  // namespace

template <class T>
void sobel(Sobel<T> const& p, int64_t begin, int64_t end) {
  Neighborhoods<kSobelBorder, T> const x(p.x);
  for (int64_t r = begin; r < end; ++r) {
    int64_t const plane = r / p.x.height, y = r % p.x.height;
    auto* const out = p.y.row(plane, y);
    for_each_gradient(x, plane, y, p.scale, [&](auto width, int64_t e, auto gx, auto gy) {
      store<decltype(width)::value>(out + e, vsqrt(gx * gx + gy * gy + p.eps));
    });
  }
}

// Streams down the rows, with u = g gx / magnitude and v = g gy / magnitude of each.
template <class T>
void sobel_backward(SobelBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  Neighborhoods<kSobelBorder, T> const x(p.x);
  NeighborhoodsVjp<kSobelBorder, F> const gradients(p.x);
  auto const fill = [&](int64_t plane, int64_t y) {  // row y, which may be one row out of bounds
    if (y < 0 || y >= p.x.height) return;
    T const* const g = p.grad.row(plane, y);
    for_each_gradient(x, plane, y, p.scale, [&](auto width, int64_t e, auto gx, auto gy) {
      constexpr int N = decltype(width)::value;
      Lanes<F, N> const magnitude = vsqrt(gx * gx + gy * gy + p.eps);
      Lanes<F, N> const s = magnitude > 0 ? load<N>(g + e) / magnitude : Lanes<F, N>{};
      store<N>(gradients.u + e, gx * s);
      store<N>(gradients.v + e, gy * s);
    });
    gradients.put(y, [](auto... neighbors) { return sobel_row_vjp(neighbors...); });
  };
  stream_rows(begin, end, p.x.height, fill, [&](int64_t plane, int64_t y, int64_t) {
    gradients.template store_row<SobelRow>(y, p.grad_x.row(plane, y), [&](auto above, auto middle, auto below) {
      return sobel_gradients_vjp(above, middle, below, p.scale);
    });
  });
}

KV_INSTANTIATE_WITH_BYTES(sobel, Sobel)
KV_INSTANTIATE(sobel_backward, SobelBackward)

}  // namespace kv::filters::KV_ISA
