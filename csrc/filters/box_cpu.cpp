// Window sums on the CPU: rows [begin, end) of all planes in order, first down the columns, then along the row.
// Compiled once per instruction set.
#include "box.h"
#include "core/lanes.h"
#include "core/scratch.h"

namespace kv::KV_ISA {
namespace {

constexpr int kDirect = 7;  // windows up to this size are summed one by one

// Calls f(Width<k>{}) for k up to kDirect.
template <int K = 1, class F>
KV_HD void with_size(int64_t k, F f) {
  if constexpr (K <= kDirect) {
    if (k == K)
      f(Width<K>{});
    else
      with_size<K + 1>(k, f);
  }
}

// The sums of a plane's rows over the windows of one row after another.
//
// Large windows: the positions of the axis are cut into blocks of the window's size, so that a window is the end of one
// block and the beginning of the next. The sums of all ends of a block are made when the window reaches it, the sum of
// the beginning grows row by row: two additions an element and row, and one for the two together.
template <class T>
class ColumnSums {
  using F = Compute<T>;
  Planes<T const> const& x_;
  BoxAxis const axis_;
  int64_t const size_, k_;
  Scratch<T> zeros_;
  Scratch<F> ends_;  // row m of it: the sum of the block's rows from m on
  Scratch<F> beginning_;

  struct Row {
    T const* data;
    F weight;
  };
  KV_HD Row row(int64_t plane, int64_t position) const {
    int64_t const y = border_index(axis_.border, position, axis_.size);
    if (y < 0) return {zeros_.data, F(1)};
    return {x_.row(plane, y), F(axis_.doubled && axis_.is_rim(y) ? 2 : 1)};
  }

  // sum = a + row, or the row alone.
  KV_HD void add(F* sum, F const* a, Row row) const {
    for_each_vector<T>(0, size_, [&](auto width, int64_t e) {
      constexpr int N = decltype(width)::value;
      Lanes<F, N> s = load<N>(row.data + e) * row.weight;
      if (a) s += load<N>(a + e);
      store<N>(sum + e, s);
    });
  }

 public:
  KV_HD ColumnSums(Planes<T const> const& x, BoxAxis const& axis)
      : x_(x),
        axis_(axis),
        size_(x.row_size()),
        k_(axis.count()),
        zeros_(size_),
        ends_(k_ > kDirect ? k_ * size_ : 0),
        beginning_(size_) {
    for (int64_t e = 0; e < size_; ++e) zeros_.data[e] = T{};
  }

  // The sums of the window of row y. `fresh`: the call before was not for the row above.
  KV_HD void window(F* sum, int64_t plane, int64_t y, bool fresh) {
    if (k_ > kDirect) return slide(sum, plane, y, fresh);
    with_size(k_, [&](auto size) {
      constexpr int K = decltype(size)::value;
      Row rows[K];
      for (int i = 0; i < K; ++i) rows[i] = row(plane, y - axis_.before + i);
      for_each_vector<T>(0, size_, [&](auto width, int64_t e) {
        constexpr int N = decltype(width)::value;
        Lanes<F, N> s = load<N>(rows[0].data + e) * rows[0].weight;
        for (int i = 1; i < K; ++i) s += load<N>(rows[i].data + e) * rows[i].weight;
        store<N>(sum + e, s);
      });
    });
  }

  // The sum of the rows that read row j, which is one of a transposed axis' rim.
  KV_HD void gather(F* sum, int64_t plane, int64_t j, Border border) const {
    int64_t const n = axis_.size, radius = axis_.before;
    F const* so_far = nullptr;
    for (int64_t r = max(int64_t(0), j - radius); r <= min(n - 1, j + radius); ++r) {
      int64_t const times = reads(border, r, j, n, axis_.after, axis_.before);
      if (times == 0) continue;
      add(sum, so_far, {x_.row(plane, r), F(times)});
      so_far = sum;
    }
  }

