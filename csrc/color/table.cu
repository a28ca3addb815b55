// False colours on CUDA: a thread takes every 256th pixel of a row's part; the table comes from the L1.
#include "core/launch.cuh"
#include "table.h"

namespace kv::cuda {
namespace {

constexpr int kThreads = 256, kTaken = 4;  // pixels of a thread

template <class T>
__global__ void __launch_bounds__(kThreads) run(__grid_constant__ ColorTable<T> const p) {
  for (int64_t r = blockIdx.y; r < p.x.rows(); r += gridDim.y) {
    int64_t const plane = r / p.x.height, y = r % p.x.height;
    T const* const x = p.x.row(plane, y);
    T const white = p.white[plane], *const table = p.table(plane);
    T* to[3];
    for (int k = 0; k < 3; ++k) to[k] = p.y.row(3 * plane + k, y);
#pragma unroll
    for (int j = 0; j < kTaken; ++j) {
      int64_t const i = (blockIdx.x * int64_t(kTaken) + j) * kThreads + threadIdx.x;
      if (i >= p.x.width) break;
      T const v = x[i] / white;
      int const color = color_of(v, p.n);
      for (int k = 0; k < 3; ++k) to[k][i] = v == v ? table[k * p.n + color] : v;
    }
  }
}

}  // namespace

template <class T>
int color_table(ColorTable<T> const& p, CUstream_st* stream) {
  dim3 const blocks(unsigned(ceil_div(p.x.width, kThreads * kTaken)), unsigned(min(p.x.rows(), int64_t(65535))));
  run<<<blocks, kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_COMPUTED(color_table, ColorTable)

}  // namespace kv::cuda
