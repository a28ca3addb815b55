// Colormaps on the CPU: rows [begin, end) of all channels in order. Compiled once per instruction set.
#include "colormap.h"

namespace kv::color::KV_ISA {

template <class T>
void apply_colormap(Colormap<T> const& p, int64_t begin, int64_t end) {
  for (int64_t r = begin; r < end; ++r) {
    int64_t const plane = r / p.x.height, y = r % p.x.height;
    T const* const x = p.x.row(plane, y);
    T const white_level = p.white[plane], *const table = p.table(plane);
    T* rgb[3];
    for (int k = 0; k < 3; ++k) rgb[k] = p.y.row(3 * plane + k, y);
    for (int64_t i = 0; i < p.x.width; ++i) {
      T const v = x[i] / white_level;
      int const index = color_index(v, p.n);
      for (int k = 0; k < 3; ++k) rgb[k][i] = v == v ? table[k * p.n + index] : v;
    }
  }
}

KV_INSTANTIATE_COMPUTED(apply_colormap, Colormap)

}  // namespace kv::color::KV_ISA
