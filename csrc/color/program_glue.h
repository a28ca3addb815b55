// The sum of parameter gradients, for the entries of color programs and of sharpness. Included by program_op.cpp and
// enhance/sharpness_op.cpp.
#pragma once

#include "glue/glue.h"
#include "program.h"

namespace kv::color {

// Sums `p.partial` to `p.sums` on the device of x.
template <class F>
void reduce_gradients(Tensor const& x, ProgramReduce<F> const& p) {
  KV_RUN(program_reduce, x, p, p.count, p.summands);
}

}  // namespace kv::color
