// Model inputs: images of any sizes are resized, normalized and written as patches, all of them in one pass. Included
// by vision_patches_cpu.cpp, vision_patches.cuh and vision_patches_op.cpp.
//
// Filters, bands and weights are those of geometry/transform/resize/resize.h, antialiased. Bytes are resized along rows
// first, and rounded and saturated after either axis, as Pillow and torchvision do: where negative weights meet hard
// edges, that is visible. On the CPU their weights are integers of 16 bits, as precise as the largest one allows, and
// their sums exact: the bytes are those of torchvision. CUDA has 16-bit floats.
//
//   repeats > 0   patches (C, repeats, P, P), blocks of merge x merge of them adjacent, images one after the other
//   repeats == 0  patches (P, P, C), row by row, each image followed by zeros up to `padded` patches
#pragma once

#include "core/dtype.h"
#include "geometry/transform/resize/resize.h"

namespace kv::contrib {

constexpr int kMaxPatchChannels = 4;

// An image, in elements, and what it becomes.
struct PatchImage {
  void const* data;
  int64_t channel_stride, row_stride, step;
  int64_t first_patch;  // of the result
  int height, width;    // of the image
  int rows, columns;    // of patches
  int first_unit;       // of the work: rows of patches on the CPU, blocks on CUDA
};

template <class T>
struct VisionPatches {
  PatchImage const* images;  // in memory of the host
  int count;
  int channels, patch, merge, repeats, padded;
  geometry::ResizeFilter filter;  // bilinear or bicubic
  DType dtype;                    // of the patches: float32 or bfloat16
  void* patches;
  bool* mask;  // (count, padded), or null
  float scale[kMaxPatchChannels], offset[kMaxPatchChannels];

  KV_HD int patch_elements() const { return channels * patch * patch; }  // without repeats
  KV_HD int64_t elements() const { return int64_t(patch_elements()) * max(repeats, 1); }
  // The patch in row i and column j of an image, counted in the result.
  KV_HD int64_t index(PatchImage const& image, int i, int j) const {
    int const m = merge;
    return image.first_patch + ((int64_t(i / m) * (image.columns / m) + j / m) * m + i % m) * m + j % m;
  }
  KV_HD geometry::ResizeAxis axis(int64_t source, int64_t result) const {
    return {filter, source, result, false, true, false};
  }
  KV_HD T const* row(PatchImage const& image, int c, int64_t y) const {
    return static_cast<T const*>(image.data) + c * image.channel_stride + y * image.row_stride;
  }
};

KV_KERNEL(vision_patches, VisionPatches)

// How many bits integer weights have behind the point: the largest one, times 2^bits, fits 16 bits.
KV_HD int weight_bits(double largest) {
  int bits = 0;
  while (bits < 21 && int(0.5 + largest * double(1 << (bits + 1))) < (1 << 15)) ++bits;
  return bits;
}
KV_HD int16_t to_weight(double weight, int bits) {
  double const x = weight * double(1 << bits);
  return int16_t(x < 0 ? x - 0.5 : x + 0.5);
}

}  // namespace kv::contrib
