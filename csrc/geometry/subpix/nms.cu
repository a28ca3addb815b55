// Local maxima on CUDA. For windows of 3 x 3, 5 x 5 and 3 x 3 x 3, threads traverse the rows from above and keep the
// state in registers. For other windows, and for channels-last images, a thread reads the window of one element.
#include "core/launch.cuh"
#include "core/nan_min_max.cuh"
#include "core/stencils/pairs.cuh"
#include "geometry/subpix/nms.h"

namespace kv::geometry::cuda {
namespace {

constexpr int kThreads = 256;
// Of a strip: small blocks, which spread evenly over a device, and few enough that those of 16 maps of 640 x 480 run at
// once.
constexpr int kRows = 11, kStripThreads = 64;

// For any window: blocks of 32 x 8 elements of a plane's rows. Planes are the last dimension of the grid.
template <class T>
__global__ void __launch_bounds__(kThreads)
    any_window(__grid_constant__ Nms<T> const p, unsigned across, unsigned down) {
  using F = Compute<T>;
  unsigned const line = blockIdx.x / across;
  int64_t const plane = line / down;
  int const at = int(blockIdx.x - line * across) * 32 + threadIdx.x % 32;
  int const y = int(line - unsigned(plane) * down) * 8 + threadIdx.x / 32, step = int(p.x.step);
  if (at >= p.x.row_size() || y >= p.x.height) return;
  int64_t first, last;
  p.fitting(plane, y, first, last);
  int const column = step == 1 ? at : at / step;
  bool above = column >= first && column < last, below = above;
  T const* const center = p.x.row(plane, y) + at;
  F const v = read(*center);
  for (int k = -p.before[0]; k <= p.after[0]; ++k)
    for (int j = -p.before[1]; j <= p.after[1] && (above || below); ++j) {
      T const* const row = center + k * p.x.outer_stride + j * p.x.row_stride;
      for (int i = -p.before[2]; i <= p.after[2]; ++i) {
        if (i == 0 && j == 0 && k == 0) continue;
        F const other = read(row[i * step]);
        above = above && v > other;
        below = below && v < other;
      }
    }
  if (p.y.data) p.y.row(plane, y)[at] = above ? *center : T{};
  if (p.maxima.data) p.maxima.row(plane, y)[at] = above;
  if (p.minima.data) p.minima.row(plane, y)[at] = below;
}

// The state of P neighboring pixels while their windows of (2R + 1)^2 pixels move down one plane or, with D = 1, three
// planes: `next` takes one row after the other, from above.
template <int R, int D, int P>
struct Climb {
  float candidates[R + 1][P];  // elements above all others in the first rows of their window up to their row, for R + 1
                               // rows; NaN elsewhere
  float above[P], previous[P];  // the largest of the last R rows, and of the last row

