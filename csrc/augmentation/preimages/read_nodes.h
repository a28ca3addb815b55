// Where the nodes of maps of a list read images, a step of the chain at a time: by matrices, or by displacements that
// are bilinear between pixels and, outside of the image, those of its border.
#pragma once

#include "augmentation/preimages/preimages.h"
#include "geometry/transform/composed/composed_warp.h"
#include "geometry/transform_points.h"

namespace kv::augmentation {

#if defined(__CUDACC__)
#define KV_NODE __device__ __forceinline__
#else
#define KV_NODE KV_HD
#endif

template <class F>
struct ReadNodes {
  Point<F> const* from;       // of all nodes; null: their own positions
  uint8_t const* from_kinds;  // null: by their places
  F const *matrices, *maps;   // (count, 9), or maps (2, height, width); the other one is null
  Point<F>* coordinates;
  uint8_t* kinds;
  int count, items;
  int rows[kMaxListed], columns[kMaxListed], first[kMaxListed];  // of nodes; the items of map b begin at first[b]
  int height[kMaxListed], width[kMaxListed];                     // of the images that are read
  int64_t node[kMaxListed], map[kMaxListed];                     // where maps begin; -1: nothing is displaced
  uint8_t margin[kMaxListed], is_bounded[kMaxListed];            // bounded: nodes outside of the image read nothing

  KV_HD int sample_of(int item) const {
    return entry_of_item(count, item, [&](int i) { return first[i]; });
  }

  KV_NODE void run(int b, int64_t i, int64_t j) const {
    int64_t const at = node[b] + i * columns[b] + j;
    Point<F> p{};
    uint8_t kind;
    if (from)
      p = from[at], kind = from_kinds[at];
    else
      p = {node_position<F>(j, columns[b], margin[b]), node_position<F>(i, rows[b], margin[b])},
      kind = kind_of(b, i, j);
    if (matrices)
      p = moved(matrices + 9 * b, p);
    else if (map[b] >= 0)
      p = from ? displaced(b, p) : p + displacement(b, i - margin[b] - 1, j - margin[b] - 1);
    if (is_bounded[b] && !(p.x >= -1 && p.x <= F(width[b]) && p.y >= -1 && p.y <= F(height[b]))) kind = kOutside;
    coordinates[at] = p;
    kinds[at] = kind;
  }

 private:
  KV_NODE uint8_t kind_of(int b, int64_t i, int64_t j) const {
    int64_t const inside = min(min(i, j), min(rows[b] - 1 - i, columns[b] - 1 - j)) - margin[b];
    return inside < 0 ? kOutside : inside == 0 ? kInside : kPixel;
  }
  static KV_NODE Point<F> moved(F const* matrix, Point<F> p) {
    F const given[2] = {p.x, p.y};
    F y[2];
    geometry::Transform<2, 2>::value(matrix, false, given, y);
    return {y[0], y[1]};
  }
  KV_NODE Point<F> displaced(int b, Point<F> p) const {
    geometry::displace(geometry::Link<F>{maps + map[b], 0, height[b], width[b]}, 0, p.x, p.y,
                       [](F const* plane, int at) KV_INLINE { return plane[at]; });
    return p;
  }
  // That of a pixel; outside of the image that of the border.
  KV_NODE Point<F> displacement(int b, int64_t row, int64_t column) const {
    int64_t const h = height[b], w = width[b];
    F const* const own = maps + map[b] + clamp(row, int64_t(0), h - 1) * w + clamp(column, int64_t(0), w - 1);
    return {own[0], own[h * w]};
  }
};

#undef KV_NODE

KV_KERNEL(read_nodes_list, ReadNodes)

}  // namespace kv::augmentation
