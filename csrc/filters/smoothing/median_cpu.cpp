// Median blur on the CPU: rows [begin, end) of all planes in order. Compiled once per instruction set.
//
// Planes are processed in blocks of columns, narrow enough that the rows of a window, with the border around them, stay
// in the cache. Loops run over whole vectors: rows in scratch have room for the rest of the last one.
#include "core/lanes.h"
#include "core/scratch.h"
#include "median.h"

namespace kv::filters::KV_ISA {
namespace {

// The type of rows in scratch for selection networks: bytes stay bytes. Windows that are searched bit by bit hold keys.
template <class T>
struct network_value {
  using type = Compute<T>;
};
template <>
struct network_value<uint8_t> {
  using type = uint8_t;
};

template <class F>
constexpr int kWidth = kVectorBytes / int(sizeof(F));
template <class F>
using Vector = Lanes<F, kWidth<F>>;

template <class F>
KV_HD Vector<F> read(F const* p) {
  return read_lanes<kWidth<F>>(p);
}
template <class F>
KV_HD void write(F* p, Vector<F> v) {
  write_lanes<kWidth<F>>(p, v);
}

template <class F>
KV_HD int64_t whole_vectors(int64_t size) {
  return (size + kWidth<F> - 1) / kWidth<F> * kWidth<F>;
}

// Converts stored pixels to the type of rows in scratch, and back.
template <class T, class F>
KV_HD void unpack(T const* in, int64_t size, F* out) {
  if constexpr (__is_same(T, F))
    __builtin_memcpy(out, in, size * sizeof(T));
  else if constexpr (__is_same(F, Compute<T>))
    for_each_vector<T>(0, size, [&](auto width, int64_t e) {
      constexpr int N = decltype(width)::value;
      store<N>(out + e, load<N>(in + e));
    });
  else
    for (int64_t e = 0; e < size; ++e) out[e] = to_key(in[e]);
}
template <class T, class F>
KV_HD void store_row(F const* in, int64_t size, T* out) {
  if constexpr (__is_same(T, F))
    __builtin_memcpy(out, in, size * sizeof(T));
  else if constexpr (__is_same(F, Compute<T>))
    for_each_vector<T>(0, size, [&](auto width, int64_t e) {
      constexpr int N = decltype(width)::value;
      store<N>(out + e, load<N>(in + e));
    });
  else
    for (int64_t e = 0; e < size; ++e) out[e] = from_key<T>(in[e]);
}

// `x` is a value or a vector.
template <class T, class V>
KV_HD auto is_nan(V x) {
  if constexpr (__is_same(V, MedianKey<T>) || __is_same(V, Vector<MedianKey<T>>))
    return x == kMedianKeyOfNan<T>;
  else
    return x != x;
}
template <class T, class F>
KV_HD bool has_nan(F const* values, int64_t size) {
  bool any = false;
  if constexpr (!__is_same(T, uint8_t)) {
    auto nans = Vector<F>{} != Vector<F>{};
    for_each_vector<T, kWidth<F>>(0, size, [&](auto vector, int64_t e) {
      if constexpr (decltype(vector)::value == 1)
        any |= is_nan<T>(values[e]);
      else
        nans |= is_nan<T>(read(values + e));
    });
    for (int i = 0; i < kWidth<F>; ++i) any |= nans[i] != 0;
  }
  return any;
}

// The last `count` rows. row(y) takes a division; the row below a known one does not.
template <class F>
struct Ring {
  F* data;
  int64_t count, stride;
  KV_HD F* row(int64_t y) const { return data + (y + count) % count * stride; }  // y > -count
  KV_HD F* below(F* row) const { return row + stride == data + count * stride ? data : row + stride; }
};

// A ring of rows of a block of columns, each with its border: `before` pixels to the left, `after` to the right.
template <class T, class F>
struct BorderedRows {
  Planes<T const> const& x;
  Border border;
  int64_t ky, kx;
  int64_t plane = 0, first = 0, size = 0;  // the current block: elements [first, first + size) of the rows of a plane
  Scratch<F> pixels;
  Scratch<uint8_t> flags;
  Ring<F> rows;       // rows start at the first pixel of the block's first window
  Ring<uint8_t> nan;  // whether a row holds NaN