  // Takes a row and, with D = 1, the largest of the rows in front of it and behind it, all times the sign.
  __device__ __forceinline__ void next(float const (&v)[P + 2 * R], float const (&others)[P + 2 * R], float sign) {
#pragma unroll
    for (int n = 0; n < P; ++n) {
      auto const at = [&](int i) { return sign * v[n + i]; };
      float adjacent = nan_max(at(0), at(2 * R));
      if (R == 2)
        adjacent = nan_max(nan_max(at(0), at(1)), nan_max(at(3), at(4)));  // two neighboring pixels share a pair
      if (D == 1) {
#pragma unroll
        for (int i = 0; i <= 2 * R; ++i) adjacent = nan_max(adjacent, sign * others[n + i]);
      }
      float const middle = at(R), row = nan_max(adjacent, middle);
#pragma unroll
      for (int j = 0; j < R; ++j) candidates[j][n] = candidates[j + 1][n];
      candidates[R][n] = middle > nan_max(adjacent, above[n]) ? middle : __uint_as_float(0x7fc00000);
      above[n] = R == 1 ? row : nan_max(row, previous[n]);
      previous[n] = row;
    }
  }
  // The pixel in the row that is R above the last one.
  __device__ __forceinline__ float middle(int n) const { return candidates[0][n]; }
  __device__ __forceinline__ bool is_summit(int n) const { return candidates[0][n] > above[n]; }
};

// The larger of two numbers, or the smaller; NaN if either is.
template <bool Larger>
__device__ __forceinline__ float extreme(float a, float b) {
  return Larger ? nan_max(a, b) : nan_min(a, b);
}
template <bool Larger, class T>
__device__ __forceinline__ Pair<T> extreme(Pair<T> a, Pair<T> b) {
  return Larger ? upper(a, b) : lower(a, b);
}
template <bool Larger, class T, int N>
__device__ __forceinline__ Vector<T, N> extremes(Vector<T, N> const& a, Vector<T, N> const& b) {
  Vector<T, N> y;
  if constexpr (sizeof(T) == 2 && N % 2 == 0) {
    Pair<T> of_a[N / 2], of_b[N / 2];
    __builtin_memcpy(of_a, &a, sizeof(a)), __builtin_memcpy(of_b, &b, sizeof(b));
#pragma unroll
    for (int i = 0; i < N / 2; ++i) of_a[i] = extreme<Larger>(of_a[i], of_b[i]);
    __builtin_memcpy(&y, of_a, sizeof(y));
  } else {
#pragma unroll
    for (int i = 0; i < N; ++i) y.v[i] = round_to<T>(extreme<Larger>(read(a.v[i]), read(b.v[i])));
  }
  return y;
}

// How a strip of rows is accessed: rows of vectors, or rows that begin anywhere.
template <int R, bool Aligned, int P>
using RowStrip = Strip<R, Aligned, P, kStripThreads / 32>;

// P elements of a row, and R elements on either side. Out-of-bounds elements are NaN, and nothing is above NaN.
template <class T>
__device__ __forceinline__ T none() {
  return round_to<T>(__uint_as_float(0x7fc00000));
}

template <class T, int R, int P, bool Aligned>
struct Row {
  Vector<T, P> own;
  Vector<T, R> left, right;  // the ends of a warp read them themselves

  __device__ __forceinline__ Row() {
#pragma unroll
    for (int i = 0; i < R; ++i) left.v[i] = right.v[i] = none<T>();
  }
  __device__ __forceinline__ void fetch(RowStrip<R, true, P> const& strip, T const* at, bool in_bounds) {
#pragma unroll
    for (int i = 0; i < P; ++i) own.v[i] = none<T>();
    if (!in_bounds) return;
    int const x = strip.x, width = strip.width;
    if (x < width) own = *reinterpret_cast<Vector<T, P> const*>(at);
    if (threadIdx.x % 32 == 0 && x > 0) left = *reinterpret_cast<Vector<T, R> const*>(at - R);
    if (threadIdx.x % 32 == 31 && x + P < width) right = *reinterpret_cast<Vector<T, R> const*>(at + P);
  }
  // The larger, or smaller, elements of two rows.
  template <bool Larger>
  static __device__ __forceinline__ Row extremes_of(Row const& a, Row const& b) {
    Row y;
    y.own = extremes<Larger>(a.own, b.own);
    y.left = extremes<Larger>(a.left, b.left);
    y.right = extremes<Larger>(a.right, b.right);
    return y;
  }
  __device__ __forceinline__ void spread(RowStrip<R, true, P> const&, float (&v)[P + 2 * R]) const {
#pragma unroll
    for (int i = 0; i < P; ++i) v[R + i] = read(own.v[i]);
#pragma unroll
    for (int i = 0; i < R; ++i) {
      float const before = __shfl_up_sync(0xffffffffu, v[P + i], 1), after = __shfl_down_sync(0xffffffffu, v[R + i], 1);
      v[i] = threadIdx.x % 32 == 0 ? read(left.v[i]) : before;
      v[R + P + i] = threadIdx.x % 32 == 31 ? read(right.v[i]) : after;
    }
  }
};

// Rows that begin anywhere.
template <class T, int R, int P>
struct Row<T, R, P, false> {
  typename RowStrip<R, false, P>::template FetchedRow<T> fetched{};

