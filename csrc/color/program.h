// Color programs: a chain of per-pixel steps in one pass over the image. A conversion is a program of one step.
//
// A pixel has three channels, in planes (NCHW) or adjacent (NHWC). All pixels of a sample form one row, because no step
// depends on a pixel's position. If no step mixes channels, a pixel is one value, and a sample is a plane, an image or
// the whole batch. Programs compute in F, float or double; storage types are converted when pixels are loaded and
// stored. A chunk of pixels stays in registers (CUDA) or in the L1 cache (CPU) from step to step.
//
// Gradients come from the same formulas on dual numbers. With derivatives along the channels a step gives its Jacobian
// at each pixel; frequent steps have a vjp below their formula instead. With a derivative along a parameter a step
// gives the gradient of that parameter.
#pragma once

#include "core/dtype.h"
#include "core/isa.h"
#include "step_list.h"

namespace kv::color {

// --- steps -----------------------------------------------------------------------------------------------------------

enum class Step : int {
#define KV_STEP(name, number, ...) name = number,
  KV_COLOR_STEPS(KV_STEP)
#undef KV_STEP
};

// A row of the table in step_list.h, which explains the columns.
enum class StepDomain { rgb, any };
enum class StepArguments { numbers, tensors };
enum class StepChannels { same, one };
enum class StepAffine { never, always, unless_clipped };
struct StepInfo {
  int number, parameters;
  StepDomain domain;
  StepArguments arguments;
  StepChannels channels;
  StepAffine affine;
};
constexpr StepInfo kStepTable[] = {
#define KV_STEP(name, number, parameters, domain, arguments, channels, affine) \
  {number, parameters, StepDomain::domain, StepArguments::arguments, StepChannels::channels, StepAffine::affine},
    KV_COLOR_STEPS(KV_STEP)
#undef KV_STEP
};
constexpr int kStepCount = sizeof(kStepTable) / sizeof(*kStepTable);

// The steps for which `is_in` holds, as bits by number: kernels can test a mask, but cannot read the table.
template <class Predicate>
constexpr uint64_t step_mask(Predicate is_in) {
  uint64_t mask = 0;
  for (int i = 0; i < kStepCount; ++i) mask |= uint64_t(is_in(kStepTable[i])) << i;
  return mask;
}
constexpr bool steps_are_numbered_in_order() {
  for (int i = 0; i < kStepCount; ++i)
    if (kStepTable[i].number != i) return false;
  return true;
}
static_assert(steps_are_numbered_in_order() && kStepCount <= 64);

constexpr uint64_t kTensorSteps = step_mask([](StepInfo s) { return s.arguments == StepArguments::tensors; });
constexpr uint64_t kPerValueSteps = step_mask([](StepInfo s) { return s.domain == StepDomain::any; });
constexpr uint64_t kOneChannelSteps = step_mask([](StepInfo s) { return s.channels == StepChannels::one; });
constexpr uint64_t kAffineSteps = step_mask([](StepInfo s) { return s.affine == StepAffine::always; });
constexpr uint64_t kClippedAffineSteps = step_mask([](StepInfo s) { return s.affine == StepAffine::unless_clipped; });

KV_HD int parameters_of(Step step) {
#define KV_STEP(name, number, parameters, ...) parameters,
  constexpr int8_t counts[] = {KV_COLOR_STEPS(KV_STEP)};
#undef KV_STEP
  return counts[int(step)];
}
// Whether parameters of the step can be tensors.
KV_HD bool takes_tensors(Step step) { return kTensorSteps >> int(step) & 1; }
// Whether the step computes every value in the same way, whatever its channel.
KV_HD bool is_per_value(Step step) { return kPerValueSteps >> int(step) & 1; }
KV_HD bool outputs_one_channel(Step step) { return kOneChannelSteps >> int(step) & 1; }
// Whether the step, with these parameters, has the same Jacobian everywhere.
template <class F>
KV_HD bool is_affine(Step step, F const* parameters) {
  if (kAffineSteps >> int(step) & 1) return true;
  return (kClippedAffineSteps >> int(step) & 1) && parameters[parameters_of(step) - 1] == 0;
}

// --- programs --------------------------------------------------------------------------------------------------------

constexpr int kMaxSteps = 16, kMaxParameters = 64, kMaxTensors = 6;
constexpr int kMaxStepTensorParameters = 6;  // parameters of a step that can be tensors

// How a CUDA thread accesses its pixels: element by element, or by vectors. plain_vectors are those of planes in the
// compute type, the most frequent case.
enum class Access : int { elements, vectors, plain_vectors };

// Sample b is (b / inner, b % inner). Its pixel i has channel c at data + outer_stride * (b / inner) + inner_stride *
// (b % inner) + channel_stride * c + step * i. Bytes are 255ths.
struct Pixels {
  void* data;
  DType type;
  int channels;
  int64_t inner, outer_stride, inner_stride, channel_stride, step;
  Access access = Access::elements;  // set by the launcher

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
// How many CUDA blocks work on a sample. A block prepares for the sample once and takes several chunks, so that the
// grid is about four waves. On the CPU it is the number of chunks.
template <class F>
KV_HD int64_t blocks_per_sample([[maybe_unused]] int64_t samples, int64_t pixels) {
  int64_t const chunks = chunks_of<F>(pixels);
#if defined(KV_CUDA) || defined(__CUDACC__)
  int64_t const each = clamp(samples * chunks / (4 * 4 * 132), int64_t(1), int64_t(16));
  return (chunks + each - 1) / each;
#else
  return chunks;
#endif
}
// In how many partial sums the mean of a sample is computed.
template <class F>
KV_HD int64_t mean_parts_of([[maybe_unused]] int64_t samples, int64_t pixels) {
#if defined(KV_CUDA) || defined(__CUDACC__)
  return min(int64_t(1024), blocks_per_sample<F>(samples, pixels));
#else
  return min(int64_t(256), (pixels + 1023) / 1024);
#endif
}

// A tensor of parameters (B or 1, C or 1, columns). Strides are 0 along axes of size 1.
struct ParameterTensor {
  void const* data;
  DType type;
  int first_column;  // among the columns of all tensors
  int64_t image_stride, channel_stride, stride;

