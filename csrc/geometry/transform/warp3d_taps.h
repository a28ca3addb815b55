// The taps of a place in a volume. Included by warp3d_cpu.cpp, inside of no namespace, and by warp3d.cu.
#pragma once

#include "geometry/transform/taps.h"
#include "geometry/transform/warp3d.h"

#if defined(__CUDACC__)
#define KV_TAPS3 __device__ __forceinline__
#else
#define KV_TAPS3 KV_HD
#endif

namespace kv {

template <int K, class F>
struct Taps3 {
  int64_t at[3][K];  // offset of the voxel, or -1 where there is none
  F weight[3][K], slope[3][K];

  template <class T>
  KV_TAPS3 Taps3(Warp3d<T> const& p, F const (&place)[3]) {
    int64_t stride = 1;
    for (int i = 0; i < 3; ++i) {
      Axis<F> const axis = p.axis(i);
      F t;
      int const first = first_tap<K, F>(near_image(axis, place[i]), t);
      tap_weights(t, weight[i]);
      tap_slopes(t, slope[i]);
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
  // A tap of weight 0 is no part of the value, whatever it holds.
  template <class T, class Read>
  KV_TAPS3 F value(T const* x, Read read) const {
    F sum = 0;
    for_each([&](int64_t at, int i, int j, int k) {
      F const w = weight[0][i] * weight[1][j] * weight[2][k];
      if (w != 0) sum += w * read(x[at]);
    });
    return sum;
  }
  KV_TAPS3 void add_slopes(F const* x, F g, F (&to_place)[3]) const {
    for_each([&](int64_t at, int i, int j, int k) {
      F const value = g * x[at];
      to_place[0] += value * slope[0][i] * weight[1][j] * weight[2][k];
      to_place[1] += value * weight[0][i] * slope[1][j] * weight[2][k];
      to_place[2] += value * weight[0][i] * weight[1][j] * slope[2][k];
    });
  }
};

}  // namespace kv

#undef KV_TAPS3
