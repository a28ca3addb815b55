// Programs of one frequent step whose parameters are numbers, on planes. On CUDA they have a kernel of their own,
// program_step.cu.
#pragma once

#include "program.h"

struct CUstream_st;

namespace kv::color::cuda {

bool takes_step(Program<float> const& p);
int program_of_step(Program<float> const& p, CUstream_st* stream);

}  // namespace kv::color::cuda
