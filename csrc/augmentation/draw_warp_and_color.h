// Random parameters, and the matrices of the chain of transforms that reads them, in one launch on CUDA.
#pragma once

#include "augmentation/draws.h"
#include "augmentation/transforms.h"

namespace kv::augmentation {

// Draws are DrawParameters<float>, or DrawListParameters<float> for images of different sizes.
template <class Draws>
struct DrawsAndChain {
  Draws draws;
  TransformMatrix<float> chain;
};

namespace cuda {
template <class Draws>
int draw_and_multiply(DrawsAndChain<Draws> const& p, CUstream_st* stream);
}  // namespace cuda

}  // namespace kv::augmentation