  KV_HD BorderedRows(Planes<T const> const& x, Border border, int64_t ky, int64_t kx, int64_t block)
      : x(x),
        border(border),
        ky(ky),
        kx(kx),
        pixels((ky + 1) * (whole_vectors<F>(block) + (kx - 1) * x.step)),
        flags(ky + 1),
        rows{pixels.data, ky + 1, whole_vectors<F>(block) + (kx - 1) * x.step},
        nan{flags.data, ky + 1, 1} {}

  KV_HD void fill(int64_t y) const {
    F* const out = rows.row(y);
    int64_t const count = size + (kx - 1) * x.step, start = first - median_before(kx) * x.step;
    int64_t const source_row = border_index(border, y, x.height);
    if (source_row < 0) {
      unpack_zeros(out, 0, count);
    } else {
      T const* const in = x.row(plane, source_row);
      prefetch(in + clamp(y + 2, int64_t(0), x.height - 1) * x.row_stride - source_row * x.row_stride);
      int64_t const low = max(-start, int64_t(0)), high = min(x.row_size() - start, count);
      unpack(in + start + low, high - low, out + low);
      auto const unpack_border = [&](int64_t e) {
        int64_t const from_left = start + e + median_before(kx) * x.step;  // not negative
        int64_t const pixel = from_left / x.step - median_before(kx), channel = from_left % x.step;
        int64_t const source = border_index(border, pixel, x.width);
        if (source < 0)
          unpack_zeros(out, e, e + 1);
        else
          unpack(in + source * x.step + channel, 1, out + e);
      };
      for (int64_t e = 0; e < low; ++e) unpack_border(e);
      for (int64_t e = high; e < count; ++e) unpack_border(e);
    }
    *nan.row(y) = has_nan<T>(out, count);
  }
  // The hardware does not prefetch the next row of a block.
  KV_HD void prefetch(T const* row) const {
    for (int64_t e = 0; e < size; e += 64 / int64_t(sizeof(T))) __builtin_prefetch(row + first + e);
  }
  KV_HD void unpack_zeros(F* out, int64_t begin, int64_t end) const {
    T const zero{};
    for (int64_t e = begin; e < end; ++e) unpack(&zero, 1, out + e);
  }

