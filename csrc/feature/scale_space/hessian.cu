// Hessian responses on CUDA. Each warp goes down a strip of columns, prefetches its rows and keeps their derivatives
// along x in registers, from which it differentiates along y; derivatives are never stored.
#include "core/row_prefetcher.cuh"
#include "feature/scale_space/hessian.h"

namespace kv::feature::cuda {
namespace {

constexpr int P = 4;        // columns of a thread
constexpr int kRing = 4;    // rows; all but one are in flight
constexpr int kRows = 32;   // of a strip
constexpr int kWarps = 4;   // of a block; they do not synchronize
constexpr int kBlocks = 4;  // of a multiprocessor

template <class Kernel, class T, class Aligned>
__global__ void __launch_bounds__(32 * kWarps, sizeof(T) == 8 ? 1 : kBlocks)
    hessian_strip(__grid_constant__ LevelHessian<T> const p, __grid_constant__ Strips<P> const strips,
                  Aligned aligned) {
  constexpr int R = Kernel::reach, K = 2 * R + 1;
  using F = Compute<T>;
  using Prefetcher = RowPrefetcher<T, P, R, kRing, Aligned>;
  __shared__ __align__(16) typename Prefetcher::Ring memory[kWarps];
  int64_t plane;
  int x, y0;
  if (!strips.locate(plane, x, y0)) return;
  int const width = int(p.x.width), y1 = min(y0 + int(strips.rows), int(p.x.height));
  Prefetcher rows(memory[threadIdx.x / 32], p.x, plane, Border::replicate, Border::replicate, aligned,
                  x - P * int(threadIdx.x % 32), y0 - R, y1 - y0 + 2 * R);
  F const factor = p.factor(plane) * SecondDerivatives<Kernel, F>().factor;

  F along[K][3][P];  // rows y - R ... y + R
  auto const next = [&](int i, F(&to)[3][P]) {
    F v[P + 2 * kBefore<K, P>];
    read_windows<K, P>(rows.row(i), v, aligned);
    filters::for_each_channel<Kernel>([&](auto c) {
#pragma unroll
      for (int j = 0; j < P; ++j) to[c.value][j] = c.along().dot([&](int k) { return v[kBefore<K, P> - R + j + k]; });
    });
  };
#pragma unroll
  for (int k = 0; k < 2 * R; ++k) next(k, along[k]);
  T* out = p.y.row(plane, y0) + x;
#pragma unroll(K)  // so that registers of rows are renamed, not moved
  for (int y = y0; y < y1; ++y, out += p.y.row_stride) {
    next(y - y0 + 2 * R, along[2 * R]);
    F derivatives[3][P], result[P];
    filters::for_each_channel<Kernel>([&](auto c) {
#pragma unroll
      for (int j = 0; j < P; ++j) derivatives[c.value][j] = c.down().dot([&](int k) { return along[k][c.value][j]; });
    });
#pragma unroll
    for (int j = 0; j < P; ++j)
      result[j] = factor * determinant(SecondDerivatives<Kernel, F>().hessian(derivatives[0][j], derivatives[1][j],
                                                                              derivatives[2][j]));
    store_pixels(out, result, x, width, aligned);
#pragma unroll
    for (int k = 0; k < 2 * R; ++k)
#pragma unroll
      for (int c = 0; c < 3; ++c)
#pragma unroll
        for (int j = 0; j < P; ++j) along[k][c][j] = along[k + 1][c][j];
  }
}

}  // namespace

template <class T>
int level_hessian(LevelHessian<T> const& p, CUstream_st* stream) {
  Strips<P> const strips(p.x.count(), p.x.height, p.x.width, kRows);
  dispatch_second_derivatives(p.sobel, [&](auto kernel) {
    with_alignment<T>(is_vectorizable<P>(p.x) && is_vectorizable<P>(p.y), [&](auto aligned) {
      hessian_strip<decltype(kernel), T><<<strips.blocks(kWarps), 32 * kWarps, 0, stream>>>(p, strips, aligned);
    });
  });
  return cudaGetLastError();
}

KV_INSTANTIATE(level_hessian, LevelHessian)

}  // namespace kv::feature::cuda
