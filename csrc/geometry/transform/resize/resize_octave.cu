// Resizing by exactly two along both axes on CUDA, which dominates the time of pyramids, and its backward pass, which
// exchanges halving and doubling.
//
//   halving     pixel i is made of the K pixels from 2 i - (K / 2 - 1) on: 2 bilinear, 4 antialiased or bicubic, 6 of
//               pyrdown, 8 of the gradient of pyrup
//   doubling    pixels 2 i and 2 i + 1 are each made of M of the pixels around i, the odd one's window being the even
//               one's mirror image: 2 bilinear, 4 of pyrup, 1 and 3 of the gradients of bilinear and of pyrdown
//
// The offsets of the windows are constants, and weights are equal everywhere but at the border. A warp traverses a
// strip of 32 vectors of the larger image downwards; each row is weighted along x once, and along y from registers.
#include "core/row_prefetcher.cuh"
#include "geometry/transform/resize/resize.h"

namespace kv::geometry::cuda {
namespace {

constexpr int kWarps = 4;
template <class T>
constexpr int kVectorSize = sizeof(T) < 4 ? 8 : 4;  // a thread's pixels of the larger image
constexpr int kMinSize = 16;                        // pixels along an axis: both borders are disjoint

// Pixels at a border, whose windows differ, and kinds of pixels in the interior.
constexpr int border_of(bool doubles) { return doubles ? 4 : 2; }
constexpr int kinds_of(bool doubles) { return doubles ? 2 : 1; }

// Where the window of pixel i of the result begins.
KV_HD int window_start(bool doubles, int i, int taps) {
  return doubles ? i / 2 - (taps - i % 2) / 2 : 2 * i - (taps / 2 - 1);
}

// The weights of both axes: of the first pixels, of one of each kind, of the last pixels.
template <bool Doubles, int Taps>
struct OctaveWeights {
  static constexpr int kBorderRows = border_of(Doubles), kRows = 2 * kBorderRows + kinds_of(Doubles);
  float at[kRows][Taps];
  // The weights of pixel i of n. Those of a pixel out of bounds are never used.
  __device__ __forceinline__ float const* of(int i, int n) const {
    int const inner = Doubles ? kBorderRows + i % 2 : kBorderRows;
    return at[i < kBorderRows ? max(i, 0) : i < n - kBorderRows ? inner : min(i - n + kRows, kRows - 1)];
  }
};

// Writes rows of them. Once for all kinds of kernels, for the sake of the time to compile.
[[gnu::noinline]] void write_weights(float* at, bool doubles, int taps, ResizeAxis const& axis) {
  int const border_rows = border_of(doubles), inner = border_rows + kinds_of(doubles), rows = border_rows + inner;
  for (int i = 0; i < rows * taps; ++i) at[i] = 0;
  for (int i = 0; i < inner; ++i) {
    Contributors<float> const reads = contributors<float>(axis, i);
    float* const from = at + i * taps + reads.first - window_start(doubles, i, taps);
    for (int k = 0; k < reads.count; ++k) from[k] = weight_at(axis, reads, i, k);
  }
  for (int i = 0; i < border_rows * taps; ++i) at[rows * taps - 1 - i] = at[i];
}

template <class T, int P, class Aligned>
using Ring = T[4][kRingPitch<T, P, Aligned>];  // three rows are in flight

// Stores a thread's P pixels, those at x ... of a row of `width`, to `to`. Called by all 32 threads.
template <class T, int P, class Aligned>
__device__ __forceinline__ void store_row_part(T* to, float const (&v)[P], int x, int width, Aligned aligned) {
  if constexpr (!Aligned::value && sizeof(T) == 4)
    store_striped<P, kWarps>(to, v, x, width);
  else
    store_pixels(to, v, x, width, aligned);
}

template <class T, int K, class Aligned>
__global__ void __launch_bounds__(32 * kWarps)
    halve(__grid_constant__ Planes<T const> const x, __grid_constant__ Planes<T> const y,
          __grid_constant__ OctaveWeights<false, K> const weights, Strips<kVectorSize<T> / 2> strips, Aligned aligned) {
  constexpr int P = kVectorSize<T>, C = P / 2, R = K / 2 - 1, kFirst = kBefore<2 * R + 1, P> - R,
                kEnd = border_of(false);
  __shared__ __align__(16) Ring<T, P, Aligned> rings[kWarps];
  int64_t plane;
  int column, top;
  if (!strips.locate(plane, column, top)) return;
  int const lane = threadIdx.x % 32, width = int(y.width), height = int(y.height);
  int const bottom = min(top + int(strips.rows), height);
  RowPrefetcher<T, P, R, 4, Aligned> rows(rings[threadIdx.x / 32], x, plane, Border::constant, Border::constant,
                                          aligned, 2 * (column - C * lane), 2 * top - R, 2 * (bottom - top + R));
  float weights_x[C][K], weights_y[R + 1][2];
#pragma unroll
  for (int c = 0; c < C; ++c) {
    float const* const from = weights.of(column + c, width);
#pragma unroll
    for (int k = 0; k < K; ++k) weights_x[c][k] = from[k];
  }

  // Two rows at a time. Of the R + 1 rows of the result that they are part of, row i is the last one, and the first one
  // is complete.
  float sums[R + 1][C] = {};
  T* out = y.row(plane, top) + column;
#pragma unroll 1
  for (int i = top; i < bottom + R; ++i) {
    float along_x[2][C];
#pragma unroll
    for (int r = 0; r < 2; ++r) {
      float v[P + 2 * kBefore<2 * R + 1, P>];
      read_windows<2 * R + 1, P>(rows.row(2 * (i - top) + r), v, aligned);
#pragma unroll
      for (int c = 0; c < C; ++c) {
        along_x[r][c] = weights_x[c][0] * v[kFirst + 2 * c];
#pragma unroll
        for (int k = 1; k < K; ++k) along_x[r][c] += weights_x[c][k] * v[kFirst + 2 * c + k];
      }
    }
    if (i == top || i <= kEnd + R || i >= height - kEnd) {  // elsewhere the weights do not change
#pragma unroll
      for (int t = 0; t <= R; ++t) {
        float const* const from = weights.of(i - t, height);
        weights_y[t][0] = from[2 * t], weights_y[t][1] = from[2 * t + 1];
      }
    }
#pragma unroll
    for (int t = R; t >= 0; --t) {
#pragma unroll
      for (int c = 0; c < C; ++c) {
        float const above = t ? sums[max(t - 1, 0)][c] : 0;
        sums[t][c] = above + weights_y[t][0] * along_x[0][c] + weights_y[t][1] * along_x[1][c];
      }
    }
    if (i < top + R) continue;
    store_row_part(out, sums[R], column, width, aligned);
    out += y.row_stride;
  }
}

template <class T, int M, class Aligned>
__global__ void __launch_bounds__(32 * kWarps)
    doubled(__grid_constant__ Planes<T const> const x, __grid_constant__ Planes<T> const y,
            __grid_constant__ OctaveWeights<true, M> const weights, Strips<kVectorSize<T> / 2> strips, T const* minuend,
            Aligned aligned) {
  constexpr int P = kVectorSize<T>, C = P / 2, R = M / 2, kMiddle = kBefore<2 * R + 1, C>, kEnd = border_of(true);
  __shared__ __align__(16) Ring<T, C, Aligned> rings[kWarps];
  int64_t plane;
  int column, top;
  if (!strips.locate(plane, column, top)) return;
  int const lane = threadIdx.x % 32, width = int(y.width), height = int(y.height);
  int const bottom = min(top + int(strips.rows), int(x.height));
  RowPrefetcher<T, C, R, 4, Aligned> rows(rings[threadIdx.x / 32], x, plane, Border::constant, Border::constant,
                                          aligned, column - C * lane, top - R, bottom - top + 2 * R);
  float weights_x[P][M], weights_y[2][M];
#pragma unroll
  for (int p = 0; p < P; ++p) {
    float const* const from = weights.of(2 * column + p, width);
#pragma unroll
    for (int k = 0; k < M; ++k) weights_x[p][k] = from[k];
  }

  float along_x[2 * R + 1][P] = {};  // of the rows around row i, which becomes two rows
  T* out = y.row(plane, 2 * top) + 2 * column;
#pragma unroll 1
  for (int i = top - 2 * R; i < bottom; ++i) {
    float v[C + 2 * kMiddle];
    read_windows<2 * R + 1, C>(rows.row(i - top + 2 * R), v, aligned);
#pragma unroll
    for (int p = 0; p < P; ++p) {
#pragma unroll
      for (int r = 0; r < 2 * R; ++r) along_x[r][p] = along_x[r + 1][p];
      float const* const window = v + kMiddle + window_start(true, p, M);
      along_x[2 * R][p] = weights_x[p][0] * window[0];
#pragma unroll
      for (int k = 1; k < M; ++k) along_x[2 * R][p] += weights_x[p][k] * window[k];
    }
    if (i < top) continue;
    if (i == top || 2 * i <= kEnd || 2 * i >= height - kEnd) {  // elsewhere the weights do not change
#pragma unroll
      for (int odd = 0; odd < 2; ++odd) {
        float const* const from = weights.of(2 * i + odd, height);
#pragma unroll
        for (int k = 0; k < M; ++k) weights_y[odd][k] = from[k];
      }
    }
#pragma unroll
    for (int odd = 0; odd < 2; ++odd) {
      float sums[P];
#pragma unroll
      for (int p = 0; p < P; ++p) {
        int const from = R + window_start(true, odd, M);
        sums[p] = weights_y[odd][0] * along_x[from][p];
#pragma unroll
        for (int k = 1; k < M; ++k) sums[p] += weights_y[odd][k] * along_x[from + k][p];
      }
      if (M == 4 && minuend && 2 * column < width) {  // M: pyrup's
        T const* const at = minuend + (out - y.data);
        Vector<T, P> from;
        if (aligned) {
          from = *reinterpret_cast<Vector<T, P> const*>(at);
        } else {
#pragma unroll
          for (int p = 0; p < P; ++p) from.v[p] = at[min(p, width - 1 - 2 * column)];
        }
#pragma unroll
        for (int p = 0; p < P; ++p) sums[p] = read(from.v[p]) - sums[p];
      }
      store_row_part(out, sums, 2 * column, width, aligned);
      out += y.row_stride;
    }
  }
}

// Special case, H200: 1.0 (resize to half) to 3.3 (pyrup backward) times as fast as the other kernels where it
// halves, 1.2 (laplacian pyramid backward) to 4.3 (pyrup) where it doubles.

// Whether an axis is halved or doubled by windows with a border that is narrow enough.
inline bool is_octave(ResizeAxis const& a) {
  bool const twice = a.source == 2 * a.result || 2 * a.source == a.result,
             antialiased_backward = a.filter == ResizeFilter::bicubic && a.antialias && a.backward;
  return twice && a.num == 2 * a.source && a.filter >= ResizeFilter::bilinear && !antialiased_backward &&
         min(a.source, a.result) >= kMinSize;
}

// Of rows that are no vectors, those with few taps are halved faster by resize_linear and resize_strips: for float16
// these take 0.7 to 0.8 of the time, 49x3x336x514 on an H200.
template <bool Doubles, int Taps>
constexpr bool kServesAnyAlignment = Doubles || Taps >= 6;

template <class T, bool Doubles, int Taps>
int launch(Resize<T> const& p, CUstream_st* stream) {
  constexpr int P = kVectorSize<T>, C = P / 2;
  if (p.x.row_stride * int64_t(sizeof(T)) > INT32_MAX) return kUnsupported;
  if (p.x.step != 1 || p.y.step != 1) return kUnsupported;
  bool const aligned = (Doubles ? is_vectorizable<C>(p.x) && is_vectorizable<P>(p.y)
                                : is_vectorizable<P>(p.x) && is_vectorizable<C>(p.y)) &&
                       reinterpret_cast<uintptr_t>(p.minuend) % alignof(Vector<T, P>) == 0;
  if (!aligned && !kServesAnyAlignment<Doubles, Taps>) return kUnsupported;
  int64_t const height = Doubles ? p.x.height : p.y.height, width = Doubles ? p.x.width : p.y.width;
  // Long strips read fewer rows twice, but there must be enough strips to fill the device.
  int rows = 32;
  while (rows > 4 && p.y.count() * ceil_div(width, 32 * C) * ceil_div(height, rows) < 3000) rows /= 2;
  OctaveWeights<Doubles, Taps> weights;
  write_weights(weights.at[0], Doubles, Taps, p.rows);
  auto const run = [&](auto aligned) {
    auto const launch = [&](auto* kernel, int taps, auto... more) {
      static int const resident = resident_blocks(kernel, 32 * kWarps);
      auto const strips = Strips<C>::near(rows, p.y.count(), height, width, taps, resident, kWarps);
      kernel<<<strips.blocks(kWarps), 32 * kWarps, 0, stream>>>(p.x, p.y, weights, strips, more..., aligned);
    };
    if constexpr (Doubles)
      launch(doubled<T, Taps, decltype(aligned)>, 1 + Taps / 2 * 2, p.minuend);
    else
      launch(halve<T, Taps, decltype(aligned)>, Taps / 2);
  };
  if constexpr (kServesAnyAlignment<Doubles, Taps>)
    with_alignment<T>(aligned, run);
  else
    run(std::true_type{});
  return cudaGetLastError();
}

}  // namespace

template <class T>
int resize_octave(Resize<T> const& p, CUstream_st* stream) {
  if (!is_octave(p.rows) || !is_octave(p.columns) || p.rows.max_taps != p.columns.max_taps) return kUnsupported;
  bool const doubles = p.y.height > p.x.height;
  if (doubles != (p.y.width > p.x.width)) return kUnsupported;
  constexpr bool kGradients = sizeof(T) > 1;  // of bytes are none
  switch (doubles ? -p.rows.max_taps : p.rows.max_taps) {
    case 2:
      return launch<T, false, 2>(p, stream);
    case 4:
      return launch<T, false, 4>(p, stream);
    case 6:
      return launch<T, false, 6>(p, stream);
    case -2:
      return launch<T, true, 2>(p, stream);
    case -4:
      return launch<T, true, 4>(p, stream);
  }
  if constexpr (kGradients) {
    switch (doubles ? -p.rows.max_taps : p.rows.max_taps) {
      case 8:
        return launch<T, false, 8>(p, stream);
      case -1:
        return launch<T, true, 1>(p, stream);
      case -3:
        return launch<T, true, 3>(p, stream);
    }
  }
  return kUnsupported;
}

template int resize_octave(Resize<float> const&, CUstream_st*);
template int resize_octave(Resize<Half> const&, CUstream_st*);
template int resize_octave(Resize<BFloat16> const&, CUstream_st*);
template int resize_octave(Resize<uint8_t> const&, CUstream_st*);

}  // namespace kv::geometry::cuda
