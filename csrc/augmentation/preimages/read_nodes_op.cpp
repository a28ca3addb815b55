// Nodes of maps of a list: schema and entry, for CPU and CUDA.
#include "augmentation/preimages/read_nodes.h"
#include "augmentation/preimages/result_sizes.h"
#include "geometry/transform/lists/list_glue.h"

namespace kv::augmentation {
namespace {

// `moved` says which samples have a map among those of `link`; `bounded` which read only the image.
std::tuple<Tensor, Tensor> read_nodes_list(Tensor const& link, std::optional<Tensor> const& coordinates,
                                           std::optional<Tensor> const& kinds, std::vector<int64_t> const& before,
                                           std::vector<int64_t> const& moved, std::vector<int64_t> const& bounded,
                                           std::vector<int64_t> const& sides, std::vector<int64_t> const& margins) {
  constexpr char const* op = "read_nodes_list";
  ResultSizes const sizes(op, sides, margins);
  size_t const count = margins.size();
  KV_CHECK(link.scalar_type() == compute_dtype(link), op, ": expected float32 or float64");
  KV_CHECK(before.size() == 2 * count && moved.size() == count && bounded.size() == count, op, ": expected sizes of ",
           count, " images, and which of them are moved and bounded");
  KV_CHECK(bool(coordinates) == bool(kinds), op, ": expected both coordinates and kinds, or none");
  int64_t const nodes = sizes.nodes.back();
  if (coordinates) check_nodes(op, *coordinates, *kinds, nodes, link.scalar_type(), link);
  std::vector<int64_t> maps(count, -1);
  int64_t length = 0;
  for (size_t b = 0; b < count; ++b) {
    int64_t const h = before[2 * b], w = before[2 * b + 1];
    KV_CHECK(h > 0 && w > 0 && h <= INT32_MAX / w, op, ": expected images of 1 to 2^31 pixels");
    if (!moved[b]) continue;
    KV_CHECK(coordinates || link.dim() > 1 || (h == sides[2 * b] && w == sides[2 * b + 1]), op,
             ": expected maps of the sizes of results");
    maps[b] = length;
    length += ceil_div(2 * h * w, 16) * 16;
  }
  bool const is_map = link.dim() == 1;
  if (is_map)
    KV_CHECK(link.size(0) == length, op, ": expected maps of ", length, " numbers, got ", link.size(0));
  else
    KV_CHECK(link.dim() == 3 && link.size(0) == int64_t(count) && link.size(1) == 3 && link.size(2) == 3, op,
             ": expected matrices of shape (", count, ", 3, 3)");
  Tensor const own = dense(link), from = coordinates ? dense(*coordinates) : own,
               from_kinds = kinds ? dense(*kinds) : own, y = empty({nodes, 2}, link),
               of_y = empty({nodes}, link, Layout::planar, ScalarType::Byte);
  auto const run = [&]<class F>(Type<F>) {
    ReadNodes<F> p;
    p.from = coordinates ? data_ptr<Point<F> const>(from) : nullptr;
    p.from_kinds = kinds ? data_ptr<uint8_t const>(from_kinds) : nullptr;
    p.maps = is_map ? data_ptr<F const>(own) : nullptr;
    p.coordinates = data_ptr<Point<F>>(y), p.kinds = data_ptr<uint8_t>(of_y);
    for (size_t first = 0; first < count; first += kMaxListed) {
      p.matrices = is_map ? nullptr : data_ptr<F const>(own) + 9 * first;
      p.count = int(std::min(count - first, size_t(kMaxListed)));
      int64_t items = 0;
      for (int i = 0; i < p.count; ++i) {
        size_t const b = first + size_t(i);
        p.rows[i] = int(sizes.rows(b)), p.columns[i] = int(sizes.columns(b));
        p.height[i] = int(before[2 * b]), p.width[i] = int(before[2 * b + 1]);
        p.node[i] = sizes.nodes[b], p.map[i] = maps[b], p.margin[i] = uint8_t(margins[b]);
        p.is_bounded[i] = bounded[b] != 0;
        p.first[i] = int(items);
        items += ceil_div(sizes.rows(b), rows_of_item(sizes.columns(b)));
        KV_CHECK(items <= INT32_MAX, op, ": expected smaller results");
      }
      p.items = int(items);
      KV_RUN(read_nodes_list, link, p, items, 16 * kItemPixels);
    }
  };
  link.scalar_type() == ScalarType::Double ? run(Type<double>{}) : run(Type<float>{});
  return {y, of_y};
}

}  // namespace

// Where nodes read images, and their kinds. result_map_list.py says what the arguments are.
KV_OPERATOR(read_nodes_list,
            "(Tensor link, Tensor? coordinates, Tensor? kinds, SymInt[] before, int[] moved, int[] bounded, SymInt[] "
            "sides, SymInt[] margins) -> (Tensor, Tensor)")

}  // namespace kv::augmentation
