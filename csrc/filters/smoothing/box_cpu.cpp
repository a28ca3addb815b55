// Window sums on the CPU: rows [begin, end) of all planes in order, first along columns, then along the row. F is the
// type of sums: 16-bit integers for bytes under small windows, otherwise that which images are computed in. Compiled
// once per instruction set.
#include "box.h"
#include "core/bytes.h"
#include "core/scratch.h"

namespace kv::filters::KV_ISA {
namespace {

// Calls f(width, e) for vectors and then single elements of [0, size), each element once, so that results may be
// written in place.
template <int N, class Call>
KV_HD void for_each_once(int64_t size, Call f) {
  int64_t e = 0;
#pragma GCC unroll 4
  for (; e + N <= size; e += N) f(Width<N>{}, e);
  for (; e < size; ++e) f(Width<1>{}, e);
}

// Calls emit(width, e, terms[0][e] + terms[1][e] + ...) for e in [0, size), as for_each_vector does. It sums a few
// vectors at a time, which shares the loads of the pointers.
template <class F, int Count = 0, class T, class Emit>
KV_HD void add_up(T const* const* terms, int count, int64_t size, Emit emit) {
  constexpr int N = kLanesAs<F, T>, kBlock = 4;
  if (Count) count = Count;  // known to the compiler
  int64_t e = 0;
  for (; e + kBlock * N <= size; e += kBlock * N) {
    Lanes<F, N> sums[kBlock];
    for (int i = 0; i < kBlock; ++i) sums[i] = load_as<N, F>(terms[0] + e + i * N);
    for (int t = 1; t < count; ++t)
      for (int i = 0; i < kBlock; ++i) sums[i] += load_as<N, F>(terms[t] + e + i * N);
    for (int i = 0; i < kBlock; ++i) emit(Width<N>{}, e + i * N, sums[i]);
  }
  if (e == size) return;
  for_each_vector<T, N>(size < N ? 0 : min(e, size - N), size, [=](auto width, int64_t e) {
    constexpr int M = decltype(width)::value;
    Lanes<F, M> sum = load_as<M, F>(terms[0] + e);
    for (int t = 1; t < count; ++t) sum += load_as<M, F>(terms[t] + e);
    emit(width, e, sum);
  });
}

// Sums of a plane's rows over windows that move down row by row.
//
// The axis is divided into blocks of the window's size, so that each window is the end of one block and the beginning
// of the next. The suffix sums of a block are computed when the window reaches it; the prefix sum grows row by row.
// That costs two additions an element and row, and one that adds the two. Windows of up to three rows are summed
// directly. Integers are one running sum.
template <class T, class F>
class ColumnSums {
  static constexpr int kDirect = 3, kN = kLanesAs<F, T>;

  Planes<T const> const& x_;
  BoxAxis const axis_;
  int64_t const size_, k_;
  Scratch<T> zeros_;
  Scratch<F> ends_;  // row i: the sum of the block's rows from i on
  Scratch<F> beginning_;

  KV_HD T const* row(int64_t plane, int64_t position) const {
    int64_t const y = border_index(axis_.border, position, axis_.size);
    return y < 0 ? zeros_.data : x_.row(plane, y);
  }
  // How often a row counts.
  KV_HD int weight(int64_t position) const {
    return axis_.doubled && axis_.is_edge(border_index(axis_.border, position, axis_.size)) ? 2 : 1;
  }

  KV_HD bool has_blocks() const { return sizeof(F) > 2 && k_ > kDirect; }
  KV_HD void clear(F* sum) const {
    for (int64_t e = 0; e < size_; ++e) sum[e] = 0;
  }
  // sum = a + weight * row
  KV_HD void add(F* sum, F const* a, F weight, T const* row) const {
    for_each_once<kN>(size_, [=](auto width, int64_t e) {
      constexpr int N = decltype(width)::value;
      store_as<N, F>(sum + e, load_as<N, F>(a + e) + load_as<N, F>(row + e) * weight);
    });
  }

