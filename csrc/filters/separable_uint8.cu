// Separable filters of 3 and 5 taps over planar images of bytes on CUDA: threads go down groups of columns
// (core/column_groups.cuh) with running sums of the rows whose windows are not complete. Other windows take the strip
// kernel of separable_strip.cuh.
#include "core/column_groups.cuh"
#include "separable_strip.cuh"

namespace kv::filters::cuda {
namespace {

constexpr int kColumns = 8, kLargestOfGroups = 5;       // of a thread; window
constexpr int kAhead = 2;                               // rows in flight
constexpr int kRows = 32, kThreads = 256, kBlocks = 2;  // of a block; on a multiprocessor at once

template <int K>
__device__ __forceinline__ void load_weights(Taps<float> const& taps, int64_t sample, float scale,
                                             float (&weights)[K]) {
  float sum = 0;
#pragma unroll
  for (int t = 0; t < K; ++t) {
    weights[t] = taps.gaussian && t > K / 2 ? weights[K - 1 - t] : tap_weight(taps, sample, t);
    sum += weights[t];
  }
  if (taps.gaussian) scale /= sum;
#pragma unroll
  for (int t = 0; t < K; ++t) weights[t] *= scale;
}

template <int K, int Bytes>
__global__ void __launch_bounds__(kThreads, kBlocks)
    separable_groups(__grid_constant__ Separable<uint8_t> const p,
                     __grid_constant__ ColumnGroups<kColumns, kThreads> const groups, float divisor) {
  constexpr int P = kColumns, R = K / 2;
  int64_t plane;
  int x, y0;
  groups.locate(plane, x, y0);
  using Rows = GroupRows<uint8_t, P, R, Bytes>;
  Rows const rows(p.x, plane, x, p.border);
  GroupStore<uint8_t, P, Bytes> out(p.y, plane, x, y0);
  int const height = int(p.x.height), y1 = min(y0 + groups.rows, height);
  auto const fetch = [&](int y) {
    int const source = y < y1 + R ? border_index(p.border, y, height) : -1;
    return source < 0 ? typename Rows::Fetched{} : rows.fetch(source);
  };
  typename Rows::Fetched ahead[kAhead];
#pragma unroll
  for (int i = 0; i < kAhead; ++i) ahead[i] = fetch(y0 - R + i);
  float weights_x[K], weights_y[K];
  load_weights(p.kx, plane / p.planes, 1.f, weights_x);
  load_weights(p.ky, plane / p.planes, p.alpha, weights_y);
  float const reciprocal = 1 / divisor;
  float sums[K - 1][P] = {};
#pragma unroll 1
  for (int first = y0 - R; first < y1 + R; first += kAhead)
#pragma unroll
    for (int i = 0; i < kAhead; ++i) {
      int const y = first + i;  // the row that is read; it completes row y - R
      if (i > 0 && y >= y1 + R) break;
      float v[P + 2 * R], h[P], result[P];
      rows.spread(ahead[i], v);
      ahead[i] = fetch(y + kAhead);
#pragma unroll
      for (int t = 0; t < K; ++t)
#pragma unroll
        for (int j = 0; j < P; ++j) h[j] = t == 0 ? weights_x[0] * v[j] : fmaf(weights_x[t], v[t + j], h[j]);
      add_row<K>(h, [&](int t) { return weights_y[K - 1 - t]; }, sums, result);
      if (p.beta != 0) {
#pragma unroll
        for (int j = 0; j < P; ++j) sums[R - 1][j] = fmaf(p.beta, v[R + j], sums[R - 1][j]);
      }
      if (y < y0 + R) continue;
      if (divisor != 1) {
#pragma unroll
        for (int j = 0; j < P; ++j) result[j] = quotient<uint8_t>(result[j], divisor, reciprocal);
      }
      out.put(result);
    }
}

// By groups where these serve images and window, or by strips.
template <int K>
int launch_strips_or_groups(Separable<uint8_t> const& p, float divisor, CUstream_st* stream) {
  if constexpr (K <= kLargestOfGroups) {
    if (p.kx.size != K) return launch_strips_or_groups<K + 2>(p, divisor, stream);
    constexpr int R = K / 2;
    bool const centered = p.kx.before == R && p.ky.before == R && p.y.step == 1;
    bool const same_size = p.x.width == p.y.width && p.x.height == p.y.height;
    // Special case, H200: 1.06 (gauss5 at 336x512) to 2.2 (gauss5 at 299x299) times as fast as strips.
    if (centered && same_size && supports_groups<kColumns, R>(p.x)) {
      with_row_bytes<kColumns>(
          [&](auto bytes) {
            ColumnGroups<kColumns, kThreads> const groups(p.x.count(), p.x.height, p.x.width, kRows,
                                                          GroupRows<uint8_t, kColumns, R, bytes.value>::kReach);
            separable_groups<K, bytes.value><<<groups.blocks(), groups.threads, 0, stream>>>(p, groups, divisor);
          },
          p.x, p.y);
      return cudaGetLastError();
    }
  }
  return launch_strip_of_size<uint8_t, false>(p, divisor, stream);
}

}  // namespace

template <>
int separable_strips(Separable<uint8_t> const& p, float divisor, CUstream_st* stream) {
  return launch_strips_or_groups<3>(p, divisor, stream);
}

}  // namespace kv::filters::cuda
