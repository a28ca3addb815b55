// The maps of operators that sample at their coordinates.
#pragma once

#include "geometry/transform/sampling_glue.h"

namespace kv::geometry {

struct Map {
  Tensor x, y;
  bool normalized, moves, align_corners;

  Map(char const* op, Tensor const& map_x, Tensor const& map_y, Tensor const& image, int64_t samples, bool normalized,
      bool moves, bool align_corners)
      : x(map_x), y(map_y), normalized(normalized), moves(moves), align_corners(align_corners) {
    for (Tensor const& map : {x, y})
      KV_CHECK(matches_samples(map, image, 3, samples) && map.size(1) == x.size(1) && map.size(2) == x.size(2), op,
               ": map_x, map_y do not fit the image or one another");
    checked_size(op, {x.size(1), x.size(2)});
  }
  Size size() const { return {x.size(1), x.size(2)}; }

  template <class F>
  SampleCoords<F> coords(Size source, int64_t batch) const {
    SampleCoords<F> p{};
    p.x = plane<F const>(x, batch);
    p.y = plane<F const>(y, batch);
    matrix::Unit const units[] = {{source.width, align_corners}, {source.height, align_corners}};
    for (int i = 0; i < 2; ++i) {
      p.scale[i] = normalized ? F(units[i].scale) : F(1);
      p.offset[i] = normalized && !moves ? F(units[i].offset) : F(0);
    }
    p.own = F(moves);
    return p;
  }
  // (B, H, W)
  template <class T>
  static Images<T> plane(Tensor const& x, int64_t batch) {
    return {
        data_ptr<T>(x), x.size(0) == 1 ? 0 : x.stride(0), 0, x.stride(1), x.stride(2), batch, x.size(1), x.size(2), 1};
  }
};

}  // namespace kv::geometry