  template <class F>
  KV_HD F value(int64_t image, int64_t channel, int column) const {
    int64_t const i = image * image_stride + channel * channel_stride + (column - first_column) * stride;
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
  Step step[kMaxSteps];
  int first[kMaxSteps];  // index of the step's first parameter
  int count;             // of all parameters
  F numbers[kMaxParameters];
  int column[kMaxParameters];  // in the tensors, or -1 for the number
  uint64_t inverted;           // parameters that a kernel reads as their reciprocals, as bits by number

  int64_t inner;  // samples of an image
  int tensor_count;
  ParameterTensor tensor[kMaxTensors];
  // The steps of an image in its order: a step for each of `length` positions, or -1 for none. `order` has them; or
  // they are made of columns of the tensors, if `ordered_by_columns`; else all steps follow each other.
  int64_t const* order;
  int64_t order_stride;
  int length;
  bool ordered_by_columns;
  int order_column[kMaxSteps];  // of a number that is added to order_first, where it is not negative; -1: nothing is
  int order_first[kMaxSteps];

  // For contrast around the mean a first run computes partial sums of the mean, `parts`. The second run adds them up
  // and stores `means`, which the backward pass reads.
  int contrast;  // index of the first such step, or -1; if there are several, a sample's order has one at most
  bool measures_mean;
  bool overwrites;      // the pixels of a sample are in the memory of its result; only clusters do that
  int64_t mean_pixels;  // that the mean is taken of: all of a sample
  F gray_weights[3];    // of the channels in the mean
  int64_t parts_count;
  F* parts;
  F* means;

  KV_HD F column_value(int64_t b, int at) const {
    int k = tensor_count - 1;
    while (tensor[k].first_column > at) --k;
    return tensor[k].template value<F>(b / inner, b % inner, at);
  }
  KV_HD F parameter(int64_t b, int i) const { return column[i] < 0 ? numbers[i] : column_value(b, column[i]); }
  KV_HD bool has_order() const { return order || ordered_by_columns; }
  KV_HD int step_at(int64_t b, int i) const {
    int64_t at = order ? order[b / inner * order_stride + i] : ordered_by_columns ? order_first[i] : i;
    if (ordered_by_columns && order_column[i] >= 0) {
      F const added = column_value(b, order_column[i]);
      at = added >= 0 ? at + int64_t(added) : -1;
    }
    return at >= 0 && at < steps ? int(at) : -1;
  }
};

template <class F>
struct ProgramBackward {
  Program<F> forward;  // y is not written; its first run sums the gradient of the mean
  Pixels grad, grad_x;
  bool needs_grad_x, reads_input;
  bool resumes;  // the first run leaves the gradient behind the contrast in grad_x, which is `grad` of the second run
  bool needs_input[kMaxSteps];  // whether a step's gradient depends on its input
  F* partial_grads;             // of the parameters: (samples, blocks, columns), or null
  int columns;

  // The last step of a sample whose input has to be computed again. step_at(i) is the i-th step of the sample.
  template <class StepAt>
  KV_HD int last_input(int length, StepAt step_at) const {
    int last = length - 1;
    while (last > 0 && !needs_input[step_at(last)]) --last;
    return last;
  }
};

// Sums (N, summands, columns) to (N, columns), which has `count` elements.
template <class F>
struct ProgramReduce {
  F const* partial;
  F* sums;
  int64_t count, summands, columns;

  KV_HD F const* first(int64_t i) const { return partial + i / columns * summands * columns + i % columns; }
};

// With how many channels a program of values runs. In double, which is rare, values are pixels whose other channels are
// not used, which saves the compilation of more kernels.
template <class F>
constexpr int kChannelsOfValue = sizeof(F) == 4 ? 1 : 3;

// F is float or double here, whatever is stored.
KV_KERNEL(program, Program)
KV_KERNEL(program_backward, ProgramBackward)
KV_KERNEL(program_reduce, ProgramReduce)

}  // namespace kv::color
