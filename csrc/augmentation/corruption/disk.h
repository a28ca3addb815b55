// Kernels that are disks with blurred edges, as of lenses out of focus. corruption/disk.py of kvision.augmentation
// defines them.
#pragma once

#include "core/isa.h"

namespace kv::augmentation {

// T is float or double.
template <class T>
struct DiskKernels {
  T const* deviations;   // (B,)
  int64_t const* radii;  // (B,)
  T* y;                  // (B, side, side)
  int64_t batch, deviation_stride, radius_stride;
  int reach;  // pixels to each side of the center

  KV_HD int side() const { return 2 * reach + 1; }
};

KV_KERNEL(disk_kernels, DiskKernels)

constexpr int kDiskWindow = 8;  // pixels to each side that the blur sees, at least

#if defined(__CUDACC__)
KV_HD float exponential_of(float x) { return ::expf(x); }
KV_HD double exponential_of(double x) { return ::exp(x); }
#else
KV_HD float exponential_of(float x) { return __builtin_expf(x); }
KV_HD double exponential_of(double x) { return __builtin_exp(x); }
#endif

template <class F>
struct Disk {
  F square, edge, taps[3];  // the weights of the center, and of pixels at 1 and 2 from it
  int most;                 // taps to each side

  KV_HD Disk(F radius, F deviation)
      : square(radius * radius), edge(max(radius, F(kDiskWindow))), most(radius > kDiskWindow ? 2 : 1) {
    F total = 0;
    for (int k = 0; k < 3; ++k) {
      F const at = F(k) / deviation;
      taps[k] = k <= most ? exponential_of(F(-0.5) * (at * at)) : F(0);
      total += k > 0 ? 2 * taps[k] : taps[k];
    }
    for (F& tap : taps) tap /= total;
  }
  KV_HD bool has(F x, F y) const { return y * y + x * x <= square; }
  // A coordinate, which the window reflects.
  KV_HD F reflected(F at) const { return at > edge ? 2 * edge - at : at < -edge ? -2 * edge - at : at; }
  // The disk after the blur, whose pixels are 1, at a pixel from its center.
  KV_HD F at(int x, int y) const {
    if (max(F(x < 0 ? -x : x), F(y < 0 ? -y : y)) > edge) return 0;
    F sum = 0;
    for (int i = -most; i <= most; ++i) {
      F row = 0;
      for (int j = -most; j <= most; ++j)
        if (has(reflected(F(x + j)), reflected(F(y + i)))) row += taps[j < 0 ? -j : j];
      sum += taps[i < 0 ? -i : i] * row;
    }
    return sum;
  }
};

}  // namespace kv::augmentation
