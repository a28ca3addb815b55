// A link of the chains of a list on the CPU: items [begin, end) of all samples. Compiled once per instruction set.
#include "core/iota.h"
#include "geometry/transform/composed/read_lanes.h"
// After core/lanes.h, whose vectors it uses.
#include "geometry/transform/composed/link_coords_list.h"

namespace kv::geometry::KV_ISA {

template <class F>
void link_coords_list(LinkCoordsList<F> const& p, int64_t begin, int64_t end) {
  for_each_sample(p, begin, end, [&](int b, int64_t first, int64_t last) {
    int64_t const height = p.height[b], width = p.width[b], plane = height * width, rows = rows_of_item(width);
    Link<F> const link = p.link(b);
    Homography<F> inverse{};
    if (link.is_matrix()) inverse = narrowed<F>(link.inverse(0));
    F const* const from = p.from ? p.from + p.offset(b) : nullptr;
    F* const to = p.to + p.offset(b);
    for (int64_t y = first * rows; y < min(last * rows, height); ++y)
      for_each_vector<F>(0, width, [&](auto lanes, int64_t x) {
        constexpr int N = decltype(lanes)::value;
        int64_t const at = y * width + x;
        Lanes<F, N> u[] = {from ? load<N>(from + at) : iota<N, F>(x)};
        Lanes<F, N> v[] = {from ? load<N>(from + plane + at) : broadcast<N>(F(y))};
        follow(link, inverse, 0, u, v, ReadLanes{});
        store<N>(to + at, u[0]);
        store<N>(to + plane + at, v[0]);
      });
  });
}

KV_INSTANTIATE_COMPUTED(link_coords_list, LinkCoordsList)

}  // namespace kv::geometry::KV_ISA