  __device__ __forceinline__ void fetch(RowStrip<R, false, P> const& strip, T const* at, bool in_bounds) {
    if (in_bounds) {
      fetched = strip.fetch(at - strip.x);
      if (strip.halo_source < 0) fetched.halo = none<T>();
    } else {
      T nones[sizeof(fetched.words) / sizeof(T)];
      for (T& x : nones) x = none<T>();
      __builtin_memcpy(fetched.words, nones, sizeof(nones));
      fetched.halo = none<T>();
    }
  }
  // Both begin at the same element of a word: they are two planes apart.
  template <bool Larger>
  static __device__ __forceinline__ Row extremes_of(Row const& a, Row const& b) {
    constexpr int N = sizeof(a.fetched.words) / sizeof(T);
    Vector<T, N> of_a, of_b;
    __builtin_memcpy(&of_a, a.fetched.words, sizeof(of_a)), __builtin_memcpy(&of_b, b.fetched.words, sizeof(of_b));
    of_a = extremes<Larger>(of_a, of_b);
    Row y;
    __builtin_memcpy(y.fetched.words, &of_a, sizeof(of_a));
    y.fetched.halo = extremes<Larger>(Vector<T, 1>{a.fetched.halo}, Vector<T, 1>{b.fetched.halo}).v[0];
    y.fetched.preceding = a.fetched.preceding;
    return y;
  }
  __device__ __forceinline__ void spread(RowStrip<R, false, P> const& strip, float (&v)[P + 2 * R]) const {
    strip.spread(fetched, v);
  }
};

// Blocks on a multiprocessor, for volumes: more of them hide more latency than the registers are worth. 0: any.
template <class T, int D, bool Minima>
constexpr int kStripBlocks = D == 0           ? 0
                             : sizeof(T) == 4 ? (Minima ? 10 : 14)
                                              : (Minima ? 8 : 10);

template <class T, int R, int D, bool Minima, bool Aligned>
__global__ void __launch_bounds__(kStripThreads, kStripBlocks<T, D, Minima>)
    strips_down(__grid_constant__ Nms<T> const p, Strips<kPixels<T>> const strips) {
  constexpr int P = kPixels<T>, kPlanes = 2 * D + 1;
  int64_t plane;
  int x, y0;
  if (!strips.locate(plane, x, y0)) return;
  int const width = int(p.x.width), height = int(p.x.height), z = D > 0 ? int(plane % p.depth) : 0;
  RowStrip<R, Aligned, P> const strip(x, width, Border::constant);
  T const* next = p.x.row(plane, 0) + (y0 - R) * p.x.row_stride + x;
  T* values = p.y.row(plane, y0) + x;
  uint8_t *maxima = p.maxima.row(plane, y0) + x, *minima = p.minima.row(plane, y0) + x;
  Row<T, R, P, Aligned> ahead[kPlanes];
  auto const fetch = [&](int y) {
#pragma unroll
    for (int k = 0; k < kPlanes; ++k) {
      bool const between = k == D || (z + k >= D && z + k < D + int(p.depth));
      ahead[k].fetch(strip, next + (k - D) * p.x.outer_stride, y >= 0 && y < height && between);
    }
    next += p.x.row_stride;
  };
  auto const store_flags = [&](uint8_t* to, Vector<uint8_t, P> const& flags) {
    if constexpr (Aligned)
      *reinterpret_cast<Vector<uint8_t, P>*>(to) = flags;
    else
      store_striped<P, kStripThreads / 32>(to, flags, x, width);
  };
  fetch(y0 - R);
  Climb<R, D, P> high{}, low{};
#pragma unroll(R + 1)
  for (int i = -2 * R; i < kRows; ++i) {
    if (y0 + i >= height) break;
    // Rows in front and behind are reduced before the threads exchange elements: two exchanges instead of three.
    using AnyRow = Row<T, R, P, Aligned>;
    float v[P + 2 * R], largest[P + 2 * R], smallest[P + 2 * R];
    ahead[D].spread(strip, v);
    if constexpr (D == 1) AnyRow::template extremes_of<true>(ahead[0], ahead[2]).spread(strip, largest);
    if constexpr (D == 1 && Minima) AnyRow::template extremes_of<false>(ahead[0], ahead[2]).spread(strip, smallest);
    fetch(y0 + R + i + 1);
    high.next(v, largest, 1);
    if constexpr (Minima) low.next(v, smallest, -1);
    if (i < 0) continue;
    float shown[P];
    Vector<uint8_t, P> is_maximum, is_minimum;
#pragma unroll
    for (int n = 0; n < P; ++n) {
      is_maximum.v[n] = high.is_summit(n);
      shown[n] = high.is_summit(n) ? high.middle(n) : 0.f;
      if constexpr (Minima) is_minimum.v[n] = low.is_summit(n);
    }
    if (!Aligned || x < width) {
      if (p.y.data) {
        if constexpr (Aligned)
          store_vector(values, shown);
        else
          store_striped<P, kStripThreads / 32>(values, shown, x, width);
      }
      if (p.maxima.data) store_flags(maxima, is_maximum);
      if constexpr (Minima) store_flags(minima, is_minimum);
    }
    values += p.y.row_stride;
    maxima += p.maxima.row_stride;
    if constexpr (Minima) minima += p.minima.row_stride;
  }
}

// In vectors; the last one may be incomplete.
template <class T>
__global__ void __launch_bounds__(kThreads) keep(ApplyNmsMask<T> const p, bool vectorized) {
  constexpr int P = kPixels<T>;
  int64_t const first = (blockIdx.x * int64_t(kThreads) + threadIdx.x) * P;
  if (vectorized && first + P <= p.count) {
    Vector<T, P> x = *reinterpret_cast<Vector<T, P> const*>(p.x + first);
    auto const flags = *reinterpret_cast<Vector<uint8_t, P> const*>(p.flags + first);
#pragma unroll
    for (int i = 0; i < P; ++i) x.v[i] = flags.v[i] ? x.v[i] : T{};
    store_vector(p.result + first, x);
  } else {
    for (int64_t i = first; i < min(first + P, p.count); ++i) p.result[i] = p.flags[i] ? p.x[i] : T{};
  }
}

}  // namespace

template <class T>
int apply_nms_mask(ApplyNmsMask<T> const& p, CUstream_st* stream) {
  constexpr int P = kPixels<T>;
  uintptr_t const at = reinterpret_cast<uintptr_t>(p.x) | reinterpret_cast<uintptr_t>(p.result);
  bool const vectorized = at % alignof(Vector<T, P>) == 0 && reinterpret_cast<uintptr_t>(p.flags) % P == 0;
  keep<T><<<unsigned(ceil_div(p.count, kThreads * P)), kThreads, 0, stream>>>(p, vectorized);
  return cudaGetLastError();
}

template <class T>
int nms(Nms<T> const& p, CUstream_st* stream) {
  constexpr int P = kPixels<T>;
  auto const reaches = [&](int d, int r) {
    return p.before[0] == d && p.after[0] == d && p.before[1] == r && p.after[1] == r && p.before[2] == r &&
           p.after[2] == r;
  };
  if constexpr (sizeof(T) < 8)
    if (p.x.step == 1) {
      Strips<P> const strips(p.x.count(), p.x.height, p.x.width, kRows);
      auto const run = [&](auto reach, auto depth, auto minima) {
        auto* kernel = strips_down<T, reach.value, depth.value, minima.value, false>;
        if (is_vectorizable<P>(p.x) && (!p.y.data || is_vectorizable<P>(p.y)))
          kernel = strips_down<T, reach.value, depth.value, minima.value, true>;
        kernel<<<strips.blocks(kStripThreads / 32), kStripThreads, 0, stream>>>(p, strips);
        return cudaGetLastError();
      };
      std::integral_constant<int, 0> const flat;
      std::integral_constant<int, 1> const one;
      std::integral_constant<int, 2> const two;
      if (reaches(0, 1) && !p.minima.data) return run(one, flat, std::false_type{});
      // Special case, H200: 8.2 (nms2d) to 18 (nms5) times as fast as a thread an element.
      if (reaches(0, 2) && !p.minima.data) return run(two, flat, std::false_type{});
      // Special case, H200: 4.0 to 7.7 times as fast as a thread an element.
      if (reaches(1, 1)) return p.minima.data ? run(one, one, std::true_type{}) : run(one, one, std::false_type{});
    }
  unsigned const across = unsigned(ceil_div(p.x.row_size(), 32)), down = unsigned(ceil_div(p.x.height, 8));
  any_window<T><<<unsigned(p.x.count() * across * down), kThreads, 0, stream>>>(p, across, down);
  return cudaGetLastError();
}

KV_INSTANTIATE(nms, Nms)
KV_INSTANTIATE(apply_nms_mask, ApplyNmsMask)

}  // namespace kv::geometry::cuda
