// Colormaps on CUDA: a thread takes every 256th pixel of a range of a row. The table is read through the L1 cache.
#include "colormap.h"
#include "core/launch.cuh"

namespace kv::color::cuda {
namespace {

constexpr int kThreads = 256, kPixelsPerThread = 4;  // pixels of a thread

template <class T>
__global__ void __launch_bounds__(kThreads) run(__grid_constant__ Colormap<T> const p) {
  for (int64_t r = blockIdx.y; r < p.x.rows(); r += gridDim.y) {
    int64_t const plane = r / p.x.height, y = r % p.x.height;
    T const* const x = p.x.row(plane, y);
    T const white_level = p.white[plane], *const table = p.table(plane);
    T* rgb[3];
    for (int k = 0; k < 3; ++k) rgb[k] = p.y.row(3 * plane + k, y);
#pragma unroll
    for (int j = 0; j < kPixelsPerThread; ++j) {
      int64_t const i = (blockIdx.x * int64_t(kPixelsPerThread) + j) * kThreads + threadIdx.x;
      if (i >= p.x.width) break;
      T const v = x[i] / white_level;
      int const index = color_index(v, p.n);
      for (int k = 0; k < 3; ++k) rgb[k][i] = v == v ? table[k * p.n + index] : v;
    }
  }
}

}  // namespace

template <class T>
int apply_colormap(Colormap<T> const& p, CUstream_st* stream) {
  dim3 const blocks(unsigned(ceil_div(p.x.width, kThreads * kPixelsPerThread)),
                    unsigned(min(p.x.rows(), int64_t(65535))));
  run<<<blocks, kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_COMPUTED(apply_colormap, Colormap)

}  // namespace kv::color::cuda
