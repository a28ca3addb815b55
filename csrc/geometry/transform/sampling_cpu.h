// Chunks of rows of sampling coordinates, and windows of taps, on the CPU. Included outside of namespaces.
#pragma once

#include "core/iota.h"
#include "core/lanes.h"
#include "geometry/transform/taps.h"

namespace kv::geometry::KV_ISA {
namespace {

// --- sampling coordinates --------------------------------------------------------------------------------------------

// Calls body(sample, y, first column, columns) for rows [begin, end) of a batch, in tiles. A row of a rotated
// image reads from many rows of its source, and the next row reads them again. Without tiles, long rows would read more
// than the caches hold.
constexpr int64_t kTileRows = 32, kTileColumns = 128;
template <class Body>
KV_HD void for_each_row_chunk(int64_t begin, int64_t end, int64_t height, int64_t width, Body body) {
  while (begin < end) {
    int64_t const b = begin / height, last = min(min(end, (b + 1) * height), begin + kTileRows);
    for (int64_t x = 0; x < width; x += kTileColumns)
      for (int64_t r = begin; r < last; ++r) body(b, r - b * height, x, min(width - x, kTileColumns));
    begin = last;
  }
}

// The sampling coordinates of chunks of rows of the output, one after the other.
template <class F>
struct CoordRow {
  F u[kTileColumns], v[kTileColumns];

  void fill(SampleCoords<F> const& coords, int64_t b, int64_t y, int64_t first, int64_t count) {
    if (coords.has_map()) {
      F const own = coords.own;
      copy(coords.x, b, y, first, count, coords.scale[0], F(first) * own + coords.offset[0], own, u);
      copy(coords.y, b, y, first, count, coords.scale[1], F(y) * own + coords.offset[1], F(0), v);
      return;
    }
    map_of(coords, b);
    double first_u, first_v;
    map.apply(double(first), double(y), first_u, first_v);
    Size const source = coords.use.source;
    F const from_u = F(origin_near(first_u, source.width)), from_v = F(origin_near(first_v, source.height));
    auto const near = bind_to_tile<F>(map, double(first), double(y), from_u, from_v);
    for_each_vector<F>(0, count, [&](auto lanes, int64_t x) {
      constexpr int N = decltype(lanes)::value;
      Lanes<F, N> to_u, to_v;
      near.apply(iota<N, F>(x), F(0), to_u, to_v);
      store<N>(u + x, Lanes<F, N>(to_u + from_u));
      store<N>(v + x, Lanes<F, N>(to_v + from_v));
    });
  }

  // From pixels of sample b to those of its image.
  Homography<double> const& map_of(SampleCoords<F> const& coords, int64_t b) {
    if (sample != b) {
      map = homography(coords.matrices + b * coords.matrix_stride, coords.use);
      sample = b;
    }
    return map;
  }

 private:
  int64_t sample = -1;
  Homography<double> map;  // of that sample

