// Colour programs: a chain of per-pixel steps in one pass over the image. A conversion is a program of one step.
//
// A pixel is three channels, which may be planes (NCHW) or neighbours (NHWC); all pixels of a sample are one row here,
// for nothing depends on where they are. Where every step treats the channels alike, a pixel is one value and a sample
// may be a plane, an image or all of them. What memory holds is a matter of loading and storing: programs compute in F,
// float or double, on a chunk of pixels that stays in registers (CUDA) or in the L1 cache (CPU) from step to step.
//
// The gradient comes from the same formulas on dual numbers: with derivatives along the channels, a step yields its
// Jacobian at each pixel, unless what it makes of a gradient is written below it; with a derivative along one of its
// parameters, how the pixel answers to that.
#pragma once

#include "core/dtype.h"
#include "core/isa.h"

namespace kv {

// The names in python/kvision/color/program.py, in this order.
enum class Step : int {
  // Conversions, of three channels.
  affine,      // 13: a 3 x 3 matrix by rows, what is added, and whether to clip to [0, 1]
  rgb_to_hsv,  // 1: eps
  hsv_to_rgb,
  rgb_to_hls,  // 1: eps
  hls_to_rgb,
  rgb_to_linear_rgb,
  linear_rgb_to_rgb,
  rgb_to_lab,
  lab_to_rgb,  // 1: whether to clip to [0, 1]
  rgb_to_luv,  // 1: eps
  luv_to_rgb,  // 1: eps
  byte_luma,   // 3 weights, of 15 bits; the result has one channel, so it comes last
  byte_hsv,
  // Of three channels, with parameters that may be tensors.
  weighted_sum,     // 3; the result has one channel, so it comes last
  byte_sum,         // 3; the same of bytes, rounded half to even; it comes last, too
  line_rgb,         // 7: factors, what is added, whether to clip
  standardize_rgb,  // 6: means, standard deviations
  saturation,       // 1: factor, in HSV
  saturation_raw,   // 1: factor, of HSV
  saturation_grey,  // 1: factor of the distance from the luma
  hue,              // 1: angle in radians
  hue_raw,          // 1: angle in radians, of HSV
  // Of any channels.
  contrast,     // 2: factor of the distance from the mean, the mean as it is at this step (found by the program)
  line,         // 3: factor, what is added, whether to clip
  standardize,  // 2: mean, standard deviation
  gamma,        // 2: exponent, gain
  log,          // 3: gain, whether to take the inverse, whether to clip
  sigmoid,      // 3: cutoff, gain, whether to fall
  solarize,     // 3: threshold, what is added first, whether to add
  posterize,    // 2: bits, how to round to the stored type
  threshold,    // 5: threshold, what is above it, what is not, whether the value itself is kept above it, and below it
  count
};
KV_HD int parameters_of(Step step) {
  constexpr int8_t counts[] = {13, 1, 0, 1, 0, 0, 0, 0, 1, 1, 1, 3, 0, 3, 3, 7,
                               6,  1, 1, 1, 1, 1, 2, 3, 2, 2, 3, 3, 3, 2, 5};
  static_assert(sizeof(counts) == size_t(Step::count), "one for each step");
  return counts[int(step)];
}
KV_HD bool takes_tensors(Step step) { return step >= Step::weighted_sum; }
KV_HD bool is_of_values(Step step) { return step >= Step::contrast; }
KV_HD bool is_sum(Step step) { return step == Step::weighted_sum || step == Step::byte_sum || step == Step::byte_luma; }
// Whether the step, with these parameters, has the same Jacobian everywhere.
template <class F>
KV_HD bool is_affine(Step step, F const* parameters) {
  if (step == Step::affine) return parameters[12] == 0;
  if (step == Step::line) return parameters[2] == 0;
  if (step == Step::line_rgb) return parameters[6] == 0;
  return step == Step::weighted_sum || step == Step::standardize_rgb || step == Step::standardize;
}

constexpr int kMostSteps = 16, kMostParameters = 64, kMostTensors = 6;
constexpr int kMostOfAStep = 6;  // parameters that can be tensors

// How a thread of CUDA takes its pixels: each number by itself, or vectors of them, which may be of what is computed in
// and planes, as most are.
enum class Access : int { each, vectors, plain };

// Sample b is (b / inner, b % inner). Its pixel i has channel c at data + outer_stride * (b / inner) + inner_stride *
// (b % inner) + channel_stride * c + step * i. Bytes are 255ths.
struct Pixels {
  void* data;
  DType type;
  int channels;
  int64_t inner, outer_stride, inner_stride, channel_stride, step;
  Access access = Access::each;  // set by the launcher

