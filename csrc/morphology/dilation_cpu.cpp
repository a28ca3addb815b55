// Dilation and erosion on the CPU. Full windows are rectangles without heights: they cost three maxima a pixel along y,
// at any height, and as many as the logarithm of their width along x. Windows whose rows are runs of members cost that
// logarithm for each different run, and one maximum a row. Other windows cost one maximum a tap. Bytes are compared as
// bytes, unless heights are added to them. Compiled once per instruction set.
#include "core/bytes.h"
#include "core/scratch.h"
#include "dilation.h"

namespace kv::morphology::KV_ISA {
namespace {

constexpr float kInfinity = __builtin_inff();

// The number that no extreme is but that of no members.
template <class F>
KV_HD F worst(bool erode) {
  if constexpr (__is_same(F, uint8_t))
    return erode ? 255 : 0;
  else
    return erode ? F(kInfinity) : -F(kInfinity);
}

// What windows compare: without heights bytes as they are, otherwise numbers of the type that computes.
template <class T, bool Heights = false>
struct ComparedOf {
  using type = Compute<T>;
};
template <>
struct ComparedOf<uint8_t, false> {
  using type = uint8_t;
};
template <class T, bool Heights = false>
using Compared = typename ComparedOf<T, Heights>::type;

// A ring of rows of numbers, each extended by as many pixels out of bounds as a window reads.
template <class F>
struct Rows {
  int64_t const before, stride;  // in numbers; a row has room for one more vector
  int const count;
  Scratch<F> memory;

  Rows(int count, int64_t size, int64_t before, int64_t after)
      : before(before), stride((before + size + after + 79) / 16 * 16), count(count), memory(count * stride) {
    for (int64_t i = 0; i < count * stride; ++i) memory.data[i] = 0;
  }
  // Row y of an image, one of the last `count` rows.
  KV_HD F* operator[](int64_t y) const { return memory.data + (y % count + count) % count * stride + before; }
};

// The members of one sample's structuring element.
template <class F>
struct Taps {
  StructuringElement<F> const& window;
  Scratch<F> offset;
  Scratch<int> row, column;
  int count = 0;
  bool full = true;     // a rectangle without heights
  bool in_runs = true;  // the members of each row are adjacent
  Scratch<int> run;     // of each row: its first member and their number

  explicit Taps(StructuringElement<F> const& window)
      : window(window),
        offset(window.height * window.width),
        row(window.height * window.width),
        column(window.height * window.width),
        run(2 * window.height) {}

  void read(int64_t sample) {
    count = 0, full = in_runs = true;
    for (int i = 0; i < window.height; ++i) {
      int* const run_of_row = run.data + 2 * i;
      run_of_row[0] = run_of_row[1] = 0;
      for (int j = 0; j < window.width; ++j) {
        F const value = window.offset(sample, i * window.width + j);
        full = full && value == 0;
        if (value == -F(kInfinity)) continue;
        offset.data[count] = value, row.data[count] = i, column.data[count] = j;
        ++count;
        if (run_of_row[1] == 0) run_of_row[0] = j;
        in_runs = in_runs && j == run_of_row[0] + run_of_row[1]++;
      }
    }
  }
};

// Rows of x and of what lies out of bounds. Windows with heights compare them multiplied by `sign`.
template <class T>
struct Source {
  using F = Compute<T>;
  Planes<T const> const& x;
  F const sign, value;
  Scratch<T> outside;

  Source(Planes<T const> const& x, StructuringElement<F> const& window)
      : x(x), sign(window.sign()), value(window.value), outside(x.row_size()) {
    for (int64_t e = 0; e < x.row_size(); ++e) store<1>(outside.data + e, value);
  }
  KV_HD bool holds(int64_t y) const { return y >= 0 && y < x.height; }
  KV_HD T const* row(int64_t plane, int64_t y) const { return holds(y) ? x.row(plane, y) : outside.data; }

  // The value out of bounds among numbers G: bytes are rounded, which changes no maximum of bytes that is rounded.
  template <class G>
  KV_HD G value_as() const {
    if constexpr (__is_same(G, uint8_t)) {
      uint8_t stored;
      store<1>(&stored, value);
      return stored;
    } else {
      return value;
    }
  }

