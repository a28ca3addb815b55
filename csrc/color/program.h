// Colour programs: a chain of per-pixel steps in one pass over the image. A conversion is a program of one step.
//
// A pixel is C channels, which may be planes (NCHW) or neighbours (NHWC); all pixels of a sample are one row here, for
// nothing depends on where they are. The gradient comes from the same formulas on dual numbers: with derivatives along
// the three channels, the program yields its Jacobian at each pixel, whatever its length, and nothing is stored.
#pragma once

#include "core/isa.h"

namespace kv {

// The names in python/kvision/color/program.py, in this order.
enum class Step : int {
  affine,      // 13: a 3 x 3 matrix by rows, what is added, and whether to clip to [0, 1]
  rgb_to_hsv,  // 1: eps
  hsv_to_rgb,
  rgb_to_hls,  // 1: eps
  hls_to_rgb,
  rgb_to_linear_rgb,
  linear_rgb_to_rgb,
  rgb_to_lab,
  lab_to_rgb,    // 1: whether to clip to [0, 1]
  rgb_to_luv,    // 1: eps
  luv_to_rgb,    // 1: eps
  weighted_sum,  // 3; the result has one channel, so it comes last
  count
};
KV_HD int parameters_of(Step step) {
  switch (step) {
    case Step::affine:
      return 13;
    case Step::weighted_sum:
      return 3;
    case Step::rgb_to_hsv:
    case Step::rgb_to_hls:
    case Step::lab_to_rgb:
    case Step::rgb_to_luv:
    case Step::luv_to_rgb:
      return 1;
    default:
      return 0;
  }
}

// Pixel i of sample b has its channel c at data + b * sample_stride + c * channel_stride + i * step.
template <class T>
struct Pixels {
  T* data;
  int channels;  // 3, or 1 after a weighted sum
  int64_t samples, pixels, sample_stride, channel_stride, step;

  KV_HD T* sample(int64_t b) const { return data + b * sample_stride; }
};

// The unit of work on the CPU.
constexpr int64_t kChunk = 1024;
KV_HD int64_t chunks_of(int64_t pixels) { return (pixels + kChunk - 1) / kChunk; }

constexpr int kMostSteps = 16, kMostParameters = 64;

template <class T>
struct Program {
  Pixels<T const> x;
  Pixels<T> y;
  int steps;
  Step step[kMostSteps];
  Compute<T> parameters[kMostParameters];
};
template <class T>
struct ProgramBackward {
  Program<T> forward;  // its y is not written
  Pixels<T const> grad;
  Pixels<T> grad_x;
};

KV_KERNEL(program, Program)
KV_KERNEL(program_backward, ProgramBackward)

}  // namespace kv
