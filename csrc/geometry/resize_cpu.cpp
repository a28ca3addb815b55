// Resizing on the CPU, a row of the result at a time: the rows of its band are added up to one line, of which its
// pixels then are weighted means. The weights along both axes are computed before, once for all planes.
//
// Where the pixels that a vector of the result begins at are near one another, as they are unless an image shrinks a
// lot, one or two loads and a permutation read them, and again for the pixels next to them.
#include "core/lanes.h"
#include "core/scratch.h"
#include "resize.h"

namespace kv::KV_ISA {
namespace {

template <bool value_>
struct Flag {
  static constexpr bool value = value_;
};

template <int N, class V, class Index>
KV_HD V permuted(V a, V b, Index index) {
  if constexpr (N == 1)
    return a;
  else
    return __builtin_shuffle(a, b, index);
}
template <int N, class V, class Index>
KV_HD V permuted(V a, Index index) {
  if constexpr (N == 1)
    return a;
  else
    return __builtin_shuffle(a, index);
}

// The weights of a pixel, `stride` apart. Not inline: they take most of the time to compile.
template <class F>
[[gnu::noinline]] Reads<F> write_weights(F* to, int64_t stride, ResizeAxis const& axis, int64_t index) {
  Reads<F> const reads = reads_of<F>(axis, int(index));
  for (int k = 0; k < reads.count; ++k) to[k * stride] = weight_at(axis, reads, int(index), k);
  return reads;
}

// The weights of `count` rows of the result from row `first` of all planes on.
template <class F>
struct RowBands {
  int64_t height, first;
  int taps;
  Scratch<F> weights;
  Scratch<Reads<F>> reads;

  RowBands(ResizeAxis const& axis, int64_t height, int64_t begin, int64_t count)
      : height(height), first(begin), taps(axis.most), weights(count * taps), reads(count) {
    for (int64_t i = 0; i < count; ++i)
      reads.data[i] = write_weights(weights.data + i * taps, 1, axis, (begin + i) % height);
  }
  // Of row `r` of all planes.
  KV_HD int64_t at(int64_t r) const { return (r - first) % height; }
};

// The weights of a row's elements in groups of N, the last of which overlaps the one before it.
template <class F, int N>
struct ColumnBands {
  using Index = Lanes<typename integer_of<sizeof(F)>::type, N>;
  int64_t size, groups;
  int taps, spread = 0;      // the latter: largest distance within a group
  Scratch<int64_t> from;     // the first element that a group reads
  Scratch<Index> distances;  // from there to the first one that each of its elements reads
  Scratch<Lanes<F, N>> weights;

  ColumnBands(ResizeAxis const& axis, int64_t size, int64_t step)
      : size(size),
        groups((size + N - 1) / N),
        taps(axis.most),
        from(groups),
        distances(groups),
        weights(groups * taps) {
    for (int64_t g = 0; g < groups; ++g) {
      F* const w = reinterpret_cast<F*>(weights.data + g * taps);
      for (int i = 0; i < N * taps; ++i) w[i] = 0;
      int64_t firsts[N], least = INT64_MAX;
      for (int i = 0; i < N; ++i) {
        int64_t const e = start(g) + i, x = e / step;
        firsts[i] = write_weights(w + i, N, axis, x).first * step + e - x * step;
        least = min(least, firsts[i]);
      }
      from.data[g] = least;
      auto* const distance = reinterpret_cast<typename integer_of<sizeof(F)>::type*>(distances.data + g);
      for (int i = 0; i < N; ++i) {
        distance[i] = firsts[i] - least;
        spread = max(spread, int(firsts[i] - least));
      }
    }
  }
  KV_HD int64_t start(int64_t group) const { return min(group * N, size - N); }
};

// A row of the result from its line. Vectors: how many loads hold what a group reads at a time, 0 for more than two.
// Careful: what a tap of weight 0 holds is no part of the value, not even if it is NaN or inf. Whether a number that is
// not careful may be one of these.
template <int Vectors, bool careful, int N, class T, class F>
KV_HD bool write_row(T* out, F const* line, ColumnBands<F, N> const& columns, int64_t step) {
  using V = Lanes<F, N>;
  V check{};
  for (int64_t g = 0; g < columns.groups; ++g) {
    F const* from = line + columns.from.data[g];
    V const* const weights = columns.weights.data + g * columns.taps;
    auto const distance = columns.distances.data[g];
    V sum{};
    for (int k = 0; k < columns.taps; ++k, from += step) {
      V value;
      if constexpr (Vectors == 1) {
        value = permuted<N>(load<N>(from), distance);
      } else if constexpr (Vectors == 2) {
        value = permuted<N>(load<N>(from), load<N>(from + N), distance);
      } else {
        for (int i = 0; i < N; ++i) value[i] = from[distance[i]];
      }
      if constexpr (careful)
        sum += weights[k] != 0 ? value * weights[k] : V{};
      else
        sum += value * weights[k];
    }
    if constexpr (!careful) check += sum - sum;
    store<N>(out + columns.start(g), sum);
  }
  if constexpr (N == 1) {
    return !(check == 0);
  } else {
    F total = 0;
    for (int i = 0; i < N; ++i) total += check[i];
    return !(total == 0);
  }
}

template <int N, class T>
void resize_rows(Resize<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const step = p.x.step, size = p.x.row_size(), height = p.y.height;
  RowBands<F> const rows(p.rows, height, begin, min(height, end - begin));
  ColumnBands<F, N> const columns(p.columns, p.y.row_size(), step);
  int64_t const beyond = columns.taps * step + 2 * N;  // a band may be shorter than most of them are
  Scratch<F> line(size + beyond);
  for (int64_t e = size; e < size + beyond; ++e) line.data[e] = 0;

  auto const write = [&](T* out, auto careful) {
    if (columns.spread < N) return write_row<1, careful.value>(out, line.data, columns, step);
    if constexpr (N > 1) {
      if (columns.spread < 2 * N) return write_row<2, careful.value>(out, line.data, columns, step);
      return write_row<0, careful.value>(out, line.data, columns, step);
    }
    return false;
  };
  for (int64_t r = begin; r < end; ++r) {
    int64_t const plane = r / height, i = rows.at(r);
    Reads<F> const band = rows.reads.data[i];
    F const* const weights = rows.weights.data + i * rows.taps;
    T const* const first = p.x.row(plane, band.first);
    for_each_vector<T>(0, size, [&](auto width, int64_t e) {
      constexpr int M = decltype(width)::value;
      Lanes<F, M> sum{};
      T const* from = first + e;
      for (int k = 0; k < band.count; ++k, from += p.x.row_stride)
        if (weights[k] != 0) sum += load<M>(from) * weights[k];
      store<M>(line.data + e, sum);
    });
    T* const out = p.y.row(plane, r - plane * height);
    if (write(out, Flag<false>{})) write(out, Flag<true>{});
  }
}

}  // namespace

template <class T>
void resize(Resize<T> const& p, int64_t begin, int64_t end) {
  constexpr int N = kLanes<T>;
  if (p.y.row_size() < N)
    resize_rows<1>(p, begin, end);
  else
    resize_rows<N>(p, begin, end);
}

KV_INSTANTIATE_WITH_BYTES(resize, Resize)

}  // namespace kv::KV_ISA
