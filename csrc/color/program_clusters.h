// Color programs around a mean in one launch instead of two runs, on GPUs with clusters.
#pragma once

#include "program.h"

namespace kv::color::cuda {

// Whether one launch serves a program around a mean, or the gradient of its image without those of parameters. It
// serves frequent steps, if a sample fits the shared memory of a cluster; of gradients, planes of floats.
bool takes_clusters(Program<float> const& p);
bool takes_clusters(ProgramBackward<float> const& p);

// The result and the means.
int program_by_clusters(Program<float> const& p, CUstream_st* stream);
// The gradient of the image.
int program_backward_by_clusters(ProgramBackward<float> const& p, CUstream_st* stream);

}  // namespace kv::color::cuda