  KV_HD int64_t offset(int64_t b) const {
    if (inner == 1) return b * outer_stride;  // no 64-bit division on the GPU
    return b / inner * outer_stride + b % inner * inner_stride;
  }
};

// The unit of work: pixels of one sample.
#if defined(KV_CUDA) || defined(__CUDACC__)
template <class F>
constexpr int64_t kChunk = sizeof(F) == 4 ? 1024 : 256;
#else
template <class F>
constexpr int64_t kChunk = 512;
#endif
template <class F>
KV_HD int64_t chunks_of(int64_t pixels) {
  return (pixels + kChunk<F> - 1) / kChunk<F>;
}
// How many share the chunks of a sample. On CUDA blocks take several each, which prepare for the sample once: four
// rounds of the machine.
template <class F>
KV_HD int64_t shares_of([[maybe_unused]] int64_t samples, int64_t pixels) {
  int64_t const chunks = chunks_of<F>(pixels);
#if defined(KV_CUDA) || defined(__CUDACC__)
  int64_t const each = clamp(samples * chunks / (4 * 4 * 132), int64_t(1), int64_t(16));
  return (chunks + each - 1) / each;
#else
  return chunks;
#endif
}
// What is summed up over a sample before its pixels are worked on is kept in so many parts.
template <class F>
KV_HD int64_t parts_of([[maybe_unused]] int64_t samples, int64_t pixels) {
#if defined(KV_CUDA) || defined(__CUDACC__)
  return min(int64_t(1024), shares_of<F>(samples, pixels));
#else
  return min(int64_t(256), (pixels + 1023) / 1024);
#endif
}

// Parameters of the samples, a tensor (B or 1, C or 1, columns), as it is in memory: strides are 0 along axes of
// size 1.
struct Rows {
  void const* data;
  DType type;
  int first;  // of its columns among those of all tensors
  int64_t image_stride, channel_stride, stride;

  template <class F>
  KV_HD F at(int64_t image, int64_t channel, int column) const {
    int64_t const i = image * image_stride + channel * channel_stride + (column - first) * stride;
    if (type == DType::float16) return F(to_float(static_cast<Half const*>(data)[i]));
    if (type == DType::bfloat16) return F(to_float(static_cast<BFloat16 const*>(data)[i]));
    if (type == DType::float32) return F(static_cast<float const*>(data)[i]);
    return F(static_cast<double const*>(data)[i]);
  }
};

template <class F>
struct Program {
  Pixels x, y;
  int64_t samples, pixels;  // pixels of a sample
  int steps;
  Step step[kMostSteps];
  int first[kMostSteps];  // of its parameters
  int count;              // of all parameters
  F numbers[kMostParameters];
  int column[kMostParameters];  // of the tensors, or -1 for the number

  int64_t inner;  // samples of an image
  int tensors;
  Rows rows[kMostTensors];
  int64_t const* order;  // an image's steps by position, -1 for none; null: all, one after the other
  int64_t order_stride;
  int length;

  // Around the mean: a first run `measures` what goes into that step, as `parts` of a sum; the second one adds them up
  // and keeps the means of the samples, where the backward pass, which has no parts, finds them.
  int contrast;  // where the first one is among the steps, or -1; of several, a sample's order has one at most
  bool measures;
  F grey[3];  // how much of the mean each channel is
  int64_t parts_count;
  F* parts;
  F* means;

  KV_HD F parameter(int64_t b, int i) const {
    if (column[i] < 0) return numbers[i];
    int k = tensors - 1;
    while (rows[k].first > column[i]) --k;
    return rows[k].template at<F>(b / inner, b % inner, column[i]);
  }
  KV_HD int step_at(int64_t b, int i) const {
    int64_t const at = order ? order[b / inner * order_stride + i] : i;
    return at >= 0 && at < steps ? int(at) : -1;
  }
};

template <class F>
struct ProgramBackward {
  Program<F> forward;  // its y is not written; what it measures is the gradient of the mean
  Pixels grad, grad_x;
  bool wants_x, reads_x;
  bool needs_input[kMostSteps];  // of a step: not where its Jacobian is the same for all pixels
  F* slopes;                     // of the parameters: (samples, shares, columns); null: not wanted
  int columns;

  // Up to which of a sample's steps pixels have to be computed again; step_at(i) is the i-th one of the sample.
  template <class StepAt>
  KV_HD int last_input(int length, StepAt step_at) const {
    int last = length - 1;
    while (last > 0 && !needs_input[step_at(last)]) --last;
    return last;
  }
};

// Sums slopes (N, summands, columns) to (N, columns), `count` of them.
template <class F>
struct ProgramReduce {
  F const* slopes;
  F* y;
  int64_t count, summands, columns;

  KV_HD F const* first(int64_t i) const { return slopes + i / columns * summands * columns + i % columns; }
};

// How many channels a value is worked on as: in double, which is rare, pixels without the other channels save the
// compilation of kernels for values.
template <class F>
constexpr int kValue = sizeof(F) == 4 ? 1 : 3;

// F is float or double here, whatever is stored.
KV_KERNEL(program, Program)
KV_KERNEL(program_backward, ProgramBackward)
KV_KERNEL(program_reduce, ProgramReduce)

}  // namespace kv
