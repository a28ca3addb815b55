// The JPEG approximation on the CPU: 16 rows of an image at a time, in tiles of 64 columns. Compiled once per
// instruction set.
#include "core/border.h"
#include "core/lanes.h"
#include "core/scratch.h"
#include "jpeg.h"

namespace kv::enhance::KV_ISA {
namespace {

// Values and gradients of a tile. Chroma has a halo of one pixel; rows are padded so that vectors may extend beyond it.
template <class F>
struct JpegTile {
  static constexpr int kPitch = kJpegWidth + 16;
  F luma[kJpegSide][kJpegWidth];
  F chroma[2][kJpegSide + 2][kPitch];
  F half[2][kJpegSide / 2][kJpegWidth / 2];

  // The size of a plane, and of downsampled chroma.
  KV_HD F* at(int plane, int y, int x) { return plane == 0 ? &luma[y][x] : &half[plane - 1][y][x]; }
  KV_HD static int pitch(int plane) { return plane == 0 ? kJpegWidth : kJpegWidth / 2; }
};

// The position of a tile in a padded image.
struct JpegTilePosition {
  int64_t b;
  int y, x, height, width, columns;

  template <class F>
  KV_HD JpegTilePosition(JpegLevels<F> const& levels, int64_t r, int x)
      : b(r / (levels.height / kJpegSide)),
        y(int(r % (levels.height / kJpegSide)) * kJpegSide),
        x(x),
        height(int(levels.height)),
        width(int(levels.width)),
        columns(min(kJpegWidth, width - x)) {}
};

// Calls f(tile) for the tiles of units [begin, end).
template <class F, class Call>
KV_HD void for_each_tile(JpegLevels<F> const& levels, int64_t begin, int64_t end, Call const& f) {
  for (int64_t r = begin; r < end; ++r)
    for (int x = 0; x < int(levels.width); x += kJpegWidth) f(JpegTilePosition(levels, r, x));
}

// Calls f(width, x) for [begin, end), in vectors where pixels are contiguous.
template <class T, class Call>
KV_HD void for_each_pixel(int64_t step, int64_t begin, int64_t end, Call const& f) {
  if (step == 1) return for_each_vector<T>(begin, end, f);
  for (int64_t x = begin; x < end; ++x) f(Width<1>{}, x);
}

template <int N, class T>
KV_HD JpegColor<Lanes<Compute<T>, N>> load_color(Images<T const> const& x, int64_t b, int64_t row, int64_t column) {
  T const* const at = x.row(b, 0, row) + column * x.step;
  return {{load<N>(at), load<N>(at + x.channel_stride), load<N>(at + 2 * x.channel_stride)}};
}

// Levels of luma, and of chroma with its halo.
template <class T>
KV_HD void load_levels(Images<T const> const& x, JpegTilePosition const& at, JpegTile<Compute<T>>& tile) {
  using F = Compute<T>;
  int const end = min(at.x + at.columns, int(x.width));
  for (int j = -1; j <= kJpegSide; ++j) {
    int const row = min(border_index(Border::reflect, at.y + j, at.height), int(x.height) - 1);
    bool const inner = j >= 0 && j < kJpegSide;
    auto const pixel = [&](auto n, int64_t from, int64_t to) {
      constexpr int N = decltype(n)::value;
      auto const rgb = load_color<N>(x, at.b, row, from);
      auto const levels = jpeg_levels<F>(rgb.v[0], rgb.v[1], rgb.v[2]);
      if (inner && to >= 0 && to < at.columns) store<N>(tile.luma[j] + to, levels.v[0]);
      for (int c = 0; c < 2; ++c) store<N>(tile.chroma[c][j + 1] + 1 + to, levels.v[1 + c]);
    };
    for_each_pixel<T>(x.step, at.x, end, [&](auto n, int64_t i) { pixel(n, i, i - at.x); });
    for (int i = end - at.x; i < at.columns; ++i) pixel(Width<1>{}, x.width - 1, i);
    auto const adjacent = [&](int i) {
      pixel(Width<1>{}, min(border_index(Border::reflect, at.x + i, at.width), int(x.width) - 1), i);
    };
    adjacent(-1);
    adjacent(at.columns);
  }
}

// Downsampling: reads four pixels along both axes for every second pixel of a tile's chroma and its halo.
template <class F, class Combine>
KV_HD void halve(JpegTile<F>& tile, int columns, Combine const& combine) {
  F rows[JpegTile<F>::kPitch];
  for (int c = 0; c < 2; ++c)
    for (int y = 0; y < kJpegSide / 2; ++y) {
      auto const* const from = tile.chroma[c] + 2 * y;
      for_each_vector<F>(0, columns + 2, [&](auto n, int64_t i) {
        constexpr int N = decltype(n)::value;
        auto const row = [&](int k) { return load<N>(from[k] + i); };
        store<N>(rows + i, combine(row(0), row(1), row(2), row(3)));
      });
      for (int i = 0; i < columns / 2; i += 8) {
        auto const at = [&](int k) { return load<8>(rows + 2 * i + k); };
        auto const a = at(0), b = at(8), c2 = at(2), d = at(10);
        store<8>(tile.half[c][y] + i,
                 combine(every_second<0>(a, b), every_second<1>(a, b), every_second<0>(c2, d), every_second<1>(c2, d)));
      }
    }
}

// --- blocks: eight vectors of eight ----------------------------------------------------------------------------------

template <class V>
KV_HD void transpose(V (&v)[8]) {
  for (int i = 0; i < 4; ++i) {
    V const a = v[i], b = v[i + 4];
    v[i] = __builtin_shufflevector(a, b, 0, 1, 2, 3, 8, 9, 10, 11);
    v[i + 4] = __builtin_shufflevector(a, b, 4, 5, 6, 7, 12, 13, 14, 15);
  }
  for (int k = 0; k < 4; ++k) {
    int const i = k / 2 * 4 + k % 2;
    V const a = v[i], b = v[i + 2];
    v[i] = __builtin_shufflevector(a, b, 0, 1, 8, 9, 4, 5, 12, 13);
    v[i + 2] = __builtin_shufflevector(a, b, 2, 3, 10, 11, 6, 7, 14, 15);
  }
  for (int i = 0; i < 8; i += 2) {
    V const a = v[i], b = v[i + 1];
    v[i] = __builtin_shufflevector(a, b, 0, 8, 2, 10, 4, 12, 6, 14);
    v[i + 1] = __builtin_shufflevector(a, b, 1, 9, 3, 11, 5, 13, 7, 15);
  }
}

// Transforms the rows of a block and transposes them to columns of coefficients.
template <class F, class V>
KV_HD void to_coefficients(V (&v)[8]) {
  jpeg_transform<F>(v);
  transpose(v);
  jpeg_transform<F>(v);
}
template <class F, class V>
KV_HD void to_rows(V (&v)[8]) {
  jpeg_inverse<F>(v);
  transpose(v);
  jpeg_inverse<F>(v);
}

template <class F>
KV_HD void load_block(F const* from, int64_t pitch, Lanes<F, 8> (&v)[8]) {
  for (int i = 0; i < 8; ++i) v[i] = load<8>(from + i * pitch);
}
template <class F>
KV_HD void store_block(F* to, int64_t pitch, Lanes<F, 8> const (&v)[8]) {
  for (int i = 0; i < 8; ++i) store<8>(to + i * pitch, v[i]);
}

// The quantization steps of luma and chroma, transposed: one row per column of coefficients.
template <class F>
struct JpegSteps {
  F of[2][8][8];
  int64_t image = -1;

