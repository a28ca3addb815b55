// SIFT descriptors of patches [begin, end) on the CPU. Compiled once per instruction set.
#include "patch_gradient_cpu.h"
#include "sift.h"

namespace kv::feature::KV_ISA {
namespace {

// Vectors of four: there are as many cells along an axis.
constexpr int kUsualCells = 4;

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

// The working memory of a patch, and what both passes do with it. Rows of pixels end with whole vectors.
template <class F>
struct SiftPatch {
  static constexpr int N = kLanes<F>;
  using V = Lanes<F, N>;
  SiftGrid const& grid;
  int planes, width;  // bins * cells, the pixels of a row
  F* pooling;         // (n, cells)
  PaddedPatch<F> patch;
  F *magnitudes, *angles;  // of a row
  VotesOfPixels<F> votes;  // (n, width)
  F* columns;              // (cells, bins, width): the votes of columns of pixels for the cells along y
  F* row;                  // (bins, cells): the gradient of the votes of a row
  F* h;                    // (cells, bins, cells)

  static KV_HD int64_t size(SiftGrid const& g) {
    int64_t const width = whole_vectors<F>(g.n);
    return PaddedPatch<F>::size(g.n) + int64_t(g.n) * g.cells + width * (2 + 3 * g.n + g.bins * g.cells) +
           g.bins * g.cells + g.size();
  }
  KV_HD SiftPatch(SiftGrid const& g, F* memory)
      : grid(g),
        planes(g.bins * g.cells),
        width(whole_vectors<F>(g.n)),
        pooling(memory),
        patch(pooling + int64_t(g.n) * g.cells, g.n) {
    int64_t const pixels = int64_t(g.n) * width;
    magnitudes = patch.data + PaddedPatch<F>::size(g.n), angles = magnitudes + width;
    votes = {angles + width, angles + width + pixels, angles + width + 2 * pixels};
    columns = votes.later + pixels;
    row = columns + int64_t(planes) * width, h = row + planes;
    for (int x = 0; x < g.n; ++x)
      for (int c = 0; c < g.cells; ++c) pooling[x * g.cells + c] = g.template pooling<F>(c, x);
    patch.clear();
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

  // The votes of columns for the bins [begin, begin + Bins) of the row `cell` of cells. A vector of pixels adds to all
  // of these bins, 0 to most, in registers: in memory a sum would wait for the store of the sum before.
  template <int Bins>
  KV_HD void sum_columns(int cell, int begin) {
    V const none{};
    int const first_row = grid.first(cell), end_row = grid.end(cell), bin_before = (begin == 0 ? grid.bins : begin) - 1;
    for (int x = 0; x < width; x += N) {
      V sums[Bins] = {};
      for (int y = first_row; y < end_row; ++y) {
        F const weight = pooling[y * grid.cells + cell];
        int64_t const pixel = int64_t(y) * width + x;
        V const first = load<N>(votes.first + pixel);
        V const earlier = load<N>(votes.earlier + pixel) * weight, later = load<N>(votes.later + pixel) * weight;
        V before = first == F(bin_before) ? later : none;  // the votes of pixels whose first bin is the one before
        for (int a = 0; a < Bins; ++a) {
          auto const is_first = first == F(begin + a);
          sums[a] += is_first ? earlier : before;
          before = is_first ? later : none;
        }
      }
      for (int a = 0; a < Bins; ++a) store<N>(columns + (int64_t(cell) * grid.bins + begin + a) * width + x, sums[a]);
    }
  }

  // The votes of columns for the cells along x, of Rows rows of `columns` and of h.
  template <int Rows>
  KV_HD void pool_columns(int begin) {
    F const* const from = columns + int64_t(begin) * width;
    F* const to = h + int64_t(begin) * grid.cells;
    if (grid.cells == kUsualCells) {
      Lanes<F, kUsualCells> sums[Rows] = {};
      for (int x = 0; x < grid.n; ++x)
        for (int i = 0; i < Rows; ++i) sums[i] += load<kUsualCells>(pooling + x * kUsualCells) * from[i * width + x];
      for (int i = 0; i < Rows; ++i) store<kUsualCells>(to + i * kUsualCells, sums[i]);
    } else {
      for (int i = 0; i < Rows * grid.cells; ++i) to[i] = 0;
      for (int i = 0; i < Rows; ++i)
        for (int x = 0; x < grid.n; ++x)
          add_scaled(to + i * grid.cells, pooling + x * grid.cells, from[i * width + x], grid.cells);
    }
  }

  template <class T>
  KV_HD void fill_histogram(T const* from) {
    patch.read(from);
    for (int y = 0; y < grid.n; ++y)
      for (int x = 0; x < width; x += N) {
        auto const g = patch_gradient(central_differences<F>(), neighbors<N>(patch, y, x));
        votes.template set<N>(int64_t(y) * width + x, to_polar<F, N>(g, F(kSiftEpsilon)), grid.bins, F(0));
      }
    for (int c = 0; c < grid.cells; ++c) {
      int a = 0;
      for (; a + 8 <= grid.bins; a += 8) sum_columns<8>(c, a);
      for (; a < grid.bins; ++a) sum_columns<1>(c, a);
    }
    int i = 0;
    for (; i + 4 <= planes; i += 4) pool_columns<4>(i);
    for (; i < planes; ++i) pool_columns<1>(i);
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
    constexpr int N = kLanes<F>;
    F sums[N] = {}, total = 0;
    int i = 0;
    for (; i + N <= size; i += N)
      for (int k = 0; k < N; ++k) sums[k] += f(i + k);
    for (; i < size; ++i) total += f(i);
    for (int k = 0; k < N; ++k) total += sums[k];
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
  PaddedPatch<F> const u(g + size, n), v(u.data + padded, n);
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