  KV_HD void slide(F* sum, int64_t plane, int64_t y, bool fresh) {
    int64_t const m = y % k_, block = y - m - axis_.before;  // block: its first position
    auto const end = [&](int64_t i) { return ends_.data + i * size_; };
    F* const beginning = beginning_.data;
    if (fresh || m == 0) {
      for (int64_t i = k_; i-- > m;) add(end(i), end(i + 1), F(weight(block + i)), row(plane, block + i));
      clear(beginning);
      for (int64_t i = block + k_; i + 1 < block + k_ + m; ++i) add(beginning, beginning, F(weight(i)), row(plane, i));
    }
    if (m == 0) return add(sum, end(0), 0, zeros_.data);
    F const* const rest = end(m);
    T const* const next = row(plane, block + k_ + m - 1);
    F const times = weight(block + k_ + m - 1);
    for_each_once<kN>(size_, [=](auto width, int64_t e) {
      constexpr int N = decltype(width)::value;
      Lanes<F, N> const b = load_as<N, F>(beginning + e) + load_as<N, F>(next + e) * times;
      store_as<N, F>(beginning + e, b);
      store_as<N, F>(sum + e, load_as<N, F>(rest + e) + b);
    });
  }

 public:
  KV_HD ColumnSums(Planes<T const> const& x, BoxAxis const& axis)
      : x_(x),
        axis_(axis),
        size_(x.row_size()),
        k_(axis.count()),
        zeros_(size_),
        ends_(has_blocks() ? (k_ + 1) * size_ : 0),
        beginning_(has_blocks() ? size_ : 0) {
    for (int64_t e = 0; e < size_; ++e) zeros_.data[e] = T{};
    if (has_blocks()) clear(ends_.data + k_ * size_);
  }

  // The sums of the window of row y. `fresh`: the call before was not for the row above. Otherwise `sum` may still hold
  // what it wrote: integers lose nothing when the row that leaves a window is subtracted.
  KV_HD void window(F* sum, int64_t plane, int64_t y, bool fresh) {
    if constexpr (sizeof(F) == 2) {
      if (fresh) {
        clear(sum);
        for (int64_t i = y - axis_.before; i <= y + axis_.after; ++i) add(sum, sum, 1, row(plane, i));
        return;
      }
      T const* const leaves = row(plane, y - 1 - axis_.before);
      T const* const enters = row(plane, y + axis_.after);
      return for_each_once<kN>(size_, [=](auto width, int64_t e) {
        constexpr int N = decltype(width)::value;
        Lanes<F, N> const change = load_as<N, F>(enters + e) - load_as<N, F>(leaves + e);
        store_as<N, F>(sum + e, Lanes<F, N>(load_as<N, F>(sum + e) + change));
      });
    }
    if (k_ > kDirect) return slide(sum, plane, y, fresh);
    T const* terms[2 * kDirect];  // a row that counts twice is there twice
    int count = 0;
    for (int64_t i = y - axis_.before; i <= y + axis_.after; ++i)
      for (int times = weight(i); times > 0; --times) terms[count++] = row(plane, i);
    add_up<F>(terms, count, size_,
              [=](auto width, int64_t e, auto s) { store_as<decltype(width)::value, F>(sum + e, s); });
  }

  // The sum of the rows that read row j, an edge row of a transposed axis.
  KV_HD void gather_edge(F* sum, int64_t plane, int64_t j, Border border) const {
    int64_t const n = axis_.size, radius = axis_.before;
    clear(sum);
    for (int64_t r = max(int64_t(0), j - radius); r <= min(n - 1, j + radius); ++r)
      if (int64_t const times = read_count(border, r, j, n, axis_.after, axis_.before))
        add(sum, sum, F(times), x_.row(plane, r));
  }

  // Prefetches a row that windows will read; a quarter faster for large images.
  KV_HD void prefetch(int64_t plane, int64_t y) const {
    if (y >= axis_.size) return;
    for (int64_t e = 0; e < size_; e += 64 / sizeof(T)) __builtin_prefetch(x_.row(plane, y) + e);
  }
};

// Sums over k pixels, `step` elements apart, along a row of `size` elements and (k - 1) step more.
//
// The sums of 4, 16, ... pixels are computed first. A window adds as many of each as the base-4 digits of its size say;
// the first digit may be up to 7.
template <class F>
class RowSums {
  static constexpr int kDigit = 7, kLevels = 32;

  int64_t const size_, k_, step_, room_;
  Scratch<F> sums_;  // level after level; level 0 are the elements

  KV_HD static int levels(int64_t k) {
    int count = 1;
    for (; k > kDigit; k /= 4) ++count;
    return count;
  }

