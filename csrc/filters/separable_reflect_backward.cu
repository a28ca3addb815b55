// Transposes of a reflected border by the strip kernel of separable_strip.cuh, for the types that have gradients.
#include "separable_strip.cuh"

namespace kv::filters::cuda {

template <class T>
int separable_reflect_backward_strips(Separable<T> const& p, float divisor, CUstream_st* stream) {
  return launch_strip_of_size<T, true>(p, divisor, stream);
}

template <class T>
int separable_reflect_backward_strips(SeparableList<T> const& p, float divisor, CUstream_st* stream) {
  return launch_strip_of_size<T, true>(p, divisor, stream);
}

template int separable_reflect_backward_strips(Separable<float> const&, float, CUstream_st*);
template int separable_reflect_backward_strips(Separable<Half> const&, float, CUstream_st*);
template int separable_reflect_backward_strips(Separable<BFloat16> const&, float, CUstream_st*);
template int separable_reflect_backward_strips(SeparableList<float> const&, float, CUstream_st*);
template int separable_reflect_backward_strips(SeparableList<Half> const&, float, CUstream_st*);
template int separable_reflect_backward_strips(SeparableList<BFloat16> const&, float, CUstream_st*);

}  // namespace kv::filters::cuda
