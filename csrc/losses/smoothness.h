// Edge-aware smoothness of an inverse depth map d (B, 1, H, W) with its image I (B, C, H, W). For every sample it is
// the sum over all pairs of neighbors p, q of
//
//   edge(p, q) = weight * abs(d(q) - d(p)) * exp(-mean over c of abs(I_c(q) - I_c(p)))
//
// with one weight along y and one along x. The gradient of a pixel is a sum over its neighbors as well. The gradient of
// d(q) is edge(p, q) with sign(d(q) - d(p)) instead of abs(d(q) - d(p)). The gradient of I_c(q) is -edge(p, q) / C *
// sign(I_c(q) - I_c(p)). Those of p have the opposite sign.
#pragma once

#include "core/isa.h"
#include "core/view.h"
#include "sign.h"

namespace kv::losses {

template <class T>
struct DepthAndImage {
  Planes<T const> depth, image;
  int64_t channels;
  Compute<T> along_y, along_x;  // weights

  KV_HD int64_t channel_stride() const { return image.inner == 1 ? image.outer_stride : image.inner_stride; }
  // Times a sum of absolute differences, this is the exponent to base 2.
  KV_HD Compute<T> exponent() const { return Compute<T>(-1.4426950408889634) / Compute<T>(channels); }
};

template <class T>
struct Smoothness {
  DepthAndImage<T> of;
  int64_t chunks;       // of a sample: rows on the CPU, blocks on CUDA, of which vectors of pixels take fewer
  Compute<T>* partial;  // (B, chunks)
  Compute<T>* sums;     // (B), written by the CUDA kernel; on the CPU the operator sums the chunks
};

template <class T>
struct SmoothnessBackward {
  DepthAndImage<T> of;
  Compute<T> const* grad;  // of the sums
  Planes<T> out;           // the gradient of the depth or of the image
  bool of_image;
};

// CUDA: rows of a thread, and threads of a block.
constexpr int kSmoothRows = 8, kSmoothThreads = 256;

KV_KERNEL(smoothness, Smoothness)
KV_KERNEL(smoothness_backward, SmoothnessBackward)

// The contribution of an edge to the gradient of a pixel of the image. Edges out of bounds contribute 0, whatever was
// read.
template <class V>
KV_HD V part_of(V edge, V difference) {
  return edge == 0 ? V{} : V(edge * sign_of(difference));
}

}  // namespace kv::losses
