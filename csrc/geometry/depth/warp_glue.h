// Checks and sizes that the operators that warp by depth share.
#pragma once

#include "geometry/depth/warp.h"
#include "geometry/transform/sampling_glue.h"

namespace kv::geometry {

// Depths (B, 1, h, w) and projections (B, 3, 4) of images, checked; a single one serves the batch.
struct Depths {
  Tensor depth, projection;

  Depths(char const* op, Tensor const& depth, Tensor const& projections, Tensor const& image)
      : depth(depth), projection(projections) {
    KV_CHECK(matches_image(depth, image, 4) && depth.size(1) == 1, op, ": depth does not fit the image");
    checked_size(op, depth);
    bool const fits =
        matches_image(projections, image, projections.dim()) && projections.size(-2) == 3 && projections.size(-1) == 4;
    KV_CHECK(fits, op, ": projection does not fit the image");
    projection = dense(projections);
  }
  Size size() const { return {depth.size(2), depth.size(3)}; }

  template <class T>
  void set(DepthSampling<T>& p, SamplingOptions const& options, Size source, int64_t batch) const {
    using F = Compute<T>;
    static_cast<Sampling<T>&>(p) = options.of<T>(source, SampleCoords<F>{});
    p.depth = images<F const>(depth, batch);
    p.projections = data_ptr<F const>(projection);
    p.projection_stride = projection.size(0) == 1 ? 0 : projection.stride(0);
  }
};

// The number of chunks for the gradient to a projection: one for each tile on CUDA, for each row on the CPU.
inline int64_t projection_parts(Size output) {
#if defined(KV_CUDA)
  return ceil_div(output.height, kDepthTileHeight) * ceil_div(output.width, kDepthTileWidth);
#else
  return output.height;
#endif
}

}  // namespace kv::geometry
