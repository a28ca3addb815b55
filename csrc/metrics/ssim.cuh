// Strided planes for the files of structural similarity on CUDA: ssim.cu has small windows over planar images,
// ssim_tiles.cu images with other windows and several scales, ssim_volumes.cu volumes, and ssim_any.cu the remaining
// cases. Included by these *.cu files.
#pragma once

#include "core/dtype.cuh"
#include "core/row_sums.cuh"
#include "ssim.h"

namespace kv::metrics::cuda {

// Planes with strides in bytes.
using StoredPlanes = Planes<uint8_t>;
template <class T>
StoredPlanes stored_planes(Planes<T> const& p) {
  constexpr int64_t size = sizeof(T);
  return {reinterpret_cast<uint8_t*>(const_cast<std::remove_const_t<T>*>(p.data)),
          p.outer,
          p.inner,
          p.outer_stride * size,
          p.inner_stride * size,
          p.row_stride * size,
          p.height,
          p.width,
          p.step};
}

template <class T>
int ssim_in_tiles(Ssim<T> const& p, CUstream_st* stream);
template <class T>
int ssim_in_tiles_backward(SsimBackward<T> const& p, CUstream_st* stream);
template <class T>
int ssim_of_volumes(Ssim<T> const& p, CUstream_st* stream);
template <class T>
int ssim_of_volumes_backward(SsimBackward<T> const& p, CUstream_st* stream);
template <class T>
int ssim_any(Ssim<T> const& p, CUstream_st* stream);
template <class T>
int ssim_any_backward(SsimBackward<T> const& p, CUstream_st* stream);

}  // namespace kv::metrics::cuda
