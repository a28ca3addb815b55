// Preimages of quadrilaterals and points: schemas and entries, for CPU and CUDA.
#include "augmentation/preimages/preimages.h"
#include "glue/glue.h"

namespace kv::augmentation {
namespace {

// The tensors of a map, and the bounds of its tiles.
struct PreimageMap {
  Tensor coordinates, kinds, x, y, tiles;
  int64_t margin;

  template <class F>
  MapGrid<F> grid() const {
    return {data_ptr<Point<F> const>(coordinates),
            data_ptr<uint8_t const>(kinds),
            data_ptr<F const>(x),
            data_ptr<F const>(y),
            data_ptr<MapTile<F>>(tiles),
            coordinates.size(0),
            coordinates.size(1),
            coordinates.size(2),
            margin};
  }
};

PreimageMap check_map(char const* op, Tensor const& queries, Tensor const& coordinates, Tensor const& kinds,
                      Tensor const& x, Tensor const& y, int64_t margin) {
  KV_CHECK(queries.scalar_type() == compute_dtype(queries), op, ": expected float32 or float64");
  KV_CHECK(coordinates.dim() == 4 && coordinates.size(3) == 2 && coordinates.size(1) > 1 && coordinates.size(2) > 1, op,
           ": expected coordinates of shape (B, H, W, 2) of two nodes or more along each axis");
  int64_t const batch = coordinates.size(0), rows = coordinates.size(1), columns = coordinates.size(2);
  KV_CHECK(rows <= INT32_MAX / columns, op, ": expected fewer than 2^31 nodes a sample");
  auto const is_like = [&](Tensor const& t, ScalarType type) {
    return t.scalar_type() == type && t.device() == queries.device();
  };
  KV_CHECK(is_like(coordinates, queries.scalar_type()) && queries.size(0) == batch, op,
           ": expected coordinates of the type, the device and the batch of the first argument");
  KV_CHECK(kinds.dim() == 3 && kinds.size(0) == batch && kinds.size(1) == rows && kinds.size(2) == columns &&
               is_like(kinds, ScalarType::Byte),
           op, ": expected uint8 kinds of shape (B, H, W)");
  auto const is_axis = [&](Tensor const& t, int64_t count) {
    return t.dim() == 2 && t.size(0) == 1 && t.size(1) == count && is_like(t, queries.scalar_type());
  };
  KV_CHECK(is_axis(x, columns) && is_axis(y, rows), op, ": expected x of shape (1, W) and y of shape (1, H)");
  KV_CHECK(margin >= 0 && margin <= (rows - 1) / 2 && margin <= (columns - 1) / 2, op,
           ": expected a margin within the map, got ", margin);
  auto const along = [&](int64_t nodes) { return MapGrid<float>::tiles_along(nodes - 1, margin); };
  Tensor const tiles = empty({batch * along(rows) * along(columns), 6}, queries);
  return {dense(coordinates), dense(kinds), dense(x), dense(y), tiles, margin};
}

template <class F>
void find_tiles(PreimageMap const& map) {
  static_assert(sizeof(MapTile<F>) == 6 * sizeof(F));
  MapTiles<F> const params{map.grid<F>()};
  KV_RUN(map_tiles, map.tiles, params, map.tiles.size(0), kTile * kTile);
}

template <class Run>
void dispatch_computed(Tensor const& x, Run run) {
  x.scalar_type() == ScalarType::Double ? run(Type<double>{}) : run(Type<float>{});
}

Tensor preimage_extents(Tensor const& quads, Tensor const& directions, Tensor const& coordinates, Tensor const& kinds,
                        Tensor const& x, Tensor const& y, int64_t margin) {
  constexpr char const* op = "preimage_extents";
  KV_CHECK(quads.dim() == 3 && quads.size(2) == 8, op, ": expected quads of shape (B, N, 8)");
  check_like(op, "directions", directions, quads);
  PreimageMap const map = check_map(op, quads, coordinates, kinds, x, y, margin);
  int64_t const batch = quads.size(0), count = quads.size(1);
  Tensor const q = dense(quads), d = dense(directions), extents = empty({batch, count, 8}, quads);
  if (batch * count == 0) return extents;
  dispatch_computed(quads, [&]<class F>(Type<F>) {
    find_tiles<F>(map);
    PreimageExtents<F> const params{map.grid<F>(), data_ptr<F const>(q), data_ptr<F const>(d), data_ptr<F>(extents),
                                    count};
    KV_RUN(preimage_extents, quads, params, batch * count, 32768);
  });
  return extents;
}

std::tuple<Tensor, Tensor> preimage_points(Tensor const& points, Tensor const& coordinates, Tensor const& kinds,
                                           Tensor const& x, Tensor const& y, int64_t margin) {
  constexpr char const* op = "preimage_points";
  KV_CHECK(points.dim() == 3 && points.size(2) == 2, op, ": expected points of shape (B, N, 2)");
  PreimageMap const map = check_map(op, points, coordinates, kinds, x, y, margin);
  int64_t const batch = points.size(0), count = points.size(1);
  Tensor const p = dense(points), positions = empty({batch, count, 2}, points),
               of_positions = empty({batch, count}, points, Layout::planar, ScalarType::Byte);
  if (batch * count == 0) return {positions, of_positions};
  dispatch_computed(points, [&]<class F>(Type<F>) {
    find_tiles<F>(map);
    PreimagePoints<F> const params{map.grid<F>(), data_ptr<Point<F> const>(p), data_ptr<Point<F>>(positions),
                                   data_ptr<uint8_t>(of_positions), count};
    KV_RUN(preimage_points, points, params, batch * count, 8192);
  });
  return {positions, of_positions};
}

}  // namespace

// Where a map of nodes reads the inside of quadrilaterals, and points. preimages.py says what the arguments are.
KV_OPERATOR(
    preimage_extents,
    "(Tensor quads, Tensor directions, Tensor coordinates, Tensor kinds, Tensor x, Tensor y, int margin) -> Tensor")
KV_OPERATOR(preimage_points,
            "(Tensor points, Tensor coordinates, Tensor kinds, Tensor x, Tensor y, int margin) -> (Tensor, Tensor)")

}  // namespace kv::augmentation
