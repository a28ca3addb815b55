// Sharpness on the CPU: rows [begin, end), counted through all planes. Compiled once per instruction set.
#include "core/lanes.h"
#include "core/scratch.h"
#include "core/stream.h"
#include "sharpness.h"

namespace kv::enhance::KV_ISA {
namespace {

// Calls pixel(width, x) for the inner pixels of a row, in vectors where they are contiguous.
template <class T, class F>
KV_HD void for_each_inner(int64_t width, int64_t step, F pixel) {
  if (step == 1) return for_each_vector<T>(1, max(width - 1, int64_t(1)), pixel);
  for (int64_t x = 1; x + 1 < width; ++x) pixel(Width<1>{}, x);
}

// The sum of the 3x3 neighborhood of an element.
template <int N, class T>
KV_HD auto sum_of_nine(T const* above, T const* center, T const* below, int64_t e, int64_t step) {
  auto const column = [&](int64_t i) { return load<N>(above + i) + load<N>(center + i) + load<N>(below + i); };
  return Lanes<Compute<T>, N>(column(e - step) + column(e) + column(e + step));
}

}  // namespace

template <class T>
void sharpness(Sharpness<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const height = p.x.height, width = p.x.width, step = p.x.step;
  for (int64_t r = begin; r < end; ++r) {
    int64_t const plane = r / height, y = r % height;
    bool const inner = y > 0 && y + 1 < height;
    T const* const x = p.x.row(plane, y);
    T* const to = p.y.row(plane, y);
    F const factor = p.factor.of(plane);
    constexpr F white = __is_same(T, uint8_t) ? 255 : 1;  // bytes are 255ths
    auto const border = [&](int64_t i) {
      store<1>(to + i * step, clipped(load<1>(x + i * step) * (1 / white), F(0)) * white);
    };
    border(0);
    border(width - 1);
    for_each_inner<T>(width, step, [&](auto n, int64_t i) {
      constexpr int N = decltype(n)::value;
      using V = Lanes<F, N>;
      int64_t const e = i * step;
      V const v = load<N>(x + e) * (1 / white);
      if (!inner) return store<N>(to + e, V(clipped(v, F(0)) * white));
      V const sum = sum_of_nine<N>(x - p.x.row_stride, x, x + p.x.row_stride, e, step) * (1 / white);
      store<N>(to + e, V(sharpened(v, V(smoothed(sum, v, F(0))), factor) * white));
    });
  }
}

template <class T>
void sharpness_list(SharpnessList<T> const& p, int64_t begin, int64_t end) {
  filter_items(p, begin, end, [](Sharpness<T> const& sample, int64_t from, int64_t to) {
    if (sample.x.step == 1) return sharpness(sample, from, to);
    Sharpness<T> const one = by_channels(sample);
    for (int64_t first = 0; first < one.x.rows(); first += one.x.height) sharpness(one, first + from, first + to);
  });
}

// Traverses the rows and keeps the contributions of three: to their pixels, to the neighbors of these, and to the
// factor.
template <class T>
void sharpness_backward(SharpnessBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const height = p.x.height, width = p.x.width, step = p.x.step, padded = width + 2;
  Scratch<F> scratch(7 * padded);
  auto const own = [&](int64_t y) { return scratch.data + (y + 3) % 3 * padded + 1; };
  auto const around = [&](int64_t y) { return own(y) + 3 * padded; };
  F* const gradients = scratch.data + 6 * padded;
  F gradient_of[3]{};

  auto const fill = [&](int64_t plane, int64_t y) {  // row y, possibly out of bounds
    F *const to_own = own(y), *const to_around = around(y);
    for_each_vector<F>(-1, width + 1, [&](auto n, int64_t i) {
      constexpr int N = decltype(n)::value;
      store<N>(to_around + i, Lanes<F, N>{});
    });
    gradient_of[(y + 3) % 3] = 0;
    if (y < 0 || y >= height) return;
    T const *const x = p.x.row(plane, y), *const g = p.grad.row(plane, y);
    F const factor = p.factor.of(plane);
    auto const border = [&](auto n, int64_t i) {
      constexpr int N = decltype(n)::value;
      using V = Lanes<F, N>;
      store<N>(to_own + i, clipped_vjp(V(load<N>(x + i * step)), V(load<N>(g + i * step)), F(0)));
    };
    border(Width<1>{}, 0);
    border(Width<1>{}, width - 1);
    if (y == 0 || y + 1 == height) return for_each_inner<T>(width, step, border);
    for_each_inner<T>(width, step, [&](auto n, int64_t i) {
      constexpr int N = decltype(n)::value;
      using V = Lanes<F, N>;
      int64_t const e = i * step;
      V const v = load<N>(x + e), sum = sum_of_nine<N>(x - p.x.row_stride, x, x + p.x.row_stride, e, step);
      auto const of = sharpened_vjp(v, V(smoothed(sum, v, F(0))), V(load<N>(g + e)), factor);
      store<N>(to_own + i, of.own);
      store<N>(to_around + i, of.around);
      store<N>(gradients + i, of.factor);
    });
    for (int64_t i = 1; p.gradients && i + 1 < width; ++i) gradient_of[(y + 3) % 3] += gradients[i];
  };

  stream_rows(begin, end, height, fill, [&](int64_t plane, int64_t y, int64_t r) {
    if (p.gradients) p.gradients[r] = gradient_of[y % 3];
    if (!p.grad_x.data) return;
    T* const to = p.grad_x.row(plane, y);
    auto const pixel = [&](auto n, int64_t i) {
      constexpr int N = decltype(n)::value;
      using V = Lanes<F, N>;
      V const sum = sum_of_nine<N>(around(y - 1), around(y), around(y + 1), i, 1);
      store<N>(to + i * step, V(load<N>(own(y) + i) + smoothed(sum, V(load<N>(around(y) + i)), F(0))));
    };
    if (step == 1)
      for_each_vector<T>(0, width, pixel);
    else
      for (int64_t i = 0; i < width; ++i) pixel(Width<1>{}, i);
  });
}

template <class T>
void sharpness_list_backward(SharpnessBackwardList<T> const& p, int64_t begin, int64_t end) {
  gradient_items(p, begin, end, [](SharpnessBackward<T> const& one, int64_t first, int64_t last) {
    sharpness_backward(one, first, last);
  });
}

KV_INSTANTIATE_WITH_BYTES(sharpness, Sharpness)
KV_INSTANTIATE_WITH_BYTES(sharpness_list, SharpnessList)
KV_INSTANTIATE(sharpness_backward, SharpnessBackward)
KV_INSTANTIATE(sharpness_list_backward, SharpnessBackwardList)

}  // namespace kv::enhance::KV_ISA
