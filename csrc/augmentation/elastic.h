// Displacements of elastic transforms: noise after a Gaussian blur, times a scale for each axis,
//
//   d_c(y, x) = scale_c * sum over i, j of ky[i] kx[j] noise_c(y - ky / 2 + i, x - kx / 2 + j)
//
// with noise of 0 out of bounds. The noise is an argument, or it is drawn by the rule of noise.h. The CPU, and CUDA
// where this kernel does not support the arguments, run the kernels of noise.h and filters/separable.h one after the
// other.
#pragma once

#include "augmentation/noise.h"

namespace kv::augmentation {

constexpr int kMaxElasticTaps = 63;  // along an axis

// Planar; rows are multiples of four pixels.
struct ElasticDisplacements {
  PixelNoise<float> noise;  // `x` is the noise, or null if it is drawn; `y` is the result
  int height, width;
  int taps_y, taps_x;
  float ky[kMaxElasticTaps + 1], kx[kMaxElasticTaps + 1];  // weights, followed by zeros
  float scale[2];                                          // of x and of y
};

namespace cuda {
int elastic_displacements(ElasticDisplacements const& params, CUstream_st* stream);
// Whether this GPU has enough shared memory for the kernel.
bool has_elastic_displacements();
}  // namespace cuda

}  // namespace kv::augmentation
