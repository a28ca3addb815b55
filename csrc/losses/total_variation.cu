// Total variation on CUDA: a block sums some rows of a plane, each thread walking down its columns; the gradient takes
// a thread for a pixel.
#include "core/launch.cuh"
#include "enhance/pieces.cuh"
#include "total_variation.h"

namespace kv::cuda {
namespace {

constexpr int kThreads = 256, kWarps = kThreads / 32;

template <class T>
__global__ void __launch_bounds__(kThreads) sum_differences(TotalVariation<T> const p) {
  using F = Compute<T>;
  __shared__ F sums[2][kWarps];
  int64_t const plane = blockIdx.x / p.pieces;
  int const height = int(p.x.height), width = int(p.x.width), y0 = int(blockIdx.x - plane * p.pieces) * p.rows;
  int const y1 = min(y0 + p.rows, height);
  F along_y = 0, along_x = 0;
  for (int x = threadIdx.x; x < width; x += kThreads) {
    T const* at = p.x.row(plane, y0) + x;
    F pixel = read(*at);
#pragma unroll 4
    for (int y = y0; y < y1; ++y) {
      if (x + 1 < width) along_x += fabs(read(at[1]) - pixel);
      if (y + 1 == height) break;
      at += p.x.row_stride;
      F const below = read(*at);
      along_y += fabs(below - pixel);
      pixel = below;
    }
  }
  along_y = warp_sum(along_y), along_x = warp_sum(along_x);
  if (threadIdx.x % 32 == 0) sums[0][threadIdx.x / 32] = along_y, sums[1][threadIdx.x / 32] = along_x;
  __syncthreads();
  if (threadIdx.x < 2) {
    F sum = 0;
    for (int w = 0; w < kWarps; ++w) sum += sums[threadIdx.x][w];
    p.partial[2 * int64_t(blockIdx.x) + threadIdx.x] = sum;
  }
}

template <class T>
__global__ void __launch_bounds__(kThreads) differences_backward(TotalVariationBackward<T> const p) {
  using F = Compute<T>;
  int64_t const i = blockIdx.x * int64_t(kThreads) + threadIdx.x, r = i / p.x.width, x = i - r * p.x.width;
  if (r >= p.x.rows()) return;
  int64_t const plane = r / p.x.height, y = r - plane * p.x.height;
  T const* const at = p.x.row(plane, y) + x;
  F const pixel = read(*at);
  auto const sign = [&](bool there, int64_t offset) { return there ? sign_of(pixel - read(at[offset])) : F(0); };
  F const along_y = sign(y > 0, -p.x.row_stride) + sign(y + 1 < p.x.height, p.x.row_stride);
  F const along_x = sign(x > 0, -1) + sign(x + 1 < p.x.width, 1);
  p.grad_x.row(plane, y)[x] = round_to<T>(along_y * p.grad[2 * plane] + along_x * p.grad[2 * plane + 1]);
}

}  // namespace

template <class T>
int total_variation(TotalVariation<T> const& p, CUstream_st* stream) {
  int64_t const planes = p.x.count();
  sum_differences<<<unsigned(planes * p.pieces), kThreads, 0, stream>>>(p);
  add_pieces<<<unsigned(ceil_div(2 * planes, 256)), 256, 0, stream>>>(p.partial, planes, p.pieces, int64_t(2), p.sums);
  return cudaGetLastError();
}

template <class T>
int total_variation_backward(TotalVariationBackward<T> const& p, CUstream_st* stream) {
  unsigned const blocks = unsigned(ceil_div(p.x.rows() * p.x.width, kThreads));
  differences_backward<<<blocks, kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE(total_variation, TotalVariation)
KV_INSTANTIATE(total_variation_backward, TotalVariationBackward)

}  // namespace kv::cuda
