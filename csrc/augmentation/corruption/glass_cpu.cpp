// Pixels that read neighbors on the CPU: rows [begin, end) of all samples. Compiled once per instruction set.
#include "core/lanes.h"
// Included after core/lanes.h, whose vectors it uses.
#include "augmentation/corruption/glass.h"

namespace kv::augmentation::KV_ISA {
namespace {

// Calls use(pixel, the one that it reads) for a row of a sample.
template <class T, class Use>
KV_HD void move_row(ReadNeighbors<T> const& p, int64_t b, int64_t row, Use use) {
  DrawSource const source = p.noise.source(b);
  for (int64_t column = 0; column < p.width; ++column) {
    typename ReadNeighbors<T>::Pixel const own{int(row), int(column)};
    typename ReadNeighbors<T>::Pixel at = own;
    for (int step = 0; step < p.steps; ++step) at = p.step_from(b, source, step, at);
    use(own, at);
  }
}

}  // namespace

template <class T>
void read_neighbors(ReadNeighbors<T> const& p, int64_t begin, int64_t end) {
  for (int64_t r = begin; r < end; ++r) {
    int64_t const b = r / p.height, row = r % p.height;
    T const* const x = p.x + b * p.x_strides[0];
    T* const y = p.y + b * p.y_strides[0] + row * p.y_strides[2];
    move_row(p, b, row, [&](auto own, auto at) KV_INLINE {
      for (int64_t c = 0; c < p.channels; ++c)
        y[c * p.y_strides[1] + own.column * p.y_strides[3]] =
            x[c * p.x_strides[1] + at.row * p.x_strides[2] + at.column * p.x_strides[3]];
    });
  }
}

template <class T>
void read_neighbors_list(ReadNeighborsList<T> const& p, int64_t begin, int64_t end) {
  for_each_sample(p.list, begin, end, [&](int b, int64_t first, int64_t last) {
    ReadNeighbors<T> const one = p.sample(b);
    int64_t const rows = rows_of_item(one.width);
    read_neighbors(one, first * rows, min(last * rows, one.height));
  });
}

template <class T>
void read_neighbors_list_backward(ReadNeighborsBackwardList<T> const& p, int64_t begin, int64_t end) {
  for (int64_t item = begin; item < end; ++item) {
    ReadNeighbors<T> const one = p.sample(int(item));
    Compute<T>* const sums = p.sums(int(item));
    for (int64_t i = 0; i < one.channels * one.height * one.width; ++i) sums[i] = 0;
    for (int64_t row = 0; row < one.height; ++row)
      move_row(one, 0, row, [&](auto own, auto at) KV_INLINE {
        for (int64_t c = 0; c < one.channels; ++c)
          sums[c * one.y_strides[1] + at.row * one.y_strides[2] + at.column * one.y_strides[3]] +=
              load<1>(one.x + c * one.x_strides[1] + own.row * one.x_strides[2] + own.column * one.x_strides[3]);
      });
  }
}

KV_INSTANTIATE_WITH_BYTES(read_neighbors, ReadNeighbors)
KV_INSTANTIATE_WITH_BYTES(read_neighbors_list, ReadNeighborsList)
KV_INSTANTIATE(read_neighbors_list_backward, ReadNeighborsBackwardList)

}  // namespace kv::augmentation::KV_ISA
