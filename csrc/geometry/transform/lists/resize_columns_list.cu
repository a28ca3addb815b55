// Antialiased bilinear resizing of lists of bytes and half types that shrink to no less than a quarter on CUDA, in one
// launch: a block finds its image in the table, and resizes as blocks of batches do.
#include "geometry/transform/lists/resize_windows_list.h"
#include "geometry/transform/resize/resize_columns.cuh"

namespace kv::geometry::cuda {
namespace {

// The sample that a block takes, in shared memory.
template <class T>
struct ColumnBlock {
  Resize<T> sample;
  unsigned block;  // among those of the sample

  // By two threads of different warps, one for what is along x.
  __device__ __forceinline__ void init(ResizeWindowsList<T> const& p, bool along_x) {
    int const b = p.list.sample_of(int(blockIdx.x));
    Resize<T> const own = resize_at(p, b);
    if (along_x) {
      sample.x = own.x, sample.columns = own.columns;
      block = blockIdx.x - unsigned(p.list.first[b]);
    } else {
      sample.y = own.y, sample.rows = own.rows, sample.minuend = nullptr;
    }
  }
};

template <class T, int N>
__global__ void __launch_bounds__(kColumnThreads, kColumnBlocks<T>)
    resize_list_columns(__grid_constant__ ResizeWindowsList<T> const p, int rows) {
  __shared__ __align__(16) unsigned char memory[sizeof(ColumnBlock<T>)];
  auto& own = *reinterpret_cast<ColumnBlock<T>*>(memory);
  if (threadIdx.x == 0) own.init(p, true);
  if (threadIdx.x == 32) own.init(p, false);
  __syncthreads();
  resize_columns_of<T, N>(own.sample, ColumnStrips::of(own.sample.y, rows), own.block);
}

template <class T, int N>
int launch(ResizeWindowsList<T>& p, CUstream_st* stream) {
  auto* const kernel = resize_list_columns<T, N>;
  static int const resident = resident_blocks(kernel, kColumnThreads);
  int64_t warps = 0, height = 0, blocks = 0;
  for (int b = 0; b < p.list.count; ++b) {
    warps += p.channels / N * ceil_div(p.list.results[b].width, 32);
    height = max(height, int64_t(p.list.results[b].height));
  }
  int const rows = rows_of_columns<T>(warps, height, resident);
  for (int b = 0; b < p.list.count; ++b) {
    p.list.first[b] = int(blocks);
    blocks += ColumnStrips::of(resize_at(p, b).y, rows).blocks(p.channels, N);
  }
  if (blocks > INT32_MAX) return kUnsupported;
  kernel<<<unsigned(blocks), kColumnThreads, 0, stream>>>(p, rows);
  return cudaGetLastError();
}

}  // namespace

template <class T>
int resize_columns_list(ResizeWindowsList<T>& p, CUstream_st* stream) {
  if (p.all.backward || p.all.matrices || p.all.filter != ResizeFilter::bilinear) return cudaSuccess;
  ResizeWindowsList<T> served = p;
  served.list.count = 0;
  int others = 0;
  for (int b = 0; b < p.list.count; ++b) {
    ResizeWindowsList<T>& to = serves_columns(resize_at(p, b)) ? served : p;
    int const at = &to == &p ? others++ : served.list.count++;
    to.list.images[at] = p.list.images[b];
    to.list.results[at] = p.list.results[b];
  }
  if (served.list.count == 0) return cudaSuccess;
  int const error = p.channels % 3 == 0 ? launch<T, 3>(served, stream) : launch<T, 1>(served, stream);
  p.list.count = others;
  return error;
}

template int resize_columns_list(ResizeWindowsList<Half>&, CUstream_st*);
template int resize_columns_list(ResizeWindowsList<BFloat16>&, CUstream_st*);
template int resize_columns_list(ResizeWindowsList<uint8_t>&, CUstream_st*);

}  // namespace kv::geometry::cuda
