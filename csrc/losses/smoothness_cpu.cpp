// Smoothness of inverse depth on the CPU: rows [begin, end) of the depth maps. Compiled once per instruction set.
#include "core/lanes.h"
#include "core/scratch.h"
#include "smoothness.h"

namespace kv::losses::KV_ISA {
namespace {

// For e < n sets to[e] to the smoothness term of pixel e of row y and the pixel `right` columns and `down` rows from
// it. With `signs`, the sign of the depth's difference replaces its absolute value.
template <class T>
KV_HD void find_edges(DepthAndImage<T> const& p, int64_t sample, int64_t y, int64_t right, int64_t down, int64_t n,
                      Compute<T> weight, bool signs, Compute<T>* to) {
  using F = Compute<T>;
  T const *const d = p.depth.row(sample, y), *const image = p.image.row(sample * p.channels, y);
  int64_t const next = down * p.depth.row_stride + right, step = p.channel_stride();
  int64_t const next_of_image = down * p.image.row_stride + right;
  for_each_vector<T>(0, n, [&](auto width, int64_t e) {
    constexpr int N = decltype(width)::value;
    using V = Lanes<F, N>;
    V apart{};
    for (int64_t c = 0; c < p.channels; ++c) {
      T const* const at = image + c * step + e;
      apart += vabs(V(load<N>(at + next_of_image) - load<N>(at)));
    }
    V const difference = load<N>(d + e + next) - load<N>(d + e);
    V const edge = signs ? V(sign_of(difference)) : V(vabs(difference));
    store<N>(to + e, V(edge * vexp2<F, N>(V(apart * p.exponent())) * weight));
  });
}

template <class F>
KV_HD F sum_of(F const* row, int64_t n) {
  constexpr int N = kLanes<F>;
  Lanes<F, N> sums{};
  F sum = 0;
  int64_t e = 0;
  for (; e + N <= n; e += N) sums += load<N>(row + e);
  for (; e < n; ++e) sum += row[e];
  for (int l = 0; l < N; ++l) sum += sums[l];
  return sum;
}

template <class F>
KV_HD void clear(F* row, int64_t n) {
  for (int64_t e = 0; e < n; ++e) row[e] = 0;
}

}  // namespace

template <class T>
void smoothness(Smoothness<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  DepthAndImage<T> const& of = p.of;
  int64_t const height = of.depth.height, width = of.depth.width;
  Scratch<F> row(width);
  for (int64_t r = begin; r < end; ++r) {
    int64_t const sample = r / height, y = r % height;
    find_edges(of, sample, y, 1, 0, width - 1, of.along_x, false, row.data);
    F sum = sum_of(row.data, width - 1);
    if (y + 1 < height) {
      find_edges(of, sample, y, 0, 1, width, of.along_y, false, row.data);
      sum += sum_of(row.data, width);
    }
    p.partial[r] = sum;
  }
}

template <class T>
void smoothness_backward(SmoothnessBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  DepthAndImage<T> const& of = p.of;
  int64_t const height = of.depth.height, width = of.depth.width;
  bool const signs = !p.of_image;
  // The first and the last edge along x are out of bounds.
  Scratch<F> along_x(width + 1), first(width), second(width);
  F *const x = along_x.data + 1, *up = first.data, *down = second.data;
  x[-1] = x[width - 1] = 0;
  for (int64_t r = begin; r < end; ++r) {
    int64_t const sample = r / height, y = r % height;
    F const g = p.grad[sample], of_y = g * of.along_y;
    if (y == 0)
      clear(up, width);
    else if (r == begin)
      find_edges(of, sample, y - 1, 0, 1, width, of_y, signs, up);
    if (y + 1 == height)
      clear(down, width);
    else
      find_edges(of, sample, y, 0, 1, width, of_y, signs, down);
    find_edges(of, sample, y, 1, 0, width - 1, g * of.along_x, signs, x);

    if (!p.of_image) {
      T* const out = p.out.row(sample, y);
      for_each_vector<T>(0, width, [&](auto n, int64_t e) {
        constexpr int N = decltype(n)::value;
        auto const at = [&](F const* row) { return load<N>(row + e); };
        store<N>(out + e, Lanes<F, N>((at(x - 1) - at(x)) + (at(up) - at(down))));
      });
    } else {
      for (int64_t c = 0; c < of.channels; ++c) {
        T const* const row = of.image.row(sample * of.channels + c, y);
        T const* const above = y > 0 ? row - of.image.row_stride : row;
        T const* const below = y + 1 < height ? row + of.image.row_stride : row;
        T* const out = p.out.row(sample * of.channels + c, y);
        auto const at = [&](auto n, int64_t e, int64_t left, int64_t right) {
          constexpr int N = decltype(n)::value;
          using V = Lanes<F, N>;
          V const own = load<N>(row + e);
          auto const part = [&](F const* edge, T const* other) {
            return part_of(V(load<N>(edge)), V(load<N>(other) - own));
          };
          V const of_x = part(x + e - 1, row + left) + part(x + e, row + right);
          V const of_y = part(up + e, above + e) + part(down + e, below + e);
          store<N>(out + e, V((of_x + of_y) / F(of.channels)));
        };
        at(Width<1>{}, 0, 0, width > 1 ? 1 : 0);
        for_each_vector<T>(1, width - 1, [&](auto n, int64_t e) { at(n, e, e - 1, e + 1); });
        if (width > 1) at(Width<1>{}, width - 1, width - 2, width - 1);
      }
    }
    F* const last = up;
    up = down, down = last;
  }
}

KV_INSTANTIATE(smoothness, Smoothness)
KV_INSTANTIATE(smoothness_backward, SmoothnessBackward)

}  // namespace kv::losses::KV_ISA