 private:
  KV_HD void slide(F* sum, int64_t plane, int64_t y, bool fresh) {
    int64_t const m = y % k_, block = y - m - axis_.before;  // position of the block's first row
    auto const end = [&](int64_t i) { return ends_.data + i * size_; };
    F* const beginning = beginning_.data;
    if (fresh || m == 0)
      for (int64_t i = k_ - 1; i >= m; --i) add(end(i), i + 1 < k_ ? end(i + 1) : nullptr, row(plane, block + i));
    for (int64_t i = fresh ? 1 : m; i <= m; ++i)
      if (i > 0) add(beginning, i > 1 ? beginning : nullptr, row(plane, block + k_ + i - 1));
    for_each_vector<T>(0, size_, [&](auto width, int64_t e) {
      constexpr int N = decltype(width)::value;
      Lanes<F, N> s = load<N>(end(m) + e);
      if (m > 0) s += load<N>(beginning + e);
      store<N>(sum + e, s);
    });
  }
};

// Calls emit(width, e, sum of s[e], s[e + step], ... s[e + (k - 1) step]) for e in [0, size). Leaves s undefined.
//
// Large windows: the sums of 1, 2, 4, ... neighbours are made in place of s, and `sums` puts the window together from
// those in the binary digits of its size. Both have room for a vector more than size + (k - 1) step elements, because
// the loops run over the end; what they read there is not used.
template <class F, class Emit>
KV_HD void sum_along(F* s, F* sums, int64_t size, int64_t k, int64_t step, Emit emit) {
  if (k <= kDirect) {
    with_size(k, [&](auto count) {
      constexpr int K = decltype(count)::value;
      for_each_vector<F>(0, size, [&](auto width, int64_t e) {
        constexpr int N = decltype(width)::value;
        Lanes<F, N> sum = load<N>(s + e);
        for (int i = 1; i < K; ++i) sum += load<N>(s + e + i * step);
        emit(width, e, sum);
      });
    });
    return;
  }
  constexpr int N = kLanes<F>;
  int64_t power = 1, done = 0;
  for (int64_t rest = k; rest > 1; power *= 2, rest /= 2) {
    int64_t const double_size = size + (k - 2 * power) * step;
    for (int64_t e = 0; e < double_size; e += N) {
      Lanes<F, N> const one = load<N>(s + e);
      if (rest % 2 == 1) {
        if (done == 0)
          store<N>(sums + e, one);
        else
          store<N>(sums + e, Lanes<F, N>(load<N>(sums + e) + load<N>(s + e + done * step)));
      }
      store<N>(s + e, Lanes<F, N>(one + load<N>(s + e + power * step)));
    }
    if (rest % 2 == 1) done += power;
  }
  for_each_vector<F>(0, size, [&](auto width, int64_t e) {
    constexpr int M = decltype(width)::value;
    Lanes<F, M> sum = load<M>(s + e + done * step);
    if (done > 0) sum += load<M>(sums + e);
    emit(width, e, sum);
  });
}

template <class T>
KV_HD void box_rows(Box<T> const& p, bool transposed, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const step = p.x.step, size = p.x.row_size(), height = p.x.height, width = p.x.width;
  BoxAxis const ay(p.ky, height, p.border, transposed), ax(p.kx, width, p.border, transposed);
  ColumnSums<T> columns(p.x, ay);

  int64_t const padded = size + (p.kx - 1) * step, room = padded + kLanes<F>, radius = ax.before;
  int64_t const rims = min(2 * ax.rim, width);
  Scratch<F> rows(2 * room), rim(rims * step), weights(rims * (2 * radius + 1));
  F* const s = rows.data;                  // the column sums of a row, with what continues it
  F* const inside = s + ax.before * step;  // those of the row itself
  auto const rim_pixel = [&](int64_t i) { return i < ax.rim ? i : width - rims + i; };
  for (int64_t i = 0; i < rims; ++i)
    for (int64_t d = -radius; d <= radius; ++d) {
      int64_t const j = rim_pixel(i), r = j + d;
      weights.data[i * (2 * radius + 1) + d + radius] =
          r < 0 || r >= width ? F(0) : F(reads(p.border, r, j, width, ax.after, ax.before));
    }

  F const scale = 1 / p.divisor;
  for (int64_t r = begin; r < end; ++r) {
    int64_t const plane = r / height, y = r % height;
    columns.window(inside, plane, y, r == begin || y == 0);
    if (ay.is_rim(y) && !ay.doubled) columns.gather(inside, plane, y, p.border);

    for (int64_t i = 0; i < rims; ++i) {
      int64_t const j = rim_pixel(i);
      for (int64_t c = 0; c < step; ++c) {
        F sum = 0;
        for (int64_t q = max(int64_t(0), j - radius); q <= min(width - 1, j + radius); ++q)
          sum += weights.data[i * (2 * radius + 1) + q - j + radius] * inside[q * step + c];
        rim.data[i * step + c] = sum;
      }
    }
    if (ax.doubled)
      for (int64_t c = 0; c < step; ++c) {
        inside[c] *= 2;
        if (width > 1) inside[size - step + c] *= 2;
      }
    auto const continue_row = [&](int64_t position) {
      int64_t const q = border_index(ax.border, position, width);
      for (int64_t c = 0; c < step; ++c) inside[position * step + c] = q < 0 ? F(0) : inside[q * step + c];
    };
    for (int64_t i = 1; i <= ax.before; ++i) continue_row(-i);
    for (int64_t i = 0; i < ax.after; ++i) continue_row(width + i);

    T const* const x = p.x.row(plane, y);
    T* const out = p.y.row(plane, y);
    F const row_scale = ay.doubled && ay.is_rim(y) ? scale / 2 : scale;
    auto const emit = [&](auto lanes, int64_t e, auto sum) {
      constexpr int N = decltype(lanes)::value;
      if constexpr (sizeof(T) == 1) {  // the quotient's ties round as OpenCV's: no reciprocal
        if (p.centre != 0) sum += load<N>(x + e) * p.centre;
        sum /= p.divisor;
      } else {
        sum *= row_scale;
        if (p.centre != 0) sum += load<N>(x + e) * (p.centre * scale);
      }
      store<N>(out + e, sum);
    };
    sum_along(s, s + room, size, p.kx, step, emit);
    for (int64_t i = 0; i < rims; ++i)
      for (int64_t c = 0; c < step; ++c) emit(Width<1>{}, rim_pixel(i) * step + c, rim.data[i * step + c]);
  }
}

}  // namespace

template <class T>
void box(Box<T> const& p, int64_t begin, int64_t end) {
  box_rows(p, false, begin, end);
}
template <class T>
void box_backward(Box<T> const& p, int64_t begin, int64_t end) {
  box_rows(p, true, begin, end);
}

KV_INSTANTIATE_WITH_BYTES(box, Box)
KV_INSTANTIATE(box_backward, Box)

}  // namespace kv::KV_ISA
