// Antialiased resizing of windows of a list on the CPU, by the kernel of batches: items [begin, end) of all samples.
// Compiled once per instruction set.
#include "geometry/transform/lists/resize_windows_list.h"

namespace kv::geometry::KV_ISA {

template <class T>
void resize_windows_list(ResizeWindowsList<T> const& p, int64_t begin, int64_t end) {
  for_each_sample(p.list, begin, end, [&](int b, int64_t first, int64_t last) {
    ResizeWindows<T> const one = sample_at(p, b);
    int64_t const rows = one.backward ? 1 : rows_of_resize_item(one.y.row_size());
    KV_ISA::resize_windows(one, first * rows, one.backward ? last : min(last * rows, one.y.rows()));
  });
}

KV_INSTANTIATE_WITH_BYTES(resize_windows_list, ResizeWindowsList)

}  // namespace kv::geometry::KV_ISA