  // Copies row y to `to` and extends it by the value of pixels out of bounds; times `sign` for windows with heights.
  template <bool Heights, class G>
  void copy(int64_t plane, int64_t y, G* to, int64_t before, int64_t after) const {
    auto const compared = [&](auto v) {
      if constexpr (Heights)
        return decltype(v)(v * sign);
      else
        return v;
    };
    int64_t const size = x.row_size();
    G const out = compared(value_as<G>());
    if (!holds(y)) {
      for (int64_t e = -before; e < size + after; ++e) to[e] = out;
      return;
    }
    T const* const from = x.row(plane, y);
    for_each_vector<T, kLanesAs<G, T>>(0, size, [&](auto width, int64_t e) {
      constexpr int N = decltype(width)::value;
      store_as<N, G>(to + e, compared(load_as<N, G>(from + e)));
    });
    for (int64_t e = -before; e < 0; ++e) to[e] = out;
    for (int64_t e = size; e < size + after; ++e) to[e] = out;
  }
};

// The maximum, or the minimum for an erosion; NaN propagates.
template <bool Erode, class V>
KV_HD V extreme(V a, V b) {
  if constexpr (__is_same(V, uint8_t) || __is_same(V, Lanes<uint8_t, kByteLanes>)) {
    return Erode ? min_bytes(a, b) : max_bytes(a, b);
  } else {
    V most;  // b where one is NaN
#if defined(__AVX512F__)
    if constexpr (__is_same(V, Lanes<float, 16>))
      most = V(Erode ? _mm512_min_ps(__m512(a), __m512(b)) : _mm512_max_ps(__m512(a), __m512(b)));
    else
#elif defined(__AVX2__)
    if constexpr (__is_same(V, Lanes<float, 8>))
      most = V(Erode ? _mm256_min_ps(__m256(a), __m256(b)) : _mm256_max_ps(__m256(a), __m256(b)));
    else
#endif
      most = (Erode ? a < b : a > b) ? a : b;
    return a != a ? a : most;
  }
}

// Maxima of adjacent pixels of a row, from those of 1, 4, 16 ... pixels, `reach`, that begin at each element.
template <bool Erode, class F, class T>
struct RowExtremes {
  static constexpr int N = kLanesAs<F, T>;
  F* row;
  int64_t step, reach = 1;

