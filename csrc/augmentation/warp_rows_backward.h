// The gradient of the image through a bilinear warp that maps rows to rows, as crops, flips and resizing do, on CUDA.
// Other warps, and all warps on the CPU, take geometry::sample_image_backward.
#pragma once

#include "core/isa.h"
#include "geometry/transform/sampling.h"

namespace kv::augmentation {

// There is one sample for each image, T computes in float, and the padding is not a reflection. The rows of `grad_x`
// are dense. `sums` is not used, because every pixel of `grad_x` is written once.
template <class T>
struct WarpRowsBackward {
  geometry::SampleImageBackward<T> warp;
};

KV_KERNEL(warp_rows_backward, WarpRowsBackward)

namespace cuda {
// Whether the shared memory of a block is large enough.
bool fits_block(geometry::Size source, geometry::Size output);
}  // namespace cuda

}  // namespace kv::augmentation
