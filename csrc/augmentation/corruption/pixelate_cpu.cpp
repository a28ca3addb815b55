// Images of blocks on the CPU: rows [begin, end) of all planes. Compiled once per instruction set.
#include <cstddef>

#include "augmentation/corruption/pixelate.h"
#include "core/lanes.h"
#include "core/scratch.h"

namespace kv::augmentation::KV_ISA {

template <class T>
void pixelate(Pixelate<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const step = p.x.step, size = p.x.row_size();
  Scratch<F> sums(size);
  int64_t shown_plane = -1;
  unsigned shown = 0;
  for (int64_t r = begin; r < end; ++r) {
    int64_t const plane = r / p.y.height, y = r % p.y.height, b = plane / p.planes_per_sample;
    BlockAxis const down = p.down(b), across = p.across(b);
    unsigned const block = down.block(unsigned(y));
    T* const to = p.y.row(plane, y);
    if (plane == shown_plane && block == shown) {
      __builtin_memcpy(to, p.y.row(plane, y - 1), size_t(size) * sizeof(T));
      continue;
    }
    shown_plane = plane, shown = block;
    BlockPixels const rows(down, block);
    for (int64_t i = 0; i < size; ++i) sums.data[i] = 0;
    for (unsigned row = rows.begin; row < rows.end; ++row) {
      F const weight = rows.weight(row);
      T const* const from = p.x.row(plane, row);
      for (int64_t i = 0; i < size; ++i) sums.data[i] += weight * F(load<1>(from + i));
    }
    for (int64_t i = 0; i < size; ++i) sums.data[i] /= F(rows.total);
    for (int64_t x = 0, next; x < p.y.width; x = next) {
      unsigned const own = across.block(unsigned(x));
      for (next = x + 1; next < p.y.width && across.block(unsigned(next)) == own;) ++next;
      BlockPixels const columns(across, own);
      for (int64_t c = 0; c < step; ++c) {
        F sum = 0, all = 0;
        for (unsigned column = columns.begin; column < columns.end; ++column) {
          F const weight = columns.weight(column);
          all += weight;
          if (weight != 0) sum += weight * sums.data[column * step + c];
        }
        for (int64_t i = x; i < next; ++i) store<1>(to + i * step + c, Lanes<F, 1>(sum / all));
      }
    }
  }
}

template <class T>
void pixelate_list(PixelateList<T> const& p, int64_t begin, int64_t end) {
  filter_items(p, begin, end,
               [](Pixelate<T> const& one, int64_t first, int64_t last) { KV_ISA::pixelate(one, first, last); });
}

KV_INSTANTIATE_WITH_BYTES(pixelate, Pixelate)
KV_INSTANTIATE_WITH_BYTES(pixelate_list, PixelateList)

}  // namespace kv::augmentation::KV_ISA
