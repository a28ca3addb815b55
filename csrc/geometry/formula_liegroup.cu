// Exponential maps of rigid motions: formulas on CUDA.
#include "formula.cuh"

namespace kv::geometry::cuda {

KV_LIE_GROUP_FORMULAS(KV_INSTANTIATE_FORMULA)

}  // namespace kv::geometry::cuda