  // The i-th is scale * n + offset + i * step.
  KV_HD static void copy(Images<F const> const& map, int64_t b, int64_t y, int64_t first, int64_t count, F scale,
                         F offset, F step, F* to) {
    F const* const from = map.row(b, 0, y) + first * map.step;
    if (map.step != 1)
      for (int64_t x = 0; x < count; ++x) to[x] = from[x * map.step] * scale + (F(x) * step + offset);
    else
      for_each_vector<F>(0, count, [&](auto lanes, int64_t x) {
        constexpr int N = decltype(lanes)::value;
        __builtin_prefetch(from + 2 * map.row_stride + x);  // a later chunk of the tile
        store<N>(to + x, Lanes<F, N>(load<N>(from + x) * scale + (iota<N, F>(x) * step + offset)));
      });
  }
};

// The number of coordinates in a vector. Filling 64 bytes element by element takes longer than filling 32 twice.
template <class T>
constexpr int kCoordLanes = (kVectorBytes < 32 ? kVectorBytes : 32) / int(sizeof(Compute<T>));

// Calls windows(number of lanes) for a chunk of a row. Offsets within a plane are ints in vectors, so huge planes are
// processed one coordinate at a time, as are chunks shorter than a vector.
template <class T, class F>
KV_HD void dispatch_lanes(Images<T const> const& x, int64_t count, F windows) {
  int64_t const reach = x.height * x.row_stride + x.width * x.step;
  if (count < kCoordLanes<T> || reach > INT32_MAX || reach < INT32_MIN)
    windows(Width<1>{});
  else
    windows(Width<kCoordLanes<T>>{});
}

// The index at which the i-th vector of N out of `count` coordinates begins; the last one overlaps the one before it.
template <int N>
KV_HD int64_t vector_start(int64_t i, int64_t count) {
  return min(i * N, count - N);
}

// --- reading by lanes ------------------------------------------------------------------------------------------------

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

// Two adjacent elements in one access.
template <class Bits, class T>
KV_HD Bits load_bits(T const* p) {
  static_assert(sizeof(Bits) == 2 * sizeof(T));
  Bits bits;
  __builtin_memcpy(&bits, p, sizeof(Bits));
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

// p[at] and p[at + step]. Adjacent pixels come in one access; what serves others is kept away from
// it, or its addresses would take the registers.
template <int N, class T, class At, class V>
[[gnu::noinline]] void gather_apart(T const* p, At const& at, int64_t step, V& a, V& b) {
  a = gather<N>(p, at);
  b = gather<N>(p + step, at);
}
template <int N, class T, class At, class V>
KV_HD void gather_two(T const* p, At const& at, int64_t step, V& a, V& b) {
  if constexpr (__is_same(T, float) && N > 1)
    if (step == 1) {
      Lanes<double, N / 2> low, high;
      for (int i = 0; i < N / 2; ++i) {
        low[i] = load_bits<double>(p + at[i]);
        high[i] = load_bits<double>(p + at[N / 2 + i]);
      }
      a = every_second<0>(__builtin_bit_cast(V, low), __builtin_bit_cast(V, high));
      b = every_second<1>(__builtin_bit_cast(V, low), __builtin_bit_cast(V, high));
      return;
    }
  if constexpr (sizeof(T) == 2 && N > 1)
    if (step == 1) {
      Lanes<uint32_t, N> both;
      for (int i = 0; i < N; ++i) both[i] = load_bits<uint32_t>(p + at[i]);
      T low[N], high[N];
      write_lanes<N>(&low->bits, __builtin_convertvector(both, Lanes<uint16_t, N>));
      write_lanes<N>(&high->bits, __builtin_convertvector(both >> 16, Lanes<uint16_t, N>));
      a = load<N>(low);
      b = load<N>(high);
      return;
    }
  if constexpr (sizeof(T) == 1 && N > 1)
    if (step == 1) {
      Lanes<int32_t, N> both;
      for (int i = 0; i < N; ++i) both[i] = load_bits<uint16_t>(p + at[i]);
      a = __builtin_convertvector(both & 0xff, V);
      b = __builtin_convertvector(both >> 8, V);
      return;
    }
  gather_apart<N>(p, at, step, a, b);
}

// --- masks -----------------------------------------------------------------------------------------------------------

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

// --- windows ---------------------------------------------------------------------------------------------------------

// The K x K taps around N sampling coordinates.
template <int K, int N, class T>
struct TapWindow {
  using F = Compute<T>;
  using V = Lanes<F, N>;
  using I = Lanes<int, N>;
  V tx, ty;
  I x, y;            // the first taps
  bool inside;       // all taps are in bounds
  bool outside;      // all taps are the fill
  Offsets<N> first;  // offsets of the first taps in a plane, if they are in bounds

  KV_HD void set(Sampling<T> const& p, V u, V v, int64_t row_stride = 0, int64_t step = 0) {
    x = first_tap<K, F>(near_image(p.x_axis, u), tx);
    y = first_tap<K, F>(near_image(p.y_axis, v), ty);
    int const width = p.x_axis.size, height = p.y_axis.size;
    inside = all<N>((x >= 0) & (x <= width - K) & (y >= 0) & (y <= height - K));
    outside =
        p.x_axis.padding == Padding::fill && !inside && all<N>((x <= -K) | (x >= width) | (y <= -K) | (y >= height));
    first.set(offset<N>(y, x, row_stride, step));
  }

  // Tap (j, i), which is in bounds.
  KV_HD V read(Images<T const> const& image, T const* plane, int j, int i) const {
    return gather<N>(plane + j * image.row_stride + i * image.step, first);
  }
  // Tap (j, i), in bounds or padded.
  KV_HD V find(Sampling<T> const& p, Images<T const> const& image, T const* plane, F fill, int j, int i) const {
    I const px = pixel_at(p.x_axis, I(x + i)), py = pixel_at(p.y_axis, I(y + j));
    I const zero{}, last_x = zero + (p.x_axis.size - 1), last_y = zero + (p.y_axis.size - 1);
    auto const exists = mask_for<F, N>((px >= 0) & (px <= last_x) & (py >= 0) & (py <= last_y));
    I const cx = min(last_x, max(zero, px)), cy = min(last_y, max(zero, py));
    Offsets<N> coords;
    coords.set(offset<N>(cy, cx, image.row_stride, image.step));
    V const value = gather<N>(plane, coords);
    return exists ? value : V(V{} + fill);
  }
};

}  // namespace
}  // namespace kv::geometry::KV_ISA
