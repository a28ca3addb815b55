// A link of the chains of a list: schema and entry, for CPU and CUDA.
#include "geometry/transform/composed/link_coords_list.h"
#include "geometry/transform/lists/warp_list_glue.h"

namespace kv::geometry {
namespace {

Tensor link_coords_list(Tensor const& link, std::optional<Tensor> const& coordinates,
                        std::vector<int64_t> const& before, std::vector<int64_t> const& sides) {
  constexpr char const* op = "link_coords_list";
  size_t const count = sides.size() / 2;
  bool const is_map = link.dim() == 1;
  KV_CHECK(count > 0 && sides.size() == 2 * count && before.size() == (is_map ? sides.size() : 0), op,
           ": expected height and width of each result and of each map");
  KV_CHECK(link.scalar_type() == compute_dtype(link), op, ": expected float32 or float64");
  auto const begins_of = [&](std::vector<int64_t> const& of) {
    std::vector<int64_t> const begins = offsets_in_block(2, {op, of, count}, count);
    KV_CHECK(begins.back() / kBlockUnit <= UINT32_MAX, op, ": expected smaller images");
    return begins;
  };
  std::vector<int64_t> const coords = begins_of(sides), maps = is_map ? begins_of(before) : std::vector<int64_t>{};
  KV_CHECK(is_map ? link.size(0) == maps.back()
                  : link.dim() == 3 && link.size(0) == int64_t(count) && link.size(1) == 3 && link.size(2) == 3,
           op, ": expected matrices of shape (", count, ", 3, 3), or maps of these sizes in one tensor");
  KV_CHECK(!coordinates || (coordinates->dim() == 1 && coordinates->size(0) == coords.back() &&
                            coordinates->scalar_type() == link.scalar_type() && coordinates->device() == link.device()),
           op, ": expected coordinates of shape (", coords.back(), ",), of the type and device of the link");
  Tensor const own = dense(link), from = coordinates ? dense(*coordinates) : own, y = empty({coords.back()}, link);
  dispatch_compute_dtype(op, y, [&](auto type) {
    using F = typename decltype(type)::type;
    LinkCoordsList<F> p;
    p.from = coordinates ? data_ptr<F const>(from) : nullptr;
    p.maps = is_map ? data_ptr<F const>(own) : nullptr;
    p.to = data_ptr<F>(y);
    for (size_t begin = 0; begin < count; begin += kMaxListed) {
      p.matrices = is_map ? nullptr : data_ptr<F const>(own) + 9 * begin;
      p.count = int(std::min(count - begin, size_t(kMaxListed)));
      int64_t items = 0;
      for (int i = 0; i < p.count; ++i) {
        size_t const b = begin + size_t(i);
        int64_t const h = sides[2 * b], w = sides[2 * b + 1];
        p.height[i] = int(h), p.width[i] = int(w), p.coords[i] = uint32_t(coords[b] / kBlockUnit);
        p.map_height[i] = is_map ? int(before[2 * b]) : 0, p.map_width[i] = is_map ? int(before[2 * b + 1]) : 0;
        p.map[i] = is_map ? uint32_t(maps[b] / kBlockUnit) : 0;
        p.first[i] = int(items);
        items += kOnCuda ? ceil_div(h * w, kLinkPixels) : ceil_div(h, rows_of_item(w));
        KV_CHECK(items <= INT32_MAX, op, ": expected smaller results");
      }
      p.items = int(items);
      KV_RUN(link_coords_list, link, p, items, 8 * kItemPixels);
    }
  });
  return y;
}

}  // namespace

// Where the pixels of results of a height and width each read before a link: matrices (B, 3, 3), or maps (2, H, W) of
// sizes `before` it in one tensor; behind it they read at `coordinates`, or at themselves. (2, h, w) of each in one
// tensor, as remap_list takes them.
KV_OPERATOR(link_coords_list, "(Tensor link, Tensor? coordinates, SymInt[] before, SymInt[] sides) -> Tensor")

}  // namespace kv::geometry
