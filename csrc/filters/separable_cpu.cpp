// Separable filters on the CPU: output rows [begin, end) of all planes in order. A row is filtered along y from the
// image into a buffer, the buffer is extended by the border, and the row is filtered along x from there. Compiled once
// per instruction set.
#include "core/lanes.h"
#include "core/scratch.h"
#include "separable.h"

namespace kv::filters::KV_ISA {
namespace {

template <class F>
KV_HD void load_weights(Taps<F> const& taps, int64_t sample, F scale, F* weights) {
  F sum = 0;
  for (int t = 0; t < taps.size; ++t) sum += weights[t] = tap_weight(taps, sample, t);
  if (taps.gaussian) scale /= sum;
  for (int t = 0; t < taps.size; ++t) weights[t] *= scale;
}

// Calls put(width, r, e, sum over i of weights[i] * rows[r + i][e]) for r < R and e in [begin, end). It serves both
// axes: along y the rows are those of the image, along x they are one row, shifted. R results share their loads.
template <int R, class T, class Put>
KV_HD void sum_rows(T const* const* rows, Compute<T> const* weights, int count, int64_t begin, int64_t end, Put put) {
  using F = Compute<T>;
  constexpr int N = kLanes<T>,
                U = R == 1 ? 8 : kVectorBytes == 64 ? 4 : 2;  // the sums fill the registers
  auto const block = [&](auto width, auto unroll, int64_t e) {
    constexpr int M = decltype(width)::value, V = decltype(unroll)::value;
    Lanes<F, M> sum[R][V] = {};
    for (int i = 0; i < count + R - 1; ++i) {
      Lanes<F, M> pixels[V];
      for (int v = 0; v < V; ++v) pixels[v] = load<M>(rows[i] + e + v * M);
      for (int r = 0; r < R; ++r)
        if (R == 1 || unsigned(i - r) < unsigned(count))
          for (int v = 0; v < V; ++v) sum[r][v] += pixels[v] * weights[i - r];
    }
    for (int r = 0; r < R; ++r)
      for (int v = 0; v < V; ++v) put(width, r, e + v * M, sum[r][v]);
  };
  for (; begin + U * N <= end; begin += U * N) block(Width<N>{}, Width<U>{}, begin);
  if (begin < end) for_each_vector<T>(begin, end, [&](auto width, int64_t e) { block(width, Width<1>{}, e); });
}

// The border of a row: `left` pixels before it, then `right` pixels after it, with the pixel of the row that each
// repeats.
struct RowBorder {
  int64_t width, left, count;
  Scratch<int64_t> table;

  KV_HD RowBorder(Border border, int64_t width, int64_t left, int64_t right)
      : width(width), left(left), count(left + right), table(left + right) {
    for (int64_t i = 0; i < count; ++i) table.data[i] = border_index(border, position(i), width);
  }
  KV_HD int64_t position(int64_t i) const { return i < left ? i - left : width + i - left; }

