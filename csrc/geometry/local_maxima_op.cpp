// Local maxima: schemas and entries, for CPU and CUDA alike. A volume's planes are the channels of an image, which is
// read planar.
#include "glue/batch.h"
#include "local_maxima.h"

namespace kv {
namespace {

void find_maxima(char const* op, Tensor const& input, std::vector<int64_t> const& window, bool volumes,
                 Tensor const* kept, Tensor const* values, Tensor const* maxima, Tensor const* minima, Layout layout) {
  auto const readable = [&](Tensor const& x) { return volumes ? dense(x) : conform(x, layout); };
  Tensor const x = readable(input), shown = kept ? readable(*kept) : x;
  for_floats(op, x, [&](auto type) {
    using T = typename decltype(type)::type;
    LocalMaxima<T> params{};
    params.x = planes<T const>(x, layout);
    params.kept = planes<T const>(shown, layout);
    if (values) params.y = planes<T>(*values, layout);
    if (maxima) params.maxima = planes<uint8_t>(*maxima, layout);
    if (minima) params.minima = planes<uint8_t>(*minima, layout);
    params.depth = volumes ? x.size(1) : 1;
    int64_t area = 1;
    for (int axis = 0; axis < 3; ++axis) {
      area *= window[axis];
      params.before[axis] = int(window[axis] - 1) / 2;
      params.after[axis] = int(window[axis]) / 2;
    }
    KV_RUN(local_maxima, x, params, params.x.rows(), params.x.row_size() * (1 + area / 8));
  });
}

Layout layout_for(char const* op, Tensor const& input, std::vector<int64_t> const& window, bool volumes) {
  check_images(op, "input", input);
  KV_CHECK(window.size() == 3, op, ": expected a window of 3 sizes, got ", window.size());
  KV_CHECK(volumes || window[0] == 1, op, ": the window of an image has a depth of 1, got ", window[0]);
  check_window(op, window[1], window[2]);
  check_window(op, window[0], 1);
  return volumes ? Layout::planar : layout_of(input);
}

Tensor local_maxima(Tensor const& input, std::vector<int64_t> window, bool volumes) {
  Layout const layout = layout_for("local_maxima", input, window, volumes);
  Tensor const values = empty_like(input, layout);
  find_maxima("local_maxima", input, window, volumes, nullptr, &values, nullptr, nullptr, layout);
  return values;
}

// The gradient, which has the layout of the input or is made to.
Tensor local_maxima_backward(Tensor const& grad, Tensor const& input, std::vector<int64_t> window, bool volumes) {
  char const* const op = "local_maxima_backward";
  check_images(op, "grad", grad);
  check_images(op, "input", input);
  check_fits(op, "input", input, grad, {grad.size(0), grad.size(1), grad.size(2), grad.size(3)});
  Tensor const x = input.size(0) == grad.size(0) ? input : for_batch(input, grad.size(0));
  Layout const layout = layout_for(op, grad, window, volumes);
  Tensor const grad_x = empty_like(grad, layout);
  find_maxima(op, x, window, volumes, &grad, &grad_x, nullptr, nullptr, layout);
  return grad_x;
}

// 0 and 1.
Tensor flags_like(Tensor const& x, Layout layout) {
  return empty({x.size(0), x.size(1), x.size(2), x.size(3)}, x, layout, ScalarType::Byte);
}

Tensor is_local_maximum(Tensor const& input, std::vector<int64_t> window, bool volumes) {
  Layout const layout = layout_for("is_local_maximum", input, window, volumes);
  Tensor const maxima = flags_like(input, layout);
  find_maxima("is_local_maximum", input, window, volumes, nullptr, nullptr, &maxima, nullptr, layout);
  return maxima;
}

std::tuple<Tensor, Tensor> local_extrema(Tensor const& input, std::vector<int64_t> window, bool volumes) {
  Layout const layout = layout_for("local_extrema", input, window, volumes);
  Tensor const maxima = flags_like(input, layout), minima = flags_like(input, layout);
  find_maxima("local_extrema", input, window, volumes, nullptr, nullptr, &maxima, &minima, layout);
  return {maxima, minima};
}

}  // namespace

KV_OPERATOR(local_maxima, "(Tensor input, int[] window, bool volumes) -> Tensor")
KV_OPERATOR(local_maxima_backward, "(Tensor grad, Tensor input, int[] window, bool volumes) -> Tensor")
KV_OPERATOR(is_local_maximum, "(Tensor input, int[] window, bool volumes) -> Tensor")
KV_OPERATOR(local_extrema, "(Tensor input, int[] window, bool volumes) -> (Tensor, Tensor)")

}  // namespace kv
