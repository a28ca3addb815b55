// Colour programs on CUDA, for BFloat16.
#include "program.cuh"

namespace kv::cuda {

KV_INSTANTIATE_ONE(program, Program, BFloat16)
KV_INSTANTIATE_ONE(program_backward, ProgramBackward, BFloat16)

}  // namespace kv::cuda