  // Writes row y of the result, unless `medians` is that row. Windows with NaN give NaN.
  KV_HD void write(F* medians, int64_t y, T* out) const {
    if constexpr (!__is_same(T, uint8_t))
      for (int64_t yy = y - median_before(ky); yy <= y + median_after(ky); ++yy)
        if (*nan.row(yy))
          for (int64_t dx = 0; dx < kx; ++dx)
            for (int64_t e = 0; e < size; ++e) {
              F const value = rows.row(yy)[e + dx * x.step];
              medians[e] = is_nan<T>(value) ? value : medians[e];
            }
    if ((void*)medians != out) store_row(medians, size, out);
  }
};

// Calls f(plane, first row, end of rows) for the part of each plane in rows [begin, end).
template <class F>
KV_HD void for_each_plane(int64_t height, int64_t begin, int64_t end, F f) {
  while (begin < end) {
    int64_t const y = begin % height, y_end = min(height, y + end - begin);
    f(begin / height, y, y_end);
    begin += y_end - y;
  }
}

// Elements of a block: long enough for fast reads, and the rows of a 5x5 network fit into the L2 cache.
template <class F>
KV_HD int64_t block_size(int64_t row_size, int64_t step) {
  return min(row_size, max(int64_t(8192 / sizeof(F)), 8 * step));
}

template <int K, class T>
void median_by_network(MedianBlur<T> const& p, int64_t begin, int64_t end) {
  using F = typename network_value<T>::type;
  using V = Vector<F>;
  constexpr int R = K / 2;
  int64_t const block = block_size<F>(p.x.row_size(), p.x.step), stride = whole_vectors<F>(block);
  BorderedRows<T, F> rows(p.x, p.border, K, K, block);
  Scratch<F> scratch((K + 1) * K * stride), medians(2 * stride);
  Ring<F> const runs{scratch.data, K + 1, K * stride};
  auto const sort = [&](int64_t y) {
    rows.fill(y);
    F *const from = rows.rows.row(y), *const to = runs.row(y);
    int64_t const size = rows.size, from_step = p.x.step,
                  to_step = stride;  // local copies, because stores may alias members
    for (int64_t e = 0; e < size; e += kWidth<F>) {
      V v[K];
      KV_UNROLL
      for (int i = 0; i < K; ++i) v[i] = read(from + e + i * from_step);
      sort_common<K>(v);
      insert_first<K>(v);
      KV_UNROLL
      for (int i = 0; i < K; ++i) write(to + e + i * to_step, v[i]);
    }
  };

  for_each_plane(p.x.height, begin, end, [&](int64_t plane, int64_t y_begin, int64_t y_end) {
    rows.plane = plane;
    for (rows.first = 0; rows.first < p.x.row_size(); rows.first += block) {
      rows.size = min(block, p.x.row_size() - rows.first);
      for (int64_t y = y_begin - R; y < y_begin + R; ++y) sort(y);
      for (int64_t y = y_begin; y < y_end; y += 2) {
        sort(y + R);
        sort(y + R + 1);
        F* run[K + 1];
        run[0] = runs.row(y - R);
        KV_UNROLL
        for (int i = 0; i < K; ++i) run[i + 1] = runs.below(run[i]);
        T *const out0 = p.y.row(plane, y) + rows.first, *const out1 = out0 + p.y.row_stride;
        bool const second = y + 1 < y_end;
        F *medians0 = medians.data, *medians1 = medians0 + stride;
        if constexpr (__is_same(T, F))
          if (rows.size % kWidth<F> == 0) {
            medians0 = out0;
            if (second) medians1 = out1;
          }
        int64_t const size = rows.size;
        for (int64_t e = 0; e < size; e += kWidth<F>) {
          auto const load_run = [&](int i, V(&v)[K]) {
            KV_UNROLL
            for (int k = 0; k < K; ++k) v[k] = read(run[i] + e + k * stride);
          };
          V middle[K + 1], a[K], b[K];
          load_run(1, a);
          load_run(2, b);
          if constexpr (K == 3) {
            middle_of_two<K>(a, b, middle);
          } else {
            V c[K], d[K], ab[2 * K], cd[2 * K];
            load_run(3, c);
            load_run(4, d);
            merge<K, K>(a, b, ab);
            merge<K, K>(c, d, cd);
            middle_of_two<K>(ab, cd, middle);
          }
          load_run(0, a);
          load_run(K, b);
          write<F>(medians0 + e, median_of<K>(middle, a));
          write<F>(medians1 + e, median_of<K>(middle, b));
        }
        rows.write(medians0, y, out0);
        if (second) rows.write(medians1, y + 1, out1);
      }
    }
  });
}

template <class T>
void median_by_search(MedianBlur<T> const& p, int64_t begin, int64_t end) {
  using F = MedianKey<T>;
  using V = Vector<F>;
  int64_t const block = block_size<F>(p.x.row_size(), p.x.step);
  BorderedRows<T, F> rows(p.x, p.border, p.ky, p.kx, block);
  Scratch<F> medians(whole_vectors<F>(block));
  F const rank = F((p.ky * p.kx - 1) / 2);

  for_each_plane(p.x.height, begin, end, [&](int64_t plane, int64_t y_begin, int64_t y_end) {
    rows.plane = plane;
    for (rows.first = 0; rows.first < p.x.row_size(); rows.first += block) {
      rows.size = min(block, p.x.row_size() - rows.first);
      int64_t const before = median_before(p.ky), after = median_after(p.ky);
      for (int64_t y = y_begin - before; y < y_begin + after; ++y) rows.fill(y);
      for (int64_t y = y_begin; y < y_end; ++y) {
        rows.fill(y + after);
        F* const top = rows.rows.row(y - before);
        for (int64_t e = 0; e < rows.size; e += kWidth<F>)
          write<F>(medians.data + e, select_key<T>(V{} + kLowestMedianKey<T>, rank, [&](V candidate) {
                     V below{};
                     F* row = top;
                     for (int64_t dy = 0; dy < p.ky; ++dy, row = rows.rows.below(row))
                       for (int64_t dx = 0; dx < p.kx; ++dx)
                         below -= read(row + e + dx * p.x.step) < candidate;  // true is -1
                     return below;
                   }));
        rows.write(medians.data, y, p.y.row(plane, y) + rows.first);
      }
    }
  });
}

// 3x3 windows of types that are computed as they are stored, directly from the image. The median of nine is the median
// of three values: the largest minimum, the median of medians and the smallest maximum of the columns. Two rows of
// results share the comparison of the two pixels that both have in a column. Windows with NaN are marked afterwards.
template <class T>
void median_3x3_direct(MedianBlur<T> const& p, int64_t begin, int64_t end) {
  int64_t const step = p.x.step, size = p.x.row_size(), width = p.x.width;
  Scratch<T> scratch(2 * size);
  T *const zeros = scratch.data, *const spare = zeros + size;
  for (int64_t e = 0; e < size; ++e) zeros[e] = T{};

  // Calls f(width, left, e, right) for all elements of a row; left and right are the indices of their neighbors, -1 for
  // 0.
  auto const for_each_element = [=, border = p.border](auto f) {
    auto const edge = [=](int64_t pixel) {
      int64_t const left = border_index(border, pixel - 1, width), right = border_index(border, pixel + 1, width);
      for (int64_t c = 0; c < step; ++c)
        f(Width<1>{}, left < 0 ? -1 : left * step + c, pixel * step + c, right < 0 ? -1 : right * step + c);
    };
    edge(0);
    for_each_vector<T, kWidth<T>>(step, size - step, [=](auto lanes, int64_t e) { f(lanes, e - step, e, e + step); });
    edge(width - 1);
  };
  auto const pixel = [](auto lanes, T const* row, int64_t at) {
    constexpr int N = decltype(lanes)::value;
    if constexpr (N == 1)
      if (at < 0) return T{};
    return read_lanes<N>(row + at);
  };

  for_each_plane(p.x.height, begin, end, [&](int64_t plane, int64_t y_begin, int64_t y_end) {
    auto const row = [&](int64_t y) -> T const* {
      int64_t const source = border_index(p.border, y, p.x.height);
      return source < 0 ? zeros : p.x.row(plane, source);
    };
    T const* rows[4] = {nullptr, nullptr, row(y_begin - 1), row(y_begin)};
    bool nan[4] = {false, false, has_nan<T>(rows[2], size), has_nan<T>(rows[3], size)};
    for (int64_t y = y_begin; y < y_end; y += 2) {
      for (int i = 0; i < 2; ++i) {
        rows[i] = rows[i + 2];
        nan[i] = nan[i + 2];
        rows[i + 2] = row(min(y + 1 + i, y_end));
        nan[i + 2] = has_nan<T>(rows[i + 2], size);
      }
      T* const out[] = {p.y.row(plane, y), y + 1 < y_end ? p.y.row(plane, y + 1) : spare};
      for_each_element([=](auto lanes, int64_t left, int64_t e, int64_t right) {
        using V = Lanes<T, decltype(lanes)::value>;
        int64_t const columns[] = {left, e, right};
        V largest_low[2], smallest_high[2], middle[2][3];
        KV_UNROLL
        for (int i = 0; i < 3; ++i) {
          V const b = pixel(lanes, rows[1], columns[i]), c = pixel(lanes, rows[2], columns[i]);
          V const shared_low = lower(b, c), shared_high = upper(b, c);
          KV_UNROLL
          for (int k = 0; k < 2; ++k) {
            V const single = pixel(lanes, rows[3 * k], columns[i]);
            V const low = lower(shared_low, single), rest = upper(shared_low, single);
            V const high = upper(rest, shared_high);
            middle[k][i] = lower(rest, shared_high);
            largest_low[k] = i == 0 ? low : upper(largest_low[k], low);
            smallest_high[k] = i == 0 ? high : lower(smallest_high[k], high);
          }
        }
        KV_UNROLL
        for (int k = 0; k < 2; ++k)
          write_lanes<decltype(lanes)::value>(
              out[k] + e, median_of_three(largest_low[k], median_of_three(middle[k][0], middle[k][1], middle[k][2]),
                                          smallest_high[k]));
      });
      for (int k = 0; k < 2; ++k)
        for (int i = k; i < k + 3; ++i)
          if (nan[i])
            for_each_element([=](auto lanes, int64_t left, int64_t e, int64_t right) {
              int64_t const columns[] = {left, e, right};
              for (int64_t l = 0; l < decltype(lanes)::value; ++l)
                for (int64_t at : columns)
                  if (at >= 0 && has_nan<T>(rows[i] + at + l, 1)) out[k][e + l] = rows[i][at + l];
            });
    }
  });
}

}  // namespace

// Special cases, one thread: networks are 17 to 30 times as fast as the search. Of them, 3 x 3 without a copy of rows
// is 1.2 times as fast for bytes, and as fast for floats.
template <class T>
void median_blur(MedianBlur<T> const& p, int64_t begin, int64_t end) {
  if (p.ky == 3 && p.kx == 3) {
    if constexpr (__is_same(T, typename network_value<T>::type))
      if (p.x.row_size() >= kWidth<T> + 2 * p.x.step) return median_3x3_direct(p, begin, end);
    return median_by_network<3>(p, begin, end);
  }
  if (p.ky == 5 && p.kx == 5) return median_by_network<5>(p, begin, end);
  median_by_search(p, begin, end);
}

// Streams down the rows. The medians of an output row, and the gradients of one tied pixel, g / (pixels of the window
// that equal the median), are stored in rings. Their rows have a border of r outputs: NaN, which equals no pixel, or
// with the circular border the outputs of the other end. A pixel gathers the gradients of the windows around it whose
// median it equals; near the border it counts how often each window reads it.
template <class T>
void median_blur_backward(MedianBlurBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const step = p.x.step, size = p.x.row_size(), width = p.x.width, height = p.x.height;
  int64_t const before_y = median_before(p.ky), after_y = median_after(p.ky);
  int64_t const before_x = median_before(p.kx), after_x = median_after(p.kx), ry = after_y, rx = after_x;
  int64_t const ring = 2 * ry + 1, padded = size + 2 * rx * step;  // rows and elements of outputs that may read a pixel
  BorderedRows<T, F> rows(p.x, p.border, p.ky, p.kx, size);
  rows.size = size;
  Scratch<F> scratch(2 * ring * padded);
  Ring<F> const medians{scratch.data + rx * step, ring, padded};
  int64_t const to_gradient = ring * padded;  // offset from a median to its gradient

  int64_t filled = 0;  // rows of x before this one are filled in `rows`
  auto const fill = [&](int64_t plane, int64_t q) {
    F *const m = medians.row(q), *const s = m + to_gradient;
    int64_t const at_row = p.border == Border::circular ? (q + height) % height : q;
    if (at_row < 0 || at_row >= height) {
      for (int64_t e = -rx * step; e < size + rx * step; ++e) m[e] = F(__builtin_nan(""));
      return;
    }
    if (at_row != filled - after_y)
      for (filled = at_row - before_y; filled < at_row + after_y;) rows.fill(filled++);
    for (; filled <= at_row + after_y; ++filled) rows.fill(filled);
    F* const top = rows.rows.row(at_row - before_y);
    T const *const y = p.y.row(plane, at_row), *const g = p.grad.row(plane, at_row);
    for_each_vector<T>(0, size, [&](auto lanes, int64_t e) {
      constexpr int N = decltype(lanes)::value;
      using V = Lanes<F, N>;
      V const median = load<N>(y + e);
      V equal{};
      F* row = top;
      for (int64_t dy = 0; dy < p.ky; ++dy, row = rows.rows.below(row))
        for (int64_t dx = 0; dx < p.kx; ++dx)
          equal += load<N>(row + e + dx * step) == median ? broadcast<N>(F(1)) : V{};
      store<N>(m + e, median);
      store<N>(s + e, load<N>(g + e) / equal);
    });
    for (int64_t e = 0; e < rx * step; ++e) {
      bool const repeats = p.border == Border::circular;
      m[e - rx * step] = repeats ? m[e - rx * step + size] : F(__builtin_nan(""));
      s[e - rx * step] = s[e - rx * step + size];
      m[size + e] = repeats ? m[e] : F(__builtin_nan(""));
      s[size + e] = s[e];
    }
  };

  for_each_plane(height, begin, end, [&](int64_t plane, int64_t y_begin, int64_t y_end) {
    rows.plane = plane;
    filled = -after_y - 2 * height;  // no row of this plane
    for (int64_t q = y_begin - ry; q < y_begin + ry; ++q) fill(plane, q);
    for (int64_t j = y_begin; j < y_end; ++j) {
      fill(plane, j + ry);
      F* const top = medians.row(j - ry);
      T const* const x = p.x.row(plane, j);
      T* const out = p.grad_x.row(plane, j);
      // reads(dx): how often the window of the output dx pixels away reads the pixel, along x
      auto const gather = [&](auto lanes, int64_t e, auto reads) {
        constexpr int N = decltype(lanes)::value;
        using V = Lanes<F, N>;
        V const value = load<N>(x + e);
        V sum{};
        F* median = top + e;
        for (int64_t q = j - ry; q <= j + ry; ++q, median = medians.below(median - e) + e) {
          F const times = F(median_read_count(p.border, q, j, height, before_y, after_y));
          for (int64_t dx = -rx; dx <= rx; ++dx)
            sum += load<N>(median + dx * step) == value
                       ? load<N>(median + to_gradient + dx * step) * (times * reads(dx))
                       : V{};
        }
        store<N>(out + e, sum);
      };
      int64_t const low = min(rx + 1, width) * step, high = max(low, size - (rx + 1) * step);
      auto const edge = [&](int64_t e) {
        int64_t const i = e / step;
        gather(Width<1>{}, e,
               [&](int64_t dx) { return F(median_read_count(p.border, i + dx, i, width, before_x, after_x)); });
      };
      for (int64_t e = 0; e < low; ++e) edge(e);
      for_each_vector<T>(low, high, [&](auto lanes, int64_t e) {
        gather(lanes, e, [&](int64_t dx) { return F(dx >= -after_x && dx <= before_x); });
      });
      for (int64_t e = high; e < size; ++e) edge(e);
    }
  });
}

template <class T>
void median_blur_list(MedianBlurList<T> const& p, int64_t begin, int64_t end) {
  filter_items(p, begin, end,
               [](MedianBlur<T> const& one, int64_t first, int64_t last) { KV_ISA::median_blur(one, first, last); });
}

template <class T>
void median_blur_list_backward(MedianBlurBackwardList<T> const& p, int64_t begin, int64_t end) {
  gradient_items(p, begin, end, [](MedianBlurBackward<T> const& one, int64_t first, int64_t last) {
    KV_ISA::median_blur_backward(one, first, last);
  });
}

KV_INSTANTIATE_WITH_BYTES(median_blur, MedianBlur)
KV_INSTANTIATE_WITH_BYTES(median_blur_list, MedianBlurList)
KV_INSTANTIATE(median_blur_backward, MedianBlurBackward)
KV_INSTANTIATE(median_blur_list_backward, MedianBlurBackwardList)

}  // namespace kv::filters::KV_ISA
