// Rotations and quaternions: formulas on CUDA.
#include "formula.cuh"

namespace kv::geometry::cuda {

KV_ROTATION_FORMULAS(KV_INSTANTIATE_FORMULA)

}  // namespace kv::geometry::cuda
