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

namespace {

// The sums of the gradients that a row of blocks shows, over what the blocks read in all.
template <class T>
KV_HD void sum_shown(Pixelate<T> const& p, int64_t plane, BlockAxis const& down, BlockAxis const& across,
                     unsigned block, Compute<T>* rows, Compute<T>* sums) {
  using F = Compute<T>;
  int64_t const step = p.x.step, size = p.x.row_size();
  for (int64_t i = 0; i < size; ++i) rows[i] = 0;
  for (unsigned row = down.first_shown(block); row < down.first_shown(block + 1); ++row) {
    T const* const from = p.x.row(plane, row);
    for (int64_t i = 0; i < size; ++i) rows[i] += F(load<1>(from + i));
  }
  F const total = F(BlockPixels(down, block).total);
  for (unsigned own = 0; own < across.count; ++own) {
    unsigned const begin = across.first_shown(own), end = across.first_shown(own + 1);
    F const all = total * F(BlockPixels(across, own).total);
    for (int64_t c = 0; c < step; ++c) {
      F sum = 0;
      for (unsigned x = begin; x < end; ++x) sum += rows[x * step + c];
      sums[own * step + c] = sum / all;
    }
  }
}

}  // namespace

template <class T>
void pixelate_backward(Pixelate<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const step = p.x.step, size = p.x.row_size();
  Scratch<F> memory(3 * size);
  F *const rows = memory.data, *const sums[] = {rows + size, rows + 2 * size};
  int64_t known_plane = -1, known[2];  // the rows of blocks whose sums are there, each at its number modulo 2
  for (int64_t r = begin; r < end; ++r) {
    int64_t const plane = r / p.y.height, y = r % p.y.height, b = plane / p.planes_per_sample;
    BlockAxis const down = p.down(b), across = p.across(b);
    if (plane != known_plane) known[0] = known[1] = -1;
    known_plane = plane;
    unsigned const reader = down.first_reader(unsigned(y));
    ReaderWeights const own(down, unsigned(y), reader);
    T* const to = p.y.row(plane, y);
    for (unsigned k = 0; k < 2; ++k) {
      if (own.v[k] == 0) continue;
      unsigned const block = reader + k;
      if (known[block % 2] != block) sum_shown(p, plane, down, across, block, rows, sums[block % 2]);
      known[block % 2] = block;
    }
    for (unsigned x = 0; x < across.size; ++x) {
      unsigned const column = across.first_reader(x);
      ReaderWeights const weights(across, x, column);
      for (int64_t c = 0; c < step; ++c) {
        F sum = 0;
        for (unsigned k = 0; k < 2; ++k)
          for (unsigned j = 0; j < 2; ++j)
            if (own.v[k] * weights.v[j] != 0)
              sum += F(own.v[k]) * F(weights.v[j]) * sums[(reader + k) % 2][(column + j) * step + c];
        store<1>(to + x * step + c, Lanes<F, 1>(sum));
      }
    }
  }
}

template <class T>
void pixelate_list(PixelateList<T> const& p, int64_t begin, int64_t end) {
  filter_items(p, begin, end,
               [](Pixelate<T> const& one, int64_t first, int64_t last) { KV_ISA::pixelate(one, first, last); });
}

template <class T>
void pixelate_backward_list(PixelateList<T> const& p, int64_t begin, int64_t end) {
  filter_items(p, begin, end, [](Pixelate<T> const& one, int64_t first, int64_t last) {
    KV_ISA::pixelate_backward(one, first, last);
  });
}

KV_INSTANTIATE_WITH_BYTES(pixelate, Pixelate)
KV_INSTANTIATE_WITH_BYTES(pixelate_list, PixelateList)
KV_INSTANTIATE(pixelate_backward, Pixelate)
KV_INSTANTIATE(pixelate_backward_list, PixelateList)

}  // namespace kv::augmentation::KV_ISA
