// Programs that have kernels of their own on CUDA.
#pragma once

#include "program.h"

struct CUstream_st;

namespace kv::color::cuda {

// Of one frequent step whose parameters are numbers, on planes: program_step.cu.
bool takes_step(Program<float> const& p);
int program_of_step(Program<float> const& p, CUstream_st* stream);

// From planes of bytes to planes of bytes, or of float32 that are vectors: program_bytes.cu.
bool takes_bytes(Program<float> const& p);
int program_of_bytes(Program<float> const& p, CUstream_st* stream);

}  // namespace kv::color::cuda
