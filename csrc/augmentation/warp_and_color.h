// A warp by a matrix and a program of color steps in one pass over memory. On the CPU both halves are those of
// geometry/transform/warp and color/program, on bands of rows that stay in the cache. On CUDA a kernel joins bilinear
// warps that map rows to rows with their programs.
#pragma once

#include "color/program.h"
#include "geometry/transform/sampling.h"

namespace kv::augmentation {

// Images have one or three channels, and types that compute in float. The sampled pixels are not stored: `warp.y` has
// their size only. `program.x` is not used.
template <class T>
struct WarpAndColor {
  geometry::Sample<T> warp;
  color::Program<float> program;

  KV_HD int64_t first_sample() const { return 0; }
};

// On the CPU a band of rows of a sample is processed at a time, by programs without a mean.
constexpr int64_t kBandPixels = 8192;
KV_HD int64_t rows_of_band(int64_t width) { return max(int64_t(1), kBandPixels / width); }
KV_HD int64_t bands_of(int64_t height, int64_t width) {
  int64_t const rows = rows_of_band(width);
  return (height + rows - 1) / rows;
}

KV_KERNEL(warp_and_color, WarpAndColor)

namespace cuda {
// Whether the kernel takes programs around the mean of samples of that size on this GPU. Any others it does.
bool keeps_samples(int64_t height, int64_t width);
}  // namespace cuda

}  // namespace kv::augmentation
