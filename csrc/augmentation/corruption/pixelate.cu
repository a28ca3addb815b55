// Images of blocks on CUDA: a block of threads has some rows of a plane. It sums the rows of a block of pixels, once
// for all rows of the result that show it, and then the columns of these sums.
#include "augmentation/corruption/pixelate.h"
#include "core/launch.cuh"

namespace kv::augmentation::cuda {
namespace {

constexpr int kPixelateThreads = 256, kPixelateRows = 32;

template <class T>
__global__ void __launch_bounds__(kPixelateThreads) show_blocks(__grid_constant__ Pixelate<T> const p, unsigned parts) {
  using F = Compute<T>;
  extern __shared__ __align__(16) char shared[];
  F* const sums = reinterpret_cast<F*>(shared);
  int64_t const plane = blockIdx.x / parts, b = plane / p.planes_per_sample;
  int const top = int(blockIdx.x % parts) * kPixelateRows, bottom = min(top + kPixelateRows, int(p.y.height));
  int const step = int(p.x.step), size = int(p.x.row_size());
  BlockAxis const down = p.down(b), across = p.across(b);
  for (int y = top, next; y < bottom; y = next) {
    unsigned const block = down.block(y);
    for (next = y + 1; next < bottom && down.block(next) == block;) ++next;
    BlockPixels const rows(down, block);
    __syncthreads();  // before other sums are overwritten
    for (int i = int(threadIdx.x); i < size; i += kPixelateThreads) {
      F sum = 0, total = 0;
      for (unsigned row = rows.begin; row < rows.end; ++row) {
        F const weight = rows.weight(row);
        total += weight;
        if (weight != 0) sum += weight * read(p.x.row(plane, row)[i]);
      }
      sums[i] = sum / total;
    }
    __syncthreads();
    for (int i = int(threadIdx.x); i < size; i += kPixelateThreads) {
      int const x = i / step;
      BlockPixels const columns(across, across.block(x));
      F sum = 0, total = 0;
      for (unsigned column = columns.begin; column < columns.end; ++column) {
        F const weight = columns.weight(column);
        total += weight;
        if (weight != 0) sum += weight * sums[i + (int(column) - x) * step];
      }
      T const value = round_to<T>(sum / total);
      for (int row = y; row < next; ++row) p.y.row(plane, row)[i] = value;
    }
  }
}

}  // namespace

template <class T>
int pixelate(Pixelate<T> const& p, CUstream_st* stream) {
  unsigned const parts = unsigned(ceil_div(p.y.height, kPixelateRows));
  size_t const bytes = size_t(p.x.row_size()) * sizeof(Compute<T>);
  if (cudaError_t const error =
          cudaFuncSetAttribute(show_blocks<T>, cudaFuncAttributeMaxDynamicSharedMemorySize, int(bytes)))
    return error;
  show_blocks<T><<<unsigned(p.y.count()) * parts, kPixelateThreads, bytes, stream>>>(p, parts);
  return cudaGetLastError();
}

KV_INSTANTIATE_WITH_BYTES(pixelate, Pixelate)

}  // namespace kv::augmentation::cuda
