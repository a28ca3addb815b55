// Color programs and their gradients on CUDA, computing in double.
#include "program_backward.cuh"
#include "program_forward.cuh"

namespace kv::color::cuda {

KV_INSTANTIATE_ONE(program, Program, double)
KV_INSTANTIATE_ONE(program_backward, ProgramBackward, double)
KV_INSTANTIATE_ONE(program_reduce, ProgramReduce, double)

}  // namespace kv::color::cuda
