// Gradients of color programs on CUDA, computing in float.
#include "program_backward.cuh"

namespace kv::color::cuda {

KV_INSTANTIATE_ONE(program_backward, ProgramBackward, float)
KV_INSTANTIATE_ONE(program_reduce, ProgramReduce, float)

}  // namespace kv::color::cuda
