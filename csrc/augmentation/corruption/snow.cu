// Snow on CUDA: a thread for each pixel, in all channels.
#include "augmentation/corruption/snow.h"
#include "core/launch.cuh"

namespace kv::augmentation::cuda {
namespace {

constexpr int kSnowThreads = 256, kSnowPixels = 4;  // of a thread, whose loads are in flight together

template <class T>
__global__ void __launch_bounds__(kSnowThreads) whiten_pixels(__grid_constant__ AddSnow<T> const p) {
  using F = Compute<T>;
  int const pixels = int(p.pixels()), width = int(p.width);
  int64_t const b = blockIdx.y;
  T const* const x = p.x + b * p.x_strides[0];
  T* const y = p.y + b * p.y_strides[0];
#pragma unroll
  for (int k = 0; k < kSnowPixels; ++k) {
    int const i = (blockIdx.x * kSnowPixels + k) * kSnowThreads + threadIdx.x;
    if (i >= pixels) return;
    int const row = i / width, column = i - row * width;
    T* const to = y + row * p.y_strides[2] + column * p.y_strides[3];
    p.whiten(
        x + row * p.x_strides[2] + column * p.x_strides[3], p.snow(b, i), [](T const& from) { return F(read(from)); },
        [&](int c, F value) { to[c * p.y_strides[1]] = round_to<T>(value); });
  }
}

}  // namespace

template <class T>
int add_snow(AddSnow<T> const& p, CUstream_st* stream) {
  dim3 const blocks(unsigned(ceil_div(p.pixels(), int64_t(kSnowThreads * kSnowPixels))), unsigned(p.batch));
  whiten_pixels<T><<<blocks, kSnowThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_WITH_BYTES(add_snow, AddSnow)

}  // namespace kv::augmentation::cuda
