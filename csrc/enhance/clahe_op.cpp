// CLAHE: schema and entry, for CPU and CUDA.
#include "clahe.h"
#include "plane_views.h"

namespace kv::enhance {
namespace {

constexpr int64_t kMaxTiles = (1 << 15) - 1;  // along an axis

// Tiles of equal size. Where one axis needs padding, OpenCV pads the other one as well.
TileAxis axis_of(int64_t pixels, int64_t tiles, bool fits, bool opencv) {
  int64_t const size = opencv && !fits ? pixels / tiles + 1 : ceil_div(pixels, tiles);
  return {int(tiles), int(size), int(pixels), !opencv};
}

// `clip_limits`, if it has data, has the limits of the images or channels.
Tensor equalize_clahe(Tensor const& input, std::optional<Tensor> const& clip_limits, double clip_limit, int64_t rows,
                      int64_t columns, bool opencv) {
  constexpr char const* op = "equalize_clahe";
  check_planes(op, input);
  int64_t const h = input.size(2), w = input.size(3);
  KV_CHECK(rows > 0 && columns > 0 && rows <= kMaxTiles && columns <= kMaxTiles, op, ": expected a grid of 1 to ",
           kMaxTiles, " tiles along each axis, got ", rows, " x ", columns);
  bool const fits = h % rows == 0 && w % columns == 0;
  TileAxis const down = axis_of(h, rows, fits, opencv), across = axis_of(w, columns, fits, opencv);
  int64_t const pixels = int64_t(down.size) * across.size;
  KV_CHECK(pixels <= INT32_MAX, op, ": expected tiles of fewer than 2^31 pixels");

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
    Clahe<T> const params{channel_planes<T const>(x, layout),
                          channel_planes<T>(y, layout),
                          down,
                          across,
                          limit_of_counts(clip_limit, pixels),
                          plane_parameter<Compute<T>>(op, "clip_limits", x, clip_limits, 0),
                          opencv,
                          tables,
                          has_nan};
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
