// Cross-correlation with small kernels on CUDA: planar images, square kernels of 3, 5 or 7 with
// their middle on the pixel.
//
// Each warp walks down a strip of 32 P columns, whose rows come by core/row_prefetcher.cuh. Nothing else is stored: a
// row adds to the running sums of the K - 1 rows that it is a tap of besides the one that it completes.
//
// Transposes fold what falls beyond the image back to its rim as it comes up. Along x, the first and the last thread of
// a row have the pixels and weights for it in their registers. Along y, rows of the rim wait in shared memory until the
// rows that they stand in for are complete.

#include "core/row_prefetcher.cuh"
#include "filter2d.h"

namespace kv::cuda {
namespace {

constexpr int kWarps = 4;  // of a block, which work alone
constexpr int kRing = 4;   // rows

template <class T, int K>
constexpr int kStripPixels = sizeof(T) < 4 && K <= 5 ? 8 : 4;

// The more arithmetic, the more the K - 1 rows cost that are read but not completed.
template <int K, int P>
constexpr int kStripRows = K == 3   ? 3 * P
                           : P == 8 ? 24
                                    : 32;

// Blocks on a multiprocessor: what its registers, 512 for each thread of a block, have room for.
template <int K, int P>
constexpr int kResident = 512 / (P * K + K * K + 40);

template <class T, int K, int P, bool Folds>
struct alignas(16) StripMemory {
  T rows[kRing][32 * P + 2 * kHalo];
  Vector<float, P> rim[Folds ? K / 2 + 1 : 1][32];  // results that wait for more, by their distance from the edge
};

// `aligned`: rows of input and output are vectors of P pixels, at the same places.
template <class T, int K, int P, bool Folds, class Aligned>
__global__ void __launch_bounds__(32 * kWarps, kResident<K, P>)
    filter_strip(__grid_constant__ Filter2d<T> const p, __grid_constant__ Strips<P> const strips, Aligned aligned) {
  constexpr int R = K / 2;
  __shared__ StripMemory<T, K, P, Folds> memory[kWarps];
  StripMemory<T, K, P, Folds>& shared = memory[threadIdx.x / 32];
  int64_t plane;
  int x, y0;
  if (!strips.locate(plane, x, y0)) return;
  int const lane = threadIdx.x % 32, x0 = x - P * lane, above = p.axis_y.before;
  int const width = int(p.y.width), height = int(p.y.height), y1 = min(y0 + int(strips.rows), height);

  // The first row read and the last row completed. Where results are folded, there is nothing above the image.
  int const first = Folds ? max(y0 - R, 0) : y0 - above, last = Folds && y1 == height ? height - 1 + R : y1 - 1;
  int const count = last + K - above - first;
  RowPrefetcher<T, P, R, kRing, Aligned> rows(shared.rows, p.x, plane, p.border, p.border, aligned,
                                              x0 + R - p.axis_x.before, first, count);

  float const* const kernel = p.kernel_of(plane);
  float w[K][K];
#pragma unroll
  for (int i = 0; i < K * K; ++i) w[i / K][i % K] = kernel[p.flip ? K * K - 1 - i : i];
  if constexpr (Folds)
    for (int i = 0; i <= R; ++i) shared.rim[i][lane] = {};

  int const out_stride = int(p.y.row_stride * sizeof(T));
  T* const out = p.y.plane(plane) + x;
  [[maybe_unused]] bool const reflects = p.fold == Border::reflect;
  float sums[K - 1][P] = {};
#pragma unroll 1
  for (int i = 0; i < count; ++i) {
    int const y = first + i + above - (K - 1);  // the row that this one completes
    T const* const row = rows.row(i);
    float v[P + 2 * kBefore<K, P>];
    read_windows<K, P>(row, v);

    float with[K][P];  // the sums with this row; the first is complete
#pragma unroll
    for (int t = 0; t < K; ++t)
#pragma unroll
      for (int j = 0; j < P; ++j) {
        with[t][j] = t < K - 1 ? sums[t < K - 1 ? t : 0][j] : 0;
#pragma unroll
        for (int k = 0; k < K; ++k) with[t][j] = fmaf(w[K - 1 - t][k], v[kBefore<K, P> - R + j + k], with[t][j]);
      }
    if constexpr (Folds) {
      // What stands q pixels before the first pixel, or after the last one, reads R + 1 - q pixels.
      auto const fold = [&](bool reflects, bool left) {
#pragma unroll
        for (int t = 0; t < K; ++t)
#pragma unroll
          for (int q = 1; q <= R; ++q) {
            float& to = with[t][left ? (reflects ? q : 0) : P - 1 - (reflects ? q : 0)];
#pragma unroll
            for (int k = 0; k <= R - q; ++k)
              to = fmaf(w[K - 1 - t][left ? R + q + k : R - q - k], v[kBefore<K, P> + (left ? k : P - 1 - k)], to);
          }
      };
      if (x == 0) reflects ? fold(true, true) : fold(false, true);
      if (x + P == width) reflects ? fold(true, false) : fold(false, false);
    }
#pragma unroll
    for (int t = 0; t < K - 1; ++t)
#pragma unroll
      for (int j = 0; j < P; ++j) sums[t][j] = with[t + 1][j];

    int to = y;
    if constexpr (Folds) {
      if (y <= R || y >= height - 1 - R) {
        to = border_index(p.fold, y, height);
        Vector<float, P>& rim = shared.rim[min(to, height - 1 - to)][lane];
#pragma unroll
        for (int j = 0; j < P; ++j) {
          if (y <= R || y >= height) with[0][j] += rim.v[j];
          if (y < 0 || y > R) rim.v[j] = with[0][j];
        }
      }
      if (y < 0) continue;
    }
    if (y < y0) continue;
    store_pixels(row_at(out, to, out_stride), with[0], x, width, aligned);
  }
}

template <int K, class T>
bool launch_strips(Filter2d<T> const& p, CUstream_st* stream) {
  constexpr int P = kStripPixels<T, K>, R = K / 2;
  bool const folds = p.fold != Border::constant;
  bool const aligned =
      p.axis_x.before == R && p.axis_y.before == R && is_vectorizable<P>(p.x) && is_vectorizable<P>(p.y);
  if (folds && (!aligned || p.y.height < 2 * (R + 1))) return false;  // lower rows of the rim would be upper ones
  int rows = kStripRows<K, P>;
  while (folds && p.y.height % rows > 0 && p.y.height % rows <= R) ++rows;  // an edge and what folds to it in one strip
  Strips<P> const strips(p.y.count(), p.y.height, p.y.width, rows);
  auto const launch = [&](auto aligned, auto folds) {
    filter_strip<T, K, P, folds><<<strips.blocks(kWarps), 32 * kWarps, 0, stream>>>(p, strips, aligned);
  };
  if constexpr (sizeof(T) > 1)  // bytes have no gradient
    if (folds) return launch(std::true_type{}, std::true_type{}), true;
  aligned ? launch(std::true_type{}, std::false_type{}) : launch(std::false_type{}, std::false_type{});
  return true;
}

}  // namespace

template <class T>
bool filter2d_strips(Filter2d<T> const& p, CUstream_st* stream) {
  bool const square = p.axis_z.size == 1 && p.axis_x.size == p.axis_y.size, planar = p.x.step == 1;
  if (!square || !planar || p.x.row_stride * int64_t(sizeof(T)) > INT32_MAX || p.x.width > INT32_MAX / 2) return false;
  return (p.axis_x.size == 3 && launch_strips<3>(p, stream)) || (p.axis_x.size == 5 && launch_strips<5>(p, stream)) ||
         (p.axis_x.size == 7 && launch_strips<7>(p, stream));
}

template bool filter2d_strips(Filter2d<float> const&, CUstream_st*);
template bool filter2d_strips(Filter2d<Half> const&, CUstream_st*);
template bool filter2d_strips(Filter2d<BFloat16> const&, CUstream_st*);
template bool filter2d_strips(Filter2d<uint8_t> const&, CUstream_st*);

}  // namespace kv::cuda
