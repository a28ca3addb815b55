// Random parameters, and the matrices of the chain of transforms that reads them, in one launch on CUDA. Included by
// draw_warp_and_color.cu and draw_warp_and_color_op.cpp.
#pragma once

#include "augmentation/draws.h"
#include "augmentation/transforms.h"

namespace kv::augmentation {

struct DrawsAndChain {
  DrawParameters<float> draws;
  TransformMatrix<float> chain;
};

namespace cuda {
int draw_and_multiply(DrawsAndChain const& p, CUstream_st* stream);
}  // namespace cuda

}  // namespace kv::augmentation
