// Resizing of batches by any factor on CUDA, and its backward pass.
#include "geometry/transform/resize/resize_strips.cuh"

namespace kv::geometry::cuda {
namespace {

template <class T, int M, bool Shrinks>
__global__ void __launch_bounds__(StripOf<T, M, Shrinks>::kThreads, StripOf<T, M, Shrinks>::kBlocks)
    resize_strips(__grid_constant__ Resize<T> const p, ResizeStrips const strips, bool aligned) {
  resize_block<T, M, Shrinks>(p, strips, aligned, blockIdx.x);
}

template <class T, int M, bool Shrinks>
int launch(Resize<T> const& p, CUstream_st* stream) {
  using S = StripOf<T, M, Shrinks>;
  bool const aligned = strips_are_aligned<S>(p.x);
  int64_t const planes = p.y.count();
  ResizeStrips strips;
  if (!divide_columns<S>(p, aligned, strips)) return kUnsupported;
  strips.warps_down = warps_down_of(planes, 0.125);
  auto const bytes_of = [&](int64_t rows) { return strip_bytes<S, Shrinks>(p, strips, rows); };
  int64_t const most = most_rows(bytes_of), resident = resident_blocks<S>(bytes_of(most)) * S::kWarps;
  if (most == 0) return kUnsupported;
  int const rows = min(int(most), strip_height(planes * strips.across, p.y.height, 6, resident, resident));
  divide_rows(p, rows, strips);
  int64_t const bytes = bytes_of(rows);
  auto const kernel = resize_strips<T, M, Shrinks>;
  if (int const error = cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, int(bytes)))
    return error;
  unsigned const blocks = unsigned(ceil_div(planes, S::kWarps / strips.warps_down)) * strips.across * strips.down;
  kernel<<<blocks, S::kThreads, unsigned(bytes), stream>>>(p, strips, aligned);
  return cudaGetLastError();
}

}  // namespace

template <class T>
int resize_strips(Resize<T> const& p, CUstream_st* stream) {
  if (p.x.row_stride * int64_t(sizeof(T)) > INT32_MAX) return kUnsupported;
  bool const shrinks = p.rows.max_readers <= p.rows.max_taps;
  int const taps = shrinks ? p.rows.max_readers : p.rows.max_taps;
  // Special case, H200: 0.97 (resize 0.2 aa) to 1.16 (resize 0.07 aa) times as fast as four rows at once.
  if (taps <= 2) return shrinks ? launch<T, 2, true>(p, stream) : launch<T, 2, false>(p, stream);
  // Special case, H200: 0.97 (resize 0.6 bicubic aa backward) to 1.63 (resize 0.6 bicubic aa) times as fast as six rows
  // at once.
  if (taps <= 4) return shrinks ? launch<T, 4, true>(p, stream) : launch<T, 4, false>(p, stream);
  if (taps <= 6) return shrinks ? launch<T, 6, true>(p, stream) : launch<T, 6, false>(p, stream);
  return kUnsupported;
}

template int resize_strips(Resize<float> const&, CUstream_st*);
template int resize_strips(Resize<Half> const&, CUstream_st*);
template int resize_strips(Resize<BFloat16> const&, CUstream_st*);
template int resize_strips(Resize<uint8_t> const&, CUstream_st*);

}  // namespace kv::geometry::cuda
