// Resizing on the CPU, a row of the result at a time. The weighted rows of its band are added up to one line, and its
// pixels are weighted means of that line. The weights along both axes are computed once for all planes.
//
// The first taps of a vector of the result are close together unless the image shrinks a lot. One or two loads and a
// permutation then read them, and likewise the second taps and so on.
#include "core/lanes.h"
#include "core/scratch.h"
#include "geometry/transform/resize.h"

namespace kv::geometry::KV_ISA {
namespace {

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
[[gnu::noinline]] Contributors<F> write_weights(F* to, int64_t stride, ResizeAxis const& axis, int64_t index) {
  Contributors<F> const reads = contributors<F>(axis, int(index));
  for (int k = 0; k < reads.count; ++k) to[k * stride] = weight_at(axis, reads, int(index), k);
  return reads;
}

// The weights of `count` rows of the result from row `first` of all planes on.
template <class F>
struct RowBands {
  int64_t height, first;
  int taps;
  Scratch<F> weights;
  Scratch<Contributors<F>> reads;

  RowBands(ResizeAxis const& axis, int64_t height, int64_t begin, int64_t count)
      : height(height), first(begin), taps(axis.max_taps), weights(count * taps), reads(count) {
    for (int64_t i = 0; i < count; ++i)
      reads.data[i] = write_weights(weights.data + i * taps, 1, axis, (begin + i) % height);
  }
  // Of row `r` of all planes.
  KV_HD int64_t at(int64_t r) const { return (r - first) % height; }
};

// The weights of a row's elements in groups of N, the last of which overlaps the one before it.
template <class F, int N>
struct ColumnBands {
  using Int = typename integer_of<sizeof(F)>::type;
  int64_t size, groups;
  int taps, spread = 0;    // the latter: largest distance within a group
  Scratch<int64_t> from;   // the first element that a group reads
  Scratch<Int> distances;  // from there to the first one that each of its elements reads
  Scratch<F> weights;      // by group, tap and element