  // Fills the border from the row.
  template <class F>
  KV_HD void extend(F* row, int64_t step) const {
    for (int64_t i = 0; i < count; ++i)
      for (int64_t c = 0; c < step; ++c)
        row[position(i) * step + c] = table.data[i] < 0 ? F(0) : row[table.data[i] * step + c];
  }
  // Adds the border to the row, the transpose of extend.
  template <class F>
  KV_HD void accumulate(F* row, int64_t step) const {
    for (int64_t i = 0; i < count; ++i)
      for (int64_t c = 0; c < step; ++c) row[table.data[i] * step + c] += row[position(i) * step + c];
  }
};

// The rows of the image that output row y sums, with their weights. Returns their number.
template <class T>
KV_HD int weighted_rows(Separable<T> const& p, int64_t plane, int64_t y, Compute<T> const* ky, T const** rows,
                        Compute<T>* weights) {
  int64_t const height = p.x.height, size = p.ky.size, before = p.ky.before;
  int count = 0;
  if (p.accumulation == Border::constant) {
    for (int64_t t = 0; t < size; ++t) {
      int64_t const source = border_index(p.border, y - before + t, height);
      if (source < 0) continue;
      rows[count] = p.x.row(plane, source);
      weights[count++] = ky[t];
    }
  } else {  // all positions whose border row is y read rows around y
    int64_t const first = max(y - size, int64_t(0)), last = min(y + size, height - 1);
    for (int64_t r = first; r <= last; ++r) weights[r - first] = 0;
    int64_t low = last, high = first;
    for_each_reader(p.accumulation, y, height, int64_t(p.ky.front()), int64_t(p.ky.back()), [&](int64_t q) {
      int64_t const begin = max(q - before, int64_t(0)), end = min(q - before + size, height);
      for (int64_t r = begin; r < end; ++r) weights[r - first] += ky[r - q + before];
      if (begin < end) low = min(low, begin), high = max(high, end - 1);
    });
    for (int64_t r = low; r <= high; ++r) {
      rows[count] = p.x.row(plane, r);
      weights[count++] = weights[r - first];
    }
  }
  return count;
}

constexpr int64_t round_up(int64_t elements) { return (elements + 15) / 16 * 16; }  // to 64 bytes and more

// sums[i] += sum over e of a[e] * rows[i][e]
template <class F>
KV_HD void add_products(F const* a, F const* const* rows, int64_t count, int64_t size, F* sums) {
  constexpr int N = kLanes<F>;
  auto const products = [&](auto unroll, int64_t i) {
    constexpr int U = decltype(unroll)::value;
    Lanes<F, N> sum[U] = {};
    F rest[U] = {};
    int64_t e = 0;
    for (; e + N <= size; e += N)
      for (int u = 0; u < U; ++u) sum[u] += load<N>(a + e) * load<N>(rows[i + u] + e);
    for (; e < size; ++e)
      for (int u = 0; u < U; ++u) rest[u] += a[e] * rows[i + u][e];
    for (int u = 0; u < U; ++u) {
      for (int l = 0; l < N; ++l) rest[u] += sum[u][l];
      sums[i + u] += rest[u];
    }
  };
  int64_t i = 0;
  for (; i + 4 <= count; i += 4) products(Width<4>{}, i);
  for (; i < count; ++i) products(Width<1>{}, i);
}

}  // namespace

template <class T>
void separable(Separable<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  constexpr int kRows = 4;  // computed at once, except where the border is accumulated along y
  int const taps_x = p.kx.size, taps_y = p.ky.size;
  int64_t const step = p.x.step, width = p.y.width, height = p.y.height, size = p.x.row_size();
  bool const accumulates = p.accumulation != Border::constant;
  int64_t const front = accumulates ? p.kx.front() : 0, back = accumulates ? p.kx.back() : 0, before = p.kx.before;
  RowBorder const input_border(p.border, p.x.width, before + front,
                               max(width - p.x.width + taps_x - 1 - before, int64_t(0)) + back);
  RowBorder const output_border(p.accumulation, width, front, back);

  // Rows start at whole vectors, with room for their borders.
  int64_t const margin = round_up(taps_x * step), padded = round_up(max(size, width * step)) + 2 * margin;
  Scratch<F> rows((kRows + 1) * padded), weights(taps_x + 3 * taps_y + 2);
  F *const row = rows.data + margin, *const full_row = row + kRows * padded;
  F *const kx = weights.data, *const ky = kx + taps_x, *const ky_of_row = ky + taps_y;
  Scratch<T const*> pointers(2 * taps_y + kRows);
  Scratch<F const*> shifted_rows(taps_x);
  for (int t = 0; t < taps_x; ++t) shifted_rows.data[t] = row + (t - before) * step;
  Scratch<T> zeros(size);
  for (int64_t e = 0; e < size; ++e) zeros.data[e] = T{};

  // Filters row k of the buffer along x into the row `out`; `in` is the input row of the same position.
  auto const along_x = [&](int k, T const* in, T* out) {
    int64_t const offset = k * padded;
    input_border.extend(row + offset, step);
    auto const put = [&](auto n, int64_t e, auto sum) {
      constexpr int N = decltype(n)::value;
      if (p.beta != 0) sum += load<N>(in + e) * p.beta;
      store<N>(out + e, sum);
    };
    auto const filter = [&](auto put) {
      sum_rows<1>(shifted_rows.data, kx, taps_x, offset - front * step, offset + (width + back) * step,
                  [&](auto n, int, int64_t e, auto sum) { put(n, e - offset, sum); });
    };
    if (!accumulates) return filter(put);
    filter([&](auto n, int64_t e, auto sum) { store<decltype(n)::value>(full_row + e, sum); });
    output_border.accumulate(full_row, step);
    for_each_vector<T>(0, width * step, [&](auto n, int64_t e) { put(n, e, load<decltype(n)::value>(full_row + e)); });
  };

  int64_t sample = -1;
  for (int64_t r = begin, count; r < end; r += count) {
    int64_t const plane = r / height, y = r % height;
    if (sample != plane / p.planes) {
      sample = plane / p.planes;
      load_weights(p.kx, sample, F(1), kx);
      load_weights(p.ky, sample, p.alpha, ky);
    }
    bool const near_border = accumulates && (y <= p.ky.front() || y + kRows - 1 >= height - 1 - p.ky.back());
    count = !near_border && y + kRows <= height && r + kRows <= end ? kRows : 1;
    auto const put = [&](auto n, int k, int64_t e, auto sum) { store<decltype(n)::value>(row + k * padded + e, sum); };
    if (count == kRows) {
      for (int i = 0; i < taps_y + kRows - 1; ++i) {
        int64_t const source = border_index(p.border, y - p.ky.before + i, p.x.height);
        pointers.data[i] = source < 0 ? zeros.data : p.x.row(plane, source);
      }
      sum_rows<kRows>(pointers.data, ky, taps_y, 0, size, put);
    } else {
      int const count_of_row = weighted_rows(p, plane, y, ky, pointers.data, ky_of_row);
      sum_rows<1>(pointers.data, ky_of_row, count_of_row, 0, size, put);
    }
    // Prefetch the rows that the next results read first.
    for (int64_t i = 0; i < count; ++i) {
      int64_t const next = y + count + taps_y - 1 - p.ky.before + i;
      if (next < p.x.height)
        for (int64_t e = 0; e < size; e += 64 / int64_t(sizeof(T))) __builtin_prefetch(p.x.row(plane, next) + e);
    }
    for (int k = 0; k < count; ++k) along_x(k, p.x.row(plane, y + k), p.y.row(plane, y + k));
  }
}

template <class T>
void separable_list(SeparableList<T> const& p, int64_t begin, int64_t end) {
  filter_items(p, begin, end,
               [](Separable<T> const& one, int64_t first, int64_t last) { KV_ISA::separable(one, first, last); });
}

template <class T>
void separable_weights_backward(SeparableWeightsBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int const taps_x = p.kx.size, taps_y = p.ky.size;
  int64_t const size = p.grad.width;
  int64_t const left = p.kx.before;
  RowBorder const input_border(p.border, p.x.width, left,
                               max(p.grad.width - p.x.width + taps_x - 1 - left, int64_t(0)));
  int64_t const padded = p.x.width + 2 * taps_x;
  Scratch<F> scratch(taps_x + 2 * taps_y + padded + size * (taps_y + 1));
  F *const kx = scratch.data, *const ky = kx + taps_x, *const weights = ky + taps_y;
  F *const row = weights + taps_y + taps_x, *const grad = row + (padded - taps_x);
  F* const ring = grad + size;  // rows filtered along x: the row of position i is at i modulo taps_y
  Scratch<T const*> pointers(taps_y);
  Scratch<F const*> shifted_rows(taps_x), filtered(taps_y);
  for (int64_t t = 0; t < taps_x; ++t) shifted_rows.data[t] = row + t - left;

  auto const store_to = [](F* to) {
    return [to](auto n, int, int64_t e, auto sum) { store<decltype(n)::value>(to + e, sum); };
  };

  int64_t sample = -1;
  for (int64_t tile = begin; tile < end; ++tile) {
    if (sample != tile / p.tiles()) {
      sample = tile / p.tiles();
      load_weights(p.kx, sample, F(1), kx);
      load_weights(p.ky, sample, F(1), ky);
    }
    int64_t const plane = tile / p.down(), y0 = tile % p.down() * p.tile_height;
    int64_t const y1 = min(y0 + p.tile_height, p.grad.height);
    F* const sums = p.sums + tile * (taps_x + taps_y);
    for (int64_t t = 0; t < taps_x + taps_y; ++t) sums[t] = 0;

    for (int64_t y = y0; y < y1; ++y) {
      // Filter along x the rows of the image that enter the window with row y.
      int64_t const top = y - p.ky.before;
      for (int64_t i = y == y0 ? top : top + taps_y - 1; i < top + taps_y; ++i) {
        F* const to = ring + (i + taps_y) % taps_y * size;
        int64_t const r = border_index(p.border, i, p.x.height);
        F const one = 1;
        T const* const source = p.x.row(plane, r);
        sum_rows<1>(&source, &one, r < 0 ? 0 : 1, 0, p.x.width, store_to(row));
        input_border.extend(row, 1);
        sum_rows<1>(shifted_rows.data, kx, taps_x, 0, size, store_to(to));
      }
      int count = 0;
      for (int t = 0; t < taps_y; ++t) {
        filtered.data[t] = ring + (top + t + taps_y) % taps_y * size;
        int64_t const r = border_index(p.border, top + t, p.x.height);
        if (r < 0) continue;
        pointers.data[count] = p.x.row(plane, r);
        weights[count++] = ky[t];
      }
      sum_rows<1>(pointers.data, weights, count, 0, p.x.width, store_to(row));
      input_border.extend(row, 1);

      T const* const g = p.grad.row(plane, y);
      for_each_vector<T>(0, size, [&](auto n, int64_t e) {
        constexpr int N = decltype(n)::value;
        store<N>(grad + e, load<N>(g + e));
      });
      add_products<F>(grad, shifted_rows.data, taps_x, size, sums);
      add_products<F>(grad, filtered.data, taps_y, size, sums + taps_x);
    }
  }
}

KV_INSTANTIATE_WITH_BYTES(separable, Separable)
KV_INSTANTIATE_WITH_BYTES(separable_list, SeparableList)
KV_INSTANTIATE(separable_weights_backward, SeparableWeightsBackward)

}  // namespace kv::filters::KV_ISA
