// Programs from planes of bytes to planes of bytes, or of float32 that are vectors. On CUDA they have a kernel of their
// own, program_bytes.cu.
#pragma once

#include "program.h"

struct CUstream_st;

namespace kv::color::cuda {

bool takes_bytes(Program<float> const& p);
int program_of_bytes(Program<float> const& p, CUstream_st* stream);

}  // namespace kv::color::cuda