  // Of four times as many, in place, for the first `size` elements.
  KV_HD void widen(int64_t size) {
    for (int64_t e = 0; e < size; e += N) {
      auto const at = [&](int64_t j) { return load_as<N, F>(row + e + j * reach * step); };
      store_as<N, F>(row + e, extreme<Erode>(extreme<Erode>(at(0), at(1)), extreme<Erode>(at(2), at(3))));
    }
    reach *= 4;
  }
  // Of `count` pixels from pixel `first` on: up to four of them, which overlap.
  template <class Out>
  KV_HD void write(int64_t first, int64_t count, int64_t size, Out* out) const {
    F const* const from = row + first * step;
    int64_t const last = (count - reach) * step;
    for_each_vector<T, N>(0, size, [&](auto width, int64_t e) {
      constexpr int M = decltype(width)::value;
      Lanes<F, M> most = load_as<M, F>(from + e + last);
      for (int64_t at = 0; at < last; at += reach * step) most = extreme<Erode>(load_as<M, F>(from + e + at), most);
      store_as<M, F>(out + e, most);
    });
  }
};

// --- full windows ----------------------------------------------------------------------------------------------------

constexpr int kSmall = 4;  // windows of up to so many rows are computed row by row

// Output rows y0 ... y1 - 1 of a plane. Along y, unless the window is low, `height` adjacent windows share a common
// row: each combines the suffix maxima up to that row (`above`) with the prefix maximum of the rows below it (`below`).
template <bool Erode, class T>
void full_rows(Dilation<T> const& p, Source<T> const& source, int64_t plane, int64_t y0, int64_t y1) {
  using F = Compared<T>;
  constexpr int N = kLanesAs<F, T>;
  auto const& window = p.window;
  F const outside = source.template value_as<F>();
  int64_t const size = p.x.row_size(), step = p.x.step, before = window.left * step;
  int64_t const after = (window.width - 1) * step - before, height = window.height;
  Rows<F> const above(int(height), size, 0, 0), below(1, size, 0, 0), across(1, size, before, after);
  F* const row = across[0];
  auto const combine = [&](F* to, F const* with, T const* pixels) {
    for_each_vector<T, N>(0, size, [&](auto width, int64_t e) {
      constexpr int M = decltype(width)::value;
      Lanes<F, M> const v = load_as<M, F>(pixels + e);
      store_as<M, F>(to + e, with ? extreme<Erode>(load_as<M, F>(with + e), v) : v);
    });
  };

  // From the maxima along y, in `row`, to output row y.
  auto const along_x = [&](int64_t y) {
    for (int64_t e = -before; e < 0; ++e) row[e] = outside;
    for (int64_t e = size; e < size + after; ++e) row[e] = outside;
    RowExtremes<Erode, F, T> extremes{row - before, step};
    while (4 * extremes.reach < window.width) extremes.widen(size + (window.width - 4 * extremes.reach) * step);
    extremes.write(0, window.width, size, p.y.row(plane, y));
  };

  if (height <= kSmall) {
    for (int64_t y = y0; y < y1; ++y) {
      T const* rows[kSmall];
      for (int i = 0; i < height; ++i) rows[i] = source.row(plane, y - window.top + i);
      for_each_vector<T, N>(0, size, [&](auto width, int64_t e) {
        constexpr int M = decltype(width)::value;
        Lanes<F, M> most = load_as<M, F>(rows[0] + e);
        for (int i = 1; i < height; ++i) most = extreme<Erode>(load_as<M, F>(rows[i] + e), most);
        store_as<M, F>(row + e, most);
      });
      along_x(y);
    }
    return;
  }

  for (int64_t block = y0; block < y1; block += height) {
    int64_t const last = block - window.top + height - 1;
    for (int64_t i = height; i-- > 0;)
      combine(above[i], i + 1 < height ? above[i + 1] : nullptr, source.row(plane, last - height + 1 + i));
    for (int64_t i = 0; i < height && block + i < y1; ++i) {
      if (i > 0) {
        T const* const next = source.row(plane, last + i);
        if (i == 1)
          combine(below[0], nullptr, next);
        else  // in place, so vectors must not overlap
          for (int64_t e = 0; e < size; e += N)
            if (e + N <= size)
              store_as<N, F>(below[0] + e, extreme<Erode>(load_as<N, F>(below[0] + e), load_as<N, F>(next + e)));
            else
              for (int64_t rest = e; rest < size; ++rest)
                below[0][rest] = extreme<Erode>(below[0][rest], load_as<1, F>(next + rest));
      }
      for_each_vector<T, N>(0, size, [&](auto width, int64_t e) {
        constexpr int M = decltype(width)::value;
        Lanes<F, M> const v = load_as<M, F>(above[i] + e);
        store_as<M, F>(row + e, i == 0 ? v : extreme<Erode>(v, load_as<M, F>(below[0] + e)));
      });
      along_x(block + i);
    }
  }
}

// --- any window ------------------------------------------------------------------------------------------------------

// The address from which each tap reads for row y of the images.
template <class F, class G>
KV_HD void locate_taps(Taps<F> const& taps, Rows<G> const& rows, int64_t y, int64_t step, G const** pointers) {
  for (int t = 0; t < taps.count; ++t)
    pointers[t] = rows[y - taps.window.top + taps.row.data[t]] + (taps.column.data[t] - taps.window.left) * step;
}

// A row of the result from the rows that its taps read. With heights windows are maxima of numbers times `sign`;
// without them they need neither. A few vectors at a time share the loads of the pointers.
template <bool Erode, bool Heights, class T>
KV_HD void most_of_taps(Dilation<T> const& p, Compared<T, Heights> const* const* pointers, Compute<T> const* offsets,
                        int count, T* out) {
  using G = Compared<T, Heights>;
  int64_t const size = p.x.row_size();
  G const none = worst<G>(Erode && !Heights);
  auto const most_of = [&](auto width, auto block, int64_t e) {
    constexpr int N = decltype(width)::value, U = decltype(block)::value;
    using V = Lanes<G, N>;
    V most[U];
    for (V& v : most) v = broadcast<N>(none);
    for (int t = 0; t < count; ++t) {
      G const* const from = pointers[t] + e;
      for (int i = 0; i < U; ++i) {
        V const x = load_as<N, G>(from + i * N);
        if constexpr (Heights)
          most[i] = extreme<false>(V(x + offsets[t]), most[i]);
        else
          most[i] = extreme<Erode>(x, most[i]);
      }
    }
    for (int i = 0; i < U; ++i) {
      if constexpr (Heights) most[i] = most[i] * p.window.sign();
      store_as<N, G>(out + e + i * N, most[i]);
    }
  };
  constexpr int N = kLanesAs<G, T>, kBlock = 4;
  int64_t e = 0;
  for (; e + kBlock * N <= size; e += kBlock * N) most_of(Width<N>{}, Width<kBlock>{}, e);
  if (e == size) return;
  for_each_vector<T, N>(size < N ? 0 : min(e, size - N), size,
                        [&](auto width, int64_t e) { most_of(width, Width<1>{}, e); });
}

template <bool Erode, bool Heights, class T>
void tap_rows(Dilation<T> const& p, Source<T> const& source, Taps<Compute<T>> const& taps, int64_t plane, int64_t y0,
              int64_t y1) {
  using F = Compute<T>;
  using G = Compared<T, Heights>;
  StructuringElement<F> const& window = p.window;
  int64_t const size = p.x.row_size(), step = p.x.step, before = window.left * step;
  int64_t const after = (window.width - 1) * step - before;
  Rows<G> const rows(window.height, size, before, after);
  Scratch<G const*> pointers(taps.count);
  for (int64_t y = y0; y < y1; ++y) {
    int64_t const last = y - window.top + window.height - 1;
    for (int64_t i = y == y0 ? last - window.height + 1 : last; i <= last; ++i)
      source.template copy<Heights>(plane, i, rows[i], before, after);
    locate_taps(taps, rows, y, step, pointers.data);
    most_of_taps<Erode, Heights>(p, pointers.data, taps.offset.data, taps.count, p.y.row(plane, y));
  }
}

// The same for windows without heights whose rows are runs of members, as those of disks. The maxima of runs are
// computed once for every row of the image, and combined along y.
template <bool Erode, class T>
void run_rows(Dilation<T> const& p, Source<T> const& source, Taps<Compute<T>> const& taps, int64_t plane, int64_t y0,
              int64_t y1) {
  using G = Compared<T>;
  auto const& window = p.window;
  int64_t const size = p.x.row_size(), step = p.x.step, before = window.left * step;
  int64_t const after = (window.width - 1) * step - before;
  Scratch<int> kind(window.height), row_of_kind(window.height);  // rows of equal runs are of one kind
  int kinds = 0;
  for (int i = 0; i < window.height; ++i) {
    int const* const run = taps.run.data + 2 * i;
    int k = 0;
    while (k < kinds &&
           !(taps.run.data[2 * row_of_kind.data[k]] == run[0] && taps.run.data[2 * row_of_kind.data[k] + 1] == run[1]))
      ++k;
    if (k == kinds) row_of_kind.data[kinds++] = i;
    kind.data[i] = k;
  }
  Rows<G> const line(1, size, before, after), runs(window.height * kinds, size, 0, 0);
  Scratch<G const*> pointers(window.height);
  for (int64_t y = y0; y < y1; ++y) {
    int64_t const first = y - window.top, last = first + window.height - 1;
    for (int64_t i = y == y0 ? first : last; i <= last; ++i) {
      source.template copy<false>(plane, i, line[0], before, after);
      RowExtremes<Erode, G, T> extremes{line[0] - before, step};
      for (int64_t shorter = 0;;) {  // runs of up to so many members are done
        for (int k = 0; k < kinds; ++k) {
          int const* const run = taps.run.data + 2 * row_of_kind.data[k];
          if (run[1] > shorter && run[1] <= 4 * extremes.reach)
            extremes.write(run[0], run[1], size, runs[i * kinds + k]);
        }
        shorter = 4 * extremes.reach;
        if (shorter >= window.width) break;
        extremes.widen(size + (window.width - shorter) * step);
      }
    }
    int count = 0;
    for (int i = 0; i < window.height; ++i)
      if (taps.run.data[2 * i + 1] > 0) pointers.data[count++] = runs[(first + i) * kinds + kind.data[i]];
    most_of_taps<Erode, false>(p, pointers.data, nullptr, count, p.y.row(plane, y));
  }
}

// Calls f(plane, first row, last row + 1) for the parts of rows [begin, end) in each plane, with the taps of its
// sample.
template <class F, class Call>
KV_HD void for_each_plane(Taps<F>& taps, int64_t height, int64_t planes, int64_t begin, int64_t end, Call call) {
  int64_t sample = -1;
  for (int64_t r = begin; r < end;) {
    int64_t const plane = r / height, y0 = r % height, y1 = min(height, y0 + end - r);
    if (plane / planes != sample) taps.read(sample = plane / planes);
    call(plane, y0, y1);
    r += y1 - y0;
  }
}

template <bool Erode, class T>
void dilate(Dilation<T> const& p, int64_t begin, int64_t end) {
  Source<T> const source(p.x, p.window);
  Taps<Compute<T>> taps(p.window);
  for_each_plane(taps, p.y.height, p.planes, begin, end, [&](int64_t plane, int64_t y0, int64_t y1) {
    // Special cases, one thread: full windows are 1.04 (5 x 5) to 2.3 times as fast as by runs, runs of disks 1.5
    // to 1.8 times as fast as tap by tap.
    if (taps.full)
      full_rows<Erode>(p, source, plane, y0, y1);
    else if (!p.window.heights && taps.in_runs && taps.count > 3 * p.window.height)
      run_rows<Erode>(p, source, taps, plane, y0, y1);
    else if (p.window.heights)
      tap_rows<Erode, true>(p, source, taps, plane, y0, y1);
    else
      tap_rows<Erode, false>(p, source, taps, plane, y0, y1);
  });
}

}  // namespace

template <class T>
void dilation(Dilation<T> const& p, int64_t begin, int64_t end) {
  p.window.erode ? dilate<true>(p, begin, end) : dilate<false>(p, begin, end);
}

template <class T>
void dilation_backward(DilationBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  StructuringElement<F> const& window = p.window;
  int64_t const size = p.x.row_size(), step = p.x.step, height = p.x.height, before = window.left * step;
  int64_t const after = (window.width - 1) * step - before;
  Source<T> const source(p.x, window);
  Taps<F> taps(window);
  // Maxima of the windows around the current row, and the gradients of their ties, which are 0 out of bounds.
  Rows<F> const rows(window.height, size, before, after), most(window.height, size, after, before),
      part(window.height, size, after, before);
  Scratch<F const*> pointers(window.height * window.width), parts(window.height * window.width);
  for_each_plane(taps, height, p.planes, begin, end, [&](int64_t plane, int64_t y0, int64_t y1) {
    // Windows of row q read rows of x from q - top on; row y is read by those of rows y + top - (window.height - 1) on.
    int64_t const first = y0 + window.top - window.height + 1;
    int64_t copied = first - window.top - 1;
    for (int64_t q = first; q < y1 + window.top; ++q) {
      while (copied < q - window.top + window.height - 1)
        ++copied, source.template copy<true>(plane, copied, rows[copied], before, after);
      if (q < 0 || q >= height) {
        for (int64_t e = 0; e < size; ++e) part[q][e] = most[q][e] = 0;
      } else {
        locate_taps(taps, rows, q, step, pointers.data);
        T const* const g = p.grad.row(plane, q);
        for_each_vector<T>(0, size, [&](auto width, int64_t e) {
          constexpr int N = decltype(width)::value;
          using V = Lanes<F, N>;
          Ties<V> ties{broadcast<N>(-F(kInfinity)), V{}};
          for (int t = 0; t < taps.count; ++t)
            ties.add(load<N>(pointers.data[t] + e) + taps.offset.data[t], broadcast<N>(F(1)));
          store<N>(most[q] + e, ties.value);
          store<N>(part[q] + e, V(load<N>(g + e) / (ties.count > 0 ? ties.count : broadcast<N>(F(1)))));
        });
      }
      int64_t const y = q - window.top;
      if (y < y0) continue;
      for (int t = 0; t < taps.count; ++t) {
        int64_t const from = y + window.top - taps.row.data[t], shift = (window.left - taps.column.data[t]) * step;
        pointers.data[t] = most[from] + shift;
        parts.data[t] = part[from] + shift;
      }
      T const* const in = p.x.row(plane, y);
      T* const out = p.grad_x.row(plane, y);
      for_each_vector<T>(0, size, [&](auto width, int64_t e) {
        constexpr int N = decltype(width)::value;
        using V = Lanes<F, N>;
        V const x = load<N>(in + e) * source.sign;
        V sum{};
        for (int t = 0; t < taps.count; ++t)
          sum += x + taps.offset.data[t] == load<N>(pointers.data[t] + e) ? load<N>(parts.data[t] + e) : V{};
        store<N>(out + e, sum);
      });
    }
  });
}

KV_INSTANTIATE_WITH_BYTES(dilation, Dilation)
KV_INSTANTIATE(dilation_backward, DilationBackward)

}  // namespace kv::morphology::KV_ISA
