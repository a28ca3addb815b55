// What both kernels of vision_patches share: which image a block works on, and its axes.
#pragma once

#include "contrib/vision_patches.h"
#include "core/launch.cuh"

namespace kv::contrib::cuda {

using geometry::cuda::kUnsupported;

// Bytes that shrink a few times; the others are not served.
int vision_patches_of_bytes(VisionPatches<uint8_t> const& p, CUstream_st* stream);

namespace {

constexpr int kImages = 256;  // of a launch
constexpr int kZeroed = 16;   // patches of padding that a block writes

struct Table {
  PatchImage images[kImages];
};

// The last image whose first block is not after this one.
template <class T>
__device__ __forceinline__ int image_of_block(VisionPatches<T> const& p, Table const& table) {
  int sample = 0;
  for (int step = kImages / 2; step > 0; step /= 2)
    if (sample + step < p.count && table.images[sample + step].first_unit <= int(blockIdx.x)) sample += step;
  return sample;
}

// Clears a part of the padding of an image.
template <class U, class T>
__device__ __forceinline__ void clear_padding(VisionPatches<T> const& p, PatchImage const& image, int part) {
  int const elements = p.patch_elements(), first = image.rows * image.columns + part * kZeroed;
  int64_t const end = int64_t(min(first + kZeroed, p.padded)) * elements;
  U* const to = static_cast<U*>(p.patches) + image.first_patch * elements;
  for (int64_t e = int64_t(first) * elements + threadIdx.x; e < end; e += blockDim.x) to[e] = U{};
}

template <class T>
__device__ __forceinline__ void write_mask(VisionPatches<T> const& p, PatchImage const& image) {
  for (int i = int(threadIdx.x); i < p.padded; i += int(blockDim.x))
    p.mask[image.first_patch + i] = i < image.rows * image.columns;
}

// An axis of an image, as ResizeAxis has it, by the few numbers that a block needs.
struct Axis {
  geometry::ResizeFilter filter;
  int source, result, radius;
  __device__ __forceinline__ Axis(geometry::ResizeFilter filter, int source, int result)
      : filter(filter), source(source), result(result), radius(geometry::filter_radius(filter)) {}
  __device__ __forceinline__ int taps() const {
    return min((2 * radius * max(source, result) + result - 1) / result, source);
  }
  __device__ __forceinline__ double scale() const { return double(source) / result; }
  __device__ __forceinline__ double center(int i, double scale) const { return (i + 0.5) * scale - 0.5; }
  // The pixels that a pixel of the result reads. Those at the very ends of a window have no weight worth a tap.
  __device__ __forceinline__ int first(double center, double scale) const {
    return max(int(floor(center - radius * max(scale, 1.) + kEnds)) + 1, 0);
  }
  __device__ __forceinline__ int end(double center, double scale) const {
    return min(int(ceil(center + radius * max(scale, 1.) - kEnds)), source);
  }
  static constexpr double kEnds = 1e-6;
};

// Blocks of a launch: tiles of each image, of so many patches, and parts of its padding.
template <class T>
unsigned fill_table(VisionPatches<T> const& p, PatchImage const* images, int across, int down, Table& table) {
  int64_t blocks = 0;
  for (int n = 0; n < p.count; ++n) {
    PatchImage& image = table.images[n] = images[n];
    image.first_unit = int(blocks);
    blocks += ceil_div(image.rows, down) * ceil_div(image.columns, across);
    if (p.repeats == 0) blocks += ceil_div(p.padded - image.rows * image.columns, kZeroed);
  }
  return unsigned(blocks);
}

}  // namespace
}  // namespace kv::contrib::cuda
