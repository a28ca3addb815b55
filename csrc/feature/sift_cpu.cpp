// SIFT descriptors of patches [begin, end) on the CPU. Compiled once per instruction set.
#include "patch_gradient_cpu.h"
#include "sift.h"

namespace kv::feature::KV_ISA {
namespace {

// The working memory of a patch, and what both passes do with it.
template <class F>
struct SiftPatch {
  SiftGrid const& grid;
  F* pooling;  // (cells, n)
  PaddedPatch<F> patch;
  F *magnitudes, *angles;  // of a row
  F* row;                  // (bins, cells): the votes of a row, or what their gradients are
  F* h;                    // (cells, bins, cells)
  int planes;              // bins * cells

  static KV_HD int64_t size(SiftGrid const& g) {
    return int64_t(g.cells) * g.n + PaddedPatch<F>::size(g.n) + 2 * g.n + g.bins * g.cells + g.size();
  }
  KV_HD SiftPatch(SiftGrid const& g, F* memory) : grid(g), planes(g.bins * g.cells) {
    pooling = memory;
    patch = {pooling + int64_t(g.cells) * g.n, g.n};
    magnitudes = patch.data + PaddedPatch<F>::size(g.n);
    angles = magnitudes + g.n;
    row = angles + g.n;
    h = row + planes;
    for (int c = 0; c < g.cells; ++c)
      for (int x = 0; x < g.n; ++x) pooling[c * g.n + x] = g.template pooling<F>(c, x);
  }

  template <class T>
  KV_HD void fill_row(int y) {
    for_each_gradient<T>(patch, y, central_differences<F>(), [&](auto width, int64_t x, auto g) {
      constexpr int N = decltype(width)::value;
      auto const polar = to_polar<F, N>(g, F(kSiftEpsilon));
      store<N>(magnitudes + x, polar.magnitude);
      store<N>(angles + x, polar.angle);
    });
  }

  // Calls f(x, vote, cell, weight) for all pixels of a row and the cells that they belong to.
  template <class Call>
  KV_HD void for_each_vote(Call f) {
    for (int c = 0; c < grid.cells; ++c)
      for (int x = grid.first(c); x < grid.end(c); ++x)
        f(x, angular_vote(angles[x], grid.bins, F(0)), c, pooling[c * grid.n + x]);
  }

  template <class T>
  KV_HD void fill_histogram(T const* from) {
    patch.read(from);
    for (int i = 0; i < grid.size(); ++i) h[i] = 0;
    for (int y = 0; y < grid.n; ++y) {
      fill_row<T>(y);
      for (int i = 0; i < planes; ++i) row[i] = 0;
      for_each_vote([&](int x, AngularVote<F> vote, int c, F weight) KV_INLINE {
        F const m = magnitudes[x] * weight;
        row[vote.first * grid.cells + c] += m * (1 - vote.t);
        row[vote.second * grid.cells + c] += m * vote.t;
      });
      for (int c = 0; c < grid.cells; ++c) {
        F const weight = pooling[c * grid.n + y];
        if (weight == 0) continue;
        for_each_vector<F>(0, planes / kLanes<F> * kLanes<F>, [&](auto width, int64_t i) {
          constexpr int N = decltype(width)::value;
          F* const to = h + c * planes + i;
          store<N>(to, load<N>(to) + load<N>(row + i) * weight);
        });
        for (int i = planes / kLanes<F> * kLanes<F>; i < planes; ++i) h[c * planes + i] += row[i] * weight;
      }
    }
  }
};

// The entries of a descriptor for normalize_sift.
template <class F>
struct Entries {
  int size;
  template <class Call>
  KV_HD void each(Call f) const {
    for (int i = 0; i < size; ++i) f(i);
  }
  template <class Call>
  KV_HD F sum(Call f) const {
    F total = 0;
    for (int i = 0; i < size; ++i) total += f(i);
    return total;
  }
};

}  // namespace

template <class T>
void sift(Sift<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int const size = p.grid.size();
  Scratch<F> scratch(SiftPatch<F>::size(p.grid));
  SiftPatch<F> s(p.grid, scratch.data);
  for (int64_t k = begin; k < end; ++k) {
    s.fill_histogram(p.patches + k * p.grid.n * p.grid.n);
    normalize_sift(s.h, p.clip, p.root, Entries<F>{size});
    for (int i = 0; i < size; ++i) store<1>(p.descriptors + k * size + p.grid.position(i), s.h[i]);
  }
}

template <class T>
void sift_backward(SiftBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int const size = p.grid.size(), n = p.grid.n, cells = p.grid.cells;
  int64_t const padded = PaddedPatch<F>::size(n);
  Scratch<F> scratch(SiftPatch<F>::size(p.grid) + size + 2 * padded + 2 * n);
  SiftPatch<F> s(p.grid, scratch.data);
  F* const g = s.h + size;
  PaddedPatch<F> const u{g + size, n}, v{u.data + padded, n};
  F *const grad_magnitudes = v.data + padded, *const grad_angles = grad_magnitudes + n;
  F const per_radian = F(p.grid.bins) / F(2 * kPi);
  for (int64_t k = begin; k < end; ++k) {
    s.fill_histogram(p.patches + k * n * n);
    for (int i = 0; i < size; ++i) g[i] = load<1>(p.grad + k * size + p.grid.position(i));
    normalize_sift_vjp(s.h, g, p.clip, p.root, Entries<F>{size});
    for (int y = 0; y < n; ++y) {
      s.template fill_row<T>(y);
      for (int i = 0; i < s.planes; ++i) {
        s.row[i] = 0;
        for (int c = 0; c < cells; ++c) s.row[i] += s.pooling[c * n + y] * g[c * s.planes + i];
      }
      for (int x = 0; x < n; ++x) grad_magnitudes[x] = grad_angles[x] = 0;
      s.for_each_vote([&](int x, AngularVote<F> vote, int c, F weight) KV_INLINE {
        F const a = s.row[vote.first * cells + c], b = s.row[vote.second * cells + c];
        grad_magnitudes[x] += weight * (a + vote.t * (b - a));
        grad_angles[x] += weight * (b - a);
      });
      for (int x = 0; x < n; ++x) {
        auto const gradient = patch_gradient(central_differences<F>(), neighbors<1>(s.patch, y, x));
        auto const back =
            to_polar_vjp(gradient, s.magnitudes[x], grad_magnitudes[x], grad_angles[x] * s.magnitudes[x] * per_radian);
        u.row(y)[x] = back.x, v.row(y)[x] = back.y;
      }
    }
    write_patch_gradient(p.grad_patches + k * n * n, central_differences<F>(), u, v);
  }
}

KV_INSTANTIATE(sift, Sift)
KV_INSTANTIATE(sift_backward, SiftBackward)

}  // namespace kv::feature::KV_ISA
