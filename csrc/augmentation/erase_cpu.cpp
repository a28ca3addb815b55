// Erased rectangles on the CPU: rows [begin, end) of all planes. Compiled once per instruction set.
#include <cstddef>

#include "augmentation/erase.h"
#include "core/lanes.h"

namespace kv::augmentation::KV_ISA {

template <class T>
void erase_rectangles(EraseRectangles<T> const& p, int64_t begin, int64_t end) {
  for (int64_t r = begin; r < end; ++r) {
    int64_t const plane = r / p.x.height, y = r % p.x.height, step = p.x.step;
    int64_t const b = plane / p.planes_per_sample, c = plane % p.planes_per_sample;
    T* const row = p.y.row(plane, y);
    __builtin_memcpy(row, p.x.row(plane, y), size_t(p.x.row_size()) * sizeof(T));
    for (int64_t k = 0; k < p.num_boxes; ++k) {
      float const* const box = p.box(b, k);
      if (!ErasedRange(box[1], box[3], p.x.height).contains(y)) continue;
      ErasedRange const columns(box[0], box[2], p.x.width);
      for (int64_t i = columns.begin * step; i < columns.end * step; ++i)
        store<1>(row + i, Lanes<Compute<T>, 1>(p.value(b, c, i)));
    }
  }
}

KV_INSTANTIATE_WITH_BYTES(erase_rectangles, EraseRectangles)

}  // namespace kv::augmentation::KV_ISA
