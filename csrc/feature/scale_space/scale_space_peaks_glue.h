// Checks and working memory of the operators that find peaks.
#pragma once

#include "feature/scale_space/scale_space_peaks.h"
#include "glue/glue.h"

namespace kv::feature {

inline void check_refinement(char const* op, int64_t steps, int64_t radius) {
  KV_CHECK(steps >= 0 && steps <= INT32_MAX && radius >= 0 && radius <= INT32_MAX, op,
           ": steps and radius must not be negative");
}

inline void check_peak_count(char const* op, int64_t count) {
  KV_CHECK(count >= 0 && count <= INT32_MAX, op, ": expected count of 0 to 2^31 - 1, got ", count);
}

// The parameters of the refinement; `size` is not set.
template <class T>
geometry::ConvQuadInterp3d<T> refinement(int64_t steps, double largest_shift, int64_t radius, bool along_scale) {
  geometry::ConvQuadInterp3d<T> search{};
  search.steps = int(steps), search.radius = int(radius), search.along_scale = along_scale;
  search.largest_shift = Compute<T>(largest_shift);
  return search;
}

// Finds the peaks of the octaves, whose `levels` and `size` are set and which have fewer than 2^31 voxels. `like` is a
// tensor on their device.
template <class T>
void run_scale_space_peaks(Tensor const& like, ScaleSpacePeaks<T>& p) {
  using F = Compute<T>;
  int64_t voxels = 0, capacity = 0, parts = 0;
  for (int o = 0; o < p.octave_count; ++o) {
    PeakOctave<T>& octave = p.octaves[o];
    int64_t const depth = octave.size[0], height = octave.size[1], width = octave.size[2];
    octave.first_part = int(parts), octave.first_voxel = int(voxels);
    voxels += depth * height * width;
    if (depth >= 3 && height >= 3 && width >= 3) {
#if defined(KV_CUDA)
      parts += peak_tiles(int(height), int(width));
#else
      parts += ceil_div(height, peak_rows(width));
#endif
    }
    // Of 2 x 2 x 2 voxels at most one is a maximum and one a minimum.
    capacity += (1 + p.minima) * ceil_div(depth, 2) * ceil_div(height, 2) * ceil_div(width, 2);
  }
  KV_CHECK(voxels <= INT32_MAX && parts <= INT32_MAX, "scale_space_peaks: the volumes are too large");
  p.parts_of_sample = int(parts), p.capacity = capacity;
#if defined(KV_CUDA)
  int64_t const bytes = p.samples * (capacity + sorted_ranks(p.count, capacity)) * int64_t(sizeof(PeakRank<F>));
  Tensor const sizes = empty({p.samples}, like, Layout::planar, ScalarType::Long);
#else
  int64_t const bytes = p.samples * parts * p.count * int64_t(sizeof(ScaleSpacePeak<F>));
  Tensor const sizes = empty({p.samples, parts}, like, Layout::planar, ScalarType::Long);
#endif
  Tensor const lists = empty({bytes}, like, Layout::planar, ScalarType::Byte);
  p.bands = data_ptr<ScaleSpacePeak<F>>(lists), p.ranks = data_ptr<PeakRank<F>>(lists);
  p.sizes = data_ptr<int64_t>(sizes);
#if defined(KV_CUDA)
  KV_RUN(find_scale_space_peaks, like, p, p.samples, 0);  // without parts it only clears the sizes
#else
  KV_RUN(find_scale_space_peaks, like, p, p.samples * parts, 16 * kPeakPixels);
#endif
  KV_RUN(sort_scale_space_peaks, like, p, p.samples, 64 * p.count);
}

}  // namespace kv::feature
