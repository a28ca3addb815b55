// Maps of lenses, vortices and grids on the CPU: rows [begin, end) of all samples. Compiled once per instruction set.
#include "augmentation/distortion/displacement_map.h"
#include "core/lanes.h"

namespace kv::augmentation::KV_ISA {
namespace {

template <class Map, class T>
KV_HD void fill_rows(DisplacementMap<T> const& p, int64_t begin, int64_t end) {
  int64_t const plane = p.height * p.width;
  for (int64_t r = begin; r < end; ++r) {
    int64_t const b = r / p.height, row = r % p.height;
    Map const map(p, p.rows + b * p.columns);
    T* const y = p.y + 2 * b * plane + row * p.width;
    for (int64_t x = 0; x < p.width; ++x) {
      Displacement<T> const moved = map.at(int(x), int(row));
      y[x] = moved.x, y[x + plane] = moved.y;
    }
  }
}

}  // namespace

template <class T>
void displacement_map(DisplacementMap<T> const& p, int64_t begin, int64_t end) {
  switch (p.kind) {
    case MapKind::lens:
      return fill_rows<LensMap<T>>(p, begin, end);
    case MapKind::swirl:
      return fill_rows<SwirlMap<T>>(p, begin, end);
    case MapKind::cells:
      return fill_rows<CellsMap<T>>(p, begin, end);
    case MapKind::triangles:
      return fill_rows<TrianglesMap<T>>(p, begin, end);
  }
}

KV_INSTANTIATE_COMPUTED(displacement_map, DisplacementMap)

}  // namespace kv::augmentation::KV_ISA
