// Colour programs on CUDA, for float.
#include "program.cuh"

namespace kv::cuda {

KV_INSTANTIATE_ONE(program, Program, float)
KV_INSTANTIATE_ONE(program_backward, ProgramBackward, float)

}  // namespace kv::cuda
