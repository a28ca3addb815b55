// Separable filters of small windows over planar images of bytes, and of half types whose rows are not aligned, on
// CUDA: threads go down groups of columns (core/stencils/column_groups.cuh) with running sums of the rows whose windows
// are not complete.
#pragma once

#include "core/stencils/column_groups.cuh"
#include "separable_strip.cuh"

namespace kv::filters::cuda {
namespace {

// The weights that strips compute in a warp: those of a Gaussian by the same sum, in the order of warp_reduce.
template <int K>
__device__ __forceinline__ void load_weights(Taps<float> const& taps, int64_t sample, float (&weights)[K]) {
#pragma unroll
  for (int t = 0; t < K; ++t)
    weights[t] = taps.gaussian && t > K / 2 ? weights[K - 1 - t] : tap_weight(taps, sample, t);
  if (!taps.gaussian) return;
  float sums[K];
#pragma unroll
  for (int t = 0; t < K; ++t) sums[t] = weights[t];
#pragma unroll
  for (int lanes = 16; lanes > 0; lanes /= 2)
#pragma unroll
    for (int t = 0; t < lanes && t + lanes < K; ++t) sums[t] += sums[t + lanes];
#pragma unroll
  for (int t = 0; t < K; ++t) weights[t] = t > K / 2 ? weights[K - 1 - t] : weights[t] / sums[0];
}

constexpr int kLargestOfGroups = 11;  // window
template <class T, int K>
constexpr bool kHasGroups = K <= 5 || (K == kLargestOfGroups && sizeof(T) == 2);  // whether they are faster than strips
constexpr int kAhead = 2;                                                         // rows in flight
// Threads and about the rows of a block, and how many blocks a multiprocessor must hold.
constexpr int kGroupThreads = 128;
template <int K>
constexpr int kGroupRows = K <= 5 ? 32 : 64;
template <int K>
constexpr int kGroupBlocks = K <= 5 ? 5 : 3;

template <class T, int K, int P, int Bytes>
__device__ __forceinline__ void filter_groups(Separable<T> const& p, ColumnGroups<P, kGroupThreads> const& groups,
                                              unsigned block, float divisor) {
  constexpr int R = K / 2;
  int64_t plane;
  int x, y0;
  groups.locate(block, plane, x, y0);
  using Rows = GroupRows<T, P, R, Bytes>;
  Rows const rows(p.x, plane, x, p.border);
  GroupStore<T, P, Bytes> out(p.y, plane, x, y0);
  int const height = int(p.x.height), y1 = min(y0 + groups.rows, height);
  auto const fetch = [&](int y) {
    int const source = y < y1 + R ? border_index(p.border, y, height) : -1;
    return source < 0 ? typename Rows::Fetched{} : rows.fetch(source);
  };
  typename Rows::Fetched ahead[kAhead];
#pragma unroll
  for (int i = 0; i < kAhead; ++i) ahead[i] = fetch(y0 - R + i);
  float weights_x[K], weights_y[K];
  load_weights(p.kx, plane / p.planes, weights_x);
  load_weights(p.ky, plane / p.planes, weights_y);
#pragma unroll
  for (int t = 0; t < K; ++t) weights_y[t] *= p.alpha;
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
        for (int j = 0; j < P; ++j) result[j] = quotient<T>(result[j], divisor, reciprocal);
      }
      out.put(result);
    }
}

template <class T, int K, int P, int Bytes>
__global__ void __launch_bounds__(kGroupThreads, kGroupBlocks<K>)
    separable_groups(__grid_constant__ Separable<T> const p,
                     __grid_constant__ ColumnGroups<P, kGroupThreads> const groups, float divisor) {
  filter_groups<T, K, P, Bytes>(p, groups, blockIdx.x, divisor);
}

template <class T, int K, int P>
__global__ void __launch_bounds__(kGroupThreads, kGroupBlocks<K>)
    separable_groups_of_list(__grid_constant__ SeparableList<T> const list, int rows, float divisor) {
  unsigned block;
  Separable<T> const* const p = sample_of_block(list, block);
  if (!p) return;
  ColumnGroups<P, kGroupThreads> const groups(p->x.count(), p->x.height, p->x.width, rows,
                                              GroupRows<T, P, K / 2>::kReach, kGroupThreads);
  filter_groups<T, K, P, 0>(*p, groups, block, divisor);
}

