// Disks on CUDA: a block for each sample.
#include "augmentation/corruption/disk.h"
#include "core/block_reduce.cuh"
#include "core/launch.cuh"

namespace kv::augmentation::cuda {
namespace {

constexpr int kDiskThreads = 256;

template <class T>
__global__ void __launch_bounds__(kDiskThreads) make_disks(__grid_constant__ DiskKernels<T> const p) {
  __shared__ int memory[kDiskThreads / 32];
  int64_t const b = blockIdx.x;
  int const side = p.side(), size = side * side;
  Disk<T> const disk(T(p.radii[b * p.radius_stride]), p.deviations[b * p.deviation_stride]);
  int pixels = 0;
  for (int i = threadIdx.x; i < size; i += kDiskThreads)
    pixels += disk.has(T(i % side - p.reach), T(i / side - p.reach));
  pixels = block_sum_to_all(pixels, memory);
  for (int i = threadIdx.x; i < size; i += kDiskThreads)
    p.y[b * size + i] = disk.at(i % side - p.reach, i / side - p.reach) / T(pixels);
}

}  // namespace

template <class T>
int disk_kernels(DiskKernels<T> const& p, CUstream_st* stream) {
  make_disks<<<unsigned(p.batch), kDiskThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_COMPUTED(disk_kernels, DiskKernels)

}  // namespace kv::augmentation::cuda
