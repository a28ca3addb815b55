// Histogram equalization on the CPU: count, build the table, map. Compiled once per instruction set.
#include "byte_histogram_cpu.h"
#include "core/scratch.h"
#include "equalize.h"

namespace kv::enhance::KV_ISA {
namespace {

// Builds the table from level to value, with an entry for NaN. False if the plane stays unchanged.
template <class T>
KV_HD bool make_table(LevelCounts const& counts, bool opencv, T (&table)[kLevels + 1], int32_t& counted) {
  using F = Compute<T>;
  int32_t count[kLevels];
  counts.sum_up(count);
  Curve curve{opencv, 0, 0, 0};
  for (int32_t n : count) {
    if (curve.pixels == 0) curve.darkest = n;
    if (n > 0) curve.brightest = n;
    curve.pixels += n;
  }
  counted = curve.pixels;
  if (!curve.changes()) return false;
  int32_t up_to = 0;
  for (int i = 0; i < kLevels; ++i) {
    up_to += count[i];
    store<1>(table + i, F(curve(up_to, count[i])) / kWhite<T>);
  }
  store<1>(table + kNanLevel, F(__builtin_nanf("")));
  return true;
}

}  // namespace

template <class T>
void equalize(Equalize<T> const& p, int64_t begin, int64_t end) {
  T memory[kChunk], table[kLevels + 1];
  int64_t const pixels = p.x.width, from = p.x.step, to = p.y.step;
  Scratch<uint16_t> const levels(pixels);  // of a plane: keeping them takes less time than quantizing twice
  uint16_t const* const level = levels.data;
  for (int64_t plane = begin; plane < end; ++plane) {
    T const* const x = p.x.plane(plane);
    T* const y = p.y.plane(plane);
    LevelCounts counts{};
    for (int64_t i = 0; i < pixels; i += kChunk) {
      int64_t const n = min(kChunk, pixels - i);
      levels_of(gather(x + i * from, from, n, memory), n, levels.data + i);
      counts.add(level + i, n);
    }
    int32_t counted = 0;
    bool const changed = make_table(counts, p.opencv, table, counted);
    Change const change = !changed ? Change::none : counted == pixels ? Change::all : Change::but_nan;
    store<1>(p.changed + plane, Compute<T>(int(change)));
    if (!changed) {
      for (int64_t i = 0; i < pixels; ++i) y[i * to] = x[i * from];
      continue;
    }
    int64_t i = 0;
    for (; to == 1 && i + 4 <= pixels; i += 4) {  // four independent look-ups in flight
      T const a = table[level[i]], b = table[level[i + 1]], c = table[level[i + 2]], d = table[level[i + 3]];
      y[i] = a, y[i + 1] = b, y[i + 2] = c, y[i + 3] = d;
    }
    for (; i < pixels; ++i) y[i * to] = table[level[i]];
  }
}

template <class T>
void equalize_backward(EqualizeBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const from = p.grad.step, of = p.output.step, to = p.grad_x.step;
  for (int64_t plane = begin; plane < end; ++plane) {
    T const* const g = p.grad.plane(plane);
    T const* const y = p.output.plane(plane);
    T* const x = p.grad_x.plane(plane);
    Change const change = p.changed ? Change(int(load<1>(p.changed + plane))) : Change::but_nan;
    auto const pixels = [&](auto width, int64_t i) {
      constexpr int N = decltype(width)::value;
      Lanes<F, N> v{};
      if (change == Change::none) v = load<N>(g + i * from);
      if (change == Change::but_nan) {
        Lanes<F, N> const out = load<N>(y + i * of);
        v = out == out ? v : load<N>(g + i * from);
      }
      store<N>(x + i * to, v);
    };
    if (from == 1 && of == 1 && to == 1)
      for_each_vector<T>(0, p.grad.width, pixels);
    else
      for (int64_t i = 0; i < p.grad.width; ++i) pixels(Width<1>{}, i);
  }
}

KV_INSTANTIATE_WITH_BYTES(equalize, Equalize)
KV_INSTANTIATE(equalize_backward, EqualizeBackward)

}  // namespace kv::enhance::KV_ISA
