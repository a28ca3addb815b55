// Antialiased resizing of windows of a batch on CUDA, and its gradient.
#include "geometry/transform/resize/resize_windows.cuh"

namespace kv::geometry::cuda {
namespace {

template <class T, int P, int R>
__global__ void __launch_bounds__(kThreads, kBlocks)
    resize_window_tiles(__grid_constant__ ResizeWindows<T> const p, WindowTiles const tiles) {
  resize_tile<T, P, R>(p, tiles, blockIdx.x);
}

template <class T>
__global__ void __launch_bounds__(kElements) resize_windows_any(__grid_constant__ ResizeWindows<T> const p) {
  resize_element(p, blockIdx.x);
}

template <class T>
int resize_tiles(ResizeWindows<T> const& p, CUstream_st* stream) {
  bool const by_groups = p.planes % kPlanes == 0 && p.x.step == 1 && has_near_planes(p.x) && has_near_planes(p.y);
  return dispatch_tiles(p, by_groups, [&](auto planes, auto radius, WindowTiles const& tiles, int threads) -> int {
    auto* const kernel = resize_window_tiles<T, planes.value, radius.value>;
    if (int const error = cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, int(tiles.bytes)))
      return error;
    unsigned const blocks = unsigned(p.y.count() / p.planes) * tiles.groups * tiles.down * tiles.across;
    kernel<<<blocks, threads, unsigned(tiles.bytes), stream>>>(p, tiles);
    return cudaGetLastError();
  });
}

}  // namespace

template <class T>
int resize_windows(ResizeWindows<T> const& p, CUstream_st* stream) {
  if constexpr (sizeof(T) < 8) {
    if (fits_tiles(p.x) && fits_tiles(p.y) && fits_coordinates(p)) {
      int const error = resize_tiles(p, stream);
      if (error != kUnsupported) return error;
    }
  }
  resize_windows_any<<<unsigned(ceil_div(p.y.rows() * p.y.row_size(), kElements)), kElements, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_WITH_BYTES(resize_windows, ResizeWindows)

}  // namespace kv::geometry::cuda