  KV_HD void find(JpegTables<F> const& tables, int64_t b) {
    if (b == image) return;
    image = b;
    F const percent = jpeg_percent(jpeg_quality(tables, b)).value;
    for (int i = 0; i < 128; ++i) of[i / 64][i % 8][i / 8 % 8] = jpeg_step(jpeg_table(tables, b, i), percent).value;
  }
};

// Calls f(plane, y, x) for the blocks of a tile.
template <class Call>
KV_HD void for_each_block(int columns, Call const& f) {
  for (int plane = 0; plane < 3; ++plane)
    for (int y = 0; y < (plane == 0 ? kJpegSide : kJpegSide / 2); y += 8)
      for (int x = 0; x < (plane == 0 ? columns : columns / 2); x += 8) f(plane, y, x);
}
// The position of a tile's block in the planes of levels.
template <class F>
KV_HD F* block_of(JpegLevels<F> const& levels, JpegTilePosition const& at, int plane, int y, int x) {
  int const scale = plane == 0 ? 1 : 2;
  return levels.row(at.b, plane, at.y / scale + y) + at.x / scale + x;
}

// --- upsampled rows of chroma ----------------------------------------------------------------------------------------

// `n` pixels, a multiple of 8, with one more on either side and padding for vector loads.
template <class F>
struct HalfRow {
  Scratch<F> memory;
  F* const data;
  int64_t const n;
  explicit KV_HD HalfRow(int64_t n) : memory(n + 32), data(memory.data + 16), n(n) {}

