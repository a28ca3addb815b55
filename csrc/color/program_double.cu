// Colour programs on CUDA, for double.
#include "program.cuh"

namespace kv::cuda {

KV_INSTANTIATE_ONE(program, Program, double)
KV_INSTANTIATE_ONE(program_backward, ProgramBackward, double)

}  // namespace kv::cuda
