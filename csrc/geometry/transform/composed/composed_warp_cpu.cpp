// Chains of matrices and maps on the CPU: rows or bands of rows [begin, end) of all results, and samples in the
// backward pass. Compiled once per instruction set.
#include "core/iota.h"
#include "core/lanes.h"
#include "core/scratch.h"
#include "geometry/transform/composed/read_lanes.h"

namespace kv::geometry::KV_ISA {
namespace {

// The inverses of the matrices of the current sample.
template <class F>
struct Inverses {
  Homography<F> maps[kMaxLinks];
  int64_t sample = -1;

  KV_HD Homography<F> const* of(Chain<F> const& chain, int64_t b) {
    if (sample != b)
      for (int k = 0; k < chain.count; ++k)
        if (chain.links[k].is_matrix()) maps[k] = narrowed<F>(chain.links[k].inverse(b));
    sample = b;
    return maps;
  }
};

// The sampling coordinates of row y.
template <class F>
void coords_of_row(Chain<F> const& chain, Homography<F> const* inverses, int64_t b, int64_t y, int64_t width, F* to_x,
                   F* to_y) {
  for_each_vector<F>(0, width, [&](auto lanes, int64_t x) {
    constexpr int N = decltype(lanes)::value;
    Lanes<F, N> u[] = {iota<N, F>(x)}, v[] = {broadcast<N>(F(y))};
    walk(chain, inverses, b, u, v, ReadLanes{});
    store<N>(to_x + x, u[0]);
    store<N>(to_y + x, v[0]);
  });
}

}  // namespace

template <class T>
void composed_coords(ComposedCoords<T> const& p, int64_t begin, int64_t end) {
  Inverses<T> inverses;
  for (int64_t row = begin; row < end; ++row) {
    int64_t const b = row / p.result.height, y = row - b * p.result.height;
    coords_of_row(p.chain, inverses.of(p.chain, b), b, y, p.result.width, p.result.row(b, 0, y), p.result.row(b, 1, y));
  }
}

template <class T>
void composed_coords_backward(ComposedCoordsBackward<T> const& p, int64_t begin, int64_t end) {
  Inverses<T> inverses;
  for (int64_t b = begin; b < end; ++b) {
    double sums[kMaxLinks][9] = {};
    Homography<T> const* const maps = inverses.of(p.chain, b);
    for (int64_t y = 0; y < p.grad.height; ++y)
      for (int64_t x = 0; x < p.grad.width; ++x) {
        int64_t const at = x * p.grad.step;
        walk_vjp(p.chain, maps, b, T(x), T(y), p.grad.row(b, 0, y)[at], p.grad.row(b, 1, y)[at], sums,
                 [&](int k, int64_t offset, T g) KV_INLINE {
                   Link<T> const& link = p.chain.links[k];
                   if (p.grads[k]) p.grads[k][2 * b * link.height * link.width + offset] += g;
                 });
      }
    for (int k = 0; k < p.chain.count; ++k) {
      Link<T> const& link = p.chain.links[k];
      if (link.is_matrix() && p.grads[k]) homography_vjp(link.of(b), link.use(), sums[k], p.grads[k] + 9 * b);
    }
  }
}

template <class T>
void composed_warp(ComposedWarp<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  Images<T> const& y = p.y;
  int64_t const rows = rows_of_band(y.width), bands = bands_of(y.height, y.width), plane = rows * y.width;
  Scratch<F> coords(2 * plane);
  Inverses<F> inverses;
  for (int64_t band = begin; band < end; ++band) {
    int64_t const b = band / bands, first = (band - b * bands) * rows, count = min(rows, y.height - first);
    for (int64_t row = 0; row < count; ++row)
      coords_of_row(p.chain, inverses.of(p.chain, b), b, first + row, y.width, coords.data + row * y.width,
                    coords.data + plane + row * y.width);
    Sample<T> sampling = p;
    Images<F const> const map{coords.data - first * y.width, 0, 0, y.width, 1, y.batch, y.height, y.width, 1};
    sampling.coords.x = sampling.coords.y = map;
    sampling.coords.y.data += plane;
    sampling.coords.scale[0] = sampling.coords.scale[1] = 1;
    sample(sampling, b * y.height + first, b * y.height + first + count);
  }
}

KV_INSTANTIATE_COMPUTED(composed_coords, ComposedCoords)
KV_INSTANTIATE_COMPUTED(composed_coords_backward, ComposedCoordsBackward)
KV_INSTANTIATE_WITH_BYTES(composed_warp, ComposedWarp)

}  // namespace kv::geometry::KV_ISA
