// Antialiased bilinear resizing of batches of bytes and half types that shrink to no less than a quarter on CUDA.
#include "geometry/transform/resize/resize_columns.cuh"

namespace kv::geometry::cuda {
namespace {

template <class T, int N>
__global__ void __launch_bounds__(kColumnThreads, kColumnBlocks<T>)
    resize_columns(__grid_constant__ Resize<T> const p, ColumnStrips const strips) {
  resize_columns_of<T, N>(p, strips, blockIdx.x);
}

template <class T, int N>
int launch(Resize<T> const& p, CUstream_st* stream) {
  auto* const kernel = resize_columns<T, N>;
  static int const resident = resident_blocks(kernel, kColumnThreads);
  int64_t const warps = p.y.count() / N * ceil_div(p.y.width, int64_t(32));
  auto const strips = ColumnStrips::of(p.y, rows_of_columns<T>(warps, p.y.height, resident));
  kernel<<<strips.blocks(p.y.count(), N), kColumnThreads, 0, stream>>>(p, strips);
  return cudaGetLastError();
}

}  // namespace

template <class T>
int resize_columns(Resize<T> const& p, CUstream_st* stream) {
  if (!serves_columns(p)) return kUnsupported;
  return p.y.count() % 3 == 0 ? launch<T, 3>(p, stream) : launch<T, 1>(p, stream);
}

template int resize_columns(Resize<Half> const&, CUstream_st*);
template int resize_columns(Resize<BFloat16> const&, CUstream_st*);
template int resize_columns(Resize<uint8_t> const&, CUstream_st*);

}  // namespace kv::geometry::cuda
