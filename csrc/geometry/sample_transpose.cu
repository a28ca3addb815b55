// The gradient to the image on CUDA, in one of two ways.
//
// Gather: a pixel of the source looks for the places that have it as a tap. By the map the other way round they lie in
// the quadrangle that its surroundings go to. The same bits every run, nothing is written twice. For warps by a matrix
// whose outside is the fill: else pixels at the rim would be taps of places all around.
//
// Scatter: every place adds to its taps by atomics, into zeros.
#include "sample.cuh"

namespace kv::cuda {
namespace {

// --- gather
// --------------------------------------------------------------------------------------------------------

// Of a row or column of places: first, last + 1.
struct Range {
  int first, last;
};

// The places near which the surroundings of a pixel are, all of them if the horizon runs through these.
template <class F>
__device__ __forceinline__ void candidates(Homography<F> const& back, F x, F y, F reach, int64_t height, int64_t width,
                                           Range& rows, Range& columns) {
  F low_u = F(width), high_u = -1, low_v = F(height), high_v = -1;
  int signs = 0;
#pragma unroll
  for (int corner = 0; corner < 4; ++corner) {
    F const cx = x + (corner & 1 ? reach : -reach), cy = y + (corner & 2 ? reach : -reach);
    F u, v;
    back.at(cx, cy, u, v);
    signs += back.affine || back.weight(cx, cy) > 0 ? 1 : -1;
    low_u = min(low_u, u);
    high_u = max(high_u, u);
    low_v = min(low_v, v);
    high_v = max(high_v, v);
  }
  bool const all = (signs != 4 && signs != -4) || !(high_u - low_u < F(width)) || !(high_v - low_v < F(height));
  // A margin for what rounding does to places on the way there and back.
  F const margin = F(0.01) + F(1e-6) * F(width + height);
  columns = {all ? 0 : max(0, int(::ceil(low_u - margin))),
             all ? int(width) : int(min(F(width), ::floor(high_u + margin) + 1))};
  rows = {all ? 0 : max(0, int(::ceil(low_v - margin))),
          all ? int(height) : int(min(F(height), ::floor(high_v + margin) + 1))};
}

constexpr int kChannels = 4;  // that a thread sums at once

template <class F, int K>
__global__ void __launch_bounds__(kThreads) gather_tiles(SampleTranspose<F> p, Tiles tiles) {
  __shared__ Homography<F> map, back;
  int64_t b;
  int y0, x0;
  tiles.place(b, y0, x0);
  F const* const given = p.places.matrices + b * p.places.matrix_stride;
  if (threadIdx.x == 0) map = homography(given, p.places.use);
  if (threadIdx.x == 32) back = inverse_homography(given, p.places.use);
  __syncthreads();
  int const x = x0 + column_in_tile();
  if (x >= p.grad_x.width) return;
#pragma unroll 1
  for (int run = 0; run < kRuns; ++run) {
    int const y = y0 + row_in_tile(run);
    if (y >= p.grad_x.height) return;
    Range rows, columns;
    candidates(back, F(x), F(y), F(K) / 2, p.grad.height, p.grad.width, rows, columns);
#pragma unroll 1
    for (int c = 0; c < p.grad.channels; c += kChannels) {
      F sums[kChannels] = {};
#pragma unroll 1
      for (int v = rows.first; v < rows.last; ++v)
#pragma unroll 1
        for (int u = columns.first; u < columns.last; ++u) {
          F place_x, place_y;
          map.at(F(u), F(v), place_x, place_y);
          Window<K, F> const window(p, place_x, place_y);
          unsigned const i = unsigned(x - window.x), j = unsigned(y - window.y);
          if (i >= K || j >= K) continue;
          F wx[K], wy[K], weight_x = 0, weight_y = 0;
          tap_weights(window.tx, wx);
          tap_weights(window.ty, wy);
#pragma unroll
          for (unsigned k = 0; k < K; ++k) {  // an index that is not known would put the weights into memory
            weight_x = k == i ? wx[k] : weight_x;
            weight_y = k == j ? wy[k] : weight_y;
          }
          F const weight = weight_x * weight_y;
          if (weight == 0) continue;
          F const* const grad = p.grad.row(b, c, v) + u * p.grad.step;
#pragma unroll
          for (int k = 0; k < kChannels; ++k)
            if (c + k < p.grad.channels) sums[k] += weight * grad[k * p.grad.channel_stride];
        }
#pragma unroll
      for (int k = 0; k < kChannels; ++k)
        if (c + k < p.grad.channels) p.grad_x.row(b, c + k, y)[x] = sums[k];
    }
  }
}

// --- scatter
// ------------------------------------------------------------------------------------------------------

template <class F, int K, bool matrix>
__global__ void __launch_bounds__(kThreads) scatter_tiles(SampleTranspose<F> p, Tiles tiles) {
  __shared__ Homography<F> map;
  int64_t b;
  int y0, x0;
  tiles.place(b, y0, x0);
  By<matrix, F> const by(p.places, map, b);
  int const x = x0 + column_in_tile();
  if (x >= p.grad.width) return;
  F* const planes = p.grad_x.row(b, 0, 0);
#pragma unroll 1
  for (int run = 0; run < kRuns; ++run) {
    int const y = y0 + row_in_tile(run);
    if (y >= p.grad.height) return;
    F u, v;
    by.at(b, y, x, u, v);
    Window<K, F> const window(p, u, v);
    F wx[K], wy[K];
    tap_weights(window.tx, wx);
    tap_weights(window.ty, wy);
    F const* const grad = p.grad.row(b, 0, y) + x * p.grad.step;
    window.for_each(p, p.grad_x.row_stride, 1, [&](int j, int i, int64_t at) {
      F const weight = wx[i] * wy[j];
      if (at < 0 || weight == 0) return;
      for (int c = 0; c < p.grad.channels; ++c)
        atomicAdd(planes + c * p.grad_x.channel_stride + at, weight * grad[c * p.grad.channel_stride]);
    });
  }
}

}  // namespace

template <class F>
int sample_transpose(SampleTranspose<F> const& p, CUstream_st* stream) {
  bool const gathers = p.places.matrices && p.x_axis.padding == Padding::fill;
  auto const& tiled = gathers ? p.grad_x.height : p.grad.height;
  Tiles const tiles(p.grad.batch, tiled, gathers ? p.grad_x.width : p.grad.width);
  if (!gathers) {
    int64_t const count = p.grad_x.batch * p.grad_x.channels * p.grad_x.height * p.grad_x.width;
    cudaError_t const error = cudaMemsetAsync(p.grad_x.data, 0, size_t(count) * sizeof(F), stream);
    if (error != cudaSuccess) return error;
  }
  with_kind(p, [&](auto matrix, auto taps) {
    if (gathers)
      gather_tiles<F, taps.value><<<tiles.count, kThreads, 0, stream>>>(p, tiles);
    else
      scatter_tiles<F, taps.value, matrix.value><<<tiles.count, kThreads, 0, stream>>>(p, tiles);
  });
  return cudaGetLastError();
}

KV_INSTANTIATE_COMPUTED(sample_transpose, SampleTranspose)

}  // namespace kv::cuda
