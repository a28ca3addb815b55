// Colour programs on CUDA, for Half.
#include "program.cuh"

namespace kv::cuda {

KV_INSTANTIATE_ONE(program, Program, Half)
KV_INSTANTIATE_ONE(program_backward, ProgramBackward, Half)

}  // namespace kv::cuda
