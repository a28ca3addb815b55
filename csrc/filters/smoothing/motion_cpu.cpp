// The kernels of motion blur on the CPU: kernels [begin, end). Compiled once per instruction set.
#include "core/lanes.h"
#include "motion.h"

namespace kv::filters::KV_ISA {

template <class T>
void motion_kernel(MotionKernel<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const count = p.count();
  for (int64_t b = begin; b < end; ++b) {
    MotionLine const line = motion_line(p, b, [](T x) { return F(load<1>(&x)); });
    double sum = 0;
    for (int64_t i = 0; i < count; ++i) sum += line.weight(i);
    for (int64_t i = 0; i < count; ++i) store<1>(p.kernels + b * count + i, F(line.weight(i) / sum));
  }
}

KV_INSTANTIATE(motion_kernel, MotionKernel)

}  // namespace kv::filters::KV_ISA
