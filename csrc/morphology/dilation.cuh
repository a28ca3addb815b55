// Shared by the CUDA files of dilation: dilation_3x3.cu and dilation_groups.cu have windows of 3 x 3 pixels,
// dilation_backward_strips.cu the gradient of flat windows of 7 x 7 and 15 x 15, dilation_backward.cu that of other
// windows that fit into shared memory, and dilation.cu everything else. Whether a window is flat is known on the device
// only, so each block finds out.
#pragma once

#include "core/launch.cuh"
#include "core/nan_min_max.cuh"
#include "dilation.h"

namespace kv::morphology::cuda {
namespace {

template <class F>
__device__ __forceinline__ F minus_infinity() {
  return -F(__int_as_float(0x7f800000));
}

__device__ __forceinline__ float combine(float a, float b) { return nan_max(a, b); }
__device__ __forceinline__ double combine(double a, double b) { return maximum(a, b); }
template <class F>
__device__ __forceinline__ Ties<F> combine(Ties<F> const& a, Ties<F> const& b) {
  F const most = combine(a.value, b.value), count = a.value == most ? a.count : F(0);
  return {most, b.value == most ? count + b.count : count};
}

__device__ __forceinline__ float tie_gradient(float g, float count) { return __fdividef(g, fmaxf(count, 1.f)); }
__device__ __forceinline__ double tie_gradient(double g, double count) { return g / fmax(count, 1.); }

}  // namespace

// Windows for which is_3x3 holds, over planar images.
template <class T>
int dilation_3x3(Dilation<T> const& p, CUstream_st* stream);
// The same of bytes and half types; false where the images are narrower than a group of columns, or channels last.
template <class T>
bool dilation_by_groups(Dilation<T> const& p, CUstream_st* stream);
template <class T>
int dilation_3x3_backward(DilationBackward<T> const& p, CUstream_st* stream);
// Windows for which needs_no_workspace holds, over planar images; without the flat ones if `flat_left_out`.
template <class T>
int dilation_backward_tiles(DilationBackward<T> const& p, bool flat_left_out, CUstream_st* stream);
// Flat windows of 7 x 7 and 15 x 15 pixels over planar images whose planes have at most INT32_MAX elements. Windows
// that are not flat are left out.
template <class T>
int dilation_backward_strips(DilationBackward<T> const& p, CUstream_st* stream);

}  // namespace kv::morphology::cuda
