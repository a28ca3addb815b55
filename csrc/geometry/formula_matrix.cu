// Poses, transforms and two views: formulas on CUDA.
#include "formula.cuh"

namespace kv::geometry::cuda {

KV_MATRIX_FORMULAS(KV_INSTANTIATE_FORMULA)

}  // namespace kv::geometry::cuda
