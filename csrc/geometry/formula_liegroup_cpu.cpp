// Exponential maps of rigid motions: formulas on the CPU.
#include "formula_cpu.h"

#if !defined(__AVX512F__)
namespace kv::geometry::KV_ISA {

KV_LIE_GROUP_FORMULAS(KV_INSTANTIATE_FORMULA)

}  // namespace kv::geometry::KV_ISA
#endif
