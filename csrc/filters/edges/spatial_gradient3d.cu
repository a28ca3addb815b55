// Derivatives of a volume on CUDA: one thread for each voxel and all its channels; neighbors are read through the L1
// cache.
#include "core/launch.cuh"
#include "spatial_gradient3d.h"

namespace kv::filters::cuda {
namespace {

// Blocks of 32 by 8 voxels of a plane, planes last.
struct Tiles {
  unsigned across, down;
  int64_t count;
  template <class T>
  explicit Tiles(Planes<T> const& p)
      : across(unsigned(ceil_div(p.width, 32))),
        down(unsigned(ceil_div(p.height, 8))),
        count(p.count() * across * down) {}
  // The thread's voxel: false out of bounds.
  template <class T>
  __device__ __forceinline__ bool locate(Planes<T> const& p, int64_t& plane, int& x, int& y) const {
    unsigned const q = blockIdx.x / across, tile = q / down;
    plane = tile;
    x = int(blockIdx.x - q * across) * 32 + threadIdx.x;
    y = int(q - tile * down) * 8 + threadIdx.y;
    return x < p.width && y < p.height;
  }
};

template <int Order, class T>
__global__ void __launch_bounds__(256) forward(SpatialGradient3d<T> p, Tiles tiles) {
  int64_t plane;
  int x, y;
  if (!tiles.locate(p.x, plane, x, y)) return;
  int const width = int(p.x.width), height = int(p.x.height), depth = int(p.depth);
  int64_t const volume = plane / depth;
  int const z = int(plane - volume * depth);
  T const* const center = p.x.row(plane, y) + x;
  int64_t const along_x[]{x > 0 ? -1 : 0, 0, x < width - 1 ? 1 : 0};
  int64_t const along_y[]{y > 0 ? -p.x.row_stride : 0, 0, y < height - 1 ? p.x.row_stride : 0};
  int64_t const along_z[]{z > 0 ? -p.x.outer_stride : 0, 0, z < depth - 1 ? p.x.outer_stride : 0};
  auto const at = [&](int k, int j, int i) { return read(center[along_z[k] + along_y[j] + along_x[i]]); };
  for_each_channel3d<Order>([&](auto c) {
    T* const out = p.y.row((volume * 3 * Order + c.index) * depth + z, y);
    out[x] = round_to<T>(c.template derivative<Compute<T>>(at));
  });
}

template <int Order, class T>
__global__ void __launch_bounds__(256) backward(SpatialGradient3dBackward<T> p, Tiles tiles) {
  using F = Compute<T>;
  int64_t plane;
  int x, y;
  if (!tiles.locate(p.grad_x, plane, x, y)) return;
  int const width = int(p.grad_x.width), height = int(p.grad_x.height), depth = int(p.depth);
  int64_t const volume = plane / depth;
  int const z = int(plane - volume * depth);
  bool const first[3]{x == 0, y == 0, z == 0}, last[3]{x == width - 1, y == height - 1, z == depth - 1};
  F sum = 0;
  for_each_channel3d<Order>([&](auto c) {
    T const* const center = p.grad.row((volume * 3 * Order + c.index) * depth + z, y) + x;
    auto const at = [&](int k, int j, int i) {
      bool const out_of_bounds = (i == 0 && first[0]) || (i == 2 && last[0]) || (j == 0 && first[1]) ||
                                 (j == 2 && last[1]) || (k == 0 && first[2]) || (k == 2 && last[2]);
      return out_of_bounds ? F(0) : read(center[(k - 1) * p.grad.outer_stride + (j - 1) * p.grad.row_stride + i - 1]);
    };
    sum += c.template derivative_vjp<F>(at, first, last);
  });
  p.grad_x.row(plane, y)[x] = round_to<T>(sum);
}

}  // namespace

template <class T>
int spatial_gradient3d(SpatialGradient3d<T> const& p, CUstream_st* stream) {
  Tiles const tiles(p.x);
  if (p.order == 1)
    forward<1><<<unsigned(tiles.count), dim3(32, 8), 0, stream>>>(p, tiles);
  else
    forward<2><<<unsigned(tiles.count), dim3(32, 8), 0, stream>>>(p, tiles);
  return cudaGetLastError();
}

template <class T>
int spatial_gradient3d_backward(SpatialGradient3dBackward<T> const& p, CUstream_st* stream) {
  Tiles const tiles(p.grad_x);
  if (p.order == 1)
    backward<1><<<unsigned(tiles.count), dim3(32, 8), 0, stream>>>(p, tiles);
  else
    backward<2><<<unsigned(tiles.count), dim3(32, 8), 0, stream>>>(p, tiles);
  return cudaGetLastError();
}

KV_INSTANTIATE(spatial_gradient3d, SpatialGradient3d)
KV_INSTANTIATE(spatial_gradient3d_backward, SpatialGradient3dBackward)

}  // namespace kv::filters::cuda
