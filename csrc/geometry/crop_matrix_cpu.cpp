// Matrices of crops on the CPU.
#include "crop_matrix.h"

namespace kv::KV_ISA {

template <class F>
void crop_matrix(CropMatrix<F> const& p, int64_t begin, int64_t end) {
  for (int64_t b = begin; b < end; ++b) write_crop_matrix(p, b);
}

KV_INSTANTIATE_COMPUTED(crop_matrix, CropMatrix)

}  // namespace kv::KV_ISA
