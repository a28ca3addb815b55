// The largest value of each image of a list on CUDA: a block reduces a part of an image, and puts its maximum where
// those of the other parts are. The bits of floats of at least 0 are in the order of the floats, and those of NaN above
// them.
#include "augmentation/lists/brightest.h"
#include "core/launch.cuh"

namespace kv::augmentation::cuda {
namespace {

constexpr int kBrightestThreads = 256;

template <class F>
using Bits = std::conditional_t<sizeof(F) == 8, unsigned long long, unsigned>;

template <class T>
__global__ void __launch_bounds__(kBrightestThreads) find_brightest(__grid_constant__ Brightest<T> const p) {
  using F = Compute<T>;
  __shared__ Bits<F> largest;
  if (threadIdx.x == 0) largest = 0;
  __syncthreads();
  int const b = p.list.sample_of(int(blockIdx.x));
  auto const x = images_of<T>(p.list.images[b], p.channels);
  int64_t const first = (int64_t(blockIdx.x) - p.list.first[b]) * kBrightestPixels,
                last = min(first + kBrightestPixels, x.height * x.width);
  F most = 0;
  for (int64_t i = first + threadIdx.x; i < last; i += kBrightestThreads) {
    int64_t const row = i / x.width, column = i - row * x.width;
    for (int c = 0; c < p.channels; ++c) {
      F const value = F(read(x.row(0, c, row)[column * x.step]));
      most = value > most || value != value ? value : most;
    }
  }
  most = most == most ? most : F(__int_as_float(0x7fffffff));
  Bits<F> bits;
  __builtin_memcpy(&bits, &most, sizeof(F));
  atomicMax(&largest, bits);
  __syncthreads();
  if (threadIdx.x == 0) atomicMax(reinterpret_cast<Bits<F>*>(p.y) + b, largest);
}

}  // namespace

template <class T>
int brightest_list(Brightest<T> const& p, CUstream_st* stream) {
  if (int const error = cudaMemsetAsync(p.y, 0, size_t(p.list.count) * sizeof(Compute<T>), stream)) return error;
  find_brightest<<<unsigned(p.list.items), kBrightestThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_WITH_BYTES(brightest_list, Brightest)

}  // namespace kv::augmentation::cuda
