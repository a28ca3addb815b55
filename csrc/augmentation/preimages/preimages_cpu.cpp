// Preimages on the CPU: tiles, quadrilaterals or points [begin, end) of all samples. Compiled once per instruction set.
#include "augmentation/preimages/preimages.h"

namespace kv::augmentation::KV_ISA {
namespace {

template <class F, template <class> class Grids>
KV_HD void bound_tiles(TilesOf<F, Grids> const& p, int64_t begin, int64_t end) {
  for (int64_t t = begin; t < end; ++t) {
    int64_t const b = p.grids.sample_of_tile(t), tile = t - p.grids.tile_of_sample(b);
    MapGrid<F> const g = p.grids.sample(b);
    g.tiles[tile] = tile_of_nodes(g, tile);
  }
}

template <class F, template <class> class Grids>
KV_HD void find_extents(ExtentsOf<F, Grids> const& p, int64_t begin, int64_t end) {
  for (int64_t n = begin; n < end; ++n) {
    MapGrid<F> const g = p.grids.sample(n / p.count);
    Quadrilateral<F> const quad(p.quads + 8 * n);
    Bounds<F> const bounds = quad.bounds();
    Point<F> directions[4];
    for (int k = 0; k < 4; ++k) directions[k] = {p.directions[8 * n + 2 * k], p.directions[8 * n + 2 * k + 1]};
    Extents<F> extents;
    for (int64_t t = 0; t < g.tile_count(); ++t) {
      MapTile<F> const& tile = g.tiles[t];
      if (!tile.bounds.overlaps(bounds)) continue;
      GridRange const cells = g.cells(t);
      bool const has_pixels = tile.has_pixels != 0;
      auto const grows = [&](GridRange const& r) KV_INLINE { return can_grow(extents, directions, g, r, has_pixels); };
      if (!grows(cells)) continue;
      if (tile.is_inside != 0 && is_within(tile, quad)) {
        add_tile(extents, directions, g, cells);
        continue;
      }
      for (int64_t i = cells.first_row; i < cells.last_row; ++i) {
        if (!grows({i, i + 1, cells.first_column, cells.last_column})) continue;
        for (int64_t j = cells.first_column; j < cells.last_column; ++j)
          if (grows({i, i + 1, j, j + 1})) add_cell(extents, quad, bounds, directions, Cell<F>(g, i, j));
      }
    }
    for (int k = 0; k < 8; ++k) p.extents[8 * n + k] = extents.values[k];
  }
}

template <class F, template <class> class Grids>
KV_HD void find_points(PointsOf<F, Grids> const& p, int64_t begin, int64_t end) {
  for (int64_t n = begin; n < end; ++n) {
    MapGrid<F> const g = p.grids.sample(n / p.count);
    int64_t const count = g.tile_count();
    MapTile<F> const* const tiles = g.tiles;
    Point<F> const point = p.points[n];
    F largest = F(__builtin_inf());
    for (int64_t t = 0; t < count; ++t)
      if (tiles[t].has_pixels != 0) largest = min(largest, tiles[t].bounds.largest_square_distance(point));
    Nearest<F> pixel = Nearest<F>::none(), exact[] = {pixel, pixel};
    for (int64_t t = 0; t < count; ++t) {
      if (tiles[t].has_pixels == 0 || !(tiles[t].bounds.square_distance(point) <= min(largest, pixel.key))) continue;
      GridRange const nodes = g.nodes(t);
      for (int64_t i = nodes.first_row; i < nodes.last_row; ++i)
        for (int64_t j = nodes.first_column; j < nodes.last_column; ++j) add_node(pixel, g, point, i, j);
    }
    for (int64_t t = 0; t < count; ++t) {
      if (!tiles[t].bounds.contains(point, F(1e-2))) continue;
      GridRange const cells = g.cells(t);
      for (int64_t i = cells.first_row; i < cells.last_row; ++i)
        for (int64_t j = cells.first_column; j < cells.last_column; ++j)
          add_positions(exact, g, point, pixel.position, i, j);
    }
    p.kinds[n] = choose_position(g, point, pixel, exact, p.positions[n]);
  }
}

}  // namespace

template <class F>
void map_tiles(MapTiles<F> const& p, int64_t begin, int64_t end) {
  bound_tiles(p, begin, end);
}
template <class F>
void map_tiles_list(MapTilesList<F> const& p, int64_t begin, int64_t end) {
  bound_tiles(p, begin, end);
}
template <class F>
void preimage_extents(PreimageExtents<F> const& p, int64_t begin, int64_t end) {
  find_extents(p, begin, end);
}
template <class F>
void preimage_extents_list(PreimageExtentsList<F> const& p, int64_t begin, int64_t end) {
  find_extents(p, begin, end);
}
template <class F>
void preimage_points(PreimagePoints<F> const& p, int64_t begin, int64_t end) {
  find_points(p, begin, end);
}
template <class F>
void preimage_points_list(PreimagePointsList<F> const& p, int64_t begin, int64_t end) {
  find_points(p, begin, end);
}

KV_INSTANTIATE_COMPUTED(map_tiles, MapTiles)
KV_INSTANTIATE_COMPUTED(map_tiles_list, MapTilesList)
KV_INSTANTIATE_COMPUTED(preimage_extents, PreimageExtents)
KV_INSTANTIATE_COMPUTED(preimage_extents_list, PreimageExtentsList)
KV_INSTANTIATE_COMPUTED(preimage_points, PreimagePoints)
KV_INSTANTIATE_COMPUTED(preimage_points_list, PreimagePointsList)

}  // namespace kv::augmentation::KV_ISA
