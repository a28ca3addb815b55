// Demosaicing on the CPU: a row of all three colours at a time, vectors of which every other pixel is green. Compiled
// once per instruction set.
#include "core/lanes.h"
#include "raw.h"

namespace kv::KV_ISA {
namespace {

// Every other lane from a, beginning with the first, the others from b.
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

// The pixel at `at` and those beside it.
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
    T const* const above = p.raw.row(b, mirrored(y - 1, height));
    T const* const beside = p.raw.row(b, y);
    T const* const below = p.raw.row(b, mirrored(y + 1, height));
    int const own = p.own(y), phase = p.phase(y), planes[] = {own, 1, 2 - own};
    auto const pixels = [&](auto n, int64_t x, int64_t left, int64_t right) {
      constexpr int N = decltype(n)::value;
      Lanes<Compute<T>, N> v[3][3];
      load_three<N>(above, left, x, right, v[0]);
      load_three<N>(beside, left, x, right, v[1]);
      load_three<N>(below, left, x, right, v[2]);
      Demosaiced const d(v[0], v[1], v[2]);
      bool const begins = x % 2 == phase;
      for (int k = 0; k < 3; ++k)
        store<N>(p.rgb.row(3 * b + planes[k], y) + x,
                 begins ? every_other<N>(d.at_own[k], d.at_green[k]) : every_other<N>(d.at_green[k], d.at_own[k]));
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
    F const up = F(times(y - 1, height)), down = F(times(y + 1, height));
    int const phase = p.forward.phase(y);
    auto const rows_of = [&](int channel, T const*(&rows)[3]) {
      for (int k = 0; k < 3; ++k) rows[k] = p.grad.row(3 * b + channel, clamp(y + k - 1, int64_t(0), height - 1));
    };
    T const *own[3], *green[3];
    rows_of(p.forward.own(y), own);
    rows_of(1, green);
    T* const to = p.grad_raw.row(b, y);
    auto const pixels = [&](auto n, int64_t x, F left, F right) {
      constexpr int N = decltype(n)::value;
      auto const of = [&](bool is_own, T const* const(&rows)[3]) {
        Lanes<F, N> v[3][3];
        for (int k = 0; k < 3; ++k) load_three<N>(rows[k], left > 0 ? x - 1 : x, x, right > 0 ? x + 1 : x, v[k]);
        return gathered(is_own, v[0], v[1], v[2], up, down, left, right);
      };
      bool const begins = x % 2 == phase;
      if constexpr (N == 1)
        store<1>(to + x, of(begins, begins ? own : green));
      else
        store<N>(to + x, begins ? every_other<N>(of(true, own), of(false, green))
                                : every_other<N>(of(false, green), of(true, own)));
    };
    auto const at_the_rim = [&](int64_t x) { pixels(Width<1>{}, x, F(times(x - 1, width)), F(times(x + 1, width))); };
    for (int64_t x = 0; x < 2; ++x) at_the_rim(x);
    if (width > 4) for_each_vector<T>(2, width - 2, [&](auto n, int64_t x) { pixels(n, x, F(1), F(1)); });
    for (int64_t x = max(int64_t(2), width - 2); x < width; ++x) at_the_rim(x);
  }
}

KV_INSTANTIATE_WITH_BYTES(raw_to_rgb, RawToRgb)
KV_INSTANTIATE(raw_to_rgb_backward, RawToRgbBackward)

}  // namespace kv::KV_ISA
