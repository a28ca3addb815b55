// CLAHE on the CPU: tables of tiles, then rows of pixels. Pixels are quantized row by row, which is the fastest order
// for memory, and histograms of tiles count these levels; bytes are their levels. The four tables of a cell are
// interleaved, four bytes per entry: a pixel needs one look-up and some vector arithmetic. Compiled once per
// instruction set.
#include "byte_histogram_cpu.h"
#include "clahe.h"
#include "core/scratch.h"
#include "core/stencils/channel_list.h"

namespace kv::enhance::KV_ISA {
namespace {

template <class V, class F>
KV_HD V round_even(V v, F) {
  constexpr F shift = sizeof(F) == 4 ? F(0x1.8p23) : F(0x1.8p52);  // its last bit has the value 1
  return (v + shift) - shift;
}

template <class F>
KV_HD void make_table(LevelCounts const& counts, int32_t limit, F scale, uint8_t* table) {
  constexpr int N = kLanes<F>;
  using I = Lanes<int32_t, N>;
  using V = Lanes<F, N>;
  int32_t count[kLevels];
  counts.sum_up(count);
  I above{};
  for (int i = 0; i < kLevels; i += N) {
    I const all = read_lanes<N>(count + i), kept = all < limit ? all : I{} + limit;
    write_lanes<N>(count + i, kept);
    above += all - kept;
  }
  int32_t excess = 0, sum = 0;
  for (int i = 0; i < N; ++i) excess += above[i];
  Excess const spread(excess);
  for (int i = 0; i < spread.rest; ++i) ++count[i * spread.distance];
  for (int32_t& n : count) n = sum += n + spread.each;
  for (int i = 0; i < kLevels; i += N) {
    V const level = round_even(product(__builtin_convertvector(read_lanes<N>(count + i), V), scale), F());
    store<N>(table + i, __builtin_convertvector(level, Lanes<float, N>));  // at most 255
  }
}

template <class T>
KV_HD void quantize_row(Clahe<T> const& p, int64_t plane, int64_t y, uint16_t* levels) {
  T memory[kChunk];
  T const* const row = p.x.row(plane, y);
  for (int64_t x = 0; x < p.across.pixels; x += kChunk) {
    int64_t const n = min(kChunk, p.across.pixels - x);
    levels_of(gather(row + x * p.x.step, p.x.step, n, memory), n, levels + x);
  }
}

// Computes the tables of a row of tiles of a plane; returns whether a pixel is NaN. Row y of the image has its levels
// at levels_at(y).
template <class T, class LevelsAt>
KV_HD bool make_tables(Clahe<T> const& p, int64_t plane, int ty, LevelsAt levels_at, uint8_t* tables) {
  using F = Compute<T>;
  F const scale = F(255) / F(int64_t(p.down.size) * p.across.size);
  int const y0 = ty * p.down.size, y1 = y0 + p.down.size;
  int32_t const limit = p.limit_of(plane);
  int32_t nan = 0;
  for (int tx = 0; tx < p.across.count; ++tx) {
    int const x0 = tx * p.across.size, x1 = x0 + p.across.size, inside = clamp(p.across.pixels, x0, x1);
    LevelCounts counts{};
    for (int y = y0; y < y1; ++y) {
      auto const* const row = levels_at(y);
      counts.add(row + x0, inside - x0);
      for (int x = inside; x < x1; ++x) ++counts.of[0][row[p.across.reflected(x)]];
    }
    for (int k = 0; k < 4; ++k) nan += counts.of[k][kNanLevel];
    make_table(counts, limit, scale, tables + (int64_t(ty) * p.across.count + tx) * kLevels);
  }
  return nan > 0;
}

template <class F, int N>
KV_HD Lanes<F, N> byte_of(uint32_t const* four, int position) {
  if constexpr (N == 1)
    return F(*four >> (8 * position) & 255);
  else
    return __builtin_convertvector(
        __builtin_convertvector(read_lanes<N>(four) >> (8 * position) & 255, Lanes<int32_t, N>), Lanes<F, N>);
}

// The four tables of a cell, interleaved.
template <class T>
KV_HD void make_cell(Clahe<T> const& p, int cy, int cx, uint8_t const* tables, uint32_t* cell) {
  auto const table = [&](int ty, int tx) { return tables + (int64_t(ty) * p.across.count + tx) * kLevels; };
  uint8_t const *const a = table(p.down.before(cy), p.across.before(cx)),
                       *const b = table(p.down.before(cy), p.across.after(cx)),
                       *const c = table(p.down.after(cy), p.across.before(cx)),
                       *const d = table(p.down.after(cy), p.across.after(cx));
  using Double4 = Lanes<uint32_t, 8>;
  auto const bytes = [](uint8_t const* p) {  // through 16 bits: GCC does a wider conversion byte by byte
    auto const half = __builtin_convertvector(read_lanes<8>(p), Lanes<uint16_t, 8>);
    return __builtin_convertvector(half, Double4);
  };
  for (int i = 0; i < kLevels; i += 8)
    write_lanes<8>(cell + i, bytes(a + i) | bytes(b + i) << 8 | bytes(c + i) << 16 | bytes(d + i) << 24);
  cell[kNanLevel] = 0;
}

// The tables of a plane, and how to map its rows by them.
template <class F>
struct ClaheRow {
  static constexpr int kCell = kLevels + 1;
  Scratch<F> weight;
  Scratch<uint32_t> cells, four;
  explicit KV_HD ClaheRow(int64_t width, int64_t across) : weight(width), cells(across * kCell), four(width) {}
};

template <class T, class L>
KV_HD void map_row(Clahe<T> const& p, int64_t plane, int y, int cy, L const* level, bool nan,
                   ClaheRow<Compute<T>> const& memory) {
  using F = Compute<T>;
  uint32_t* const four = memory.four.data;
  for (int cx = 0; cx <= p.across.count; ++cx) {
    uint32_t const* const cell = memory.cells.data + cx * memory.kCell;
    for (int x = p.across.cell(cx); x < p.across.cell(cx + 1); ++x) four[x] = cell[level[x]];
  }
  T* const to = p.y.row(plane, y);
  F const wy = p.down.template weight<F>(y, cy);
  T result[kChunk];
  for (int64_t x = 0; x < p.across.pixels; x += kChunk) {
    int64_t const n = min(kChunk, p.across.pixels - x);
    T* const results = p.y.step == 1 ? to + x : result;
    for_each_vector<T>(0, n, [&](auto width, int64_t i) {
      constexpr int N = decltype(width)::value;
      using V = Lanes<F, N>;
      uint32_t const* const at = four + x + i;
      V v = mixed(byte_of<F, N>(at, 0), byte_of<F, N>(at, 1), byte_of<F, N>(at, 2), byte_of<F, N>(at, 3),
                  load<N>(memory.weight.data + x + i), broadcast<N>(wy));
      if (p.to_levels) v = round_even(v, F());
      store<N>(results + i, V(v / kWhite<T>));
    });
    if (nan)
      for (int64_t i = 0; i < n; ++i)
        if (level[x + i] == kNanLevel) store<1>(results + i, F(__builtin_nan("")));
    if (p.y.step != 1)
      for (int64_t i = 0; i < n; ++i) to[(x + i) * p.y.step] = result[i];
  }
}

}  // namespace

template <class T>
void clahe_tables(Clahe<T> const& p, int64_t begin, int64_t end) {
  int64_t const width = p.across.pixels;
  Scratch<uint16_t> const levels(width * p.down.size);
  for (int64_t r = begin; r < end; ++r) {
    int64_t const plane = r / p.down.count;
    int const ty = int(r % p.down.count), y0 = ty * p.down.size;
    if constexpr (__is_same(T, uint8_t))
      if (p.x.step == 1) {
        auto const row = [&](int y) { return p.x.row(plane, p.down.reflected(y)); };
        p.has_nan[r] = make_tables(p, plane, ty, row, p.tables_of(plane));
        continue;
      }
    auto const levels_at = [&](int y) { return levels.data + (y - y0) * width; };
    for (int y = y0; y < y0 + p.down.size; ++y) quantize_row(p, plane, p.down.reflected(y), levels_at(y));
    p.has_nan[r] = make_tables(p, plane, ty, levels_at, p.tables_of(plane));
  }
}

template <class T>
void clahe(Clahe<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const width = p.across.pixels, cells_down = p.down.count + 1;
  bool const by_cells = p.by_cells();
  Scratch<uint8_t> const own_tables(by_cells ? 0 : int64_t(p.down.count) * p.across.count * kLevels);
  Scratch<uint16_t> const levels(by_cells ? width : width * p.down.pixels);
  ClaheRow<F> const memory(width, p.across.count + 1);
  for (int cx = 0; cx <= p.across.count; ++cx)
    for (int x = p.across.cell(cx); x < p.across.cell(cx + 1); ++x)
      memory.weight.data[x] = p.across.template weight<F>(x, cx);

  auto const map_cells = [&](int64_t plane, int cy, uint8_t const* tables, bool nan, auto levels_at) {
    int const y0 = p.down.cell(cy), y1 = p.down.cell(cy + 1);
    for (int cx = 0; y0 < y1 && cx <= p.across.count; ++cx)
      make_cell(p, cy, cx, tables, memory.cells.data + cx * memory.kCell);
    for (int y = y0; y < y1; ++y) map_row(p, plane, y, cy, levels_at(y), nan, memory);
  };
  for (int64_t r = begin; r < end; ++r) {
    if (by_cells) {
      int64_t const plane = r / cells_down;
      int const cy = int(r % cells_down);
      if constexpr (__is_same(T, uint8_t))
        if (p.x.step == 1) {
          map_cells(plane, cy, p.tables_of(plane), false, [&](int y) { return p.x.row(plane, y); });
          continue;
        }
      uint8_t const* const has_nan = p.has_nan + plane * p.down.count;
      map_cells(plane, cy, p.tables_of(plane), has_nan[p.down.before(cy)] || has_nan[p.down.after(cy)], [&](int y) {
        quantize_row(p, plane, y, levels.data);
        return levels.data;
      });
      continue;
    }
    if constexpr (__is_same(T, uint8_t))
      if (p.x.step == 1) {
        auto const row = [&](int y) { return p.x.row(r, p.down.reflected(y)); };
        for (int ty = 0; ty < p.down.count; ++ty) make_tables(p, r, ty, row, own_tables.data);
        for (int cy = 0; cy < cells_down; ++cy) map_cells(r, cy, own_tables.data, false, row);
        continue;
      }
    auto const levels_at = [&](int y) { return levels.data + p.down.reflected(y) * width; };
    bool nan = false;
    for (int ty = 0; ty < p.down.count; ++ty) {
      for (int y = ty * p.down.size; y < min((ty + 1) * p.down.size, p.down.pixels); ++y)
        quantize_row(p, r, y, levels.data + y * width);
      nan |= make_tables(p, r, ty, levels_at, own_tables.data);
    }
    for (int cy = 0; cy < cells_down; ++cy) map_cells(r, cy, own_tables.data, nan, levels_at);
  }
}

template <class T>
void clahe_list(ClaheList<T> const& p, int64_t begin, int64_t end) {
  channel_items(p, begin, end,
                [](Clahe<T> const& one, int64_t first, int64_t last) { KV_ISA::clahe(one, first, last); });
}

KV_INSTANTIATE_WITH_BYTES(clahe_list, ClaheList)
KV_INSTANTIATE_WITH_BYTES(clahe_tables, Clahe)
KV_INSTANTIATE_WITH_BYTES(clahe, Clahe)

}  // namespace kv::enhance::KV_ISA
