// Maps of lenses, vortices, grids and splines on the CPU: rows [begin, end) of all samples, or of a list items, which
// are some rows of a map. Compiled once per instruction set.
#include "augmentation/distortion/displacement_map.h"

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
  with_map<T>(p.kind, [&](auto map) KV_INLINE { fill_rows<typename decltype(map)::type>(p, begin, end); });
}

template <class T>
void displacement_map_list(DisplacementMapList<T> const& p, int64_t begin, int64_t end) {
  for_each_sample(p.list, begin, end, [&](int b, int64_t first, int64_t last) {
    DisplacementMap<T> const one = p.sample(b);
    int64_t const rows = rows_of_item(one.width), from = first * rows, to = min(last * rows, one.height);
    if (p.is_chosen(b)) return displacement_map(one, from, to);
    for (T* const y : {one.y, one.y + one.height * one.width})
      for (int64_t i = from * one.width; i < to * one.width; ++i) y[i] = 0;
  });
}

KV_INSTANTIATE_COMPUTED(displacement_map, DisplacementMap)
KV_INSTANTIATE_COMPUTED(displacement_map_list, DisplacementMapList)

}  // namespace kv::augmentation::KV_ISA
