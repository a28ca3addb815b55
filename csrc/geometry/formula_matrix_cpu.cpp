// Poses, transforms and two views: formulas on the CPU.
#include "formula_cpu.h"

#if !defined(__AVX512F__)
namespace kv::geometry::KV_ISA {

KV_MATRIX_FORMULAS(KV_INSTANTIATE_FORMULA)

}  // namespace kv::geometry::KV_ISA
#endif
