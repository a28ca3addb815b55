// Essential matrices on the CPU: problems [begin, end). In double: the AVX-512 build uses the AVX2 code.
#include "geometry/epipolar/essential.h"

#if !defined(__AVX512F__)
namespace kv::geometry::KV_ISA {

template <class T>
void essential(Essential<T> const& p, int64_t begin, int64_t end) {
  for (int64_t b = begin; b < end; ++b) decompose_essential(p, b);
}

template <class T>
void essential_backward(Essential<T> const& p, int64_t begin, int64_t end) {
  for (int64_t b = begin; b < end; ++b) essential_vjp(p, b);
}

template <class T>
void motion_choice(MotionChoice<T> const& p, int64_t begin, int64_t end) {
  for (int64_t b = begin; b < end; ++b) choose_motion(p, b, SingleThread{});
}

KV_INSTANTIATE_ONE(essential, Essential, double)
KV_INSTANTIATE_ONE(essential_backward, Essential, double)
KV_INSTANTIATE_ONE(motion_choice, MotionChoice, double)

}  // namespace kv::geometry::KV_ISA
#endif
