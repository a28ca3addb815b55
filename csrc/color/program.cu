// Color programs on CUDA, computing in float.
#include "program_forward.cuh"

namespace kv::color::cuda {

KV_INSTANTIATE_ONE(program, Program, float)

}  // namespace kv::color::cuda