  ColumnBands(ResizeAxis const& axis, int64_t size, int64_t step)
      : size(size),
        groups((size + N - 1) / N),
        taps(axis.max_taps),
        from(groups),
        distances(groups * N),
        weights(groups * taps * N) {
    for (int64_t i = 0; i < groups * taps * N; ++i) weights.data[i] = 0;
    for (int64_t g = 0; g < groups; ++g) {
      int64_t firsts[N], lowest = INT64_MAX;
      for (int i = 0; i < N; ++i) {
        int64_t const e = start(g) + i, x = e / step;
        firsts[i] = write_weights(weights.data + g * taps * N + i, N, axis, x).first * step + e - x * step;
        lowest = min(lowest, firsts[i]);
      }
      from.data[g] = lowest;
      for (int i = 0; i < N; ++i) {
        distances.data[g * N + i] = Int(firsts[i] - lowest);
        spread = max(spread, int(firsts[i] - lowest));
      }
    }
  }
  KV_HD int64_t start(int64_t group) const { return min(group * N, size - N); }
};

// A row of the result from its line, or `minuend` minus it. Vectors: how many loads hold what a group reads at a time,
// 0 for more than two. Taps: how many there are, 0 for any number. Says whether all of the row is finite.
template <int Vectors, int Taps, int N, class T, class F>
KV_HD bool write_row(T* out, T const* minuend, F const* line, ColumnBands<F, N> const& columns, int64_t step) {
  using V = Lanes<F, N>;
  int const taps = Taps ? Taps : columns.taps;
  V check{};
  for (int64_t g = 0; g < columns.groups; ++g) {
    F const* from = line + columns.from.data[g];
    F const* weights = columns.weights.data + g * taps * N;
    auto const distance =
        *reinterpret_cast<Lanes<typename ColumnBands<F, N>::Int, N> const*>(columns.distances.data + g * N);
    V sum{};
    for (int k = 0; k < taps; ++k, from += step, weights += N) {
      V value;
      if constexpr (Vectors == 1) {
        value = permuted<N>(load<N>(from), distance);
      } else if constexpr (Vectors == 2) {
        value = permuted<N>(load<N>(from), load<N>(from + N), distance);
      } else {
        for (int i = 0; i < N; ++i) value[i] = from[distance[i]];
      }
      sum += value * load<N>(weights);
    }
    check += sum - sum;
    if (minuend) sum = load<N>(minuend + columns.start(g)) - sum;
    store<N>(out + columns.start(g), sum);
  }
  if constexpr (N == 1) {
    return check == 0;
  } else {
    F total = 0;
    for (int i = 0; i < N; ++i) total += check[i];
    return total == 0;
  }
}

// The same, but a tap of weight 0 contributes nothing, even if it is NaN or inf.
template <int N, class T, class F>
[[gnu::noinline]] void write_row_with_care(T* out, T const* minuend, F const* line, ColumnBands<F, N> const& columns,
                                           int64_t step) {
  for (int64_t g = 0; g < columns.groups; ++g)
    for (int i = 0; i < N; ++i) {
      F const* from = line + columns.from.data[g] + columns.distances.data[g * N + i];
      F sum = 0;
      for (int k = 0; k < columns.taps; ++k, from += step) {
        F const weight = columns.weights.data[(g * columns.taps + k) * N + i];
        if (weight != 0) sum += *from * weight;
      }
      if (minuend) sum = load<1>(minuend + columns.start(g) + i) - sum;
      store<1>(out + columns.start(g) + i, sum);
    }
}

template <int N, class T>
void resize_rows(Resize<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const step = p.x.step, size = p.x.row_size(), height = p.y.height;
  RowBands<F> const rows(p.rows, height, begin, min(height, end - begin));
  ColumnBands<F, N> const columns(p.columns, p.y.row_size(), step);
  int64_t const margin = columns.taps * step + 2 * N;  // a band may be shorter than most of them are
  Scratch<F> line(size + margin);
  for (int64_t e = size; e < size + margin; ++e) line.data[e] = 0;

  auto const write_with = [&](T* out, T const* minuend, auto vectors) {
    constexpr int M = decltype(vectors)::value;
    if (columns.taps == 1) return write_row<M, 1>(out, minuend, line.data, columns, step);
    if (columns.taps == 2) return write_row<M, 2>(out, minuend, line.data, columns, step);
    if (columns.taps == 4) return write_row<M, 4>(out, minuend, line.data, columns, step);
    return write_row<M, 0>(out, minuend, line.data, columns, step);
  };
  auto const write = [&](T* out, T const* minuend) {
    if (columns.spread < N) return write_with(out, minuend, Width<1>{});
    if constexpr (N > 1) {
      if (columns.spread < 2 * N) return write_with(out, minuend, Width<2>{});
      return write_row<0, 0>(out, minuend, line.data, columns, step);
    }
    return true;
  };
  for (int64_t r = begin; r < end; ++r) {
    int64_t const plane = r / height, i = rows.at(r);
    Contributors<F> const band = rows.reads.data[i];
    F const* const weights = rows.weights.data + i * rows.taps;
    T const* const first = p.x.row(plane, band.first);
    auto const add_up = [&](auto sum_at) {
      for_each_vector<T>(0, size, [&](auto width, int64_t e) {
        constexpr int M = decltype(width)::value;
        store<M>(line.data + e, Lanes<F, M>(sum_at(width, first + e)));
      });
    };
    if (band.count == 2 && weights[0] != 0 && weights[1] != 0)
      add_up([&](auto width, T const* from) {
        constexpr int M = decltype(width)::value;
        return load<M>(from) * weights[0] + load<M>(from + p.x.row_stride) * weights[1];
      });
    else
      add_up([&](auto width, T const* from) {
        constexpr int M = decltype(width)::value;
        Lanes<F, M> sum{};
        for (int k = 0; k < band.count; ++k, from += p.x.row_stride)
          if (weights[k] != 0) sum += load<M>(from) * weights[k];
        return sum;
      });
    T* const out = p.y.row(plane, r - plane * height);
    T const* const minuend = p.minuend ? p.minuend_at(out) : nullptr;
    if (!write(out, minuend)) write_row_with_care(out, minuend, line.data, columns, step);
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

}  // namespace kv::geometry::KV_ISA
