// Subvoxel peaks on CUDA: one thread for each voxel. Peaks may share voxels, so their gradients are added with atomics.
#include "core/launch.cuh"
#include "geometry/subpix/quad_interp3d.h"

namespace kv::geometry::cuda {
namespace {

constexpr int kThreads = 256;

// Blocks of 32 x 8 voxels of a plane. Planes are the last dimension of the grid.
struct Tiles {
  unsigned across, down, count;
  template <class T>
  explicit Tiles(ConvQuadInterp3d<T> const& p)
      : across(unsigned(ceil_div(p.size[2], 32))),
        down(unsigned(ceil_div(p.size[1], 8))),
        count(unsigned(p.volumes * p.size[0] * across * down)) {}
};

// Calls use(volume, z, y, x) for the thread's voxel.
template <class T, class Use>
__device__ __forceinline__ void at_voxel(ConvQuadInterp3d<T> const& p, Tiles const& tiles, Use use) {
  unsigned const line = blockIdx.x / tiles.across, plane = line / tiles.down, volume = plane / unsigned(p.size[0]);
  int const y = int(line - plane * tiles.down) * 8 + threadIdx.x / 32;
  int const x = int(blockIdx.x - line * tiles.across) * 32 + threadIdx.x % 32;
  if (x < p.size[2] && y < p.size[1]) use(int64_t(volume), int(plane - volume * unsigned(p.size[0])), y, x);
}

template <class T, class Use>
__device__ __forceinline__ void at_peak(ConvQuadInterp3d<T> const& p, T const* volume, int64_t number, int z, int y,
                                        int x, Use use) {
  auto const value = [](T const& v) { return read(v); };
  if (p.chosen ? p.chosen[number] != 0 : is_peak(volume, p.size, z, y, x, value))
    find_peak(p, volume, z, y, x, value, use);
}

template <class T>
__global__ void __launch_bounds__(kThreads) peaks_of(__grid_constant__ ConvQuadInterp3d<T> const p, Tiles tiles) {
  using F = Compute<T>;
  at_voxel(p, tiles, [&](int64_t volume, int z, int y, int x) {
    int64_t const width = p.size[2], plane = p.size[1] * width, size = p.size[0] * plane;
    int64_t const at = z * plane + y * width + x, number = volume * size + at;
    T const* const from = p.x + volume * size;
    F value = read(p.x[number]), coord[] = {F(z), F(x), F(y)};
    at_peak(p, from, number, z, y, x, [&](int const(&c)[3], Quadratic<F> const& q) {
      value = read(from[c[2] * plane + c[1] * width + c[0]]) + q.rise();
      coord[0] = F(c[2]) + q.shift[2];
      coord[1] = F(c[0]) + q.shift[0];
      coord[2] = F(c[1]) + q.shift[1];
    });
    p.values[number] = round_to<T>(value);
#pragma unroll
    for (int a = 0; a < 3; ++a) p.coords[(3 * volume + a) * size + at] = round_to<T>(coord[a]);
  });
}

// Adds into a gradient that starts as zeros.
template <class T>
__global__ void __launch_bounds__(kThreads)
    peaks_backward(__grid_constant__ ConvQuadInterp3dBackward<T> const p, Tiles tiles) {
  using F = Compute<T>;
  ConvQuadInterp3d<T> const& f = p.forward;
  at_voxel(f, tiles, [&](int64_t volume, int z, int y, int x) {
    int64_t const width = f.size[2], plane = f.size[1] * width, size = f.size[0] * plane;
    int64_t const at = z * plane + y * width + x, number = volume * size + at;
    F const grad_value = read(p.grad_values[number]);
    F* const grad_x = p.grad_x + volume * size;
    bool refined = false;
    at_peak(f, f.x + volume * size, number, z, y, x, [&](int const(&c)[3], Quadratic<F> const& q) {
      refined = true;
      auto const coord = [&](int a) { return F(read(p.grad_coords[(3 * volume + a) * size + at])); };
      F const grad_shift[] = {coord(1), coord(2), coord(0)};
      F* const center = grad_x + c[2] * plane + c[1] * width + c[0];
      q.vjp(grad_shift, grad_value,
            [&](int dx, int dy, int dz, F number) { atomicAdd(center + dz * plane + dy * width + dx, number); });
    });
    if (!refined) atomicAdd(grad_x + at, grad_value);
  });
}

}  // namespace

template <class T>
int conv_quad_interp3d(ConvQuadInterp3d<T> const& p, CUstream_st* stream) {
  Tiles const tiles(p);
  peaks_of<T><<<tiles.count, kThreads, 0, stream>>>(p, tiles);
  return cudaGetLastError();
}

template <class T>
int conv_quad_interp3d_backward(ConvQuadInterp3dBackward<T> const& p, CUstream_st* stream) {
  Tiles const tiles(p.forward);
  ConvQuadInterp3d<T> const& f = p.forward;
  size_t const voxels = size_t(f.volumes) * size_t(f.size[0]) * size_t(f.size[1]) * size_t(f.size[2]);
  if (int const error = cudaMemsetAsync(p.grad_x, 0, voxels * sizeof(Compute<T>), stream)) return error;
  peaks_backward<T><<<tiles.count, kThreads, 0, stream>>>(p, tiles);
  return cudaGetLastError();
}

KV_INSTANTIATE(conv_quad_interp3d, ConvQuadInterp3d)
KV_INSTANTIATE(conv_quad_interp3d_backward, ConvQuadInterp3dBackward)

}  // namespace kv::geometry::cuda
