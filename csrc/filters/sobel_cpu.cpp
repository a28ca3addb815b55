// Sobel on the CPU: rows [begin, end) of all planes in order. Compiled once per instruction set.
#include "core/lanes.h"
#include "core/scratch.h"
#include "sobel.h"

namespace kv::KV_ISA {

template <class T>
void sobel(Sobel<T> const& p, int64_t begin, int64_t end) {
  int64_t const step = p.x.step, size = p.x.row_size();
  for (int64_t r = begin; r < end; ++r) {
    int64_t const plane = r / p.x.height, y = r % p.x.height;
    T const* const b = p.x.row(plane, y);
    T const* const a = y > 0 ? b - p.x.row_stride : b;
    T const* const c = y + 1 < p.x.height ? b + p.x.row_stride : b;
    T* const out = p.y.row(plane, y);

    auto const pixel = [&](auto width, int64_t e, int64_t left, int64_t right) {
      constexpr int N = decltype(width)::value;
      Lanes<Compute<T>, N> gx, gy;
      sobel_gradients(load<N>(a + left), load<N>(a + e), load<N>(a + right), load<N>(b + left), load<N>(b + right),
                      load<N>(c + left), load<N>(c + e), load<N>(c + right), p.scale, gx, gy);
      store<N>(out + e, vsqrt(gx * gx + gy * gy + p.eps));
    };
    for (int64_t e = 0; e < step; ++e) pixel(Width<1>{}, e, e, e + step < size ? e + step : e);
    for_each_vector<T>(step, size - step, [&](auto width, int64_t e) { pixel(width, e, e - step, e + step); });
    for (int64_t e = max(step, size - step); e < size; ++e) pixel(Width<1>{}, e, e - step, e);
  }
}

// Streams down the rows. For each it keeps u = g gx / magnitude and v = g gy / magnitude of the rows above, beside and
// below in a ring of three, each row with one pixel more at either end that holds the continuation (see sobel.h).
template <class T>
void sobel_backward(SobelBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const step = p.x.step, size = p.x.row_size(), height = p.x.height, padded = size + 2 * step;
  Scratch<F> scratch(6 * padded);
  auto const ring = [&](int which, int64_t y) { return scratch.data + (which * 3 + (y + 3) % 3) * padded + step; };

  auto const fill = [&](int64_t plane, int64_t y) {  // u and v of row y, which may be one outside the image
    int64_t const inside = clamp(y, int64_t(0), height - 1);
    F* const u = ring(0, y);
    F* const v = ring(1, y);
    T const* const b = p.x.row(plane, inside);
    T const* const a = inside > 0 ? b - p.x.row_stride : b;
    T const* const c = inside + 1 < height ? b + p.x.row_stride : b;
    T const* const g = p.grad.row(plane, inside);
    F const odd = y == inside ? F(1) : F(-1);
    auto const pixel = [&](auto width, int64_t e, int64_t left, int64_t right) {
      constexpr int N = decltype(width)::value;
      Lanes<F, N> gx, gy;
      sobel_gradients(load<N>(a + left), load<N>(a + e), load<N>(a + right), load<N>(b + left), load<N>(b + right),
                      load<N>(c + left), load<N>(c + e), load<N>(c + right), p.scale, gx, gy);
      Lanes<F, N> const s = sobel_magnitude_vjp<Lanes<F, N>>(load<N>(g + e), vsqrt(gx * gx + gy * gy + p.eps));
      store<N>(u + e, Lanes<F, N>(gx * s));
      store<N>(v + e, Lanes<F, N>(gy * s * odd));
    };
    for (int64_t e = 0; e < step; ++e) pixel(Width<1>{}, e, e, e + step < size ? e + step : e);
    for_each_vector<T>(step, size - step, [&](auto width, int64_t e) { pixel(width, e, e - step, e + step); });
    for (int64_t e = max(step, size - step); e < size; ++e) pixel(Width<1>{}, e, e - step, e);
    for (int64_t e = 0; e < step; ++e) {
      u[e - step] = -u[e];
      v[e - step] = v[e];
      u[size + e] = -u[size - step + e];
      v[size + e] = v[size - step + e];
    }
  };

  for (int64_t r = begin; r < end; ++r) {
    int64_t const plane = r / height, y = r % height;
    if (r == begin || y == 0) {
      fill(plane, y - 1);
      fill(plane, y);
    }
    fill(plane, y + 1);
    F const *const ua = ring(0, y - 1), *const ub = ring(0, y), *const uc = ring(0, y + 1);
    F const *const va = ring(1, y - 1), *const vc = ring(1, y + 1);
    T* const out = p.grad_x.row(plane, y);
    for_each_vector<T>(0, size, [&](auto width, int64_t e) {
      constexpr int N = decltype(width)::value;
      store<N>(out + e, sobel_gradients_vjp(load<N>(ua + e - step), load<N>(ua + e + step), load<N>(ub + e - step),
                                            load<N>(ub + e + step), load<N>(uc + e - step), load<N>(uc + e + step),
                                            load<N>(va + e - step), load<N>(va + e), load<N>(va + e + step),
                                            load<N>(vc + e - step), load<N>(vc + e), load<N>(vc + e + step), p.scale));
    });
  }
}

KV_INSTANTIATE(sobel, Sobel)
KV_INSTANTIATE(sobel_backward, SobelBackward)

}  // namespace kv::KV_ISA
