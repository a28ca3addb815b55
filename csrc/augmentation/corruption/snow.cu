// Snow on CUDA: a thread for each pixel, in all channels. A block of a list finds its sample in the table.
#include "augmentation/corruption/snow.h"
#include "core/launch.cuh"

namespace kv::augmentation::cuda {
namespace {

constexpr int kSnowThreads = 256, kSnowPixels = 4;  // of a thread, whose loads are in flight together

// The pixels of a thread of sample b, those of a block following each other.
template <class T>
__device__ __forceinline__ void whiten_block(AddSnow<T> const& p, int64_t b, int block, bool copies = false) {
  using F = Compute<T>;
  int const pixels = int(p.pixels()), width = int(p.width);
  T const* const x = p.x + b * p.x_strides[0];
  T* const y = p.y + b * p.y_strides[0];
#pragma unroll
  for (int k = 0; k < kSnowPixels; ++k) {
    int const i = (block * kSnowPixels + k) * kSnowThreads + int(threadIdx.x);
    if (i >= pixels) return;
    int const row = i / width, column = i - row * width;
    T const* const from = x + row * p.x_strides[2] + column * p.x_strides[3];
    T* const to = y + row * p.y_strides[2] + column * p.y_strides[3];
    if (copies) {
      for (int c = 0; c < int(p.channels); ++c) to[c * p.y_strides[1]] = from[c * p.x_strides[1]];
      continue;
    }
    p.whiten(
        from, p.snow(b, i), [](T const& from) { return F(read(from)); },
        [&](int c, F value) { to[c * p.y_strides[1]] = round_to<T>(value); });
  }
}

template <class T>
__global__ void __launch_bounds__(kSnowThreads) whiten_pixels(__grid_constant__ AddSnow<T> const p) {
  whiten_block(p, blockIdx.y, int(blockIdx.x));
}
template <class T>
__global__ void __launch_bounds__(kSnowThreads) whiten_list(__grid_constant__ AddSnowList<T> const p) {
  int const b = p.sample_of(int(blockIdx.x));
  whiten_block(p.sample(b), 0, int(blockIdx.x) - p.listed[b].first, p.copies(b));
}

int64_t snow_blocks(int64_t pixels) { return ceil_div(pixels, int64_t(kSnowThreads * kSnowPixels)); }

}  // namespace

template <class T>
int add_snow(AddSnow<T> const& p, CUstream_st* stream) {
  dim3 const blocks(unsigned(snow_blocks(p.pixels())), unsigned(p.batch));
  whiten_pixels<T><<<blocks, kSnowThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int add_snow_list(AddSnowList<T> const& params, CUstream_st* stream) {
  AddSnowList<T> p = params;
  int64_t blocks = 0;
  for (int b = 0; b < p.count; ++b) {
    p.listed[b].first = int(blocks);
    blocks += snow_blocks(int64_t(p.listed[b].height) * p.listed[b].width);
    if (blocks > INT32_MAX) return cudaErrorInvalidConfiguration;
  }
  whiten_list<T><<<unsigned(blocks), kSnowThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_WITH_BYTES(add_snow, AddSnow)
KV_INSTANTIATE_WITH_BYTES(add_snow_list, AddSnowList)

}  // namespace kv::augmentation::cuda
