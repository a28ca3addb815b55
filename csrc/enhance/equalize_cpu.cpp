// Histogram equalization on the CPU: count, build the table, map. Bytes are their levels. Compiled once per instruction
// set.
#include "byte_histogram_cpu.h"
#include "core/bytes.h"
#include "core/scratch.h"
#include "core/stencils/channel_list.h"
#include "equalize.h"

namespace kv::enhance::KV_ISA {
namespace {

// Builds the table from level to value, with an entry for NaN. False if the plane stays unchanged.
template <class T>
KV_HD bool make_table(int32_t const (&count)[kLevels], bool opencv, T (&table)[kLevels + 1], int32_t& counted) {
  using F = Compute<T>;
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

// Maps n bytes, `step` apart, by the values of a table, four independent look-ups in flight.
KV_HD void map_bytes(uint8_t const* x, int64_t from, uint8_t* y, int64_t to, int64_t n, uint8_t const* values) {
  int64_t i = 0;
  for (; i + 4 <= n; i += 4, x += 4 * from, y += 4 * to) {
    uint8_t const a = values[x[0]], b = values[x[from]], c = values[x[2 * from]], d = values[x[3 * from]];
    y[0] = a, y[to] = b, y[2 * to] = c, y[3 * to] = d;
  }
  for (; i < n; ++i, x += from, y += to) *y = values[*x];
}

// Counts the levels of pixels [first, last) of a plane. Keeps them at `levels`, which holds a chunk or, if `keeps`,
// all.
template <class T>
KV_HD void count_levels(Equalize<T> const& p, int64_t plane, int64_t first, int64_t last, uint16_t* levels, bool keeps,
                        int32_t (&count)[kLevels]) {
  T memory[kChunk];
  T const* const x = p.x.plane(plane);
  LevelCounts counts{};
  if constexpr (__is_same(T, uint8_t))
    return counts.add(x + first * p.x.step, last - first, p.x.step), counts.sum_up(count);
  for (int64_t i = first; i < last; i += kChunk) {
    int64_t const n = min(kChunk, last - i);
    uint16_t* const level = keeps ? levels + i - first : levels;
    levels_of(gather(x + i * p.x.step, p.x.step, n, memory), n, level);
    counts.add(level, n);
  }
  counts.sum_up(count);
}

template <class T>
KV_HD void map_levels(uint16_t const* level, int64_t n, T const (&table)[kLevels + 1], T* y, int64_t step) {
  int64_t i = 0;
  for (; step == 1 && i + 4 <= n; i += 4) {  // four independent look-ups in flight
    T const a = table[level[i]], b = table[level[i + 1]], c = table[level[i + 2]], d = table[level[i + 3]];
    y[i] = a, y[i + 1] = b, y[i + 2] = c, y[i + 3] = d;
  }
  for (; i < n; ++i) y[i * step] = table[level[i]];
}

}  // namespace

template <class T>
void equalize_counts(Equalize<T> const& p, int64_t begin, int64_t end) {
  uint16_t levels[kChunk];
  for (int64_t r = begin; r < end; ++r) {
    int64_t const plane = r / p.parts, part = r % p.parts;
    int32_t count[kLevels];
    count_levels(p, plane, p.first_of(part), p.first_of(part + 1), levels, false, count);
    __builtin_memcpy(p.counts + r * kLevels, count, sizeof(count));
  }
}

// Rows are planes, or parts of them that equalize_counts has counted.
template <class T>
void equalize(Equalize<T> const& p, int64_t begin, int64_t end) {
  T memory[kChunk], table[kLevels + 1];
  int64_t const pixels = p.x.width, from = p.x.step, to = p.y.step;
  // The levels of a plane: keeping them takes less time than quantizing twice.
  bool const keeps = p.parts == 1 && !__is_same(T, uint8_t);
  Scratch<uint16_t> const levels(keeps ? pixels : kChunk);
  bool changed = false;
  for (int64_t r = begin; r < end; ++r) {
    int64_t const plane = r / p.parts, part = r % p.parts, first = p.first_of(part), last = p.first_of(part + 1);
    if (r == begin || part == 0) {
      int32_t count[kLevels] = {}, counted = 0;
      if (p.parts == 1) count_levels(p, plane, first, last, levels.data, keeps, count);
      for (int64_t k = 0; p.parts > 1 && k < p.parts; ++k)
        for (int i = 0; i < kLevels; ++i) count[i] += p.counts[(plane * p.parts + k) * kLevels + i];
      changed = make_table(count, p.opencv, table, counted);
      Change const change = !changed ? Change::none : counted == pixels ? Change::all : Change::but_nan;
      if (part == 0) store<1>(p.changed + plane, Compute<T>(int(change)));
    }
    T const* const x = p.x.plane(plane);
    T* const y = p.y.plane(plane);
    if (!changed) {
      for (int64_t i = first; i < last; ++i) y[i * to] = x[i * from];
      continue;
    }
    if constexpr (__is_same(T, uint8_t)) {
      ByteTable bytes;
      __builtin_memcpy(bytes.values, table, sizeof(bytes.values));
      if (from == 1 && to == 1)
        bytes.map(x + first, y + first, last - first);
      else
        map_bytes(x + first * from, from, y + first * to, to, last - first, bytes.values);
      continue;
    }
    if (keeps) {
      map_levels(levels.data, pixels, table, y, to);
      continue;
    }
    for (int64_t i = first; i < last; i += kChunk) {
      int64_t const n = min(kChunk, last - i);
      levels_of(gather(x + i * from, from, n, memory), n, levels.data);
      map_levels(levels.data, n, table, y + i * to, to);
    }
  }
}

template <class T>
void equalize_list(EqualizeList<T> const& p, int64_t begin, int64_t end) {
  channel_items(p, begin, end, [](Equalize<T> const& one, int64_t first, int64_t last) {
    KV_ISA::equalize(flat_sample(one), first, last);
  });
}

template <class T>
void equalize_backward(EqualizeBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const from = p.grad.step, of = p.x.step, to = p.grad_x.step;
  for (int64_t plane = begin; plane < end; ++plane) {
    T const* const g = p.grad.plane(plane);
    T const* const x = p.x.plane(plane);
    T* const grad_x = p.grad_x.plane(plane);
    Change const change = p.changed ? Change(int(load<1>(p.changed + plane))) : Change::but_nan;
    auto const pixels = [&](auto width, int64_t i) {
      constexpr int N = decltype(width)::value;
      Lanes<F, N> v{};
      if (change == Change::none) v = load<N>(g + i * from);
      if (change == Change::but_nan) {
        Lanes<F, N> const own = load<N>(x + i * of);
        v = own == own ? v : load<N>(g + i * from);
      }
      store<N>(grad_x + i * to, v);
    };
    if (from == 1 && of == 1 && to == 1)
      for_each_vector<T>(0, p.grad.width, pixels);
    else
      for (int64_t i = 0; i < p.grad.width; ++i) pixels(Width<1>{}, i);
  }
}

template <class T>
void equalize_list_backward(EqualizeBackwardList<T> const& p, int64_t begin, int64_t end) {
  channel_gradient_items(p, begin, end, [](EqualizeBackward<T> const& one, int64_t first, int64_t last) {
    KV_ISA::equalize_backward(one, first, last);
  });
}

KV_INSTANTIATE_WITH_BYTES(equalize, Equalize)
KV_INSTANTIATE_WITH_BYTES(equalize_list, EqualizeList)
KV_INSTANTIATE_WITH_BYTES(equalize_counts, Equalize)
KV_INSTANTIATE(equalize_backward, EqualizeBackward)
KV_INSTANTIATE(equalize_list_backward, EqualizeBackwardList)

}  // namespace kv::enhance::KV_ISA
