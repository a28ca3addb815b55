// Rows of places and windows of taps on the CPU. Included by sample*_cpu.cpp, inside of no namespace.
#pragma once

#include "core/lanes.h"
#include "core/scratch.h"
#include "taps.h"

namespace kv::KV_ISA {
namespace {

// --- places
// --------------------------------------------------------------------------------------------------------

template <int N, class F>
KV_HD Lanes<F, N> count_from(int64_t first) {
  if constexpr (N == 1) {
    return F(first);
  } else {
    Lanes<F, N> v;
    for (int i = 0; i < N; ++i) v[i] = F(i);
    return v + F(first);
  }
}

// The places of a row of the output.
template <class F>
struct PlaceRow {
  int64_t width;
  Scratch<F> memory;
  F* u;
  F* v;

  explicit PlaceRow(int64_t width) : width(width), memory(2 * width), u(memory.data), v(u + width) {}

  void fill(Places<F> const& places, int64_t b, int64_t y) {
    if (!places.matrices) {
      copy(places.x.row(b, 0, y), places.x.step, places.scale[0], places.offset[0], u);
      copy(places.y.row(b, 0, y), places.y.step, places.scale[1], places.offset[1], v);
      return;
    }
    auto const map = homography(places.matrices + b * places.matrix_stride, places.use);
    for_each_vector<F>(0, width, [&](auto lanes, int64_t x) {
      constexpr int N = decltype(lanes)::value;
      Lanes<F, N> to_u, to_v;
      map.at(count_from<N, F>(x), F(y), to_u, to_v);
      store<N>(u + x, to_u);
      store<N>(v + x, to_v);
    });
  }

