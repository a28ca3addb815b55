// A step of the diamond-square algorithm on CUDA: a thread for each pixel.
#include "contrib/diamond_square.h"
#include "core/launch.cuh"

namespace kv::contrib::cuda {
namespace {

constexpr int kFractalRows = 8;

template <class T>
__global__ void __launch_bounds__(32 * kFractalRows) refine(__grid_constant__ RefineFractal<T> const p) {
  int64_t const x = blockIdx.x * 32 + threadIdx.x, y = blockIdx.y * kFractalRows + threadIdx.y;
  if (x >= p.width() || y >= p.height()) return;
  for (int64_t i = blockIdx.z; i < p.planes; i += gridDim.z) {
    auto const plane = fractal_plane(p, i, [](T const* from) { return read(*from); });
    p.fine[(i * p.height() + y) * p.width() + x] = round_to<T>(plane.at(y, x));
  }
}

}  // namespace

template <class T>
int refine_fractal(RefineFractal<T> const& p, CUstream_st* stream) {
  dim3 const blocks(unsigned(ceil_div(p.width(), 32)), unsigned(ceil_div(p.height(), kFractalRows)),
                    unsigned(p.planes < 65535 ? p.planes : 65535));
  refine<<<blocks, dim3(32, kFractalRows), 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE(refine_fractal, RefineFractal)

}  // namespace kv::contrib::cuda
