// Preimages of quadrilaterals and points: schemas and entries, for CPU and CUDA.
#include "augmentation/preimages/preimages.h"
#include "augmentation/preimages/result_sizes.h"
#include "glue/glue.h"

namespace kv::augmentation {
namespace {

template <class Run>
void dispatch_computed(Tensor const& x, Run run) {
  x.scalar_type() == ScalarType::Double ? run(Type<double>{}) : run(Type<float>{});
}

template <class F>
Tensor empty_tiles(int64_t count, Tensor const& like) {
  static_assert(sizeof(MapTile<F>) == 6 * sizeof(F));
  return empty({count, 6}, like);
}

bool is_like(Tensor const& t, ScalarType type, Tensor const& other) {
  return t.scalar_type() == type && t.device() == other.device();
}

// Maps (B, H, W) of nodes at x and y.
struct PreimageMaps {
  Tensor coordinates, kinds, x, y;
  int64_t margin;

  PreimageMaps(char const* op, Tensor const& queries, Tensor const& coordinates_, Tensor const& kinds_,
               Tensor const& x_, Tensor const& y_, int64_t margin_)
      : coordinates(coordinates_), kinds(kinds_), x(x_), y(y_), margin(margin_) {
    KV_CHECK(queries.scalar_type() == compute_dtype(queries), op, ": expected float32 or float64");
    KV_CHECK(coordinates.dim() == 4 && coordinates.size(3) == 2 && coordinates.size(1) > 1 && coordinates.size(2) > 1,
             op, ": expected coordinates of shape (B, H, W, 2) of two nodes or more along each axis");
    int64_t const batch = coordinates.size(0), rows = coordinates.size(1), columns = coordinates.size(2);
    KV_CHECK(rows <= INT32_MAX / columns, op, ": expected fewer than 2^31 nodes a sample");
    KV_CHECK(is_like(coordinates, queries.scalar_type(), queries) && queries.size(0) == batch, op,
             ": expected coordinates of the type, the device and the batch of the first argument");
    KV_CHECK(kinds.dim() == 3 && kinds.size(0) == batch && kinds.size(1) == rows && kinds.size(2) == columns &&
                 is_like(kinds, ScalarType::Byte, queries),
             op, ": expected uint8 kinds of shape (B, H, W)");
    auto const is_axis = [&](Tensor const& t, int64_t count) {
      return t.dim() == 2 && t.size(0) == 1 && t.size(1) == count && is_like(t, queries.scalar_type(), queries);
    };
    KV_CHECK(is_axis(x, columns) && is_axis(y, rows), op, ": expected x of shape (1, W) and y of shape (1, H)");
    KV_CHECK(margin >= 0 && margin <= (rows - 1) / 2 && margin <= (columns - 1) / 2, op,
             ": expected a margin within the map, got ", margin);
    coordinates = dense(coordinates), kinds = dense(kinds), x = dense(x), y = dense(y);
  }

  // Calls run(maps, first sample, number of samples) with the bounds of tiles.
  template <class F, class Run>
  void for_each_table(Run run) const {
    MapGrids<F> grids{{data_ptr<Point<F> const>(coordinates), data_ptr<uint8_t const>(kinds), data_ptr<F const>(x),
                       data_ptr<F const>(y), nullptr, coordinates.size(1), coordinates.size(2), margin}};
    int64_t const batch = coordinates.size(0), count = batch * grids.first.tile_count();
    Tensor const tiles = empty_tiles<F>(count, coordinates);
    grids.first.tiles = data_ptr<MapTile<F>>(tiles);
    MapTiles<F> const params{{grids, count}};
    KV_RUN(map_tiles, tiles, params, count, kTile * kTile);
    run(grids, int64_t(0), batch);
  }
};

// Maps of results of a size each, one after the other: coordinates (N, 2) and kinds (N,).
struct PreimageMapsList {
  Tensor coordinates, kinds;
  ResultSizes sizes;

