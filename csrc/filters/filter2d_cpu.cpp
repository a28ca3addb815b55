// Cross-correlation with any kernel on the CPU: one loop over blocks of rows in float32 or float64. It reads the image
// directly where possible; other types and pixels near the border are copied into a padded tile first. Rows [begin,
// end) of all planes in order; compiled once per instruction set.
#include "filter2d_cpu.h"

namespace kv::filters::KV_ISA {
namespace {

constexpr int kBlockRows = 8;  // output rows of a block
constexpr int kRows = 4;       // output rows that share loads

// Keeps a value in a register: GCC would load it again for each use.
template <class V>
KV_HD void keep([[maybe_unused]] V& v) {
#if defined(__x86_64__)
  asm("" : "+v"(v));
#endif
}

// out[o][e] = the sum over ky taps k and kx taps i of weights[i][k] * rows[o + k][e + i * step], for `count` <= kRows
// rows o and `size` elements e. The sum is added to `out` unless `fresh`. KY is ky where that is small, else 0. The
// last vector of a row overlaps the previous one if `overlap`; otherwise it ends after the row.
template <int KY, class F>
void correlate(F const* const* rows, F const* weights, int ky, int kx, int64_t step, F* out, int64_t out_stride,
               int count, int64_t size, bool fresh, bool overlap) {
  constexpr int N = kLanes<F>;
  using V = Lanes<F, N>;
  auto const vectors = [&](auto vector_count, int64_t e) KV_INLINE {
    constexpr int M = decltype(vector_count)::value;
    V sum[kRows][M];
    unroll<kRows>([&](auto o) KV_INLINE {
      unroll<M>([&](auto v) KV_INLINE {
        sum[o.value][v.value] = fresh || o.value >= count ? V{} : load<N>(out + o.value * out_stride + e + v.value * N);
      });
    });
    for (int i = 0; i < kx; ++i) {
      F const* const w = weights + i * ky;
      auto const add_row = [&](int r, auto first,
                               auto last) KV_INLINE {  // the outputs first ... last - 1 read row r
        V x[M];
        unroll<M>([&](auto v) KV_INLINE {
          x[v.value] = load<N>(rows[r] + e + i * step + v.value * N);
          keep(x[v.value]);
        });
        unroll<kRows>([&](auto o) KV_INLINE {
          if constexpr (o.value >= first.value && o.value < last.value)
            unroll<M>([&](auto v) KV_INLINE { sum[o.value][v.value] += x[v.value] * w[r - o.value]; });
        });
      };
      if constexpr (KY > 0) {
        unroll<KY + kRows - 1>([&](auto r)
                                   KV_INLINE { add_row(r.value, Width<r.value - KY + 1>{}, Width<r.value + 1>{}); });
      } else {
        unroll<kRows - 1>([&](auto r) KV_INLINE { add_row(r.value, Width<0>{}, Width<r.value + 1>{}); });
        for (int r = kRows - 1; r < ky; ++r) add_row(r, Width<0>{}, Width<kRows>{});
        unroll<kRows - 1>([&](auto r) KV_INLINE { add_row(ky + r.value, Width<r.value + 1>{}, Width<kRows>{}); });
      }
    }
    unroll<kRows>([&](auto o) KV_INLINE {
      if (o.value < count)
        unroll<M>([&](auto v)
                      KV_INLINE { store<N>(out + o.value * out_stride + e + v.value * N, sum[o.value][v.value]); });
    });
  };
  int64_t e = 0;
  for (; e + 2 * N <= size; e += 2 * N) vectors(Width<2>{}, e);
  for (; e < size; e += N) vectors(Width<1>{}, overlap ? min(e, size - N) : e);
}

template <class F>
auto correlate_for(int ky) {
  switch (ky) {
    case 1:
      return &correlate<1, F>;
    case 2:
      return &correlate<2, F>;
    case 3:
      return &correlate<3, F>;
    case 4:
      return &correlate<4, F>;
    case 5:
      return &correlate<5, F>;
    case 6:
      return &correlate<6, F>;
    case 7:
      return &correlate<7, F>;
    default:
      return &correlate<0, F>;
  }
}

// Copies a few columns of `rows` rows from y on. It goes column by column, so that the border rule along x is evaluated
// once for each.
template <class T>
KV_HD void copy_columns(Planes<T const> const& x, int64_t plane, int64_t y, int64_t rows, Border border, int64_t first,
                        int64_t count, Compute<T>* to, int64_t to_stride) {
  int64_t const step = x.step, above = clamp(-y, int64_t(0), rows), below = clamp(x.height - y, above, rows);
  T const* const top = x.plane(plane);
  for (int64_t i = 0; i < count; ++i, to += step) {
    int64_t const column = border_index(border, first + i, x.width);
    auto const copy = [&](int64_t r, int64_t row) {
      for (int64_t c = 0; c < step; ++c)
        to[r * to_stride + c] =
            row < 0 || column < 0 ? Compute<T>(0) : load<1>(top + row * x.row_stride + column * step + c);
    };
    for (int64_t r = 0; r < above; ++r) copy(r, border_index(border, y + r, x.height));
    for (int64_t r = above; r < below; ++r) copy(r, y + r);
    for (int64_t r = below; r < rows; ++r) copy(r, border_index(border, y + r, x.height));
  }
}

}  // namespace

template <class T>
void filter2d(Filter2d<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  constexpr int N = kLanes<F>;
  KernelAxis const tx = p.axis_x, ty = p.axis_y, tz = p.axis_z;
  int64_t const step = p.x.step, width = p.y.width, height = p.y.height, overhang = tx.size - 1;
  struct Span {
    int64_t first, count;  // pixels
  };
  // The outputs whose taps reach out of bounds at either end, and those between them.
  int64_t const after = max(int64_t(0), width - p.x.width + overhang - tx.before);
  Span const left_edge{0, tx.before}, right_edge{width - after, after}, inside{tx.before, width - after - tx.before};
  // With accumulation: the positions out of bounds that are added to pixels.
  bool const accumulates = p.accumulation != Border::constant;
  Span const left{accumulates ? tx.before - overhang : 0, accumulates ? overhang - tx.before : 0},
      right{width, accumulates ? tx.before : 0};
  int64_t const above = accumulates ? ty.size - 1 - ty.before : 0, below = accumulates ? ty.before : 0;

  int64_t const sum_stride = max(width, 2 * overhang + overhang) * step + 2 * N,
                tile_stride = sum_stride + overhang * step;
  int64_t const tile_rows = kBlockRows + ty.size - 1;
  Scratch<F> scratch(tile_rows * tile_stride + 2 * kBlockRows * sum_stride + p.x.row_size() + p.taps());
  F *const tile = scratch.data, *const sums = tile + tile_rows * tile_stride,
           *const partial = sums + kBlockRows * sum_stride, *const zeros = partial + kBlockRows * sum_stride,
           *const weights = zeros + p.x.row_size();
  for (int64_t e = 0; e < p.x.row_size(); ++e) zeros[e] = 0;
  for (int64_t e = 0; e < tile_rows * tile_stride; ++e)
    tile[e] = 0;  // vectors may end after rows, and denormals would be slow
  Scratch<F const*> rows(tile_rows + kRows);
  auto const correlate = correlate_for<F>(ty.size);

  F const* kernel = nullptr;  // `weights` holds its taps column by column, flipped if p.flip
  auto const arrange_weights = [&](F const* sample_kernel) {
    if (sample_kernel == kernel) return;
    kernel = sample_kernel;
    for (int z = 0; z < tz.size; ++z)
      for (int y = 0; y < ty.size; ++y)
        for (int x = 0; x < tx.size; ++x) {
          int const tap = (z * ty.size + y) * tx.size + x;
          weights[(z * tx.size + x) * ty.size + y] = kernel[p.flip ? p.taps() - 1 - tap : tap];
        }
  };

  // Filters `count` rows into `out`; row_at(r) is input row r.
  auto const filter_rows = [&](auto row_at, int64_t count, int kz, F* out, int64_t out_stride, int64_t size, bool fresh,
                               bool overlap) {
    int64_t const last = count + ty.size - 2;
    for (int64_t r = 0; r <= last + kRows; ++r) rows.data[r] = row_at(min(r, last));
    for (int64_t o = 0; o < count; o += kRows)
      correlate(rows.data + o, weights + kz * ty.size * tx.size, ty.size, tx.size, step, out + o * out_stride,
                out_stride, int(min(count - o, int64_t(kRows))), size, fresh, overlap);
  };

  // Filters rows y ... y + count - 1 at two spans of columns, which `out` has next to each other with a gap of
  // `overhang` pixels. Rows and columns may be out of bounds.
  auto const filter_spans = [&](int64_t plane, int64_t y, int64_t count, Span a, Span b, F* out) {
    int64_t const z = plane % p.depth;
    Span const spans[] = {a, b};
    bool fresh = true;
    auto const filter_plane = [&](int64_t from, int kz) {
      int64_t const tile_count = count + ty.size - 1;
      F* to = tile;
      for (Span const span : spans) {
        if (span.count == 0) continue;
        int64_t const first = span.first - tx.before, pixels = span.count + overhang;
        if (span.count < width)
          copy_columns<T>(p.x, from, y - ty.before, tile_count, p.border, first, pixels, to, tile_stride);
        else
          for (int64_t r = 0; r < tile_count; ++r)
            copy_pixels<T>(p.x, from, y - ty.before + r, p.border, first, pixels, to + r * tile_stride);
        to += pixels * step;
      }
      int64_t const pixels = a.count && b.count ? a.count + overhang + b.count : a.count + b.count;
      filter_rows([&](int64_t r) { return tile + r * tile_stride; }, count, kz, out, sum_stride, pixels * step, fresh,
                  false);
      fresh = false;
    };
    for_each_reader(p.accumulation, z, int64_t(p.depth), int64_t(tz.size - 1 - tz.before), int64_t(tz.before),
                    [&](int64_t at) {
                      for (int kz = 0; kz < tz.size; ++kz) {
                        int64_t const from = border_index(p.border, at + kz - tz.before, int64_t(p.depth));
                        if (from >= 0) filter_plane(plane - z + from, kz);
                      }
                    });
  };

  // Results are written to the image directly if it has the compute type and rows of at least a vector.
  bool const direct = __is_same(T, F) && tz.size == 1 && inside.count * step >= N;

  for (int64_t r = begin; r < end;) {
    int64_t const plane = r / height, y = r % height, count = min(min(height - y, end - r), int64_t(kBlockRows));
    arrange_weights(p.kernel_of(plane));
    F* out = sums;
    int64_t out_stride = sum_stride;

    // Filters two spans of rows q ... q + n - 1 and adds or stores the results to the rows of this block.
    auto const merge = [&](int64_t q, int64_t n, Span a, Span b, bool add) {
      if (a.count + b.count == 0) return;
      Span const spans[] = {a, b};
      filter_spans(plane, q, n, a, b, partial);
      for (int64_t o = 0; o < n; ++o) {
        int64_t const row = border_index(p.accumulation, q + o, height) - y;
        if (row < 0 || row >= count) continue;
        F const* from = partial + o * sum_stride;
        for (Span const span : spans) {
          if (span.count == 0) continue;
          for (int64_t i = 0; i < span.count; ++i) {
            F* const to = out + row * out_stride + border_index(p.accumulation, span.first + i, width) * step;
            for (int64_t c = 0; c < step; ++c) to[c] = add ? to[c] + from[i * step + c] : from[i * step + c];
          }
          from += (span.count + overhang) * step;
        }
      }
    };
    auto const accumulate_rows = [&](int64_t first, int64_t last) {
      for (int64_t q = first; q < last; q += kBlockRows) {
        int64_t const n = min(last - q, int64_t(kBlockRows));
        bool meets = false;
        for (int64_t o = 0; o < n; ++o) {
          int64_t const row = border_index(p.accumulation, q + o, height) - y;
          meets |= row >= 0 && row < count;
        }
        if (!meets) continue;
        merge(q, n, {0, width}, {0, 0}, true);
        merge(q, n, left, right, true);
      }
    };

    if constexpr (__is_same(T, F)) {
      if (direct) {
        out = p.y.row(plane, y), out_stride = p.y.row_stride;
        auto const row_at = [&](int64_t r) -> F const* {
          int64_t const from = border_index(p.border, y - ty.before + r, p.x.height);
          return from < 0 ? zeros : p.x.row(plane, from);
        };
        filter_rows(row_at, count, 0, out + inside.first * step, out_stride, inside.count * step, true, true);
        merge(y, count, left_edge, right_edge, false);
      }
    }
    if (!direct) filter_spans(plane, y, count, {0, width}, {0, 0}, sums);
    merge(y, count, left, right, true);
    accumulate_rows(-above, 0);
    accumulate_rows(height, height + below);
    if (!direct || p.clamps)
      for (int64_t o = 0; o < count; ++o)
        for_each_vector<T>(0, width * step, [&](auto lanes, int64_t e) {
          constexpr int N = decltype(lanes)::value;
          Lanes<F, N> const v = load<N>(out + o * out_stride + e);
          store<N>(p.y.row(plane, y + o) + e, p.clamps ? p.clamped(v) : v);
        });
    r += count;
  }
}

template <class T>
void filter2d_list(Filter2dList<T> const& p, int64_t begin, int64_t end) {
  filter_items(p, begin, end,
               [](Filter2d<T> const& one, int64_t first, int64_t last) { KV_ISA::filter2d(one, first, last); });
}

KV_INSTANTIATE_WITH_BYTES(filter2d, Filter2d)
KV_INSTANTIATE_WITH_BYTES(filter2d_list, Filter2dList)

}  // namespace kv::filters::KV_ISA
