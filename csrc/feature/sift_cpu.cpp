// SIFT descriptors of patches [begin, end) on the CPU. Compiled once per instruction set.
#include "patch_gradient_cpu.h"
#include "sift.h"

namespace kv::feature::KV_ISA {
namespace {

// Vectors of four: there are as many cells along an axis.
constexpr int kUsualCells = 4;

// Histograms of a row, for pixels that take turns: adding to a sum waits for the sum before.
constexpr int kTurns = 4;

template <class F>
KV_HD void add_scaled(F* to, F const* from, F scale, int size) {
  int i = 0;
  for (; i + 4 <= size; i += 4) store<4>(to + i, load<4>(to + i) + load<4>(from + i) * scale);
  for (; i < size; ++i) to[i] += from[i] * scale;
}
template <class F>
KV_HD F dot(F const* a, F const* b, int size) {
  Lanes<F, 4> sums{};
  F sum = 0;
  int i = 0;
  for (; i + 4 <= size; i += 4) sums += load<4>(a + i) * load<4>(b + i);
  for (; i < size; ++i) sum += a[i] * b[i];
  return sum + ((sums[0] + sums[1]) + (sums[2] + sums[3]));
}

// The working memory of a patch, and what both passes do with it.
template <class F>
struct SiftPatch {
  SiftGrid const& grid;
  F* pooling;  // (cells, n)
  PaddedPatch<F> patch;
  F *magnitudes, *angles;  // of a row
  VotesOfRow<F> votes;
  F* row;      // kTurns x (bins, cells): the votes of a row, or what their gradients are
  F* h;        // (cells, bins, cells)
  int planes;  // bins * cells

  static KV_HD int64_t size(SiftGrid const& g) {
    return int64_t(g.cells) * g.n + PaddedPatch<F>::size(g.n) + 5 * g.n + kTurns * g.bins * g.cells + g.size();
  }
  KV_HD SiftPatch(SiftGrid const& g, F* memory) : grid(g), planes(g.bins * g.cells) {
    pooling = memory;
    patch = {pooling + int64_t(g.cells) * g.n, g.n};
    magnitudes = patch.data + PaddedPatch<F>::size(g.n);
    angles = magnitudes + g.n;
    votes = {angles + g.n, angles + 2 * g.n, angles + 3 * g.n};
    row = angles + 4 * g.n;
    h = row + kTurns * planes;
    for (int x = 0; x < g.n; ++x)
      for (int c = 0; c < g.cells; ++c) pooling[x * g.cells + c] = g.template pooling<F>(c, x);
  }

  template <class T>
  KV_HD void fill_row(int y) {
    for_each_gradient<T>(patch, y, central_differences<F>(), [&](auto width, int64_t x, auto g) KV_INLINE {
      constexpr int N = decltype(width)::value;
      auto const polar = to_polar<F, N>(g, F(kSiftEpsilon));
      store<N>(magnitudes + x, polar.magnitude);
      store<N>(angles + x, polar.angle);
    });
  }

  // Adds the votes of a row to its histograms. `Cells` is the number of cells, or 0 for any.
  template <int Cells>
  KV_HD void count_votes() {
    int const cells = Cells ? Cells : grid.cells;
    for (int x = 0; x < grid.n; ++x) {
      F* const to = row + (x % kTurns) * planes;
      int const first = int(votes.first[x]), second = first + 1 == grid.bins ? 0 : first + 1;
      add_scaled(to + first * cells, pooling + x * cells, votes.earlier[x], cells);
      add_scaled(to + second * cells, pooling + x * cells, votes.later[x], cells);
    }
  }

  template <class T>
  KV_HD void fill_histogram(T const* from) {
    patch.read(from);
    for (int i = 0; i < grid.size(); ++i) h[i] = 0;
    for (int y = 0; y < grid.n; ++y) {
      for_each_gradient<T>(patch, y, central_differences<F>(), [&](auto width, int64_t x, auto g) KV_INLINE {
        constexpr int N = decltype(width)::value;
        votes.template set<N>(x, to_polar<F, N>(g, F(kSiftEpsilon)), grid.bins, F(0));
      });
      for (int i = 0; i < kTurns * planes; ++i) row[i] = 0;
      if (grid.cells == kUsualCells)
        count_votes<kUsualCells>();
      else
        count_votes<0>();
      for (int i = 1; i < kTurns; ++i) add_scaled(row, row + i * planes, F(1), planes);
      for (int c = 0; c < grid.cells; ++c) {
        F const weight = pooling[y * grid.cells + c];
        if (weight == 0) continue;
        add_scaled(h + c * planes, row, weight, planes);
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
  Scratch<int> positions(size);
  for (int i = 0; i < size; ++i) positions.data[i] = p.grid.position(i);
  for (int64_t k = begin; k < end; ++k) {
    s.fill_histogram(p.patches + k * p.grid.n * p.grid.n);
    normalize_sift(s.h, p.clip, p.root, Entries<F>{size});
    for (int i = 0; i < size; ++i) store<1>(p.descriptors + k * size + positions.data[i], s.h[i]);
  }
}

template <class T>
void sift_backward(SiftBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int const size = p.grid.size(), n = p.grid.n, cells = p.grid.cells;
  int64_t const padded = PaddedPatch<F>::size(n);
  Scratch<F> scratch(SiftPatch<F>::size(p.grid) + size + 2 * padded);
  SiftPatch<F> s(p.grid, scratch.data);
  F* const g = s.h + size;
  PaddedPatch<F> const u{g + size, n}, v{u.data + padded, n};
  F const per_radian = F(p.grid.bins) / F(2 * kPi);
  for (int64_t k = begin; k < end; ++k) {
    s.fill_histogram(p.patches + k * n * n);
    for (int i = 0; i < size; ++i) g[i] = load<1>(p.grad + k * size + p.grid.position(i));
    normalize_sift_vjp(s.h, g, p.clip, p.root, Entries<F>{size});
    for (int y = 0; y < n; ++y) {
      s.template fill_row<T>(y);
      for (int i = 0; i < s.planes; ++i) s.row[i] = 0;
      for (int c = 0; c < cells; ++c) add_scaled(s.row, g + c * s.planes, s.pooling[y * cells + c], s.planes);
      for (int x = 0; x < n; ++x) {
        auto const vote = angular_vote(s.angles[x], p.grid.bins, F(0));
        F const a = dot(s.row + vote.first * cells, s.pooling + x * cells, cells);
        F const b = dot(s.row + vote.second * cells, s.pooling + x * cells, cells);
        auto const gradient = patch_gradient(central_differences<F>(), neighbors<1>(s.patch, y, x));
        auto const back =
            to_polar_vjp(gradient, s.magnitudes[x], a + vote.t * (b - a), (b - a) * s.magnitudes[x] * per_radian);
        u.row(y)[x] = back.x, v.row(y)[x] = back.y;
      }
    }
    write_patch_gradient(p.grad_patches + k * n * n, central_differences<F>(), u, v);
  }
}

KV_INSTANTIATE(sift, Sift)
KV_INSTANTIATE(sift_backward, SiftBackward)

}  // namespace kv::feature::KV_ISA