 private:
  KV_HD void copy(F const* from, int64_t step, F scale, F offset, F* to) const {
    if (step != 1)
      for (int64_t x = 0; x < width; ++x) to[x] = from[x * step] * scale + offset;
    else
      for_each_vector<F>(0, width, [&](auto lanes, int64_t x) {
        constexpr int N = decltype(lanes)::value;
        store<N>(to + x, Lanes<F, N>(load<N>(from + x) * scale + offset));
      });
  }
};

// How many places a vector has. Filling 64 bytes element by element takes longer than filling 32 twice.
template <class T>
constexpr int kPlaces = (kVectorBytes < 32 ? kVectorBytes : 32) / int(sizeof(Compute<T>));

// Calls pixels(number of lanes, x) over a row. Offsets within a plane are ints in vectors, so huge planes go one by
// one.
template <class T, class F>
KV_HD void for_each_place(Images<T> const& x, int64_t width, F pixels) {
  int64_t const reach = x.height * x.row_stride + x.width * x.step;
  if (reach > INT32_MAX || reach < INT32_MIN)
    for (int64_t e = 0; e < width; ++e) pixels(Width<1>{}, e);
  else
    for_each_vector<T, kPlaces<T>>(0, width, pixels);
}

// --- reading by lanes
// ----------------------------------------------------------------------------------------------

template <int N, class I>
KV_HD auto offset(I y, I x, int64_t row, int64_t step) {
  if constexpr (N == 1)
    return y * row + x * step;
  else
    return y * int(row) + x * int(step);
}

// Offsets in memory, from where they go to addresses faster than out of vectors.
template <int N>
struct Offsets {
  int values[N];
  KV_HD void set(Lanes<int, N> v) { __builtin_memcpy(values, &v, sizeof(v)); }
  KV_HD int operator[](int i) const { return values[i]; }
};
template <>
struct Offsets<1> {
  int64_t value;
  KV_HD void set(int64_t v) { value = v; }
  KV_HD int64_t operator[](int) const { return value; }
};

// Two floats.
KV_HD double load_bits(float const* p) {
  double bits;
  __builtin_memcpy(&bits, p, 8);
  return bits;
}

// Element by element: gather instructions are slower than that on many processors.
template <int N, class T, class At>
KV_HD Lanes<Compute<T>, N> gather(T const* p, At const& at) {
  if constexpr (N == 1) {
    return load<1>(p + at[0]);
  } else {
    Lanes<Compute<T>, N> v;
    for (int i = 0; i < N; ++i) v[i] = load<1>(p + at[i]);
    return v;
  }
}

// p[at] and p[at + step].
template <int N, class T, class At, class V>
KV_HD void gather_two(T const* p, At const& at, int64_t step, V& a, V& b) {
  if constexpr (__is_same(T, float) && N > 1)
    if (step == 1) {  // both in one access
      Lanes<double, N / 2> low, high;
      typename lanes_of<int, N>::type even;
      for (int i = 0; i < N / 2; ++i) {
        low[i] = load_bits(p + at[i]);
        high[i] = load_bits(p + at[N / 2 + i]);
      }
      for (int i = 0; i < N; ++i) even[i] = 2 * i;
      a = __builtin_shuffle(__builtin_bit_cast(V, low), __builtin_bit_cast(V, high), even);
      b = __builtin_shuffle(__builtin_bit_cast(V, low), __builtin_bit_cast(V, high), even + 1);
      return;
    }
  a = gather<N>(p, at);
  b = gather<N>(p + step, at);
}

// --- masks
// ---------------------------------------------------------------------------------------------------------

// A comparison of ints as one that chooses between numbers F.
template <class F, int N, class M>
KV_HD auto mask_for(M mask) {
  if constexpr (N == 1)
    return bool(mask);
  else
    return __builtin_convertvector(mask, Lanes<typename integer_of<sizeof(F)>::type, N>);
}

template <int N, class M>
KV_HD bool all(M mask) {
  if constexpr (N == 1) {
    return bool(mask);
  } else {
#if defined(__AVX2__)
    if constexpr (sizeof(M) == 32) return _mm256_movemask_epi8((__m256i)mask) == -1;
#endif
#if defined(__x86_64__)
    if constexpr (sizeof(M) == 16) return _mm_movemask_epi8((__m128i)mask) == 0xffff;
#endif
    bool every = true;
    for (int i = 0; i < N; ++i) every = every && mask[i] != 0;
    return every;
  }
}

// --- windows
// -------------------------------------------------------------------------------------------------------

// The K x K taps around N places.
template <int K, int N, class T>
struct Window {
  using F = Compute<T>;
  using V = Lanes<F, N>;
  using I = Lanes<int, N>;
  Axis<F> const &x_axis, &y_axis;
  V tx, ty;
  I x, y;            // the first taps
  bool inside;       // all taps of all places are
  Offsets<N> first;  // where the first taps are in a plane, if they are inside

  KV_HD Window(Sampling<T> const& p, V u, V v, int64_t row_stride = 0, int64_t step = 0)
      : x_axis(p.x_axis), y_axis(p.y_axis) {
    x = first_tap<K, F>(near_image(x_axis, u), tx);
    y = first_tap<K, F>(near_image(y_axis, v), ty);
    inside = all<N>((x >= 0) & (x <= x_axis.size - K) & (y >= 0) & (y <= y_axis.size - K));
    first.set(offset<N>(y, x, row_stride, step));
  }

  // Tap (j, i), read where it is known to be a pixel.
  KV_HD V read(Images<T const> const& image, T const* plane, int j, int i) const {
    return gather<N>(plane + j * image.row_stride + i * image.step, first);
  }
  // Tap (j, i), whatever is there.
  KV_HD V find(Images<T const> const& image, T const* plane, F fill, int j, int i) const {
    I const px = pixel_at(x_axis, I(x + i)), py = pixel_at(y_axis, I(y + j));
    I const zero{}, last_x = zero + (x_axis.size - 1), last_y = zero + (y_axis.size - 1);
    auto const exists = mask_for<F, N>((px >= 0) & (px <= last_x) & (py >= 0) & (py <= last_y));
    I const cx = min(last_x, max(zero, px)), cy = min(last_y, max(zero, py));
    Offsets<N> places;
    places.set(offset<N>(cy, cx, image.row_stride, image.step));
    V const value = gather<N>(plane, places);
    return exists ? value : V(V{} + fill);
  }
};

}  // namespace
}  // namespace kv::KV_ISA
