// Matrices of warps: formulas on CUDA.
#include "formula.cuh"

namespace kv::geometry::cuda {

KV_PLANE_FORMULAS(KV_INSTANTIATE_FORMULA)
KV_SPACE_FORMULAS(KV_INSTANTIATE_FORMULA)

}  // namespace kv::geometry::cuda
