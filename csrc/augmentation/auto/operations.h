// The operations of policies: in a step each sample of a batch gets one of them, in one traversal of the images. On the
// CPU the kernels of the operators themselves serve a sample each. On CUDA a first launch computes the matrices, and
// what equalize, auto_contrast and contrast need to know of a plane; in a second one each block does to a tile what its
// sample has chosen. The gradient takes two more: that of the warp, of all samples, and the sums that the mean of
// contrast and the range of auto_contrast get.
#pragma once

#include "color/program.h"
#include "core/product.h"
#include "enhance/byte_histogram.h"
#include "geometry/transform/lists/sample_list.h"
#include "geometry/transform/matrices.h"
#include "geometry/transform/sampling.h"

namespace kv::augmentation {

enum class Operation : int {
  none = -1,
  identity,
  auto_contrast,
  equalize,
  invert,
  rotate,
  posterize,
  solarize,
  solarize_add,
  color,
  contrast,
  brightness,
  sharpness,
  shear_x,
  shear_y,
  translate_x,
  translate_y,
  translate_x_pixels,
  translate_y_pixels
};
constexpr int kOperations = 18;

KV_HD bool moves_pixels(Operation operation) {
  return operation == Operation::rotate || operation >= Operation::shear_x;
}
KV_HD bool measures_planes(Operation operation) {
  return operation == Operation::auto_contrast || operation == Operation::equalize || operation == Operation::contrast;
}

// Only images of three channels have colors: `color` leaves others as they are, and the mean of contrast is that of all
// their values.
constexpr int kColors = 3;

// What CUDA measures of a plane: its lowest and highest value, or the sum of its values; or whether equalization
// changes it, and the new values of its levels.
constexpr int kMeasured = 2 + enhance::kLevels;

template <class T>
struct ApplyOperations {
  geometry::Sample<T> warp;  // the images, which are dense, the results, and how operations that move pixels read them
  int64_t const* operation;  // of the samples
  float const* value;
  int64_t operation_stride, value_stride;
  float* matrices;  // (B, 3, 3), from pixels of the images to pixels of the results
  float* measured;  // CUDA: kMeasured numbers of each plane

  KV_HD Operation operation_of(int64_t b) const {
    int64_t const number = operation[b * operation_stride];
    bool const lacks_colors = number == int(Operation::color) && channels() != kColors;
    return number >= 0 && number < kOperations && !lacks_colors ? Operation(int(number)) : Operation::none;
  }
  KV_HD float value_of(int64_t b) const { return value[b * value_stride]; }
  KV_HD int channels() const { return warp.x.channels; }
};

// The same of a list of images of different sizes. `all` is what the samples share, with the numbers of all of them,
// and of images their channels only.
template <class T>
struct ApplyOperationsList {
  ApplyOperations<T> all;
  ListedSamples list;
  int tiles_per_block;  // on CUDA
};

using geometry::sample_at;

template <class T>
KV_HD void set_sample(ApplyOperations<T>& one, ApplyOperationsList<T> const& p, int b) {
  ListedImage const& image = p.list.images[b];
  geometry::Size const size{image.height, image.width};
  geometry::select_sample(one.warp, b, size, size);
  one.warp.x = images_of<T>(image, p.all.channels());
  one.warp.y = images_of<T>(p.list.results[b], p.all.channels(), p.list.interleaved);
  one.operation += b * one.operation_stride;
  one.value += b * one.value_stride;
  one.matrices += 9 * b;
  one.measured += int64_t(b) * p.all.channels() * kMeasured;
}

// The sums of a plane that its gradient needs: of contrast that of the mean's gradient, of auto_contrast the RangeSums.
constexpr int kGradientSums = 4;

// The gradient of the images of one step. All images are planar and dense.
template <class T>
struct ApplyOperationsBackward {
  ApplyOperations<T> forward;             // whose results are not written
  geometry::SampleImageBackward<T> warp;  // the gradients, and how operations that move pixels read the images
  float* sums;                            // CUDA: kGradientSums numbers of each plane
};

// The choices of a policy, from the numbers that were drawn for it. The columns of a sample are `count` groups: the
// index of a sub-policy, then the chance, the level and the mirroring of each of its `length` operations.
template <class T>
struct ChooseOperations {
  T const* columns;
  int64_t stride, column_stride, batch;
  T const*
      table;  // (sub-policies, length, 5): number, probability, value at the lowest and highest level, neutral value
  int64_t policies;
  int count, length;
  T top_level;
  int64_t* operation;  // (B, count * length); -1 for none
  T* value;

