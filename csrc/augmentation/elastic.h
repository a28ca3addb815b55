// Displacements of elastic transforms: noise after a Gaussian blur, times a scale for each axis,
//
//   d_c(y, x) = scale_c * sum over i, j of ky[i] kx[j] noise_c(y - ky / 2 + i, x - kx / 2 + j)
//
// with noise of 0, or reflected noise, out of bounds. The noise is an argument, or it is drawn by the rule of noise.h.
// The CPU, and CUDA where this kernel does not support the arguments, run the kernels of noise.h and
// filters/separable.h one after the other.
#pragma once

#include "augmentation/lists/listed_maps.h"
#include "augmentation/noise.h"
#include "filters/separable.h"

namespace kv::augmentation {

constexpr int kMaxElasticTaps = 63;  // along an axis

// Planar.
struct ElasticDisplacements {
  PixelNoise<float> noise;  // `x` is the noise, or null if it is drawn; `y` is the result
  int height, width;
  int taps_y, taps_x;
  float ky[kMaxElasticTaps + 1], kx[kMaxElasticTaps + 1];  // weights, followed by zeros
  float scale[2];    // of x and of y; the noise has one itself where it has parameters
  bool is_mirrored;  // out of bounds
  double sigma[2];   // not 0: of x and of y, by which the kernel computes the weights
};

// Maps of a list, in one block of memory, of drawn noise, or of given noise in another block. Those of samples that are
// not chosen, by the noise, are 0.
struct ElasticDisplacementsList {
  ElasticDisplacements all;
  filters::SideBlur by_sides;  // the windows of `all` are the largest, or those of all
  ListedMaps list;

  KV_HD ElasticDisplacements sample(int b) const {
    ElasticDisplacements one = all;
    one.noise.skip(b);
    one.noise.batch = 1;
    one.noise.y += int64_t(kMapUnit) * list.begin[b];
    if (one.noise.x) one.noise.x += int64_t(kMapUnit) * list.begin[b];
    one.height = list.height[b], one.width = list.width[b];
    one.noise.pixels = one.noise.channel_stride = int64_t(one.height) * one.width;
    one.scale[0] = float(by_sides.factor(by_sides.x, one.width, one.height, one.width));
    one.scale[1] = float(by_sides.factor(by_sides.y, one.height, one.height, one.width));
    if (by_sides.x.follows) {
      filters::Taps<double> x, y;
      by_sides.x.set(x, one.width), by_sides.y.set(y, one.height);
      one.taps_x = x.size, one.taps_y = y.size;
      one.sigma[0] = x.sigma, one.sigma[1] = y.sigma;
    }
    return one;
  }
};

namespace cuda {
int elastic_displacements(ElasticDisplacements const& params, CUstream_st* stream);
int elastic_displacements_list(ElasticDisplacementsList const& params, CUstream_st* stream);
// Whether this GPU has enough shared memory for the kernel.
bool has_elastic_displacements();
}  // namespace cuda

}  // namespace kv::augmentation