// Windows of `K` pixels and more: by groups where these serve images and window, or by strips.
template <int K = 3, class T>
int launch_strips_or_groups(Separable<T> const& p, float divisor, CUstream_st* stream) {
  if constexpr (K <= kLargestOfGroups) {
    if (p.kx.size != K) return launch_strips_or_groups<K + 2>(p, divisor, stream);
  }
  if constexpr (kHasGroups<T, K>) {
    constexpr int P = kGroupPixels<T>, R = K / 2;
    bool const centered = p.kx.before == R && p.ky.before == R && p.y.step == 1;
    bool const same_size = p.x.width == p.y.width && p.x.height == p.y.height;
    auto const launch = [&](auto bytes) {
      constexpr int kBytes = decltype(bytes)::value;
      static int const resident = resident_blocks(separable_groups<T, K, P, kBytes>, kGroupThreads);
      ColumnGroups<P, kGroupThreads> const groups(p.x.count(), p.x.height, p.x.width, kGroupRows<K>,
                                                  GroupRows<T, P, R, kBytes>::kReach, K, resident);
      separable_groups<T, K, P, kBytes><<<groups.blocks(), groups.threads, 0, stream>>>(p, groups, divisor);
      return int(cudaGetLastError());
    };
    if (centered && same_size && supports_groups<P, R>(p.x)) {
      if constexpr (sizeof(T) == 1) {
        // Special case, H200: 1.06 (gauss5 at 336x512) to 2.2 (gauss5 at 299x299) times as fast as strips, bytes.
        return with_row_bytes<P>(launch, p.x, p.y);
      } else {
        // Special case, H200: 1.13 (gauss3) to 1.42 (gauss5 of 299x299) times as fast as strips, half types at 335x513.
        int const bytes = p.border != Border::circular ? bytes_of_rows<P>(p.x, p.y) : P * int(sizeof(T));
        if (bytes == 0) return launch(std::integral_constant<int, 0>{});
        if constexpr (K <= 5)
          if (bytes == 8) return launch(std::integral_constant<int, 8>{});
      }
    }
  }
  return launch_strip_of_size<T, false>(p, divisor, stream);
}

template <int K = 3, class T>
int launch_strips_or_groups(SeparableList<T> const& p, float divisor, CUstream_st* stream) {
  if constexpr (K <= kLargestOfGroups) {
    if (p.all.kx.size != K) return launch_strips_or_groups<K + 2>(p, divisor, stream);
  }
  if constexpr (kHasGroups<T, K>) {
    constexpr int P = kGroupPixels<T>, R = K / 2, kThreads = kGroupThreads;
    bool const centered = p.all.kx.before == R && p.all.ky.before == R;
    if (centered && (sizeof(T) == 1 || p.all.border != Border::circular) &&
        all_samples(p, [](Separable<T> const& one) { return supports_groups<P, R>(one.x); })) {
      using Groups = ColumnGroups<P, kThreads>;
      auto const groups_of = [](Separable<T> const& one, int rows) {
        return Groups(one.x.count(), one.x.height, one.x.width, rows, GroupRows<T, P, R>::kReach, kThreads);
      };
      int const rows = Groups::busy_rows(kGroupRows<K>, [&](int rows) {
        return sum_of_samples(p, [&](Separable<T> const& one) {
          Groups const groups = groups_of(one, rows);
          return int64_t(groups.groups) * groups.down;
        });
      });
      return launch_list(
          p, [&](Separable<T> const& one) { return groups_of(one, rows).blocks(); },
          [&](SeparableList<T> const& list, unsigned blocks) {
            separable_groups_of_list<T, K, P><<<blocks, kThreads, 0, stream>>>(list, rows, divisor);
          });
    }
  }
  return launch_strip_of_size<T, false>(p, divisor, stream);
}

}  // namespace
}  // namespace kv::filters::cuda
