// Hessian responses of levels on CUDA. Each warp traverses a strip of columns downwards and keeps the derivatives along
// x of the last rows in registers, as filters/edges/spatial_gradient.cu does; derivatives are never stored.
#include "core/launch.cuh"
#include "feature/scale_space/hessian.h"

namespace kv::feature::cuda {
namespace {

constexpr int P = 4;  // columns of a thread
template <class Kernel>
constexpr int kRows = Kernel::reach == 1 ? 16 : 32;

template <class Kernel, class T, bool Aligned>
__global__ void __launch_bounds__(256) hessian_strip(__grid_constant__ LevelHessian<T> const p, Strips<P> strips) {
  constexpr int R = Kernel::reach;
  using F = Compute<T>;
  int64_t plane;
  int x, y0;
  if (!strips.locate(plane, x, y0)) return;
  Strip<R, Aligned, P> const strip(x, int(p.x.width), Border::replicate);
  RowCursor<T> rows(p.x, plane, y0 - R);
  F const factor = p.factor(plane);
  int const y1 = min(y0 + int(strips.rows), int(p.x.height));

  F along[2 * R + 1][3][P];  // rows y - R ... y + R
  auto prefetched = strip.fetch(rows.next());
  auto const next = [&](F(&to)[3][P]) {
    F v[P + 2 * R];
    auto const fetched = prefetched;
    prefetched = strip.fetch(rows.next());
    strip.spread(fetched, v);
    filters::for_each_channel<Kernel>([&](auto c) {
#pragma unroll
      for (int i = 0; i < P; ++i) to[c.value][i] = c.along().dot([&](int k) { return v[i + k]; });
    });
  };
#pragma unroll
  for (int k = 0; k < 2 * R; ++k) next(along[k]);
#pragma unroll(Aligned ? 2 * R + 1 : 1)
  for (int y = y0; y < y1; ++y) {
    next(along[2 * R]);
    F derivatives[3][P], result[P];
    filters::for_each_channel<Kernel>([&](auto c) {
#pragma unroll
      for (int i = 0; i < P; ++i)
        derivatives[c.value][i] = c.down().dot([&](int k) { return along[k][c.value][i]; }) * c.template scale<F>(true);
    });
#pragma unroll
    for (int i = 0; i < P; ++i)
      result[i] = determinant(SymmetricMatrix<F>{derivatives[0][i], derivatives[2][i], derivatives[1][i]}) * factor;
    strip.store_in_stripes(p.y.row(plane, y), result);
#pragma unroll
    for (int k = 0; k < 2 * R; ++k)
#pragma unroll
      for (int c = 0; c < 3; ++c)
#pragma unroll
        for (int i = 0; i < P; ++i) along[k][c][i] = along[k + 1][c][i];
  }
}

}  // namespace

template <class T>
int level_hessian(LevelHessian<T> const& p, CUstream_st* stream) {
  auto const run = [&](auto kernel) {
    using Kernel = decltype(kernel);
    Strips<P> const strips(p.x.count(), p.x.height, p.x.width, kRows<Kernel>);
    with_alignment<T>(is_vectorizable<P>(p.x) && is_vectorizable<P>(p.y), [&](auto aligned) {
      hessian_strip<Kernel, T, aligned.value><<<strips.blocks(), 256, 0, stream>>>(p, strips);
    });
  };
  p.sobel ? run(filters::Sobel2{}) : run(filters::Diff2{});
  return cudaGetLastError();
}

KV_INSTANTIATE(level_hessian, LevelHessian)

}  // namespace kv::feature::cuda
