// The operations of policies on the CPU: samples [begin, end), each by the kernel of its operation. Compiled once per
// instruction set.
#include "core/lanes.h"
#include "core/scratch.h"
// Included after core/lanes.h, whose vectors they use.
#include "augmentation/auto/operations.h"
#include "enhance/equalize.h"
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

template <class T, class I>
KV_HD color::Pixels pixels_of(I const& x, int64_t b) {
  return {const_cast<T*>(x.row(b, 0, 0)), kDType<T>, x.channels, 1, 0, 0, x.channel_stride, x.step};
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

template <class T>
void run_color(ApplyOperations<T> const& p, int64_t b, ColorOperation const& operation) {
  Images<T const> const& x = p.warp.x;
  int64_t const pixels = x.height * x.width;
  color::Program<float> program{};
  program.x = pixels_of<T>(x, b), program.y = pixels_of<T>(p.warp.y, b);
  program.samples = program.inner = program.steps = program.length = 1;
  program.pixels = program.mean_pixels = pixels;
  program.step[0] = operation.step;
  program.count = color::parameters_of(operation.step);
  for (int i = 0; i < program.count; ++i) program.numbers[i] = operation.parameters[i], program.column[i] = -1;
  bool const around_mean = operation.step == color::Step::contrast;
  program.contrast = around_mean ? 0 : -1;
  float mean;
  Scratch<float> const parts(around_mean ? color::mean_parts_of<float>(1, pixels) : 0);
  if (around_mean) {
    program.parts_count = color::mean_parts_of<float>(1, pixels);
    program.parts = parts.data;
    program.means = &mean;
    for (int k = 0; k < kImageChannels; ++k) program.gray_weights[k] = luma_weight(k);
    program.measures_mean = true;
    color::KV_ISA::program(program, 0, program.parts_count);
    program.measures_mean = false;
  }
  color::KV_ISA::program(program, 0, color::chunks_of<float>(pixels));
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
  for (int64_t b = begin; b < end; ++b) {
    Operation const operation = p.operation_of(b);
    float const value = p.value_of(b);
    Double4 m[9];
    operation_matrix(operation, double(value) + Double4{}, double(x.height), double(x.width), m);
    for (int i = 0; i < 9; ++i) p.matrices[9 * b + i] = float(m[i][0]);
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
        enhance::KV_ISA::sharpness(sharpness, 0, kImageChannels * x.height);
        break;
      }
      case Operation::equalize: {
        T changed[kImageChannels];
        enhance::Equalize<T> const equalize{planes_of(x, b, true), planes_of(y, b, true), changed, false, nullptr};
        enhance::KV_ISA::equalize(equalize, 0, kImageChannels);
        break;
      }
      case Operation::auto_contrast:
        for (int k = 0; k < kImageChannels; ++k) {
          float lowest, highest;
          find_range(planes_of(x, b, true), k, lowest, highest);
          set_range(color, k, lowest, highest);
        }
        [[fallthrough]];
      default:
        run_color(p, b, color);
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
#if !defined(__AVX512F__)
KV_INSTANTIATE_ONE(apply_operations, ApplyOperations, ::kv::Half)
KV_INSTANTIATE_ONE(apply_operations, ApplyOperations, ::kv::BFloat16)
#endif
KV_INSTANTIATE_ONE(choose_operations, ChooseOperations, float)

}  // namespace kv::augmentation::KV_ISA