  KV_HD void choose(int64_t i) const {
    int64_t const steps = int64_t(count) * length, b = i / steps, step = i - b * steps, group = step / length,
                  k = step - group * length;
    T const* const drawn = columns + b * stride + group * (1 + 3 * length) * column_stride;
    T const chance = drawn[(1 + 3 * k) * column_stride], level = drawn[(2 + 3 * k) * column_stride],
            mirrored = drawn[(3 + 3 * k) * column_stride];
    int64_t const policy = clamp(int64_t(drawn[0]), int64_t(0), policies - 1);
    T const* const row = table + (policy * length + k) * 5;
    T const low = row[2], high = row[3], neutral = row[4];
    T x = low + (high - low) * level / top_level;
    if (mirrored > T(.5) && neutral == neutral) x = 2 * neutral - x;
    operation[i] = chance < row[1] ? int64_t(row[0]) : -1;
    value[i] = x;
  }
};

constexpr int kMixedValues = 4096;  // of an item

// Adds the results of a chain of operations to the mixtures of a list, of which it is the first or a further chain. The
// images and the results are dense; chains and sums are blocks of memory with whole items for each image.
template <class T>
struct MixOperations {
  ListedSamples list;
  int channels;
  T const* chains;
  float* sums;                           // of mixtures that have further chains
  float const *weights, *image_weights;  // of the chain and of the image itself, of each sample
  int64_t weight_stride;
  bool is_first, is_last;

  // Of V values of a sample. As operators would that multiply and add one after the other.
  template <class V>
  KV_HD V sum(int b, V image, V chain, V sum) const {
    int64_t const own = b * weight_stride;
    V const before = is_first ? product(image, image_weights[own]) : sum;
    return before + product(chain, weights[own]);
  }
  // Where a sample begins in the blocks.
  KV_HD int64_t begin_of(int b) const { return list.first[b] * int64_t(kMixedValues); }
  KV_HD int64_t values_of(int b) const { return channels * int64_t(list.results[b].height) * list.results[b].width; }
};

KV_KERNEL(apply_operations, ApplyOperations)
// On the CPU an item is a sample, on CUDA a block of tiles of one.
KV_KERNEL(apply_operations_list, ApplyOperationsList)
KV_KERNEL(apply_operations_backward, ApplyOperationsBackward)
KV_KERNEL(mix_operations_list, MixOperations)
KV_KERNEL(choose_operations, ChooseOperations)

// The matrix of an operation, the identity if it moves no pixels. Values are degrees counter-clockwise, tangents,
// fractions of the sides and pixels. V is a double or, on the CPU, lanes of them, as trigonometry.h has it.
template <class V>
KV_HD void operation_matrix(Operation operation, V const& value, double height, double width, V* m) {
  V const zero = constant<V>(0), one = constant<V>(1);
  V linear[] = {one, zero, zero, one}, shift[] = {zero, zero};
  V const center[] = {constant<V>((width - 1) / 2), constant<V>((height - 1) / 2)};
  switch (operation) {
    case Operation::rotate:
      geometry::cos_sin_degrees(value, linear[0], linear[1]);
      linear[2] = -linear[1], linear[3] = linear[0];
      break;
    case Operation::shear_x:
      linear[1] = -value;
      break;
    case Operation::shear_y:
      linear[2] = -value;
      break;
    case Operation::translate_x:
      shift[0] = value * width;
      break;
    case Operation::translate_y:
      shift[1] = value * height;
      break;
    case Operation::translate_x_pixels:
      shift[0] = value;
      break;
    case Operation::translate_y_pixels:
      shift[1] = value;
      break;
    default:
      break;
  }
  geometry::write_affine<2>(linear, center, shift, m);
}

// An operation on single pixels as a color step with its parameters.
struct ColorOperation {
  color::Step step;
  float parameters[6];
};

// `split` says how posterize rounds to the type of the images (posterize in color/adjustments.h). The mean of contrast
// is parameter 1.
KV_HD ColorOperation color_operation(Operation operation, float value, float split) {
  using color::Step;
  switch (operation) {
    case Operation::invert:
      return {Step::scale_shift, {-1, 1, 0}};
    case Operation::brightness:
      return {Step::scale_shift, {value, 0, 1}};
    case Operation::contrast:
      return {Step::contrast, {value, 0}};
    case Operation::color:
      return {Step::saturation_gray, {value}};
    case Operation::posterize:
      return {Step::posterize, {__builtin_rintf(value), split}};
    case Operation::solarize:
      return {Step::solarize, {value, 0, 1}};
    case Operation::solarize_add:
      return {Step::solarize, {.5f, value, 1}};
    default:
      return {Step::scale_shift, {1, 0, 0}};
  }
}
template <class T>
constexpr float kPosterizeSplit = __is_same(T, Half)       ? 8193.f
                                  : __is_same(T, BFloat16) ? 65537.f
                                                           : 1.f;

// What is added to the range of auto_contrast, as to that of normalize_min_max.
constexpr float kRangeEps = 1e-6f;

// The step of auto_contrast, for all colors or for the values of a plane: parameters are the lowest values of C
// channels and their ranges. A channel of one value stays as it is.
template <int C>
KV_HD void set_range(ColorOperation& operation, int channel, float lowest, float highest) {
  bool const is_flat = lowest == highest;
  operation.step = C == kColors ? color::Step::standardize_rgb : color::Step::standardize;
  operation.parameters[channel] = is_flat ? 0 : lowest;
  operation.parameters[C + channel] = is_flat ? 1 : highest - lowest + kRangeEps;
}

KV_HD constexpr float luma_weight(int channel) { return channel == 0 ? .299f : channel == 1 ? .587f : .114f; }

}  // namespace kv::augmentation
