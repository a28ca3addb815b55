// The gradients of the matrices of lists on the CPU, by the kernels of batches: items [begin, end) of all samples.
// Compiled once per instruction set.
#include "geometry/transform/lists/sample_list.h"

namespace kv::geometry::KV_ISA {
template <class T>
void sample_list_matrix_backward(SampleListMatrixBackward<T> const& p, int64_t begin, int64_t end) {
  for_each_sample(p.list, begin, end, [&](int b, int64_t first, int64_t last) {
    KV_ISA::sample_coords_backward(sample_at(p, b), first, last);
  });
}

template <class T>
void sample_antialiased_list_matrix_backward(AntialiasedListMatrixBackward<T> const& p, int64_t begin, int64_t end) {
  for_each_sample(p.list, begin, end, [&](int b, int64_t first, int64_t last) {
    KV_ISA::sample_antialiased_coords_backward(sample_at(p, b), first, last);
  });
}

template <class T>
void warp_matrix_list_backward(WarpMatrixListBackward<T> const& p, int64_t begin, int64_t end) {
  for (int64_t b = begin; b < end; ++b) KV_ISA::warp_matrix_backward(sample_at(p, int(b)), 0, 1);
}

KV_INSTANTIATE(sample_list_matrix_backward, SampleListMatrixBackward)
KV_INSTANTIATE(sample_antialiased_list_matrix_backward, AntialiasedListMatrixBackward)
KV_INSTANTIATE_COMPUTED(warp_matrix_list_backward, WarpMatrixListBackward)

}  // namespace kv::geometry::KV_ISA
