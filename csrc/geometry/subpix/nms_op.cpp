// Local maxima: schemas and entries, for CPU and CUDA. The planes of a volume become the channels of a planar image.
#include "geometry/subpix/nms.h"
#include "glue/batch.h"

namespace kv::geometry {
namespace {

void find_maxima(char const* op, Tensor const& input, std::vector<int64_t> const& window, bool volumes,
                 Tensor const* values, Tensor const* maxima, Tensor const* minima, Layout layout) {
  Tensor const x = volumes ? dense(input) : as_layout(input, layout);
  dispatch_floating(op, x, [&](auto type) {
    using T = typename decltype(type)::type;
    Nms<T> params{};
    params.x = planes<T const>(x, layout);
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
    KV_RUN(nms, x, params, params.x.rows(), params.x.row_size() * (1 + area / 8));
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

// Flags of 0 and 1.
Tensor flags_like(Tensor const& x, Layout layout) {
  return empty({x.size(0), x.size(1), x.size(2), x.size(3)}, x, layout, ScalarType::Byte);
}

// The maxima, and flags of where they are; these are empty unless `marked`.
std::tuple<Tensor, Tensor> nms(Tensor const& input, std::vector<int64_t> window, bool volumes, bool marked) {
  Layout const layout = layout_for("nms", input, window, volumes);
  Tensor const values = empty_like(input, layout);
  Tensor const maxima =
      marked ? flags_like(input, layout) : empty({input.size(0), 0}, input, Layout::planar, ScalarType::Byte);
  find_maxima("nms", input, window, volumes, &values, marked ? &maxima : nullptr, nullptr, layout);
  return {values, maxima};
}

Tensor apply_nms_mask(Tensor const& input, Tensor const& flags) {
  char const* const op = "apply_nms_mask";
  check_images(op, "input", input);
  bool fits = flags.dim() == 4 && flags.scalar_type() == ScalarType::Byte && flags.device() == input.device();
  for (int64_t i = 0; fits && i < 4; ++i) fits = flags.size(i) == input.size(i) || (i == 0 && flags.size(0) == 1);
  KV_CHECK(fits, op, ": flags do not fit the input");
  Layout const layout = layout_of(input);
  auto const flat = [&](Tensor const& x) {
    Tensor const all = x.size(0) == input.size(0) ? x : expand_batch(x, input.size(0));
    return layout == Layout::planar ? dense(all)
                                    : torch::stable::contiguous(all, torch::headeronly::MemoryFormat::ChannelsLast);
  };
  Tensor const x = flat(input), marks = flat(flags), result = empty_like(input, layout);
  dispatch_floating(op, x, [&](auto type) {
    using T = typename decltype(type)::type;
    ApplyNmsMask<T> const params{data_ptr<T const>(x), data_ptr<uint8_t const>(marks), data_ptr<T>(result),
                                 result.numel()};
    KV_RUN(apply_nms_mask, x, params, params.count, 1);
  });
  return result;
}

Tensor nms_mask(Tensor const& input, std::vector<int64_t> window, bool volumes) {
  Layout const layout = layout_for("nms_mask", input, window, volumes);
  Tensor const maxima = flags_like(input, layout);
  find_maxima("nms_mask", input, window, volumes, nullptr, &maxima, nullptr, layout);
  return maxima;
}

std::tuple<Tensor, Tensor> nms_minmax_masks(Tensor const& input, std::vector<int64_t> window, bool volumes) {
  Layout const layout = layout_for("nms_minmax_masks", input, window, volumes);
  Tensor const maxima = flags_like(input, layout), minima = flags_like(input, layout);
  find_maxima("nms_minmax_masks", input, window, volumes, nullptr, &maxima, &minima, layout);
  return {maxima, minima};
}

}  // namespace

KV_OPERATOR(nms, "(Tensor input, int[] window, bool volumes, bool marked) -> (Tensor, Tensor)")
KV_OPERATOR(apply_nms_mask, "(Tensor input, Tensor flags) -> Tensor")
KV_OPERATOR(nms_mask, "(Tensor input, int[] window, bool volumes) -> Tensor")
KV_OPERATOR(nms_minmax_masks, "(Tensor input, int[] window, bool volumes) -> (Tensor, Tensor)")

}  // namespace kv::geometry
