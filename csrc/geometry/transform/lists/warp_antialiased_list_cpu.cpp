// Antialiased warps of lists of images on the CPU, by the kernels of batches: items [begin, end) of all samples.
// Compiled once per instruction set.
#include "geometry/transform/antialiased/warp_antialiased.h"
#include "geometry/transform/lists/sample_list.h"

namespace kv::geometry::KV_ISA {
template <class T>
void sample_antialiased_list(SampleList<T> const& p, int64_t begin, int64_t end) {
  for_each_sample(p.list, begin, end, [&](int b, int64_t first, int64_t last) {
    Sample<T> const one = sample_at(p, b);
    int64_t const rows = rows_of_item(one.y.width);
    KV_ISA::sample_antialiased(one, first * rows, min(last * rows, one.y.height));
  });
}

template <class T>
void sample_antialiased_list_backward(SampleListBackward<T> const& p, int64_t begin, int64_t end) {
  for_each_sample(p.list, begin, end, [&](int b, int64_t first, int64_t last) {
    KV_ISA::sample_antialiased_image_backward(sample_at(p, b), first, last);
  });
}

KV_INSTANTIATE_WITH_BYTES(sample_antialiased_list, SampleList)
KV_INSTANTIATE_COMPUTED(sample_antialiased_list_backward, SampleListBackward)

}  // namespace kv::geometry::KV_ISA
