// CLAHE on the CPU: a plane's tables, then its cells. The four tables of a cell become one of four bytes an entry, so a
// pixel is one look-up and some vector arithmetic.
#include "clahe.h"
#include "core/scratch.h"
#include "levels_cpu.h"

namespace kv::KV_ISA {
namespace {

template <class V, class F>
KV_HD V round_even(V v, F) {
  constexpr F shift = sizeof(F) == 4 ? F(0x1.8p23) : F(0x1.8p52);  // whose last place is 1
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
  for (int32_t& n : count) n = sum += n + spread.share;
  for (int i = 0; i < kLevels; i += N) {
    V const level = round_even(product(__builtin_convertvector(at(i), V), scale), F());
    store<N>(table + i, __builtin_convertvector(level, Lanes<float, N>));  // at most 255
  }
}

template <class T>
KV_HD void make_tables(Clahe<T> const& p, int64_t plane, uint8_t* tables) {
  using F = Compute<T>;
  F const scale = F(255) / F(int64_t(p.down.size) * p.across.size);
  uint16_t level[kPiece];
  T memory[kPiece];
  for (int tile = 0; tile < p.down.count * p.across.count; ++tile) {
    int const y0 = tile / p.across.count * p.down.size, x0 = tile % p.across.count * p.across.size;
    LevelCounts counts{};
    for (int y = y0; y < y0 + p.down.size; ++y) {
      T const* const row = p.x.row(plane, p.down.reflected(y));
      for (int x = x0; x < x0 + p.across.size; x += kPiece) {
        int const n = min(int(kPiece), x0 + p.across.size - x);
        T const* pixels = memory;
        if (x + n <= p.across.pixels)
          pixels = gathered(row + x * p.x.step, p.x.step, n, memory);
        else
          for (int i = 0; i < n; ++i) memory[i] = row[p.across.reflected(x + i) * p.x.step];
        levels_of(pixels, n, level);
        counts.add(level, n);
      }
    }
    make_table(counts, p.limit, scale, tables + tile * kLevels);
  }
}

template <class F, int N>
KV_HD Lanes<F, N> byte_of(uint32_t const* four, int place) {
  if constexpr (N == 1)
    return F(*four >> (8 * place) & 255);
  else
    return __builtin_convertvector(
        __builtin_convertvector(*reinterpret_cast<Lanes<uint32_t, N> const*>(four) >> (8 * place) & 255,
                                Lanes<int32_t, N>),
        Lanes<F, N>);
}

// The rows of one cell.
template <class T>
KV_HD void map_cell(Clahe<T> const& p, int64_t plane, int cy, int cx, uint8_t const* tables) {
  using F = Compute<T>;
  int const x0 = p.across.cell(cx), x1 = p.across.cell(cx + 1), y0 = p.down.cell(cy), y1 = p.down.cell(cy + 1);
  if (x0 >= x1 || y0 >= y1) return;
  uint32_t cell[kLevels + 1];
  auto const table = [&](int ty, int tx) { return tables + (ty * p.across.count + tx) * kLevels; };
  uint8_t const *const a = table(p.down.before(cy), p.across.before(cx)),
                       *const b = table(p.down.before(cy), p.across.after(cx)),
                       *const c = table(p.down.after(cy), p.across.before(cx)),
                       *const d = table(p.down.after(cy), p.across.after(cx));
  using Four = Lanes<uint32_t, 8>;
  auto const bytes = [](uint8_t const* p) {  // through 16 bits: GCC takes a wider step byte by byte
    auto const half = __builtin_convertvector(*reinterpret_cast<Lanes<uint8_t, 8> const*>(p), Lanes<uint16_t, 8>);
    return __builtin_convertvector(half, Four);
  };
  for (int i = 0; i < kLevels; i += 8)
    *reinterpret_cast<Four*>(cell + i) = bytes(a + i) | bytes(b + i) << 8 | bytes(c + i) << 16 | bytes(d + i) << 24;
  cell[kNanLevel] = 0;

  uint16_t level[kPiece];
  uint32_t four[kPiece];
  T memory[kPiece], result[kPiece];
  F weight[kPiece];
  for (int x = x0; x < x1; x += kPiece) {
    int const n = min(int(kPiece), x1 - x);
    for (int i = 0; i < n; ++i) weight[i] = p.across.template weight<F>(x + i, cx);
    for (int y = y0; y < y1; ++y) {
      F const wy = p.down.template weight<F>(y, cy);
      T const* const pixels = gathered(p.x.row(plane, y) + x * p.x.step, p.x.step, n, memory);
      T* const to = p.y.row(plane, y) + x * p.y.step;
      T* const results = p.y.step == 1 ? to : result;
      levels_of(pixels, n, level);
      for (int i = 0; i < n; ++i) four[i] = cell[level[i]];
      for_each_vector<T>(0, n, [&](auto width, int64_t i) {
        constexpr int N = decltype(width)::value;
        using V = Lanes<F, N>;
        V v = mixed(byte_of<F, N>(four + i, 0), byte_of<F, N>(four + i, 1), byte_of<F, N>(four + i, 2),
                    byte_of<F, N>(four + i, 3), load<N>(weight + i), broadcast<N>(wy));
        if (p.to_levels) v = round_even(v, F());
        V const own = load<N>(pixels + i);
        store<N>(results + i, own == own ? V(v / 255) : own);
      });
      if (p.y.step != 1)
        for (int i = 0; i < n; ++i) to[i * p.y.step] = result[i];
    }
  }
}

}  // namespace

template <class T>
void clahe(Clahe<T> const& p, int64_t begin, int64_t end) {
  Scratch<uint8_t> const tables(int64_t(p.down.count) * p.across.count * kLevels);
  for (int64_t plane = begin; plane < end; ++plane) {
    make_tables(p, plane, tables.data);
    for (int cy = 0; cy <= p.down.count; ++cy)
      for (int cx = 0; cx <= p.across.count; ++cx) map_cell(p, plane, cy, cx, tables.data);
  }
}

KV_INSTANTIATE(clahe, Clahe)

}  // namespace kv::KV_ISA
