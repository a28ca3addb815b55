// Warps with a program of color steps on the CPU: parts [begin, end) of all samples, which are bands of rows. The warp
// writes a band to a buffer that stays in the cache, and the program reads it there. Compiled once per instruction set.
#include "augmentation/warp_and_color.h"
#include "core/lanes.h"
#include "core/scratch.h"

namespace kv::augmentation::KV_ISA {
namespace {

template <class T>
constexpr DType kTypeOf = sizeof(T) == 4             ? DType::float32
                          : sizeof(T) == 1           ? DType::uint8
                          : __is_same(T, ::kv::Half) ? DType::float16
                                                     : DType::bfloat16;

// A table that shifts values below a split and inverts the others, both saturated, as those of solarization, inversion
// and brightness do: a few instructions for a vector, where look-ups go one by one.
//
//   y = x + shift        x < split
//   y = sum - x          x >= split
struct ShiftAndInvert {
  int shift, split, sum;

  explicit ShiftAndInvert(uint8_t const* table) {
    int zeros = 0, last = 255;
    while (zeros < 256 && table[zeros] == 0) ++zeros;
    shift = zeros ? 1 - zeros : table[0];
    split = 0;
    while (split < 256 && table[split] == shifted(split)) ++split;
    while (last > split && table[last] == 0) --last;
    sum = split < 256 ? table[last] + last : 0;
  }
  KV_HD int shifted(int x) const { return clamp(x + shift, 0, 255); }
  KV_HD int at(int x) const { return x < split ? shifted(x) : clamp(sum - x, 0, 255); }
  KV_HD bool fits(uint8_t const* table) const {
    bool equal = true;
    for (int x = 0; x < 256; ++x) equal &= table[x] == at(x);
    return equal;
  }
};

template <class V>
KV_HD V saturating_add(V a, V b) {
  V const sum = a + b;
  return sum | V(sum < a);
}
template <class V>
KV_HD V saturating_subtract(V a, V b) {
  return (a - b) & V(a > b);
}

template <int N>
KV_HD void shift_and_invert(ShiftAndInvert const& map, uint8_t const* x, uint8_t* y) {
  using V = Lanes<uint8_t, N>;
  auto const all = [](int value) { return V{} + uint8_t(value); };
  V v;
  __builtin_memcpy(&v, x, N);
  V const shifted = saturating_subtract(saturating_add(v, all(max(map.shift, 0))), all(max(-map.shift, 0)));
  V const inverted = saturating_add(saturating_subtract(all(min(map.sum, 255)), v), all(max(map.sum - 255, 0)));
  V const below = V(v < all(min(map.split, 255))) | all(map.split > 255 ? 255 : 0);
  v = (shifted & below) | (inverted & ~below);
  __builtin_memcpy(y, &v, N);
}

}  // namespace

template <class T>
void map_bytes(MapBytes<T> const& p, int64_t begin, int64_t end) {
  constexpr int N = kVectorBytes;
  int64_t const parts = parts_of(p.size);
  for (int64_t part = begin; part < end; ++part) {
    int64_t const b = part / parts, first = (part - b * parts) * kPartBytes, count = min(kPartBytes, p.size - first);
    T const* const table = p.tables + 256 * b;
    T const* const x = p.x + b * p.size + first;
    T* const y = p.y + b * p.size + first;
    ShiftAndInvert const map(table);
    int64_t i = 0;
    if (map.fits(table))
      for (; i + N <= count; i += N) shift_and_invert<N>(map, x + i, y + i);
    for (; i + 4 <= count; i += 4) {  // four independent look-ups in flight
      T const c = table[x[i]], d = table[x[i + 1]], e = table[x[i + 2]], f = table[x[i + 3]];
      y[i] = c, y[i + 1] = d, y[i + 2] = e, y[i + 3] = f;
    }
    for (; i < count; ++i) y[i] = table[x[i]];
  }
}

template <class T>
void warp_and_color(WarpAndColor<T> const& p, int64_t begin, int64_t end) {
  Images<T> const& y = p.warp.y;
  int64_t const width = y.width, rows = rows_of_band(width), bands = bands_of(y.height, width);
  Scratch<T> band(y.channels * rows * width);
  for (int64_t part = begin; part < end; ++part) {
    int64_t const b = part / bands, first = (part - b * bands) * rows, count = min(rows, y.height - first);
    geometry::Sample<T> warp = p.warp;
    warp.y = {band.data - first * width, 0, rows * width, width, 1, y.batch, y.height, width, y.channels};
    geometry::KV_ISA::sample(warp, b * y.height + first, b * y.height + first + count);

    // The band as a sample of its own, but for the pixels of the mean.
    color::Program<float> program = p.program;
    program.x = {band.data, kTypeOf<T>, y.channels, 1, 0, 0, rows * width, 1};
    program.pixels = count * width;
    float mean;
    if (first > 0) program.means = &mean - b;  // stored once, with the first band
    if (program.measures_mean) {
      program.parts_count = 1;
      program.parts += part - b;
      color::KV_ISA::program(program, b, b + 1);
    } else {
      program.y.data = static_cast<char*>(program.y.data) + first * width * program.y.step * size_of(program.y.type);
      int64_t const chunks = color::chunks_of<float>(program.pixels);
      color::KV_ISA::program(program, b * chunks, (b + 1) * chunks);
    }
  }
}

KV_INSTANTIATE_ONE(map_bytes, MapBytes, uint8_t)
KV_INSTANTIATE_ONE(warp_and_color, WarpAndColor, float)
KV_INSTANTIATE_ONE(warp_and_color, WarpAndColor, uint8_t)
#if !defined(__AVX512F__)
KV_INSTANTIATE_ONE(warp_and_color, WarpAndColor, ::kv::Half)
KV_INSTANTIATE_ONE(warp_and_color, WarpAndColor, ::kv::BFloat16)
#endif

}  // namespace kv::augmentation::KV_ISA