 public:
  KV_HD RowSums(int64_t size, int64_t k, int64_t step)
      : size_(size), k_(k), step_(step), room_(size + (k - 1) * step), sums_(levels(k) * room_) {}

  KV_HD F* elements() const { return sums_.data; }

  // emit(width, e, elements()[e] + elements()[e + step] + ...) for e in [0, size)
  template <class Emit>
  KV_HD void sums(Emit emit) const {
    F const* terms[kDigit + 3 * kLevels];
    int count = 0;
    int64_t power = 1, done = 0, rest = k_;
    F* level = sums_.data;
    for (;; rest /= 4, power *= 4, level += room_) {
      bool const last = rest <= kDigit;
      for (int64_t i = last ? rest : rest % 4; i > 0; --i, done += power) terms[count++] = level + done * step_;
      if (last) break;
      F const* four[4];
      for (int i = 0; i < 4; ++i) four[i] = level + i * power * step_;
      F* const above = level + room_;
      add_up<F>(four, 4, size_ + (k_ - 4 * power) * step_,
                [=](auto width, int64_t e, auto s) { store_as<decltype(width)::value, F>(above + e, s); });
    }
    if constexpr (sizeof(F) == 2) {
      if (count == 3) return add_up<F, 3>(terms, count, size_, emit);
      if (count == 5) return add_up<F, 5>(terms, count, size_, emit);
    }
    add_up<F>(terms, count, size_, emit);
  }
};

// The ends of a row of column sums: its border, and the sums of the edge pixels that gather_edge.
template <class F>
class RowEdges {
  BoxAxis const axis_;
  int64_t const step_, count_, radius_;
  Scratch<F> weights_, sums_;

  KV_HD int64_t pixel(int64_t i) const { return i < axis_.edge ? i : axis_.size - count_ + i; }
  // Calls f(r, weight) for the pixels r that may read pixel(i).
  template <class Call>
  KV_HD void for_each_source(int64_t i, Call f) const {
    int64_t const j = pixel(i);
    F* const weights = weights_.data + i * (2 * radius_ + 1) + radius_ - j;
    for (int64_t r = max(int64_t(0), j - radius_); r <= min(axis_.size - 1, j + radius_); ++r) f(r, weights[r]);
  }

 public:
  KV_HD RowEdges(BoxAxis const& axis, Border border, int64_t step)
      : axis_(axis),
        step_(step),
        count_(min(2 * axis.edge, axis.size)),
        radius_(axis.before),
        weights_(count_ * (2 * radius_ + 1)),
        sums_(count_ * step) {
    for (int64_t i = 0; i < count_; ++i)
      for_each_source(i, [&](int64_t r, F& weight) {
        weight = F(read_count(border, r, pixel(i), axis_.size, axis_.after, axis_.before));
      });
  }

  // Extends row s, which has room for `before` pixels before it and `after` pixels after it, and sums the edge pixels.
  KV_HD void extend_row(F* s) const {
    for (int64_t i = 0; i < count_; ++i)
      for (int64_t c = 0; c < step_; ++c) {
        F sum = 0;
        for_each_source(i, [&](int64_t r, F weight) { sum += weight * s[r * step_ + c]; });
        sums_.data[i * step_ + c] = sum;
      }
    if (axis_.doubled)
      for (int64_t i = 0; i < count_; ++i)
        for (int64_t c = 0; c < step_; ++c) s[pixel(i) * step_ + c] *= 2;
    auto const extend = [&](int64_t position) {
      int64_t const j = border_index(axis_.border, position, axis_.size);
      for (int64_t c = 0; c < step_; ++c) s[position * step_ + c] = j < 0 ? F(0) : s[j * step_ + c];
    };
    for (int64_t i = 1; i <= axis_.before; ++i) extend(-i);
    for (int64_t i = 0; i < axis_.after; ++i) extend(axis_.size + i);
  }

