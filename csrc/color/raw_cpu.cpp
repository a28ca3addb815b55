// Demosaicing on the CPU: a row of all three colors at a time, by vectors in which every other pixel is green. Compiled
// once per instruction set.
#include "core/lanes.h"
#include "raw.h"

namespace kv::color::KV_ISA {
namespace {

// Even lanes of a, odd lanes of b.
template <int N, class V>
KV_HD V every_other(V a, V b) {
  if constexpr (N == 1) {
    return a;
  } else {
    V odd;
    for (int i = 0; i < N; ++i) odd[i] = i % 2;
    return odd == 0 ? a : b;
  }
}

// A pixel and its left and right neighbors.
template <int N, class T, class V>
KV_HD void load_three(T const* row, int64_t left, int64_t at, int64_t right, V (&v)[3]) {
  v[0] = load<N>(row + left);
  v[1] = load<N>(row + at);
  v[2] = load<N>(row + right);
}

}  // namespace

template <class T>
void raw_to_rgb(RawToRgb<T> const& p, int64_t begin, int64_t end) {
  int64_t const height = p.raw.height, width = p.raw.width;
  for (int64_t r = begin; r < end; ++r) {
    int64_t const b = r / height, y = r % height;
    T const* const above = p.raw.row(b, reflected(y - 1, height));
    T const* const center = p.raw.row(b, y);
    T const* const below = p.raw.row(b, reflected(y + 1, height));
    int const row_color = p.row_color(y), phase = p.phase(y), planes[] = {row_color, 1, 2 - row_color};
    auto const pixels = [&](auto n, int64_t x, int64_t left, int64_t right) {
      constexpr int N = decltype(n)::value;
      Lanes<Compute<T>, N> v[3][3];
      load_three<N>(above, left, x, right, v[0]);
      load_three<N>(center, left, x, right, v[1]);
      load_three<N>(below, left, x, right, v[2]);
      Demosaic const d(v[0], v[1], v[2]);
      bool const starts_with_row_color = x % 2 == phase;
      for (int k = 0; k < 3; ++k)
        store<N>(p.rgb.row(3 * b + planes[k], y) + x, starts_with_row_color
                                                          ? every_other<N>(d.at_row_color[k], d.at_green[k])
                                                          : every_other<N>(d.at_green[k], d.at_row_color[k]));
    };
    pixels(Width<1>{}, 0, 1, 1);
    for_each_vector<T>(1, width - 1, [&](auto n, int64_t x) { pixels(n, x, x - 1, x + 1); });
    pixels(Width<1>{}, width - 1, width - 2, width - 2);
  }
}

template <class T>
void raw_to_rgb_backward(RawToRgbBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const height = p.grad.height, width = p.grad.width;
  for (int64_t r = begin; r < end; ++r) {
    int64_t const b = r / height, y = r % height;
    F const up = F(reader_count(y - 1, height)), down = F(reader_count(y + 1, height));
    int const phase = p.forward.phase(y);
    auto const rows_of = [&](int channel, T const*(&rows)[3]) {
      for (int k = 0; k < 3; ++k) rows[k] = p.grad.row(3 * b + channel, clamp(y + k - 1, int64_t(0), height - 1));
    };
    T const *row_color[3], *green[3];
    rows_of(p.forward.row_color(y), row_color);
    rows_of(1, green);
    T* const grad_raw = p.grad_raw.row(b, y);
    auto const pixels = [&](auto n, int64_t x, F left, F right) {
      constexpr int N = decltype(n)::value;
      auto const gradient = [&](bool has_row_color, T const* const(&rows)[3]) {
        Lanes<F, N> v[3][3];
        for (int k = 0; k < 3; ++k) load_three<N>(rows[k], left > 0 ? x - 1 : x, x, right > 0 ? x + 1 : x, v[k]);
        return demosaic_vjp(has_row_color, v[0], v[1], v[2], up, down, left, right);
      };
      bool const starts_with_row_color = x % 2 == phase;
      if constexpr (N == 1)
        store<1>(grad_raw + x, gradient(starts_with_row_color, starts_with_row_color ? row_color : green));
      else
        store<N>(grad_raw + x, starts_with_row_color
                                   ? every_other<N>(gradient(true, row_color), gradient(false, green))
                                   : every_other<N>(gradient(false, green), gradient(true, row_color)));
    };
    auto const border_pixel = [&](int64_t x) {
      pixels(Width<1>{}, x, F(reader_count(x - 1, width)), F(reader_count(x + 1, width)));
    };
    for (int64_t x = 0; x < 2; ++x) border_pixel(x);
    if (width > 4) for_each_vector<T>(2, width - 2, [&](auto n, int64_t x) { pixels(n, x, F(1), F(1)); });
    for (int64_t x = max(int64_t(2), width - 2); x < width; ++x) border_pixel(x);
  }
}

KV_INSTANTIATE_WITH_BYTES(raw_to_rgb, RawToRgb)
KV_INSTANTIATE(raw_to_rgb_backward, RawToRgbBackward)

}  // namespace kv::color::KV_ISA
