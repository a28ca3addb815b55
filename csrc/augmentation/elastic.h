// Displacements of elastic transforms: noise after a Gaussian blur, times a number for each axis,
//
//   d_c(y, x) = scale_c * sum over i, j of ky[i] kx[j] noise_c(y - ky / 2 + i, x - kx / 2 + j)
//
// with noise of 0 out of bounds. The noise is given, or drawn as noise.h says. On the CPU, and on CUDA where the kernel
// does not serve, noise and blur are those of noise.h and filters/separable.h. Included by elastic.cu and
// elastic_op.cpp.
#pragma once

#include "augmentation/noise.h"

namespace kv::augmentation {

constexpr int kMaxElasticTaps = 63;  // along an axis

// Planar; rows are multiples of four pixels.
struct ElasticDisplacements {
  PixelNoise<float> noise;  // `x` is null where it is drawn, `y` has the result
  int height, width;
  int taps_y, taps_x;
  float ky[kMaxElasticTaps + 1], kx[kMaxElasticTaps + 1];  // weights, zeros behind them
  float scale[2];                                          // of x and of y
};

namespace cuda {
int elastic_displacements(ElasticDisplacements const& params, CUstream_st* stream);
// Whether this GPU has the shared memory for it.
bool serves_elastic_displacements();
}  // namespace cuda

}  // namespace kv::augmentation