  PreimageMapsList(char const* op, Tensor const& queries, Tensor const& coordinates_, Tensor const& kinds_,
                   std::vector<int64_t> const& sides, std::vector<int64_t> const& margins)
      : coordinates(coordinates_), kinds(kinds_), sizes(op, sides, margins) {
    KV_CHECK(queries.scalar_type() == compute_dtype(queries), op, ": expected float32 or float64");
    KV_CHECK(queries.size(0) == sizes.count(), op, ": expected height and width of ", queries.size(0), " results");
    check_nodes(op, coordinates, kinds, sizes.nodes.back(), queries.scalar_type(), queries);
    coordinates = dense(coordinates), kinds = dense(kinds);
  }

  template <class F, class Run>
  void for_each_table(Run run) const {
    ListedGrids<F> grids{};
    grids.first.coordinates = data_ptr<Point<F> const>(coordinates), grids.first.kinds = data_ptr<uint8_t const>(kinds);
    for (int64_t first = 0; first < sizes.count(); first += kMaxListed) {
      grids.count = int(std::min(sizes.count() - first, int64_t(kMaxListed)));
      int64_t count = 0;
      for (int i = 0; i < grids.count; ++i) {
        size_t const b = size_t(first + i);
        MapGrid<F> g{};
        g.rows = sizes.rows(b), g.columns = sizes.columns(b), g.margin = sizes.margins[b];
        grids.rows[i] = int(g.rows), grids.columns[i] = int(g.columns), grids.margin[i] = int(g.margin);
        grids.node[i] = sizes.nodes[b], grids.tile[i] = int(count);
        count += g.tile_count();
        KV_CHECK(count <= INT32_MAX, "preimages: expected smaller results");
      }
      Tensor const tiles = empty_tiles<F>(count, coordinates);
      grids.first.tiles = data_ptr<MapTile<F>>(tiles);
      MapTilesList<F> const params{{grids, count}};
      KV_RUN(map_tiles_list, tiles, params, count, kTile * kTile);
      run(grids, first, int64_t(grids.count));
    }
  }
};

void check_quads(char const* op, Tensor const& quads, Tensor const& directions) {
  KV_CHECK(quads.dim() == 3 && quads.size(2) == 8, op, ": expected quads of shape (B, N, 8)");
  check_like(op, "directions", directions, quads);
}

void check_points(char const* op, Tensor const& points) {
  KV_CHECK(points.dim() == 3 && points.size(2) == 2, op, ": expected points of shape (B, N, 2)");
}

template <class Maps, class Run>
Tensor find_extents(Maps const& maps, Tensor const& quads, Tensor const& directions, Run run) {
  int64_t const batch = quads.size(0), count = quads.size(1);
  Tensor const q = dense(quads), d = dense(directions), extents = empty({batch, count, 8}, quads);
  if (batch * count == 0) return extents;
  dispatch_computed(quads, [&]<class F>(Type<F>) {
    maps.template for_each_table<F>([&]<template <class> class Grids>(Grids<F> const& grids, int64_t first, int64_t n) {
      int64_t const at = 8 * first * count;
      ExtentsOf<F, Grids> const params{
          grids, data_ptr<F const>(q) + at, data_ptr<F const>(d) + at, data_ptr<F>(extents) + at, count, n * count};
      run(params);
    });
  });
  return extents;
}

template <class Maps, class Run>
std::tuple<Tensor, Tensor> find_points(Maps const& maps, Tensor const& points, Run run) {
  int64_t const batch = points.size(0), count = points.size(1);
  Tensor const p = dense(points), positions = empty({batch, count, 2}, points),
               kinds = empty({batch, count}, points, Layout::planar, ScalarType::Byte);
  if (batch * count == 0) return {positions, kinds};
  dispatch_computed(points, [&]<class F>(Type<F>) {
    maps.template for_each_table<F>([&]<template <class> class Grids>(Grids<F> const& grids, int64_t first, int64_t n) {
      int64_t const at = first * count;
      PointsOf<F, Grids> const params{grids,
                                      data_ptr<Point<F> const>(p) + at,
                                      data_ptr<Point<F>>(positions) + at,
                                      data_ptr<uint8_t>(kinds) + at,
                                      count,
                                      n * count};
      run(params);
    });
  });
  return {positions, kinds};
}

Tensor preimage_extents(Tensor const& quads, Tensor const& directions, Tensor const& coordinates, Tensor const& kinds,
                        Tensor const& x, Tensor const& y, int64_t margin) {
  constexpr char const* op = "preimage_extents";
  check_quads(op, quads, directions);
  PreimageMaps const maps(op, quads, coordinates, kinds, x, y, margin);
  return find_extents(maps, quads, directions, [&]<class F>(ExtentsOf<F, MapGrids> const& all) {
    PreimageExtents<F> const params{all};
    KV_RUN(preimage_extents, quads, params, params.total, 32768);
  });
}

Tensor preimage_extents_list(Tensor const& quads, Tensor const& directions, Tensor const& coordinates,
                             Tensor const& kinds, std::vector<int64_t> const& sides,
                             std::vector<int64_t> const& margins) {
  constexpr char const* op = "preimage_extents_list";
  check_quads(op, quads, directions);
  PreimageMapsList const maps(op, quads, coordinates, kinds, sides, margins);
  return find_extents(maps, quads, directions, [&]<class F>(ExtentsOf<F, ListedGrids> const& all) {
    PreimageExtentsList<F> const params{all};
    KV_RUN(preimage_extents_list, quads, params, params.total, 32768);
  });
}

std::tuple<Tensor, Tensor> preimage_points(Tensor const& points, Tensor const& coordinates, Tensor const& kinds,
                                           Tensor const& x, Tensor const& y, int64_t margin) {
  constexpr char const* op = "preimage_points";
  check_points(op, points);
  PreimageMaps const maps(op, points, coordinates, kinds, x, y, margin);
  return find_points(maps, points, [&]<class F>(PointsOf<F, MapGrids> const& all) {
    PreimagePoints<F> const params{all};
    KV_RUN(preimage_points, points, params, params.total, 8192);
  });
}

std::tuple<Tensor, Tensor> preimage_points_list(Tensor const& points, Tensor const& coordinates, Tensor const& kinds,
                                                std::vector<int64_t> const& sides,
                                                std::vector<int64_t> const& margins) {
  constexpr char const* op = "preimage_points_list";
  check_points(op, points);
  PreimageMapsList const maps(op, points, coordinates, kinds, sides, margins);
  return find_points(maps, points, [&]<class F>(PointsOf<F, ListedGrids> const& all) {
    PreimagePointsList<F> const params{all};
    KV_RUN(preimage_points_list, points, params, params.total, 8192);
  });
}

}  // namespace

// Where a map of nodes reads the inside of quadrilaterals, and points. result_map.py says what the arguments are.
KV_OPERATOR(
    preimage_extents,
    "(Tensor quads, Tensor directions, Tensor coordinates, Tensor kinds, Tensor x, Tensor y, int margin) -> Tensor")
KV_OPERATOR(preimage_points,
            "(Tensor points, Tensor coordinates, Tensor kinds, Tensor x, Tensor y, int margin) -> (Tensor, Tensor)")
KV_OPERATOR(preimage_extents_list,
            "(Tensor quads, Tensor directions, Tensor coordinates, Tensor kinds, SymInt[] sides, SymInt[] margins) -> "
            "Tensor")
KV_OPERATOR(preimage_points_list,
            "(Tensor points, Tensor coordinates, Tensor kinds, SymInt[] sides, SymInt[] margins) -> (Tensor, Tensor)")

}  // namespace kv::augmentation
