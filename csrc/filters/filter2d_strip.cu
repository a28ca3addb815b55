// Cross-correlation with small kernels on CUDA: planar images, and square kernels of 3, 5 or 7 whose middle is on the
// pixel.
//
// Each warp goes down a strip of 32 P columns and prefetches its rows (core/row_prefetcher.cuh). It stores running sums
// only: a row completes one output row and adds to the sums of the K - 1 rows below that.
//
// Transposes accumulate sums out of bounds into the border as they are computed. Along x, the first and the last thread
// of a row have the pixels and weights for it in registers. Along y, rows near the border wait in shared memory until
// the rows out of bounds that they receive are complete.

#include "core/row_prefetcher.cuh"
#include "core/stencils/filter_list.cuh"
#include "filter2d.h"

namespace kv::filters::cuda {
namespace {

constexpr int kWarps = 4;  // of a block; they do not synchronize
constexpr int kRing = 4;   // rows

template <class T, int K>
constexpr int kStripPixels = sizeof(T) < 4 && K <= 5 ? 8 : 4;

// A strip reads K - 1 rows more than it completes. The larger K, the more they cost, so the higher the strips are.
template <int K, int P>
constexpr int kStripRows = K == 3   ? 3 * P
                           : P == 8 ? 24
                                    : 32;

// Blocks on a multiprocessor, limited by its registers, 512 for each thread of a block.
template <int K, int P>
constexpr int kResident = 512 / (P * K + K * K + 40);

template <class T, int K, int P, bool Accumulates, class Aligned>
struct alignas(16) StripMemory {
  T rows[kRing][kRingPitch<T, P, Aligned>];
  Vector<float, P> border[Accumulates ? K / 2 + 1 : 1][32];  // incomplete results, by their distance from the edge
};

// `aligned`: rows of input and output are vectors of P pixels that start at the same columns.
template <class T, int K, int P, bool Accumulates, class Aligned>
__device__ __forceinline__ void correlate_strip(Filter2d<T> const& p, Strips<P> const& strips, unsigned block,
                                                Aligned aligned) {
  constexpr int R = K / 2;
  __shared__ StripMemory<T, K, P, Accumulates, Aligned> memory[kWarps];
  StripMemory<T, K, P, Accumulates, Aligned>& shared = memory[threadIdx.x / 32];
  int64_t plane;
  int x, y0;
  if (!strips.locate(block, plane, x, y0)) return;
  int const lane = threadIdx.x % 32, x0 = x - P * lane, above = p.axis_y.before;
  int const width = int(p.y.width), height = int(p.y.height), y1 = min(y0 + int(strips.rows), height);

  // The first row that is read and the last one that is completed. With accumulation, rows above the image are zeros
  // and are not read.
  int const first = Accumulates ? max(y0 - R, 0) : y0 - above,
            last = Accumulates && y1 == height ? height - 1 + R : y1 - 1;
  int const count = last + K - above - first;
  RowPrefetcher<T, P, R, kRing, Aligned> rows(shared.rows, p.x, plane, p.border, p.border, aligned,
                                              x0 + R - p.axis_x.before, first, count);

  float const* const kernel = p.kernel_of(plane);
  float w[K][K];
#pragma unroll
  for (int i = 0; i < K * K; ++i) w[i / K][i % K] = kernel[p.flip ? K * K - 1 - i : i];
  if constexpr (Accumulates)
    for (int i = 0; i <= R; ++i) shared.border[i][lane] = {};

  T* const out = p.y.plane(plane) + x;
  int const out_stride = int(p.y.row_stride * sizeof(T));
  [[maybe_unused]] bool const reflects = p.accumulation == Border::reflect;
  float sums[K - 1][P] = {};
#pragma unroll 1
  for (int i = 0; i < count; ++i) {
    int const y = first + i + above - (K - 1);  // the output row that this row completes
    T const* const row = rows.row(i);
    float v[P + 2 * kBefore<K, P>];
    read_windows<K, P>(row, v, aligned);

    float updated[K][P];  // the sums including this row; the first is complete
#pragma unroll
    for (int t = 0; t < K; ++t)
#pragma unroll
      for (int j = 0; j < P; ++j) {
        updated[t][j] = t < K - 1 ? sums[t < K - 1 ? t : 0][j] : 0;
#pragma unroll
        for (int k = 0; k < K; ++k) updated[t][j] = fmaf(w[K - 1 - t][k], v[kBefore<K, P> - R + j + k], updated[t][j]);
      }
    if constexpr (Accumulates) {
      // The position q pixels before the first pixel, or after the last one, reads R + 1 - q pixels. Pixel j of the
      // thread has `distance(j)` pixels to that end and receives these sums.
      auto const accumulate = [&](auto left, auto distance) {
        auto const accumulate_as = [&](auto reflects) {
#pragma unroll
          for (int j = 0; j < P; ++j)
#pragma unroll
            for (int q = 1; q <= R; ++q) {
              int const d = reflects ? q : 0;
              if (distance(j) == d) {
#pragma unroll
                for (int t = 0; t < K; ++t)
#pragma unroll
                  for (int k = 0; k <= R - q; ++k) {
                    // Pixels that other warps have are not reached.
                    int const at = kBefore<K, P> + min(max(left ? j - d + k : j + d - k, -R), P - 1 + R);
                    updated[t][j] = fmaf(w[K - 1 - t][left ? R + q + k : R - q - k], v[at], updated[t][j]);
                  }
              }
            }
        };
        reflects ? accumulate_as(std::true_type{}) : accumulate_as(std::false_type{});
      };
      if (x == 0) accumulate(std::true_type{}, [](int j) { return j; });
      if constexpr (Aligned::value) {
        if (x + P == width) accumulate(std::false_type{}, [](int j) { return P - 1 - j; });
      } else {
        if (x < width && x + P >= width - R)
          accumulate(std::false_type{}, [&](int j) {
            int pixels = width - 1 - x - j;
            asm("" : "+r"(pixels));  // or the compiler would index registers by it, in local memory
            return pixels;
          });
      }
    }
#pragma unroll
    for (int t = 0; t < K - 1; ++t)
#pragma unroll
      for (int j = 0; j < P; ++j) sums[t][j] = updated[t + 1][j];

    int to = y;
    if constexpr (Accumulates) {
      if (y <= R || y >= height - 1 - R) {
        to = border_index(p.accumulation, y, height);
        Vector<float, P>& border_row = shared.border[min(to, height - 1 - to)][lane];
#pragma unroll
        for (int j = 0; j < P; ++j) {
          if (y <= R || y >= height) updated[0][j] += border_row.v[j];
          if (y < 0 || y > R) border_row.v[j] = updated[0][j];
        }
      }
      if (y < 0) continue;
    }
    if (y < y0) continue;
    if constexpr (!Accumulates && sizeof(T) > 1)
      if (p.clamps)
#pragma unroll
        for (int j = 0; j < P; ++j) updated[0][j] = p.clamped(updated[0][j]);
    store_pixels(row_at(out, to, out_stride), updated[0], x, width, aligned);
  }
}

template <class T, int K, int P, bool Accumulates, class Aligned>
__global__ void __launch_bounds__(32 * kWarps, kResident<K, P>)
    filter_strip(__grid_constant__ Filter2d<T> const p, __grid_constant__ Strips<P> const strips, Aligned aligned) {
  correlate_strip<T, K, P, Accumulates>(p, strips, blockIdx.x, aligned);
}

// The strips of an image. Where sums are accumulated its last row and all rows that it receives are in one of them.
template <class T, int K, int P>
KV_HD Strips<P> strips_of(Filter2d<T> const& p, bool accumulates) {
  int rows = kStripRows<K, P>;
  int const height = int(p.y.height);
  while (accumulates && height % rows > 0 && height % rows <= K / 2) ++rows;
  return {p.y.count(), p.y.height, p.y.width, rows};
}

template <class T, int K, int P, bool Accumulates>
__global__ void __launch_bounds__(32 * kWarps, kResident<K, P>)
    filter_strip_of_list(__grid_constant__ Filter2dList<T> const list) {
  unsigned block;
  Filter2d<T> const* const p = sample_of_block(list, block);
  if (p) correlate_strip<T, K, P, Accumulates>(*p, strips_of<T, K, P>(*p, Accumulates), block, std::false_type{});
}

// Special case, H200: 1.7 (7 x 7) to 4.0 (3 x 3 backward) times as fast as tiles.
template <int K, class T>
bool launch_strips(Filter2d<T> const& p, CUstream_st* stream) {
  constexpr int P = kStripPixels<T, K>, R = K / 2;
  bool const accumulates = p.accumulation != Border::constant;
  bool const centered = p.axis_x.before == R && p.axis_y.before == R;
  bool const aligned = centered && is_vectorizable<P>(p.x) && is_vectorizable<P>(p.y);
  if (accumulates && (!centered || p.y.height < 2 * (R + 1))) return false;  // rows near both borders are not supported
  Strips<P> const strips = strips_of<T, K, P>(p, accumulates);
  auto const launch = [&](auto accumulates) {
    with_alignment<T>(aligned, [&](auto aligned) {
      filter_strip<T, K, P, accumulates><<<strips.blocks(kWarps), 32 * kWarps, 0, stream>>>(p, strips, aligned);
    });
  };
  if constexpr (sizeof(T) > 1)  // uint8 has no gradient
    if (accumulates) return launch(std::true_type{}), true;
  launch(std::false_type{});
  return true;
}

template <int K, class T>
bool launch_strips(Filter2dList<T> const& p, CUstream_st* stream, int& error) {
  constexpr int P = kStripPixels<T, K>, R = K / 2;
  bool const accumulates = p.all.accumulation != Border::constant;
  bool const centered = p.all.axis_x.before == R && p.all.axis_y.before == R;
  if (accumulates && (!centered || !all_samples(p, [](Filter2d<T> const& one) { return one.y.height >= 2 * (R + 1); })))
    return false;
  auto const launch = [&](auto accumulates) {
    error = launch_list(
        p,
        [](Filter2d<T> const& one) {
          return strips_of<T, K, kStripPixels<T, K>>(one, decltype(accumulates)::value).blocks(kWarps);
        },
        [&](Filter2dList<T> const& list, unsigned blocks) {
          filter_strip_of_list<T, K, kStripPixels<T, K>, decltype(accumulates)::value>
              <<<blocks, 32 * kWarps, 0, stream>>>(list);
        });
  };
  if constexpr (sizeof(T) > 1)
    if (accumulates) return launch(std::true_type{}), true;
  launch(std::false_type{});
  return true;
}

// `work`: p or a list of such, and what launching it takes.
template <class T, class... Work>
bool launch_strips_of_size(Filter2d<T> const& p, Work&... work) {
  if (p.axis_z.size != 1 || p.axis_x.size != p.axis_y.size) return false;
  return (p.axis_x.size == 3 && launch_strips<3>(work...)) || (p.axis_x.size == 5 && launch_strips<5>(work...)) ||
         (p.axis_x.size == 7 && launch_strips<7>(work...));
}

template <class T>
bool is_strippable(Planes<T const> const& x) {
  return x.step == 1 && x.row_stride * int64_t(sizeof(T)) <= INT32_MAX && x.width <= INT32_MAX / 2;
}

}  // namespace

template <class T>
bool try_filter2d_strips(Filter2d<T> const& p, CUstream_st* stream) {
  return is_strippable(p.x) && launch_strips_of_size(p, p, stream);
}
template <class T>
bool try_filter2d_strips(Filter2dList<T> const& p, CUstream_st* stream, int& error) {
  return all_samples(p, [](Filter2d<T> const& one) { return is_strippable(one.x); }) &&
         launch_strips_of_size(p.all, p, stream, error);
}

template bool try_filter2d_strips(Filter2dList<float> const&, CUstream_st*, int&);
template bool try_filter2d_strips(Filter2dList<Half> const&, CUstream_st*, int&);
template bool try_filter2d_strips(Filter2dList<BFloat16> const&, CUstream_st*, int&);
template bool try_filter2d_strips(Filter2dList<uint8_t> const&, CUstream_st*, int&);

template bool try_filter2d_strips(Filter2d<float> const&, CUstream_st*);
template bool try_filter2d_strips(Filter2d<Half> const&, CUstream_st*);
template bool try_filter2d_strips(Filter2d<BFloat16> const&, CUstream_st*);
template bool try_filter2d_strips(Filter2d<uint8_t> const&, CUstream_st*);

}  // namespace kv::filters::cuda
