// Preimages on CUDA: a warp finds each tile's bounds, a block each quadrilateral or point. The threads of a warp look
// at 32 tiles at a time, then together at the cells of those that matter.
#include "augmentation/preimages/preimages.h"
#include "core/block_reduce.cuh"

namespace kv::augmentation::cuda {
namespace {

constexpr int kThreads = 128, kWarps = kThreads / 32;

template <class F>
struct NearerFirst {
  __device__ __forceinline__ Nearest<F> operator()(Nearest<F> a, Nearest<F> const& b) const {
    if (b.index >= 0) a.add(b.key, b.index, b.position);
    return a;
  }
};

template <class F, template <class> class Grids>
__global__ void __launch_bounds__(kThreads) bound_tiles(__grid_constant__ TilesOf<F, Grids> const p) {
  int64_t const t = blockIdx.x * int64_t(kWarps) + threadIdx.x / 32;
  if (t >= p.tiles) return;
  int64_t const b = p.grids.sample_of_tile(t), of_sample = t - p.grids.tile_of_sample(b);
  MapGrid<F> const g = p.grids.sample(b);
  GridRange const r = g.nodes(of_sample);
  MapTile<F> tile{{}, 0, 1};
  for (int64_t i = r.first_row; i < r.last_row; ++i)
    for (int64_t j = r.first_column + threadIdx.x % 32; j < r.last_column; j += 32) {
      int64_t const at = g.index(i, j);
      tile.bounds.add(g.coordinates[at]);
      if (g.kinds[at] == kPixel) tile.has_pixels = 1;
      if (g.kinds[at] == kOutside) tile.is_inside = 0;
    }
  tile.bounds.low = {warp_reduce(tile.bounds.low.x, Min()), warp_reduce(tile.bounds.low.y, Min())};
  tile.bounds.high = {warp_reduce(tile.bounds.high.x, Max()), warp_reduce(tile.bounds.high.y, Max())};
  tile.has_pixels = warp_reduce(tile.has_pixels, Max());
  tile.is_inside = warp_reduce(tile.is_inside, Min());
  if (threadIdx.x % 32 == 0) g.tiles[of_sample] = tile;
}

// Calls matters(tile) for all tiles of a map, each in one thread, and visit(number of the tile) by all threads of a
// warp for those for which it is true.
template <class F, class Matters, class Visit>
__device__ __forceinline__ void for_each_tile(MapGrid<F> const& g, Matters matters, Visit visit) {
  int64_t const count = g.tile_count();
  int const lane = threadIdx.x % 32, warp = threadIdx.x / 32;
  for (int64_t first = 32 * warp; first < count; first += kThreads) {
    int64_t const t = first + lane;
    unsigned left = __ballot_sync(0xffffffffu, t < count && matters(g.tiles[min(t, count - 1)]));
    while (left != 0) {
      int const bit = __ffs(int(left)) - 1;
      left &= left - 1;
      visit(first + bit);
    }
  }
}

template <class Visit>
__device__ __forceinline__ void for_each_in(GridRange const& r, Visit visit) {
  int const columns = int(r.last_column - r.first_column), count = int(r.last_row - r.first_row) * columns;
  for (int k = threadIdx.x % 32; k < count; k += 32) visit(r.first_row + k / columns, r.first_column + k % columns);
}

template <class F, template <class> class Grids>
__global__ void __launch_bounds__(kThreads) find_extents(__grid_constant__ ExtentsOf<F, Grids> const p) {
  int64_t const n = blockIdx.x;
  MapGrid<F> const g = p.grids.sample(n / p.count);
  Quadrilateral<F> const quad(p.quads + 8 * n);
  Bounds<F> const bounds = quad.bounds();
  Point<F> directions[4];
  for (int k = 0; k < 4; ++k) directions[k] = {p.directions[8 * n + 2 * k], p.directions[8 * n + 2 * k + 1]};
  Extents<F> extents;
  for_each_tile(
      g, [&](MapTile<F> const& tile) { return tile.bounds.overlaps(bounds); },
      [&](int64_t t) {
        MapTile<F> const tile = g.tiles[t];
        GridRange const cells = g.cells(t);
        auto const grows = [&](GridRange const& r) {
          return can_grow(extents, directions, g, r, tile.has_pixels != 0);
        };
        if (!grows(cells)) return;
        if (tile.is_inside != 0 && is_within(tile, quad))
          add_tile(extents, directions, g, cells);
        else
          for_each_in(cells, [&](int64_t i, int64_t j) {
            if (grows({i, i + 1, j, j + 1})) add_cell(extents, quad, bounds, directions, Cell<F>(g, i, j));
          });
      });
  block_reduce<kThreads>(extents.values, Max());
  if (threadIdx.x < 8) p.extents[8 * n + threadIdx.x] = extents.values[threadIdx.x];
}

template <class F, template <class> class Grids>
__global__ void __launch_bounds__(kThreads) find_points(__grid_constant__ PointsOf<F, Grids> const p) {
  int64_t const n = blockIdx.x;
  MapGrid<F> const g = p.grids.sample(n / p.count);
  int64_t const count = g.tile_count();
  Point<F> const point = p.points[n];
  F largest[1] = {F(__builtin_inf())};
  for (int64_t t = threadIdx.x; t < count; t += kThreads) {
    MapTile<F> const& tile = g.tiles[t];
    if (tile.has_pixels != 0) largest[0] = min(largest[0], tile.bounds.largest_square_distance(point));
  }
  block_reduce<kThreads>(largest, Min());
  Nearest<F> pixel[] = {Nearest<F>::none()}, exact[] = {pixel[0], pixel[0]};
  for_each_tile(
      g,
      [&](MapTile<F> const& tile) {
        return tile.has_pixels != 0 && tile.bounds.square_distance(point) <= min(largest[0], pixel[0].key);
      },
      [&](int64_t t) { for_each_in(g.nodes(t), [&](int64_t i, int64_t j) { add_node(pixel[0], g, point, i, j); }); });
  block_reduce<kThreads>(pixel, NearerFirst<F>());
  for_each_tile(
      g, [&](MapTile<F> const& tile) { return tile.bounds.contains(point, F(1e-2)); },
      [&](int64_t t) {
        for_each_in(g.cells(t), [&](int64_t i, int64_t j) { add_positions(exact, g, point, pixel[0].position, i, j); });
      });
  block_reduce<kThreads>(exact, NearerFirst<F>());
  if (threadIdx.x == 0) p.kinds[n] = choose_position(g, point, pixel[0], exact, p.positions[n]);
}

template <class Kernel, class Params>
int run(Kernel kernel, int64_t blocks, Params const& p, CUstream_st* stream) {
  kernel<<<unsigned(blocks), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

}  // namespace

template <class F>
int map_tiles(MapTiles<F> const& p, CUstream_st* stream) {
  return run(bound_tiles<F, MapGrids>, ceil_div(p.tiles, kWarps), p, stream);
}
template <class F>
int map_tiles_list(MapTilesList<F> const& p, CUstream_st* stream) {
  return run(bound_tiles<F, ListedGrids>, ceil_div(p.tiles, kWarps), p, stream);
}
template <class F>
int preimage_extents(PreimageExtents<F> const& p, CUstream_st* stream) {
  return run(find_extents<F, MapGrids>, p.total, p, stream);
}
template <class F>
int preimage_extents_list(PreimageExtentsList<F> const& p, CUstream_st* stream) {
  return run(find_extents<F, ListedGrids>, p.total, p, stream);
}
template <class F>
int preimage_points(PreimagePoints<F> const& p, CUstream_st* stream) {
  return run(find_points<F, MapGrids>, p.total, p, stream);
}
template <class F>
int preimage_points_list(PreimagePointsList<F> const& p, CUstream_st* stream) {
  return run(find_points<F, ListedGrids>, p.total, p, stream);
}

KV_INSTANTIATE_COMPUTED(map_tiles, MapTiles)
KV_INSTANTIATE_COMPUTED(map_tiles_list, MapTilesList)
KV_INSTANTIATE_COMPUTED(preimage_extents, PreimageExtents)
KV_INSTANTIATE_COMPUTED(preimage_extents_list, PreimageExtentsList)
KV_INSTANTIATE_COMPUTED(preimage_points, PreimagePoints)
KV_INSTANTIATE_COMPUTED(preimage_points_list, PreimagePointsList)

}  // namespace kv::augmentation::cuda
