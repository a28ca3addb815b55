// Resizing of lists on the CPU, by the kernel of batches: items [begin, end) of all results. Compiled once per
// instruction set.
#include "geometry/transform/lists/resize_list.h"

namespace kv::geometry::KV_ISA {

template <class T>
void resize_list(ResizeList<T> const& p, int64_t begin, int64_t end) {
  for_each_sample(p.list, begin, end, [&](int b, int64_t first, int64_t last) {
    ListedImage const& from = p.list.images[b];
    ListedResult const& to = p.list.results[b];
    Resize<T> const one{planes_of(images_of<T>(from, p.channels), p.list.interleaved),
                        planes_of(images_of<T>(to, p.channels, p.list.interleaved), p.list.interleaved),
                        resize_axis_at(p, from.height, to.height), resize_axis_at(p, from.width, to.width)};
    int64_t const rows = rows_of_resize_item(one.y.row_size());
    KV_ISA::resize(one, first * rows, min(last * rows, one.y.rows()));
  });
}

KV_INSTANTIATE_WITH_BYTES(resize_list, ResizeList)

}  // namespace kv::geometry::KV_ISA
