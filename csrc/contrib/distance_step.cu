// A step of the approximate distance transform on CUDA: a thread for each pixel.
#include "core/launch.cuh"
#include "distance_step.h"

namespace kv::contrib::cuda {
namespace {

constexpr int kThreads = 256;

// R is the radius if it is known at compile time, else 0.
template <class T, int R>
__global__ void __launch_bounds__(kThreads) grow(__grid_constant__ DistanceStep<T> const p) {
  unsigned const i = blockIdx.x * kThreads + threadIdx.x, pixels = unsigned(p.pixels());
  if (i >= pixels) return;
  int const width = int(p.width), height = int(p.height), depth = int(p.depth), radius = R > 0 ? R : p.radius;
  unsigned const row = i / unsigned(width);
  int const x = int(i - row * width), z = int(row / unsigned(height)), y = int(row - z * height);
  for (int64_t plane = blockIdx.y; plane < p.planes; plane += gridDim.y) {
    T const* const grown = p.grown + plane * pixels;
    T const* weight = p.kernel;
    T near = 0;
#pragma unroll 1
    for (int dz = -p.radius_z; dz <= p.radius_z; ++dz)
#pragma unroll
      for (int dy = -radius; dy <= radius; ++dy) {
        T const* const from = grown + (clamp(z + dz, 0, depth - 1) * height + clamp(y + dy, 0, height - 1)) * width;
#pragma unroll
        for (int dx = -radius; dx <= radius; ++dx, ++weight) near += *weight * from[clamp(x + dx, 0, width - 1)];
      }
    int64_t const at = plane * pixels + i;
    bool const reached = is_reached(near);
    p.next[at] = reached ? T(1) : p.grown[at];
    p.next_total[at] = reached ? p.total[at] + (p.distance + p.scale * ::log(near)) : p.total[at];
  }
}

}  // namespace

template <class T>
int distance_step(DistanceStep<T> const& p, CUstream_st* stream) {
  dim3 const blocks(unsigned(ceil_div(p.pixels(), int64_t(kThreads))), unsigned(min(p.planes, int64_t(65535))));
  if (p.radius == 1)
    grow<T, 1><<<blocks, kThreads, 0, stream>>>(p);
  else
    grow<T, 0><<<blocks, kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_COMPUTED(distance_step, DistanceStep)

}  // namespace kv::contrib::cuda