  KV_HD void interpolate(JpegLevels<F> const& levels, int64_t b, int plane, JpegPair<F> const& rows) const {
    F const *const near = levels.row(b, plane, rows.near), *const far = levels.row(b, plane, rows.far);
    for (int64_t i = 0; i < n; i += 8)
      store<8>(data + i, load<8>(near + i) * rows.near_weight + load<8>(far + i) * rows.far_weight);
  }
  // Calls f(vector, x) for pixels x ... x + 7 of 2 n, each interpolated between its near and its far pixel.
  template <class Call>
  KV_HD void spread(F near_weight, F far_weight, Call const& f) const {
    for (int64_t i = 0; i < n; i += 8) {
      auto const own = load<8>(data + i) * near_weight;
      auto const even = own + load<8>(data + i - 1) * far_weight, odd = own + load<8>(data + i + 1) * far_weight;
      f(__builtin_shufflevector(even, odd, 0, 8, 1, 9, 2, 10, 3, 11), 2 * i);
      f(__builtin_shufflevector(even, odd, 4, 12, 5, 13, 6, 14, 7, 15), 2 * i + 8);
    }
  }
};

// The upsampled chroma of a row of pixels.
template <class F>
struct DoubledRow {
  HalfRow<F> half;
  Scratch<F> memory;
  explicit KV_HD DoubledRow(int64_t width) : half(width / 2), memory(2 * width) {}
  KV_HD F* of(int c) const { return memory.data + 2 * c * half.n; }
  KV_HD void fill(JpegLevels<F> const& levels, int64_t b, int64_t y) const {
    auto const rows = jpeg_doubled<F>(int(y), int(levels.height));
    for (int c = 0; c < 2; ++c) {
      half.interpolate(levels, b, 1 + c, rows);
      half.data[-1] = half.data[0];
      half.data[half.n] = half.data[half.n - 1];
      half.spread(rows.near_weight, rows.far_weight, [&](auto const& v, int64_t x) { store<8>(of(c) + x, v); });
    }
  }
};

}  // namespace

template <class T>
void jpeg_blocks(JpegBlocks<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  JpegTile<F> tile;
  JpegSteps<F> steps;
  for_each_tile(p.levels, begin, end, [&](JpegTilePosition const& at) {
    steps.find(p.tables, at.b);
    load_levels(p.x, at, tile);
    halve(tile, at.columns, [](auto const&... v) { return jpeg_halved<F>(v...); });
    for_each_block(at.columns, [&](int plane, int y, int x) {
      alignas(64) Lanes<F, 8> v[8];
      load_block<F>(tile.at(plane, y, x), tile.pitch(plane), v);
      to_coefficients<F>(v);
      for (int i = 0; i < 8; ++i) v[i] = jpeg_quantized<F>(v[i], Lanes<F, 8>(load<8>(steps.of[plane > 0][i])));
      to_rows<F>(v);
      store_block<F>(block_of(p.levels, at, plane, y, x), p.levels.width_of(plane), v);
    });
  });
}

template <class T>
void jpeg_pixels(JpegPixels<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  DoubledRow<F> const chroma(p.levels.width);
  for (int64_t r = begin; r < end; ++r) {
    int64_t const b = r / p.y.height, y = r % p.y.height;
    chroma.fill(p.levels, b, y);
    F const* const luma = p.levels.row(b, 0, y);
    for_each_pixel<T>(p.y.step, 0, p.y.width, [&](auto n, int64_t x) {
      constexpr int N = decltype(n)::value;
      using V = Lanes<F, N>;
      auto const rgb = jpeg_rgb<F>(V(load<N>(luma + x)), V(load<N>(chroma.of(0) + x)), V(load<N>(chroma.of(1) + x)));
      for (int c = 0; c < 3; ++c) store<N>(p.y.row(b, c, y) + x * p.y.step, jpeg_clip<F>(rgb.v[c]));
    });
  }
}

namespace {

// Calls run(sample, first row of tiles, row behind the last, whether it is copied) for the rows of which the first tile
// is among the items.
template <class List, class Run>
KV_HD void rows_of_tiles(List const& p, int64_t begin, int64_t end, Run run) {
  for_each_sample(p.table(), begin, end, [&](int b, int64_t first, int64_t last) KV_INLINE {
    int64_t const across = ceil_div(p.blocks(b).x.width, int64_t(kJpegWidth));
    run(b, ceil_div(first, across), ceil_div(last, across), p.copies(b));
  });
}

template <class List>
KV_HD void blocks_of_list(List const& p, int64_t begin, int64_t end) {
  rows_of_tiles(p, begin, end, [&](int b, int64_t first, int64_t last, bool is_copied) {
    if (!is_copied) KV_ISA::jpeg_blocks(p.blocks(b), first, last);
  });
}
// Rows [first, last) of the pixels of an image.
template <class T>
KV_HD void copy_pixels(Images<T const> const& x, Images<T> const& y, int64_t first, int64_t last) {
  for (int64_t row = first; row < last; ++row)
    for (int c = 0; c < 3; ++c)
      for (int64_t i = 0; i < y.width; ++i) y.row(0, c, row)[i * y.step] = x.row(0, c, row)[i * x.step];
}

}  // namespace

template <class T>
void jpeg_blocks_list(JpegList<T> const& p, int64_t begin, int64_t end) {
  blocks_of_list(p, begin, end);
}
template <class T>
void jpeg_blocks_again(JpegListBackward<T> const& p, int64_t begin, int64_t end) {
  blocks_of_list(p, begin, end);
}

template <class T>
void jpeg_pixels_list(JpegList<T> const& p, int64_t begin, int64_t end) {
  rows_of_tiles(p, begin, end, [&](int b, int64_t first, int64_t last, bool is_copied) {
    auto const pixels = p.pixels(b);
    int64_t const top = first * kJpegSide, bottom = min(last * kJpegSide, pixels.y.height);
    is_copied ? copy_pixels(p.blocks(b).x, pixels.y, top, bottom) : KV_ISA::jpeg_pixels(pixels, top, bottom);
  });
}

template <class T>
void jpeg_blocks_backward(JpegBlocksBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  JpegLevels<F> const& levels = p.forward.levels;
  JpegTile<F> tile, grads;
  JpegSteps<F> steps;
  DoubledRow<F> const chroma(levels.width);
  int64_t const pad = 8, row = levels.width + 2 * pad;
  Scratch<F> memory(kJpegSide * levels.width + 2 * (kJpegSide + 2) * row);
  F *const of_luma = memory.data, *const of_chroma = memory.data + kJpegSide * levels.width;

  for (int64_t r = begin; r < end; ++r) {
    JpegTilePosition const first(levels, r, 0);
    // The gradients of full-size levels, in these rows and the adjacent one.
    for (int j = -1; j <= kJpegSide; ++j) {
      int const y = clamp(first.y + j, 0, first.height - 1);
      bool const inner = j >= 0 && j < kJpegSide;
      F* const to[] = {of_luma + j * levels.width, of_chroma + (j + 1) * row + pad,
                       of_chroma + (kJpegSide + 3 + j) * row + pad};
      auto const set = [&](auto n, int64_t x, auto const& result) {
        constexpr int N = decltype(n)::value;
        for (int c = inner ? 0 : 1; c < 3; ++c) store<N>(to[c] + x, result.v[c]);
      };
      int64_t const width = y < p.grad.height ? p.grad.width : 0;
      if (width > 0) chroma.fill(levels, first.b, y);
      F const* const luma = levels.row(first.b, 0, y);
      for_each_pixel<T>(p.grad.step, 0, width, [&](auto n, int64_t x) {
        constexpr int N = decltype(n)::value;
        using V = Lanes<F, N>;
        set(n, x,
            jpeg_clipped_rgb_vjp<F>(V(load<N>(luma + x)), V(load<N>(chroma.of(0) + x)), V(load<N>(chroma.of(1) + x)),
                                    load_color<N>(p.grad, first.b, y, x)));
      });
      for (int64_t x = width; x < levels.width; ++x) set(Width<1>{}, x, JpegColor<F>{});
      for (int c = 1; c < 3; ++c) to[c][-1] = to[c][0], to[c][levels.width] = to[c][levels.width - 1];
    }

    F gradients[2][8][8]{};
    for_each_tile(levels, r, r + 1, [&](JpegTilePosition const& at) {
      steps.find(p.forward.tables, at.b);
      load_levels(p.forward.x, at, tile);
      halve(tile, at.columns, [](auto const&... v) { return jpeg_halved<F>(v...); });
      for (int y = 0; y < kJpegSide; ++y)
        for (int x = 0; x < at.columns; x += 8)
          store<8>(&grads.luma[y][x], load<8>(of_luma + y * levels.width + at.x + x));
      for (int c = 0; c < 2; ++c)
        for (int y = 0; y < kJpegSide + 2; ++y)
          for (int x = 0; x < at.columns + 2; ++x)
            grads.chroma[c][y][x] = of_chroma[(c * (kJpegSide + 2) + y) * row + pad - 1 + at.x + x];
      halve(grads, at.columns, [](auto const&... v) { return jpeg_doubled_vjp<F>(v...); });
      for_each_block(at.columns, [&](int plane, int y, int x) {
        alignas(64) Lanes<F, 8> v[8], g[8];
        load_block<F>(tile.at(plane, y, x), tile.pitch(plane), v);
        to_coefficients<F>(v);
        load_block<F>(grads.at(plane, y, x), tile.pitch(plane), g);
        to_coefficients<F>(g);
        for (int i = 0; i < 8; ++i) {
          F* const to = gradients[plane > 0][i];
          Lanes<F, 8> derivative = load<8>(to);
          jpeg_quantized_vjp<F>(v[i], Lanes<F, 8>(load<8>(steps.of[plane > 0][i])), g[i], derivative);
          store<8>(to, derivative);
        }
        if (!p.grad_levels.data) return;
        to_rows<F>(g);
        store_block<F>(block_of(p.grad_levels, at, plane, y, x), levels.width_of(plane), g);
      });
    });
    if (!p.gradients) continue;
    for (int i = 0; i < 128; ++i) p.gradients[r * 128 + i] = gradients[i / 64][i % 8][i / 8 % 8];
  }
}

template <class T>
void jpeg_pixels_backward(JpegPixelsBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  JpegLevels<F> const& levels = p.grad_levels;
  int64_t const width = levels.width;
  HalfRow<F> const half(width / 2);
  Scratch<F> memory(3 * width);
  for (int64_t r = begin; r < end; ++r) {
    int64_t const b = r / p.grad_x.height, y = r % p.grad_x.height;
    F* const sums[] = {memory.data, memory.data + width, memory.data + 2 * width};
    int64_t const after = y + 1 < p.grad_x.height ? y + 1 : levels.height;
    for (int64_t row = y; row < after; ++row) {  // the last row also serves the rows out of bounds
      auto const add = [&](int plane, auto const& v, int64_t x) {
        F* const to = sums[plane] + x;
        store<8>(to, row == y ? v : load<8>(to) + v);
      };
      F const* const luma = levels.row(b, 0, row);
      for (int64_t x = 0; x < width; x += 8) add(0, load<8>(luma + x), x);
      for (int plane = 1; plane < 3; ++plane) {
        half.interpolate(levels, b, plane, jpeg_halved_vjp<F>(int(row), int(levels.height)));
        half.data[-1] = half.data[half.n] = 0;
        half.spread(F(kJpegInner), F(kJpegOuter), [&](auto const& v, int64_t x) { add(plane, v, x); });
        sums[plane][1] += half.data[0] * F(kJpegOuter);
        sums[plane][width - 2] += half.data[half.n - 1] * F(kJpegOuter);
      }
    }
    for (F* const sum : sums)
      for (int64_t x = p.grad_x.width; x < width; ++x) sum[p.grad_x.width - 1] += sum[x];
    for_each_pixel<T>(p.grad_x.step, 0, p.grad_x.width, [&](auto n, int64_t x) {
      constexpr int N = decltype(n)::value;
      using V = Lanes<F, N>;
      auto const rgb = jpeg_levels_vjp<F>(V(load<N>(sums[0] + x)), V(load<N>(sums[1] + x)), V(load<N>(sums[2] + x)));
      for (int c = 0; c < 3; ++c) store<N>(p.grad_x.row(b, c, y) + x * p.grad_x.step, rgb.v[c]);
    });
  }
}

template <class T>
void jpeg_blocks_list_backward(JpegListBackward<T> const& p, int64_t begin, int64_t end) {
  rows_of_tiles(p, begin, end, [&](int b, int64_t first, int64_t last, bool is_copied) {
    if (!is_copied) KV_ISA::jpeg_blocks_backward(p.blocks_backward(b), first, last);
  });
}
template <class T>
void jpeg_pixels_list_backward(JpegListBackward<T> const& p, int64_t begin, int64_t end) {
  rows_of_tiles(p, begin, end, [&](int b, int64_t first, int64_t last, bool is_copied) {
    auto const pixels = p.pixels_backward(b);
    int64_t const top = first * kJpegSide, bottom = min(last * kJpegSide, pixels.grad_x.height);
    is_copied ? copy_pixels(p.given(b), pixels.grad_x, top, bottom) : KV_ISA::jpeg_pixels_backward(pixels, top, bottom);
  });
}

template <class F>
void jpeg_steps_backward(JpegStepsBackward<F> const& p, int64_t begin, int64_t end) {
  for (int64_t b = begin; b < end; ++b) {
    auto const percent = jpeg_percent(jpeg_quality(p.tables, b));
    F of_percent = 0;
    for (int first = 0; first < 128; first += 64) {
      F* const to = (first == 0 ? p.grad_luma : p.grad_chroma) + b * 64;
      for (int i = 0; i < 64; ++i) {
        F sum = 0;
        for (int64_t chunk = 0; chunk < p.chunks; ++chunk) sum += p.gradients[(b * p.chunks + chunk) * 128 + first + i];
        F const table = jpeg_table(p.tables, b, first + i);
        sum *= jpeg_step(table, percent.value).derivative;
        to[i] = sum * percent.value;
        of_percent += sum * table;
      }
    }
    p.grad_quality[b] = of_percent * percent.derivative;
  }
}

KV_INSTANTIATE(jpeg_blocks, JpegBlocks)
KV_INSTANTIATE(jpeg_pixels, JpegPixels)
KV_INSTANTIATE(jpeg_blocks_list, JpegList)
KV_INSTANTIATE(jpeg_pixels_list, JpegList)
KV_INSTANTIATE(jpeg_blocks_backward, JpegBlocksBackward)
KV_INSTANTIATE(jpeg_pixels_backward, JpegPixelsBackward)
KV_INSTANTIATE(jpeg_blocks_again, JpegListBackward)
KV_INSTANTIATE(jpeg_blocks_list_backward, JpegListBackward)
KV_INSTANTIATE(jpeg_pixels_list_backward, JpegListBackward)
KV_INSTANTIATE_COMPUTED(jpeg_steps_backward, JpegStepsBackward)

}  // namespace kv::enhance::KV_ISA
