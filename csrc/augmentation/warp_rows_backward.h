// The gradient of the image through a bilinear warp that maps rows to rows, as crops, flips and resizing do, on CUDA.
// Any other warp, and all on the CPU, have geometry::sample_image_backward. Included by warp_rows_backward.cu and
// warp_and_color_op.cpp.
#pragma once

#include "core/isa.h"
#include "geometry/transform/sampling.h"

namespace kv::augmentation {

// A sample for each image. `sums` is not used: every pixel of `grad_x`, whose rows are dense, is written once. Types
// compute in float, and the padding is not a reflection.
template <class T>
struct WarpRowsBackward {
  geometry::SampleImageBackward<T> warp;
};

KV_KERNEL(warp_rows_backward, WarpRowsBackward)

namespace cuda {
// Whether what a block needs fits its shared memory.
bool fits_block(geometry::Size source, geometry::Size output);
}  // namespace cuda

}  // namespace kv::augmentation
