// CLAHE on the CPU: a plane's tables, then its rows. Pixels are quantized row by row, which is the fastest order for
// memory, and histograms of tiles count these levels. The four tables of a cell are interleaved, four bytes per entry:
// a pixel needs one look-up and some vector arithmetic. Compiled once per instruction set.
#include "byte_histogram_cpu.h"
#include "clahe.h"
#include "core/scratch.h"

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
  auto const at = [&](int i) -> I& { return *reinterpret_cast<I*>(count + i); };
  I above{};
  for (int i = 0; i < kLevels; i += N) {
    I const all = at(i);
    at(i) = all < limit ? all : I{} + limit;
    above += all - at(i);
  }
  int32_t excess = 0, sum = 0;
  for (int i = 0; i < N; ++i) excess += above[i];
  Excess const spread(excess);
  for (int i = 0; i < spread.rest; ++i) ++count[i * spread.distance];
  for (int32_t& n : count) n = sum += n + spread.each;
  for (int i = 0; i < kLevels; i += N) {
    V const level = round_even(product(__builtin_convertvector(at(i), V), scale), F());
    store<N>(table + i, __builtin_convertvector(level, Lanes<float, N>));  // at most 255
  }
}

// Computes the tables of a plane and the levels of its pixels; returns whether a pixel is NaN.
template <class T>
KV_HD bool make_tables(Clahe<T> const& p, int64_t plane, uint8_t* tables, uint16_t* levels) {
  using F = Compute<T>;
  F const scale = F(255) / F(int64_t(p.down.size) * p.across.size);
  int64_t const width = p.across.pixels;
  T memory[kChunk];
  int32_t nan = 0;
  for (int ty = 0; ty < p.down.count; ++ty) {
    int const y0 = ty * p.down.size, y1 = y0 + p.down.size;
    for (int y = y0; y < min(y1, p.down.pixels); ++y) {
      T const* const row = p.x.row(plane, y);
      for (int64_t x = 0; x < width; x += kChunk) {
        int64_t const n = min(kChunk, width - x);
        levels_of(gather(row + x * p.x.step, p.x.step, n, memory), n, levels + y * width + x);
      }
    }
    for (int tx = 0; tx < p.across.count; ++tx) {
      int const x0 = tx * p.across.size, x1 = x0 + p.across.size, inside = clamp(p.across.pixels, x0, x1);
      LevelCounts counts{};
      for (int y = y0; y < y1; ++y) {
        uint16_t const* const row = levels + p.down.reflected(y) * width;
        counts.add(row + x0, inside - x0);
        for (int x = inside; x < x1; ++x) ++counts.of[0][row[p.across.reflected(x)]];
      }
      for (int k = 0; k < 4; ++k) nan += counts.of[k][kNanLevel];
      make_table(counts, p.limit, scale, tables + (ty * p.across.count + tx) * kLevels);
    }
  }
  return nan > 0;
}

template <class F, int N>
KV_HD Lanes<F, N> byte_of(uint32_t const* four, int position) {
  if constexpr (N == 1)
    return F(*four >> (8 * position) & 255);
  else
    return __builtin_convertvector(
        __builtin_convertvector(*reinterpret_cast<Lanes<uint32_t, N> const*>(four) >> (8 * position) & 255,
                                Lanes<int32_t, N>),
        Lanes<F, N>);
}

// The four tables of a cell, interleaved.
template <class T>
KV_HD void make_cell(Clahe<T> const& p, int cy, int cx, uint8_t const* tables, uint32_t* cell) {
  auto const table = [&](int ty, int tx) { return tables + (ty * p.across.count + tx) * kLevels; };
  uint8_t const *const a = table(p.down.before(cy), p.across.before(cx)),
                       *const b = table(p.down.before(cy), p.across.after(cx)),
                       *const c = table(p.down.after(cy), p.across.before(cx)),
                       *const d = table(p.down.after(cy), p.across.after(cx));
  using Double4 = Lanes<uint32_t, 8>;
  auto const bytes = [](uint8_t const* p) {  // through 16 bits: GCC does a wider conversion byte by byte
    auto const half = __builtin_convertvector(*reinterpret_cast<Lanes<uint8_t, 8> const*>(p), Lanes<uint16_t, 8>);
    return __builtin_convertvector(half, Double4);
  };
  for (int i = 0; i < kLevels; i += 8)
    *reinterpret_cast<Double4*>(cell + i) = bytes(a + i) | bytes(b + i) << 8 | bytes(c + i) << 16 | bytes(d + i) << 24;
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

template <class T>
KV_HD void map_row(Clahe<T> const& p, int64_t plane, int y, int cy, uint16_t const* level, bool nan,
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
void clahe(Clahe<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const width = p.across.pixels;
  Scratch<uint8_t> const tables(int64_t(p.down.count) * p.across.count * kLevels);
  Scratch<uint16_t> const levels(width * p.down.pixels);
  ClaheRow<F> const memory(width, p.across.count + 1);
  for (int cx = 0; cx <= p.across.count; ++cx)
    for (int x = p.across.cell(cx); x < p.across.cell(cx + 1); ++x)
      memory.weight.data[x] = p.across.template weight<F>(x, cx);
  for (int64_t plane = begin; plane < end; ++plane) {
    bool const nan = make_tables(p, plane, tables.data, levels.data);
    for (int cy = 0; cy <= p.down.count; ++cy) {
      int const y0 = p.down.cell(cy), y1 = p.down.cell(cy + 1);
      for (int cx = 0; y0 < y1 && cx <= p.across.count; ++cx)
        make_cell(p, cy, cx, tables.data, memory.cells.data + cx * memory.kCell);
      for (int y = y0; y < y1; ++y) map_row(p, plane, y, cy, levels.data + y * width, nan, memory);
    }
  }
}

KV_INSTANTIATE_WITH_BYTES(clahe, Clahe)

}  // namespace kv::enhance::KV_ISA
