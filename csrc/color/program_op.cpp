// Colour programs: schemas and entries, for CPU and CUDA alike.
#include "glue/glue.h"
#include "program.h"

namespace kv {
namespace {

void check_colors(char const* op, char const* name, Tensor const& x) {
  check_images(op, name, x);
  KV_CHECK(x.size(1) == 3, op, ": expected ", name, " of 3 channels, got ", x.size(1));
}

// `x` itself, or a dense copy: pixels are then one row.
Tensor dense(Tensor const& x, Layout layout) {
  if (layout == Layout::channels_last)
    return x.stride(0) == x.stride(2) * x.size(2) || x.size(0) == 1 ? x : conform(torch::stable::contiguous(x), layout);
  return torch::stable::contiguous(x);
}

template <class T>
Pixels<T> pixels(Tensor const& x, Layout layout) {
  auto* data = static_cast<T*>(const_cast<void*>(static_cast<void const*>(x.const_data_ptr())));
  int64_t const n = x.size(2) * x.size(3), c = x.size(1);
  bool const last = layout == Layout::channels_last;
  return {data, int(c), x.size(0), n, n * c, last ? 1 : n, last ? c : 1};
}

template <class T>
Program<T> program_of(char const* op, std::vector<int64_t> const& steps, std::vector<double> const& parameters) {
  KV_CHECK(steps.size() <= kMostSteps, op, ": expected at most ", kMostSteps, " steps, got ", steps.size());
  Program<T> p{};
  size_t needed = 0;
  for (int64_t step : steps) {
    KV_CHECK(step >= 0 && step < int64_t(Step::count), op, ": there is no step ", step);
    KV_CHECK(p.steps == 0 || p.step[p.steps - 1] != Step::weighted_sum, op, ": a weighted sum must be the last step");
    p.step[p.steps++] = Step(step);
    needed += parameters_of(Step(step));
  }
  KV_CHECK(parameters.size() == needed && needed <= kMostParameters, op, ": expected ", needed,
           " parameters and at most ", kMostParameters, ", got ", parameters.size());
  for (size_t i = 0; i < needed; ++i) p.parameters[i] = Compute<T>(parameters[i]);
  return p;
}

// Channels of the result.
int64_t channels_of(std::vector<int64_t> const& steps) {
  return !steps.empty() && Step(steps.back()) == Step::weighted_sum ? 1 : 3;
}

Tensor color_program(Tensor const& input, std::vector<int64_t> steps, std::vector<double> parameters) {
  check_colors("color_program", "input", input);
  Layout const layout = layout_of(input);
  Tensor const x = dense(input, layout), y = empty({x.size(0), channels_of(steps), x.size(2), x.size(3)}, x, layout);
  for_floats("color_program", x, [&](auto type) {
    using T = typename decltype(type)::type;
    Program<T> params = program_of<T>("color_program", steps, parameters);
    params.x = pixels<T const>(x, layout);
    params.y = pixels<T>(y, y.size(1) == 1 ? Layout::planar : layout);
    KV_RUN(program, x, params, params.x.samples * chunks_of(params.x.pixels), 3 * min(kChunk, params.x.pixels));
  });
  return y;
}

Tensor color_program_backward(Tensor const& grad, Tensor const& input, std::vector<int64_t> steps,
                              std::vector<double> parameters) {
  check_colors("color_program_backward", "input", input);
  bool same = grad.dim() == 4 && grad.size(1) == channels_of(steps) && grad.scalar_type() == input.scalar_type() &&
              grad.device() == input.device();
  for (int64_t i : {0, 2, 3}) same = same && grad.size(i) == input.size(i);
  KV_CHECK(same, "color_program_backward: grad differs in shape, dtype or device from the result of input");
  Layout const layout = layout_of(input);
  Tensor const x = dense(input, layout),
               g = grad.size(1) == 1 ? torch::stable::contiguous(grad) : dense(conform(grad, layout), layout),
               grad_x = empty_like(x, layout);
  for_floats("color_program_backward", x, [&](auto type) {
    using T = typename decltype(type)::type;
    ProgramBackward<T> params{program_of<T>("color_program_backward", steps, parameters),
                              pixels<T const>(g, g.size(1) == 1 ? Layout::planar : layout), pixels<T>(grad_x, layout)};
    params.forward.x = pixels<T const>(x, layout);
    KV_RUN(program_backward, x, params, params.grad.samples * chunks_of(params.grad.pixels),
           12 * min(kChunk, params.grad.pixels));
  });
  return grad_x;
}

}  // namespace

KV_OPERATOR(color_program, "(Tensor input, int[] steps, float[] parameters) -> Tensor")
KV_OPERATOR(color_program_backward, "(Tensor grad, Tensor input, int[] steps, float[] parameters) -> Tensor")

}  // namespace kv
