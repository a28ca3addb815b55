// The operations of policies on the CPU: samples [begin, end), each by the kernel of its operation. Compiled once per
// instruction set.
#include "core/lanes.h"
#include "core/scratch.h"
// Included after core/lanes.h, whose vectors they use.
#include "augmentation/auto/operations.h"
#include "enhance/equalize.h"
#include "enhance/min_max.h"
#include "enhance/sharpness.h"

namespace kv::augmentation::KV_ISA {
namespace {

// The planes of a sample; each is one row if it is flat.
template <class T>
KV_HD Planes<T> planes_of(Images<T> const& x, int64_t b, bool flat) {
  int64_t const height = flat ? 1 : x.height, width = flat ? x.height * x.width : x.width;
  return {x.row(b, 0, 0), x.channels, 1,     x.channel_stride, 0, flat ? width * x.step : x.row_stride,
          height,         width,      x.step};
}

// The pixels that a color step takes at once: those of a sample; of one without colors all values, which are one row;
// or the values of a plane.
struct Row {
  int channel, channels;
  int64_t pixels, step;
};
template <class T>
KV_HD Row row_of(Images<T const> const& x) {
  int64_t const pixels = x.height * x.width;
  return x.channels == kColors ? Row{0, kColors, pixels, x.step} : Row{0, 1, x.channels * pixels, 1};
}
template <class T, class I>
KV_HD color::Pixels pixels_of(I const& x, int64_t b, Row const& row) {
  return {const_cast<T*>(x.row(b, row.channel, 0)), kDType<T>, row.channels, 1, 0, 0, x.channel_stride, row.step};
}

// The range of a plane in [0, 1]; NaN if it has one.
template <class T>
void find_range(Planes<T const> const& x, int64_t channel, float& lowest, float& highest) {
  constexpr float unit = __is_same(T, uint8_t) ? 1 / 255.f : 1;
  lowest = __builtin_inff(), highest = -lowest;
  bool has_nan = false;
  T const* const row = x.plane(channel);
  for (int64_t i = 0; i < x.width; ++i) {
    float const v = load<1>(row + i * x.step) * unit;
    lowest = min(lowest, v), highest = max(highest, v);
    has_nan |= v != v;
  }
  if (has_nan) lowest = highest = __builtin_nanf("");
}

// The color program of one operation on a sample. Around a mean it needs `parts` and `mean`.
template <class T>
color::Program<float> program_of(Images<T const> const& x, int64_t b, Row const& row, ColorOperation const& operation,
                                 float* parts, float* mean) {
  int64_t const pixels = row.pixels;
  color::Program<float> program{};
  program.x = pixels_of<T>(x, b, row);
  program.samples = program.inner = program.steps = program.length = 1;
  program.pixels = program.mean_pixels = pixels;
  program.step[0] = operation.step;
  program.count = color::parameters_of(operation.step);
  for (int i = 0; i < program.count; ++i) program.numbers[i] = operation.parameters[i], program.column[i] = -1;
  program.contrast = operation.step == color::Step::contrast ? 0 : -1;
  program.parts_count = color::mean_parts_of<float>(1, pixels);
  program.parts = parts;
  program.means = mean;
  for (int k = 0; k < row.channels; ++k) program.gray_weights[k] = row.channels == 1 ? 1 : luma_weight(k);
  return program;
}

template <class T>
void run_color(ApplyOperations<T> const& p, int64_t b, Row const& row, ColorOperation const& operation) {
  Scratch<float> const parts(color::mean_parts_of<float>(1, row.pixels));
  float mean;
  auto program = program_of(p.warp.x, b, row, operation, parts.data, &mean);
  program.y = pixels_of<T>(p.warp.y, b, row);
  if (program.contrast >= 0) {
    program.measures_mean = true;
    color::KV_ISA::program(program, 0, program.parts_count);
    program.measures_mean = false;
  }
  color::KV_ISA::program(program, 0, color::chunks_of<float>(row.pixels));
}

template <class T>
void run_color_backward(ApplyOperationsBackward<T> const& p, int64_t b, ColorOperation const& operation) {
  Images<T const> const& x = p.forward.warp.x;
  Row const row = row_of(x);
  Scratch<float> const parts(color::mean_parts_of<float>(1, row.pixels));
  float mean = 0;
  color::ProgramBackward<float> backward{};
  color::Program<float>& program = backward.forward;
  program = program_of(x, b, row, operation, parts.data, &mean);
  backward.grad = pixels_of<T>(p.warp.grad, b, row), backward.grad_x = pixels_of<T>(p.warp.grad_x, b, row);
  backward.needs_grad_x = true;
  backward.needs_input[0] = backward.reads_input = !color::is_affine(operation.step, operation.parameters);
  if (program.contrast >= 0) {
    program.measures_mean = true;
    color::KV_ISA::program(program, 0, program.parts_count);
    for (int64_t i = 0; i < program.parts_count; ++i) mean += parts.data[i];
    mean /= float(row.pixels);
    color::KV_ISA::program_backward(backward, 0, program.parts_count);
    program.measures_mean = false;
  }
  color::KV_ISA::program_backward(backward, 0, color::chunks_of<float>(row.pixels));
}

// The gradient of images that equalize() makes, of a sample.
template <class T>
void equalize_backward(ApplyOperationsBackward<T> const& p, int64_t b) {
  Images<T const> const& x = p.forward.warp.x;
  Scratch<T> const result(x.channels * x.height * x.width), changed(x.channels);
  Images<T> y = p.warp.grad_x;  // of the same layout
  y.data = result.data;
  y.batch_stride = 0;
  enhance::Equalize<T> const equalize{planes_of(x, b, true), planes_of(y, b, true), changed.data, false, nullptr};
  enhance::KV_ISA::equalize(equalize, 0, x.channels);
  Images<T const> const equalized{y.data,  y.batch_stride, y.channel_stride, y.row_stride, y.step,
                                  y.batch, y.height,       y.width,          y.channels};
  enhance::EqualizeBackward<T> const backward{planes_of(p.warp.grad, b, true), planes_of(equalized, b, true),
                                              planes_of(p.warp.grad_x, b, true), changed.data};
  enhance::KV_ISA::equalize_backward(backward, 0, x.channels);
}

// The gradient of images that are stretched to their range, of a sample.
template <class T>
void auto_contrast_backward(ApplyOperationsBackward<T> const& p, int64_t b) {
  auto const x = planes_of(p.forward.warp.x, b, true), grad = planes_of(p.warp.grad, b, true);
  auto const grad_x = planes_of(p.warp.grad_x, b, true);
  int64_t const channels = p.forward.channels();
  Scratch<T> const range(2 * channels);
  enhance::MinMaxBackward<T> backward{};
  backward.grad = grad, backward.x = x, backward.grad_x = grad_x;
  backward.range = range.data;
  backward.scale = 1, backward.eps = kRangeEps;
  for (int64_t k = 0; k < channels; ++k) {
    T &lowest = range.data[2 * k], &highest = range.data[2 * k + 1];
    find_range(x, k, lowest, highest);
    if (lowest == highest)
      __builtin_memcpy(grad_x.plane(k), grad.plane(k), size_t(x.width) * sizeof(T));
    else
      enhance::KV_ISA::min_max_backward(backward, k, k + 1);
  }
}

template <class T>
void write_matrix(ApplyOperations<T> const& p, int64_t b) {
  Images<T const> const& x = p.warp.x;
  Double4 m[9];
  operation_matrix(p.operation_of(b), double(p.value_of(b)) + Double4{}, double(x.height), double(x.width), m);
  for (int i = 0; i < 9; ++i) p.matrices[9 * b + i] = float(m[i][0]);
}

template <class T>
void copy_sample(Images<T const> const& x, Images<T> const& y, int64_t b) {
  auto const from = planes_of(x, b, true);
  auto const to = planes_of(y, b, true);
  int64_t const runs = x.step == 1 ? x.channels : 1, length = x.step == 1 ? from.width : from.width * x.step;
  for (int64_t k = 0; k < runs; ++k) __builtin_memcpy(to.plane(k), from.plane(k), size_t(length) * sizeof(T));
}

}  // namespace

template <class T>
void apply_operations(ApplyOperations<T> const& p, int64_t begin, int64_t end) {
  Images<T const> const& x = p.warp.x;
  Images<T> const& y = p.warp.y;
  bool const has_colors = x.channels == kColors;
  for (int64_t b = begin; b < end; ++b) {
    Operation const operation = p.operation_of(b);
    float const value = p.value_of(b);
    write_matrix(p, b);
    if (moves_pixels(operation)) {
      geometry::KV_ISA::sample(p.warp, b * x.height, (b + 1) * x.height);
      continue;
    }
    ColorOperation color = color_operation(operation, value, kPosterizeSplit<T>);
    switch (operation) {
      case Operation::none:
      case Operation::identity:
        copy_sample(x, y, b);
        break;
      case Operation::sharpness: {
        enhance::Sharpness<T> const sharpness{
            planes_of(x, b, false), planes_of(y, b, false), {nullptr, 0, 0, 1, value}};
        enhance::KV_ISA::sharpness(sharpness, 0, x.channels * x.height);
        break;
      }
      case Operation::equalize: {
        Scratch<T> const changed(x.channels);
        enhance::Equalize<T> const equalize{planes_of(x, b, true), planes_of(y, b, true), changed.data, false, nullptr};
        enhance::KV_ISA::equalize(equalize, 0, x.channels);
        break;
      }
      case Operation::auto_contrast:
        for (int k = 0; k < x.channels; ++k) {
          float lowest, highest;
          find_range(planes_of(x, b, true), k, lowest, highest);
          if (has_colors) {
            set_range<kColors>(color, k, lowest, highest);
          } else {
            set_range<1>(color, 0, lowest, highest);
            run_color(p, b, {k, 1, x.height * x.width, x.step}, color);
          }
        }
        if (has_colors) run_color(p, b, row_of(x), color);
        break;
      default:
        run_color(p, b, row_of(x), color);
    }
  }
}

// Samples of a list.
template <class T>
void apply_operations_list(ApplyOperationsList<T> const& p, int64_t begin, int64_t end) {
  for (int64_t b = begin; b < end; ++b) apply_operations(sample_at(p, int(b)), 0, 1);
}

// Items of a list.
template <class T>
void mix_operations_list(MixOperations<T> const& p, int64_t begin, int64_t end) {
  for (int64_t item = begin; item < end; ++item) {
    int const b = p.list.sample_of(int(item));
    T const* const image = static_cast<T const*>(p.list.images[b].data);
    T* const result = static_cast<T*>(p.list.results[b].data);
    int64_t const place = p.begin_of(b), first = (item - p.list.first[b]) * kMixedValues;
    T const* const chain = p.chains + place;
    float* const sums = p.sums + place;
    int64_t const last = min(first + kMixedValues, p.values_of(b));
    auto const mix = [&](auto width, int64_t i) {
      constexpr int N = decltype(width)::value;
      using V = Lanes<float, N>;
      V const own = p.is_first ? load<N>(image + i) : V{}, before = p.is_first ? V{} : load<N>(sums + i);
      V const sum = p.sum(b, own, load<N>(chain + i), before);
      p.is_last ? store<N>(result + i, sum) : store<N>(sums + i, sum);
    };
    // The last vector must not read sums that it has written.
    constexpr int N = kLanes<T>;
    int64_t i = first;
    for (; i + N <= last; i += N) mix(Width<N>{}, i);
    for (; i < last; ++i) mix(Width<1>{}, i);
  }
}

template <class T>
void apply_operations_backward(ApplyOperationsBackward<T> const& p, int64_t begin, int64_t end) {
  Images<T const> const& x = p.forward.warp.x;
  for (int64_t b = begin; b < end; ++b) {
    Operation const operation = p.forward.operation_of(b);
    float const value = p.forward.value_of(b);
    if (moves_pixels(operation)) {
      write_matrix(p.forward, b);
      geometry::KV_ISA::sample_image_backward(p.warp, b * x.channels, (b + 1) * x.channels);
      continue;
    }
    switch (operation) {
      case Operation::none:
      case Operation::identity:
        copy_sample(p.warp.grad, p.warp.grad_x, b);
        break;
      case Operation::sharpness: {
        enhance::SharpnessBackward<T> const backward{planes_of(p.warp.grad, b, false),
                                                     planes_of(x, b, false),
                                                     planes_of(p.warp.grad_x, b, false),
                                                     {nullptr, 0, 0, 1, value},
                                                     nullptr,
                                                     1};
        enhance::KV_ISA::sharpness_backward(backward, 0, x.channels * x.height);
        break;
      }
      case Operation::equalize:
        equalize_backward(p, b);
        break;
      case Operation::auto_contrast:
        auto_contrast_backward(p, b);
        break;
      default:
        run_color_backward(p, b, color_operation(operation, value, kPosterizeSplit<T>));
    }
  }
}

// Steps of samples.
template <class T>
void choose_operations(ChooseOperations<T> const& p, int64_t begin, int64_t end) {
  for (int64_t i = begin; i < end; ++i) p.choose(i);
}

KV_INSTANTIATE_ONE(apply_operations, ApplyOperations, float)
KV_INSTANTIATE_ONE(apply_operations, ApplyOperations, uint8_t)
KV_INSTANTIATE_ONE(apply_operations_list, ApplyOperationsList, float)
KV_INSTANTIATE_ONE(mix_operations_list, MixOperations, float)
KV_INSTANTIATE_ONE(apply_operations_list, ApplyOperationsList, uint8_t)
KV_INSTANTIATE_ONE(mix_operations_list, MixOperations, uint8_t)
#if !defined(__AVX512F__)
KV_INSTANTIATE_ONE(apply_operations, ApplyOperations, ::kv::Half)
KV_INSTANTIATE_ONE(apply_operations, ApplyOperations, ::kv::BFloat16)
KV_INSTANTIATE_ONE(apply_operations_list, ApplyOperationsList, ::kv::Half)
KV_INSTANTIATE_ONE(mix_operations_list, MixOperations, ::kv::Half)
KV_INSTANTIATE_ONE(apply_operations_list, ApplyOperationsList, ::kv::BFloat16)
KV_INSTANTIATE_ONE(mix_operations_list, MixOperations, ::kv::BFloat16)
#endif
KV_INSTANTIATE_ONE(apply_operations_backward, ApplyOperationsBackward, float)
KV_INSTANTIATE_ONE(choose_operations, ChooseOperations, float)

}  // namespace kv::augmentation::KV_ISA