  template <class Emit>
  KV_HD void sums(Emit emit) const {
    for (int64_t i = 0; i < count_; ++i)
      for (int64_t c = 0; c < step_; ++c) emit(Width<1>{}, pixel(i) * step_ + c, sums_.data[i * step_ + c]);
  }
};

// The mean of n bytes in 16 bits, (sum + n / 2) / n rounded down; n is odd, so that no mean ends in a half. The
// division is a product with (2^k + e) / n, the reciprocal rounded up, where e < n < 128 and 2^k > 2^15 n. The result
// is too large by (sum + n / 2) e / (2^k n) < 255.5 n / (2^15 n) < 1 / n, which reaches no next integer.
struct MeanOfBytes {
  uint16_t half, reciprocal;
  int shift = 0;

  KV_HD static bool serves(int64_t n) { return n % 2 == 1 && n > 1 && n < 128; }
  KV_HD explicit MeanOfBytes(int n) : half(uint16_t(n / 2)) {
    while (2 << shift < n) ++shift;
    reciprocal = uint16_t(((1 << (16 + shift)) + n - 1) / n);
  }
  template <int N>
  KV_HD Lanes<uint16_t, N> of(Lanes<uint16_t, N> sum) const {
    using V = Lanes<uint16_t, N>;
    return V(high_product<N>(V(sum + half), reciprocal) >> shift);
  }
};

template <class F, class T>
KV_HD void box_rows(Box<T> const& p, bool transposed, int64_t begin, int64_t end) {
  int64_t const height = p.x.height, size = p.x.row_size();
  BoxAxis const down(p.ky, height, p.border, transposed), along(p.kx, p.x.width, p.border, transposed);
  ColumnSums<T, F> columns(p.x, down);
  RowSums<F> const row(size, p.kx, p.x.step);
  RowEdges<F> const edges(along, p.border, p.x.step);
  F* const s = row.elements() + along.before * p.x.step;
  Compute<T> const center = p.center, divisor = p.divisor, reciprocal = 1 / divisor;
  bool const has_center = center != 0;  // 0 times an infinite pixel is not 0
  MeanOfBytes const mean(sizeof(F) == 2 ? int(divisor) : 3);

  for (int64_t r = begin; r < end; ++r) {
    int64_t const plane = r / height, y = r % height;
    columns.prefetch(plane, y + down.after + 2);
    columns.window(s, plane, y, r == begin || y == 0);
    if (down.is_edge(y) && down.gathers()) columns.gather_edge(s, plane, y, p.border);
    edges.extend_row(s);

    T const* const x = p.x.row(plane, y);
    T* const out = p.y.row(plane, y);
    auto const emit = [&, row_scale = down.doubled && down.is_edge(y) ? 0.5f : 1.f](auto width, int64_t e, auto sum) {
      constexpr int N = decltype(width)::value;
      if constexpr (sizeof(F) == 2) {
        store_as<N, F>(out + e, mean.template of<N>(sum));
      } else {
        Lanes<F, N> all = sum * F(row_scale);
        if (has_center) all += load<N>(x + e) * center;
        store<N>(out + e, quotient<T>(all, divisor, reciprocal));
      }
    };
    row.sums(emit);
    edges.sums(emit);
  }
}

}  // namespace

template <class T>
void box(Box<T> const& p, int64_t begin, int64_t end) {
  if constexpr (sizeof(T) == 1) {
    // Special case: 2.5 to 4.5 times as fast as sums of floats, one thread.
    int64_t const n = p.kx * p.ky;
    if (p.center == 0 && p.divisor == n && MeanOfBytes::serves(n)) return box_rows<uint16_t>(p, false, begin, end);
  }
  box_rows<Compute<T>>(p, false, begin, end);
}
template <class T>
void box_backward(Box<T> const& p, int64_t begin, int64_t end) {
  box_rows<Compute<T>>(p, true, begin, end);
}

template <class T>
void box_list(BoxList<T> const& p, int64_t begin, int64_t end) {
  filter_items(p, begin, end, [](Box<T> const& one, int64_t first, int64_t last) { KV_ISA::box(one, first, last); });
}
template <class T>
void box_list_backward(BoxList<T> const& p, int64_t begin, int64_t end) {
  filter_items(p, begin, end,
               [](Box<T> const& one, int64_t first, int64_t last) { KV_ISA::box_backward(one, first, last); });
}

KV_INSTANTIATE_WITH_BYTES(box, Box)
KV_INSTANTIATE(box_backward, Box)
KV_INSTANTIATE_WITH_BYTES(box_list, BoxList)
KV_INSTANTIATE(box_list_backward, BoxList)

}  // namespace kv::filters::KV_ISA
