// CLAHE: schema and entry, for CPU and CUDA.
#include "clahe.h"
#include "plane_views.h"

namespace kv::enhance {
namespace {

// `clip_limits`, if it has data, has the limits of the images or channels.
Tensor equalize_clahe(Tensor const& input, std::optional<Tensor> const& clip_limits, double clip_limit, int64_t rows,
                      int64_t columns, bool opencv) {
  constexpr char const* op = "equalize_clahe";
  check_planes(op, input);
  int64_t const h = input.size(2), w = input.size(3);
  KV_CHECK(rows > 0 && columns > 0 && rows <= kMaxTiles && columns <= kMaxTiles, op, ": expected a grid of 1 to ",
           kMaxTiles, " tiles along each axis, got ", rows, " x ", columns);
  KV_CHECK((h / rows + 1) * (w / columns + 1) <= INT32_MAX, op, ": expected tiles of fewer than 2^31 pixels");

  Layout const layout = layout_of(input);
  Tensor const x = as_layout(input, layout), y = empty_like(x, layout);
  int64_t const planes = x.size(0) * x.size(1);
#if defined(KV_CUDA)
  bool const by_cells = true;
#else
  bool const by_cells = planes < kManyPlanes && h * w >= kLargePlane;
#endif
  Tensor const memory =
      empty({by_cells ? planes : 0, rows * (columns * kLevels + 1)}, x, Layout::planar, ScalarType::Byte);
  uint8_t *const tables = by_cells ? static_cast<uint8_t*>(memory.mutable_data_ptr()) : nullptr,
                 *const has_nan = by_cells ? tables + planes * rows * columns * kLevels : nullptr;
  dispatch_floating_and_uint8(op, x, [&](auto type) {
    using T = typename decltype(type)::type;
    Clahe<T> params{};
    params.x = channel_planes<T const>(x, layout), params.y = channel_planes<T>(y, layout);
    params.clip_limits = plane_parameter<Compute<T>>(op, "clip_limits", x, clip_limits, 0);
    params.to_levels = opencv;
    params.tables = tables, params.has_nan = has_nan;
    params.set_axes(h, w, rows, columns, clip_limit);
#if !defined(KV_CUDA)
    if (by_cells) KV_RUN(clahe_tables, x, params, planes * rows, 2 * h * w / rows);
#endif
    KV_RUN(clahe, x, params, by_cells ? planes * (rows + 1) : planes, by_cells ? 2 * h * w / rows : 4 * h * w);
  });
  return y;
}

}  // namespace

KV_OPERATOR(equalize_clahe,
            "(Tensor input, Tensor? clip_limits, float clip_limit, int rows, int columns, bool opencv) -> Tensor")

}  // namespace kv::enhance
