// The taps of sampling coordinates in a volume. Included by warp3d_cpu.cpp, outside of namespaces, and by warp3d.cu.
#pragma once

#include "geometry/transform/taps.h"
#include "geometry/transform/warp3d.h"

#if defined(__CUDACC__)
#define KV_TAPS3 __device__ __forceinline__
#else
#define KV_TAPS3 KV_HD
#endif

namespace kv::geometry {

template <int K, class F>
struct TapWindow3 {
  int64_t at[3][K];  // offset of the voxel, or -1 out of bounds
  F weight[3][K], derivative[3][K];

  template <class T>
  KV_TAPS3 TapWindow3(Warp3d<T> const& p, F const (&coords)[3]) {
    int64_t stride = 1;
    for (int i = 0; i < 3; ++i) {
      Axis<F> const axis = p.axis(i);
      F t;
      int const first = first_tap<K, F>(near_image(axis, coords[i]), t);
      tap_weights(t, weight[i]);
      tap_derivatives(t, derivative[i]);
      for (int k = 0; k < K; ++k) {
        int const voxel = pixel_at(axis, first + k);
        at[i][k] = unsigned(voxel) < unsigned(axis.size) ? voxel * stride : -1;
      }
      stride *= axis.size;
    }
  }
  // Calls tap(offset, i, j, k) for the taps that are voxels.
  template <class Tap>
  KV_TAPS3 void for_each(Tap tap) const {
    for (int k = 0; k < K; ++k)
      for (int j = 0; j < K; ++j)
        for (int i = 0; i < K; ++i)
          if (at[0][i] >= 0 && at[1][j] >= 0 && at[2][k] >= 0) tap(at[0][i] + at[1][j] + at[2][k], i, j, k);
  }
  // A tap of weight 0 contributes nothing, even if it is inf or NaN.
  template <class T, class Read>
  KV_TAPS3 F value(T const* x, Read read) const {
    F sum = 0;
    for_each([&](int64_t at, int i, int j, int k) {
      F const w = weight[0][i] * weight[1][j] * weight[2][k];
      if (w != 0) sum += w * read(x[at]);
    });
    return sum;
  }
  KV_TAPS3 void accumulate_coord_grads(F const* x, F g, F (&grad_coords)[3]) const {
    for_each([&](int64_t at, int i, int j, int k) {
      F const value = g * x[at];
      grad_coords[0] += value * derivative[0][i] * weight[1][j] * weight[2][k];
      grad_coords[1] += value * weight[0][i] * derivative[1][j] * weight[2][k];
      grad_coords[2] += value * weight[0][i] * weight[1][j] * derivative[2][k];
    });
  }
};

}  // namespace kv::geometry

#undef KV_TAPS3
