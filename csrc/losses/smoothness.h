// How rough an inverse depth map d (B, 1, H, W) is where its image I (B, C, H, W) has no edges. For every sample it is
// the sum over all neighbors p, q of
//
//   rough(p, q) = weight * abs(d(q) - d(p)) * exp(-mean over c of abs(I_c(q) - I_c(p)))
//
// with one weight along y and one along x. A pixel's gradient is a sum over its neighbors, too: that to d(q) of the
// sign of d(q) - d(p) where rough has its size, that to I_c(q) of -rough / C times the sign of I_c(q) - I_c(p); those
// to p have the other sign. Included by smoothness_cpu.cpp, smoothness.cu and smoothness_op.cpp.
#pragma once

#include "core/isa.h"
#include "core/view.h"
#include "sign.h"

namespace kv {

template <class T>
struct DepthAndImage {
  Planes<T const> depth, image;
  int64_t channels;
  Compute<T> along_y, along_x;  // weights

  KV_HD int64_t channel_stride() const { return image.inner == 1 ? image.outer_stride : image.inner_stride; }
  // Times a sum of absolute differences it is the exponent to base 2.
  KV_HD Compute<T> exponent() const { return Compute<T>(-1.4426950408889634) / Compute<T>(channels); }
};

template <class T>
struct Smoothness {
  DepthAndImage<T> of;
  int64_t chunks;       // of a sample: its rows on the CPU, blocks on CUDA
  Compute<T>* partial;  // (B, chunks)
  Compute<T>* sums;     // (B), by CUDA's kernel; on the CPU the entry adds up the chunks
};

template <class T>
struct SmoothnessBackward {
  DepthAndImage<T> of;
  Compute<T> const* grad;  // of the sums
  Planes<T> out;           // to the depth, or to the image
  bool of_image;
};

// CUDA: what a block takes.
constexpr int kSmoothRows = 16, kSmoothColumns = 256;

KV_KERNEL(smoothness, Smoothness)
KV_KERNEL(smoothness_backward, SmoothnessBackward)

// What an edge brings to the gradient of a pixel of the image. Edges beyond the image are 0, whatever is read there.
template <class V>
KV_HD V part_of(V rough, V difference) {
  return rough == 0 ? V{} : V(rough * sign_of(difference));
}

}  // namespace kv
