// Sobel on the CPU: rows [begin, end) of all planes in order. Compiled once per instruction set.
#include "core/lanes.h"
#include "core/scratch.h"
#include "core/stream.h"
#include "sobel.h"

namespace kv::filters::KV_ISA {
namespace {

template <int N, class T>
KV_HD SobelColumn<Lanes<Compute<T>, N>> column(T const* a, T const* b, T const* c) {
  return sobel_column(load<N>(a), load<N>(b), load<N>(c));
}

// Calls pixel(width, element, left neighbor, right neighbor) over a row with the replicate border.
template <class T, class F>
KV_HD void for_each_pixel(int64_t size, int64_t step, F pixel) {
  for (int64_t e = 0; e < step; ++e) pixel(Width<1>{}, e, e, e + step < size ? e + step : e);
  for_each_vector<T>(step, size - step, [&](auto width, int64_t e) { pixel(width, e, e - step, e + step); });
  for (int64_t e = max(step, size - step); e < size; ++e) pixel(Width<1>{}, e, e - step, e);
}

}  // namespace

template <class T>
void sobel(Sobel<T> const& p, int64_t begin, int64_t end) {
  for (int64_t r = begin; r < end; ++r) {
    int64_t const plane = r / p.x.height, y = r % p.x.height;
    T const* const b = p.x.row(plane, y);
    T const* const a = y > 0 ? b - p.x.row_stride : b;
    T const* const c = y + 1 < p.x.height ? b + p.x.row_stride : b;
    T* const out = p.y.row(plane, y);
    for_each_pixel<T>(p.x.row_size(), p.x.step, [&](auto width, int64_t e, int64_t left, int64_t right) {
      constexpr int N = decltype(width)::value;
      auto const at = [&](int64_t i) { return column<N>(a + i, b + i, c + i); };
      Lanes<Compute<T>, N> gx, gy;
      sobel_gradients(at(left), at(e), at(right), p.scale, gx, gy);
      store<N>(out + e, vsqrt(gx * gx + gy * gy + p.eps));
    });
  }
}

// Streams down the rows. u = g gx / magnitude and v = g gy / magnitude of a row are stored in a padded row whose ends
// are extended as sobel.h says; their contributions to the rows around are stored in a ring of three.
template <class T>
void sobel_backward(SobelBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const step = p.x.step, size = p.x.row_size(), height = p.x.height, padded = size + 2 * step;
  Scratch<F> scratch(2 * padded + 6 * size);
  F* const u = scratch.data + step;
  F* const v = u + padded;
  auto const across = [&](int64_t y) { return scratch.data + 2 * padded + (y + 3) % 3 * size; };
  auto const along = [&](int64_t y) { return across(y) + 3 * size; };

  auto const fill = [&](int64_t plane, int64_t y) {  // row y, which may be one row out of bounds
    int64_t const source = clamp(y, int64_t(0), height - 1);
    T const* const b = p.x.row(plane, source);
    T const* const a = source > 0 ? b - p.x.row_stride : b;
    T const* const c = source + 1 < height ? b + p.x.row_stride : b;
    T const* const g = p.grad.row(plane, source);
    F const sign = y == source ? F(1) : F(-1);
    for_each_pixel<T>(size, step, [&](auto width, int64_t e, int64_t left, int64_t right) {
      constexpr int N = decltype(width)::value;
      auto const at = [&](int64_t i) { return column<N>(a + i, b + i, c + i); };
      Lanes<F, N> gx, gy;
      sobel_gradients(at(left), at(e), at(right), p.scale, gx, gy);
      Lanes<F, N> const magnitude = vsqrt(gx * gx + gy * gy + p.eps);
      Lanes<F, N> const s = magnitude > 0 ? load<N>(g + e) / magnitude : Lanes<F, N>{};
      store<N>(u + e, gx * s);
      store<N>(v + e, gy * s * sign);
    });
    for (int64_t e = 0; e < step; ++e) {
      u[e - step] = -u[e];
      v[e - step] = v[e];
      u[size + e] = -u[size - step + e];
      v[size + e] = v[size - step + e];
    }
    for_each_vector<F>(0, size, [&](auto width, int64_t e) {
      constexpr int N = decltype(width)::value;
      auto const row = sobel_row_vjp(load<N>(u + e - step), load<N>(u + e + step), load<N>(v + e - step),
                                     load<N>(v + e), load<N>(v + e + step));
      store<N>(across(y) + e, row.across);
      store<N>(along(y) + e, row.along);
    });
  };

  stream_rows(begin, end, height, fill, [&](int64_t plane, int64_t y, int64_t) {
    T* const out = p.grad_x.row(plane, y);
    for_each_vector<T>(0, size, [&](auto width, int64_t e) {
      constexpr int N = decltype(width)::value;
      auto const row = [&](int64_t i) { return SobelRow<Lanes<F, N>>{load<N>(across(i) + e), load<N>(along(i) + e)}; };
      store<N>(out + e, sobel_gradients_vjp(row(y - 1), row(y), row(y + 1), p.scale));
    });
  });
}

KV_INSTANTIATE(sobel, Sobel)
KV_INSTANTIATE(sobel_backward, SobelBackward)

}  // namespace kv::filters::KV_ISA
