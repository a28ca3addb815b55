// Erased parts on the CPU: rows [begin, end) of all planes. Compiled once per instruction set.
#include <cstddef>

#include "augmentation/erase.h"
#include "core/lanes.h"
#include "core/scratch.h"

namespace kv::augmentation::KV_ISA {

namespace {

// Copies rows and calls erase_row(sample, row, erase), which calls erase(first pixel, end). What stays of a row is
// copied back from where it was saved.
template <class Params, class EraseRow>
KV_HD void erase_rows(Params const& p, int64_t begin, int64_t end, EraseRow erase_row) {
  using T = typename Params::Stored;
  size_t const bytes = size_t(p.x.row_size()) * sizeof(T);
  Scratch<T> const saved(p.keeps_erased() ? p.x.row_size() : 0);
  for (int64_t r = begin; r < end; ++r) {
    int64_t const plane = r / p.x.height, y = r % p.x.height, step = p.x.step;
    int64_t const b = plane / p.planes_per_sample, c = plane % p.planes_per_sample;
    T* const row = p.y.row(plane, y);
    if (p.keeps_erased()) __builtin_memcpy(saved.data, row, bytes);
    __builtin_memcpy(row, p.x.row(plane, y), bytes);
    erase_row(b, y, [&](int64_t first, int64_t last) {
      if (p.keeps_erased()) {
        if (first < last)
          __builtin_memcpy(row + first * step, saved.data + first * step, size_t((last - first) * step) * sizeof(T));
        return;
      }
      for (int64_t i = first * step; i < last * step; ++i) store<1>(row + i, Lanes<Compute<T>, 1>(p.value(b, c, i)));
    });
  }
}

// Calls erase(image, first row, end) for the items of a list.
template <class All, class EraseRows>
KV_HD void for_each_image(EraseList<All> const& p, int64_t begin, int64_t end, EraseRows erase) {
  for_each_sample(p.list, begin, end, [&](int b, int64_t first, int64_t last) {
    All const one = p.sample(b);
    erase(one, kEraseRows * first, min(kEraseRows * last, one.x.rows()));
  });
}

}  // namespace

template <class T>
void erase_rectangles(EraseRectangles<T> const& p, int64_t begin, int64_t end) {
  erase_rows(p, begin, end, [&](int64_t b, int64_t y, auto erase) {
    for (int64_t k = 0; k < p.num_boxes; ++k) {
      float const* const box = p.box(b, k);
      if (!ErasedRange(box[1], box[3], p.x.height).contains(y)) continue;
      ErasedRange const columns(box[0], box[2], p.x.width);
      erase(columns.begin, columns.end);
    }
  });
}

template <class T>
void erase_grid(EraseGrid<T> const& p, int64_t begin, int64_t end) {
  int64_t sample = -1;
  GridLines lines;
  erase_rows(p, begin, end, [&](int64_t b, int64_t y, auto erase) {
    if (b != sample) lines = GridLines(p.grids + b * p.grid_stride, p.x.height, p.x.width);
    sample = b;
    for (int64_t x = 0; x < p.x.width; ++x)
      if (lines.contains(x, y)) erase(x, x + 1);
  });
}

template <class T>
void erase_rectangles_list(EraseRectanglesList<T> const& p, int64_t begin, int64_t end) {
  for_each_image(p, begin, end, [](auto const&... rows) { KV_ISA::erase_rectangles(rows...); });
}
template <class T>
void erase_grid_list(EraseGridList<T> const& p, int64_t begin, int64_t end) {
  for_each_image(p, begin, end, [](auto const&... rows) { KV_ISA::erase_grid(rows...); });
}
template <class T>
void erase_marked_list(EraseMarkedList<T> const& p, int64_t begin, int64_t end) {
  for_each_image(p, begin, end, [](auto const& one, int64_t first, int64_t last) {
    erase_rows(one, first, last, [&](int64_t b, int64_t y, auto erase) {
      for (int64_t x = 0; x < one.x.width; ++x)
        if (one.contains(b, x, y)) erase(x, x + 1);
    });
  });
}

KV_INSTANTIATE_WITH_BYTES(erase_rectangles, EraseRectangles)
KV_INSTANTIATE_WITH_BYTES(erase_grid, EraseGrid)
KV_INSTANTIATE_WITH_BYTES(erase_rectangles_list, EraseRectanglesList)
KV_INSTANTIATE_WITH_BYTES(erase_grid_list, EraseGridList)
KV_INSTANTIATE_WITH_BYTES(erase_marked_list, EraseMarkedList)

}  // namespace kv::augmentation::KV_ISA
