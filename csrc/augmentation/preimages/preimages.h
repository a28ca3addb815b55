// Preimages: where a map reads given quadrilaterals and points. A map is a grid of nodes: the node in row i and column
// j is at (x[j], y[i]) of the result, and reads an image at `coordinates`. Between nodes coordinates are bilinear:
//
//   a --u-- b     read(u, v) = a + e u + f v + g u v,  e = b - a, f = c - a, g = d - b - f
//   v       |
//   c ----- d     cell (i, j), whose node a is node (i, j)
#pragma once

#include "core/ceil_div.h"
#include "core/image_list.h"
#include "core/isa.h"

namespace kv::augmentation {

// Of a node. Only cells whose four nodes are `inside` count as shown by the result; only a pixel is the nearest one.
enum NodeKind : uint8_t { kOutside = 0, kInside = 1, kPixel = 2 };
// Of the position of a point: no cell inside shows it; that of the pixel that reads nearest to it; exact.
enum PositionKind : uint8_t { kInvisible = 0, kNearestPixel = 1, kExact = 2 };

template <class F>
struct Point {
  F x, y;
  KV_HD friend Point operator+(Point a, Point b) { return {a.x + b.x, a.y + b.y}; }
  KV_HD friend Point operator-(Point a, Point b) { return {a.x - b.x, a.y - b.y}; }
  KV_HD friend Point operator*(Point a, F s) { return {a.x * s, a.y * s}; }
};
template <class F>
KV_HD F cross(Point<F> a, Point<F> b) {
  return a.x * b.y - a.y * b.x;
}
template <class F>
KV_HD F dot(Point<F> a, Point<F> b) {
  return a.x * b.x + a.y * b.y;
}

constexpr int kTile = 16;  // cells along each side of a tile

template <class F>
struct Bounds {
  Point<F> low{F(__builtin_inf()), F(__builtin_inf())}, high{-F(__builtin_inf()), -F(__builtin_inf())};

  KV_HD void add(Point<F> p) {  // NaN adds nothing
    low = {min(low.x, p.x), min(low.y, p.y)};
    high = {max(high.x, p.x), max(high.y, p.y)};
  }
  KV_HD bool overlaps(Bounds const& o) const {
    return low.x <= o.high.x && high.x >= o.low.x && low.y <= o.high.y && high.y >= o.low.y;
  }
  // With a margin for rounding.
  KV_HD bool contains(Point<F> p, F margin) const {
    return p.x >= low.x - margin && p.x <= high.x + margin && p.y >= low.y - margin && p.y <= high.y + margin;
  }
  KV_HD F square_distance(Point<F> p) const {
    F const x = max(max(low.x - p.x, p.x - high.x), F(0)), y = max(max(low.y - p.y, p.y - high.y), F(0));
    return x * x + y * y;
  }
  KV_HD F largest_square_distance(Point<F> p) const {
    F const x = max(p.x - low.x, high.x - p.x), y = max(p.y - low.y, high.y - p.y);
    return x * x + y * y;
  }
};

template <class F>
struct MapTile {
  Bounds<F> bounds;         // of what its nodes read
  F has_pixels, is_inside;  // booleans: whether a node is a pixel; whether all nodes are inside
};

// Rows and columns of cells or nodes, [begin, end).
struct GridRange {
  int64_t first_row, last_row, first_column, last_column;
};

// Where node i of an axis is: pixels, the edges of the first and the last one, and `margin` nodes beyond each, twice as
// far from the edge as the one before.
template <class F>
KV_HD F node_position(int64_t i, int64_t nodes, int64_t margin) {
  int64_t const pixel = i - margin - 1, after = pixel - (nodes - 2 * margin - 2);
  F const edge = F(-0.5);
  if (pixel < 0) return pixel == -1 ? edge : edge - F(int64_t(1) << (-2 - pixel));
  if (after < 0) return F(pixel);
  F const last = edge + F(pixel - after);
  return after == 0 ? last : last + F(int64_t(1) << (after - 1));
}

// The map of a sample.
template <class F>
struct MapGrid {
  Point<F> const* coordinates;  // (rows, columns)
  uint8_t const* kinds;         // (rows, columns)
  F const *x, *y;               // (columns,) and (rows,), ascending; null for those of node_position
  MapTile<F>* tiles;            // (tiles_down, tiles_across)
  int64_t rows, columns;

  int64_t margin;  // cells at each side that are outside; they are tiles of their own, as they are much larger

  KV_HD static int64_t tiles_along(int64_t cells, int64_t margin) { return ceil_div(cells - 2 * margin, kTile) + 2; }
  KV_HD int64_t tiles_across() const { return tiles_along(columns - 1, margin); }
  KV_HD int64_t tile_count() const { return tiles_along(rows - 1, margin) * tiles_across(); }
  KV_HD int64_t first_cell(int64_t tile, int64_t cells) const {
    if (tile == 0) return 0;
    return tile == tiles_along(cells, margin) ? cells : min(margin + kTile * (tile - 1), cells - margin);
  }
  KV_HD int64_t index(int64_t i, int64_t j) const { return i * columns + j; }
  KV_HD Point<F> position(int64_t i, int64_t j) const {
    if (x) return {x[j], y[i]};
    return {node_position<F>(j, columns, margin), node_position<F>(i, rows, margin)};
  }
  KV_HD GridRange cells(int64_t tile) const {
    int64_t const i = tile / tiles_across(), j = tile % tiles_across();
    return {first_cell(i, rows - 1), first_cell(i + 1, rows - 1), first_cell(j, columns - 1),
            first_cell(j + 1, columns - 1)};
  }
  // The nodes of a tile's cells. Those between tiles belong to several.
  KV_HD GridRange nodes(int64_t tile) const {
    GridRange r = cells(tile);
    if (r.first_row < r.last_row && r.first_column < r.last_column) ++r.last_row, ++r.last_column;
    return r;
  }
};

template <class F>
KV_HD MapTile<F> tile_of_nodes(MapGrid<F> const& g, int64_t tile) {
  MapTile<F> t{{}, 0, 1};
  GridRange const r = g.nodes(tile);
  for (int64_t i = r.first_row; i < r.last_row; ++i)
    for (int64_t j = r.first_column; j < r.last_column; ++j) {
      int64_t const at = g.index(i, j);
      t.bounds.add(g.coordinates[at]);
      if (g.kinds[at] == kPixel) t.has_pixels = 1;
      if (g.kinds[at] == kOutside) t.is_inside = 0;
    }
  return t;
}

template <class F>
struct Cell {
  Point<F> a, b, c, d;
  Point<F> first, size;  // of its position
  bool is_inside;

  KV_HD Cell(MapGrid<F> const& g, int64_t i, int64_t j) {
    int64_t const at = g.index(i, j), below = at + g.columns;
    a = g.coordinates[at], b = g.coordinates[at + 1], c = g.coordinates[below], d = g.coordinates[below + 1];
    first = g.position(i, j), size = g.position(i + 1, j + 1) - first;
    is_inside = g.kinds[at] && g.kinds[at + 1] && g.kinds[below] && g.kinds[below + 1];
  }
  KV_HD Bounds<F> bounds() const {
    Bounds<F> r;
    r.add(a), r.add(b), r.add(c), r.add(d);
    return r;
  }
  KV_HD Point<F> position(F u, F v) const { return {first.x + u * size.x, first.y + v * size.y}; }

  // Calls f with each position, at most two, at which the cell reads p. Without v, which the cross product with f + g u
  // removes, a quadratic equation of u remains: h x f + (h x g - e x f) u - (e x g) u^2 = 0, h = p - a.
  template <class Found>
  KV_HD void solve(Point<F> p, Found found) const {
    constexpr F kTolerance = F(2e-3);  // of u and v: on a side, rounding must not leave p to neither cell
    Point<F> const e = b - a, f = c - a, g = d - b - f, h = p - a;
    F const k0 = cross(h, f), k1 = cross(h, g) - cross(e, f), k2 = -cross(e, g);
    F const square = max(k1 * k1 - 4 * k2 * k0, F(0));
    F const q = F(-0.5) * (k1 + (k1 < 0 ? -sqrt(square) : sqrt(square)));
    F const roots[] = {k0 / q, q / k2};
    for (int k = 0; k < 2; ++k) {
      F const u = roots[k];
      if (!(u >= -kTolerance && u <= 1 + kTolerance)) continue;  // nor NaN
      Point<F> const along = f + g * u;
      F const v = dot(h - e * u, along) / dot(along, along);
      if (!(v >= -kTolerance && v <= 1 + kTolerance)) continue;
      Point<F> const miss = h - e * u - along * v;  // not 0 if the discriminant was negative
      if (!(dot(miss, miss) <= 4 * kTolerance * kTolerance * max(max(dot(e, e), dot(along, along)), F(1)))) continue;
      found(position(clamp(u, F(0), F(1)), clamp(v, F(0), F(1))));
    }
  }
};

// --- extents of quadrilaterals ---------------------------------------------------------------------------------------

template <class F>
struct Quadrilateral {
  Point<F> corners[4];  // convex, in either order
  F sign;

  KV_HD explicit Quadrilateral(F const* numbers) {
    for (int k = 0; k < 4; ++k) corners[k] = {numbers[2 * k], numbers[2 * k + 1]};
    sign = cross(corners[2] - corners[0], corners[3] - corners[1]) < 0 ? F(-1) : F(1);
  }
  // How far p is to the inside of a side, in units of its length.
  KV_HD F depth(int k, Point<F> p) const { return sign * cross(corners[(k + 1) & 3] - corners[k], p - corners[k]); }
  KV_HD bool contains(Point<F> p) const {
    return depth(0, p) >= 0 && depth(1, p) >= 0 && depth(2, p) >= 0 && depth(3, p) >= 0;
  }
  KV_HD Bounds<F> bounds() const {
    Bounds<F> r;
    for (int k = 0; k < 4; ++k) r.add(corners[k]);
    return r;
  }
};

// The largest products of four directions with positions: among cells inside, and among all cells. -inf for none.
template <class F>
struct Extents {
  F values[8];

  KV_HD Extents() {
    for (F& v : values) v = -F(__builtin_inf());
  }
  KV_HD void add(Point<F> const (&directions)[4], Point<F> position, bool is_inside) {
    for (int k = 0; k < 4; ++k) {
      F const v = dot(directions[k], position);
      values[4 + k] = max(values[4 + k], v);
      if (is_inside) values[k] = max(values[k], v);
    }
  }
  // Whether a position in a rectangle can add anything.
  KV_HD bool can_grow(Point<F> const (&directions)[4], Point<F> first, Point<F> size, bool is_inside) const {
    bool grows = false;
    for (int k = 0; k < 4; ++k) {
      F const most =
          dot(directions[k], first) + max(directions[k].x * size.x, F(0)) + max(directions[k].y * size.y, F(0));
      grows = grows || most > values[is_inside ? k : 4 + k];
    }
    return grows;
  }
};

// The part of a segment within the quadrilateral: p at u = 0, q at u = 1.
template <class F, class Found>
KV_HD void clip_segment(Quadrilateral<F> const& quad, Point<F> p, Point<F> q, Found found) {
  F first = 0, last = 1;
  for (int k = 0; k < 4; ++k) {
    F const at_p = quad.depth(k, p), at_q = quad.depth(k, q);
    if (!(at_p >= 0 || at_q >= 0)) return;
    if (at_p < 0) first = max(first, at_p / (at_p - at_q));
    if (at_q < 0) last = min(last, at_p / (at_p - at_q));
  }
  if (first <= last) found(first), found(last);
}

// The preimage in a cell is bounded by its grid lines and the sides of the quadrilateral, whose extremes are at their
// ends.
template <class F>
KV_HD void add_cell(Extents<F>& extents, Quadrilateral<F> const& quad, Bounds<F> const& quad_bounds,
                    Point<F> const (&directions)[4], Cell<F> const& cell) {
  Bounds<F> const bounds = cell.bounds();
  if (!bounds.overlaps(quad_bounds)) return;
  auto const add = [&](F u, F v) KV_INLINE { extents.add(directions, cell.position(u, v), cell.is_inside); };
  if (quad.contains(cell.a) && quad.contains(cell.b) && quad.contains(cell.c) && quad.contains(cell.d)) {
    add(0, 0), add(1, 0), add(0, 1), add(1, 1);
    return;
  }
  clip_segment(quad, cell.a, cell.b, [&](F u) KV_INLINE { add(u, 0); });
  clip_segment(quad, cell.c, cell.d, [&](F u) KV_INLINE { add(u, 1); });
  clip_segment(quad, cell.a, cell.c, [&](F v) KV_INLINE { add(0, v); });
  clip_segment(quad, cell.b, cell.d, [&](F v) KV_INLINE { add(1, v); });
  for (int k = 0; k < 4; ++k)
    if (bounds.contains(quad.corners[k], F(1e-3)))
      cell.solve(quad.corners[k], [&](Point<F> p) KV_INLINE { extents.add(directions, p, cell.is_inside); });
}

// Whether cells may add anything, by their positions alone. Cells inside have pixels.
template <class F>
KV_HD bool can_grow(Extents<F> const& extents, Point<F> const (&directions)[4], MapGrid<F> const& g,
                    GridRange const& cells, bool has_pixels) {
  Point<F> const first = g.position(cells.first_row, cells.first_column);
  return extents.can_grow(directions, first, g.position(cells.last_row, cells.last_column) - first, has_pixels);
}

template <class F>
KV_HD bool is_within(MapTile<F> const& tile, Quadrilateral<F> const& quad) {
  Point<F> const low = tile.bounds.low, high = tile.bounds.high;
  return quad.contains(low) && quad.contains(high) && quad.contains({low.x, high.y}) && quad.contains({high.x, low.y});
}

// A tile that reads the inside of the quadrilateral alone, all of it inside: its corners are the extremes.
template <class F>
KV_HD void add_tile(Extents<F>& extents, Point<F> const (&directions)[4], MapGrid<F> const& g, GridRange const& cells) {
  extents.add(directions, g.position(cells.first_row, cells.first_column), true);
  extents.add(directions, g.position(cells.first_row, cells.last_column), true);
  extents.add(directions, g.position(cells.last_row, cells.first_column), true);
  extents.add(directions, g.position(cells.last_row, cells.last_column), true);
}

// --- positions of points ---------------------------------------------------------------------------------------------

// The candidate with the smallest key; of equal ones the first in row order.
template <class F>
struct Nearest {
  F key;
  int64_t index;  // of a node or a cell; -1 for none
  Point<F> position;

  static KV_HD Nearest none() { return {F(__builtin_inf()), -1, {}}; }
  KV_HD void add(F key_, int64_t index_, Point<F> position_) {
    if (!(key_ < key || (key_ == key && index >= 0 && index_ < index))) return;
    key = key_, index = index_, position = position_;
  }
};

template <class F>
KV_HD void add_node(Nearest<F>& nearest, MapGrid<F> const& g, Point<F> point, int64_t i, int64_t j) {
  int64_t const at = g.index(i, j);
  if (g.kinds[at] != kPixel) return;
  Point<F> const miss = g.coordinates[at] - point;
  nearest.add(dot(miss, miss), i * g.columns + j, g.position(i, j));
}

// Of the positions at which cells read a point, those nearest to a pixel: [0] of cells inside, [1] of the others.
template <class F>
KV_HD void add_positions(Nearest<F> (&nearest)[2], MapGrid<F> const& g, Point<F> point, Point<F> pixel, int64_t i,
                         int64_t j) {
  Cell<F> const cell(g, i, j);
  if (!cell.bounds().contains(point, F(1e-2))) return;
  cell.solve(point, [&](Point<F> p) KV_INLINE {
    Nearest<F>& of_kind = nearest[cell.is_inside ? 0 : 1];
    of_kind.add(dot(p - pixel, p - pixel), i * g.columns + j, p);
  });
}

constexpr double kNearPixel = 1.5;

// The position of a point and its kind, from the pixel that reads nearest to it and the exact positions near that.
template <class F>
KV_HD PositionKind choose_position(MapGrid<F> const& g, Point<F> point, Nearest<F> const& pixel,
                                   Nearest<F> const (&exact)[2], Point<F>& position) {
  if (exact[0].index >= 0 && exact[0].key <= F(kNearPixel * kNearPixel)) {
    position = exact[0].position;
    return kExact;
  }
  if (exact[0].index >= 0 && pixel.index >= 0) {
    position = pixel.position;
    return kNearestPixel;
  }
  if (exact[1].index >= 0)
    position = exact[1].position;
  else if (pixel.index >= 0)  // out of the grid, too
    position = pixel.position + (point - g.coordinates[pixel.index]);
  else
    position = {F(__builtin_nan("")), F(__builtin_nan(""))};
  return kInvisible;
}

// --- kernels ---------------------------------------------------------------------------------------------------------

// Maps of one size, of all samples one after the other.
template <class F>
struct MapGrids {
  MapGrid<F> first;

  KV_HD int64_t tile_of_sample(int64_t b) const { return b * first.tile_count(); }
  KV_HD int64_t sample_of_tile(int64_t t) const { return t / first.tile_count(); }
  KV_HD MapGrid<F> sample(int64_t b) const {
    MapGrid<F> g = first;
    g.coordinates += b * g.rows * g.columns, g.kinds += b * g.rows * g.columns, g.tiles += tile_of_sample(b);
    return g;
  }
};

// Maps of a size each, one after the other.
template <class F>
struct ListedGrids {
  MapGrid<F> first;  // of which the pointers count
  int count;
  int rows[kMaxListed], columns[kMaxListed], margin[kMaxListed], tile[kMaxListed];  // tile: the first one
  int64_t node[kMaxListed];                                                         // the first one

  KV_HD int64_t tile_of_sample(int64_t b) const { return tile[b]; }
  KV_HD int64_t sample_of_tile(int64_t t) const {
    return entry_of_item(count, int(t), [&](int i) { return tile[i]; });
  }
  KV_HD MapGrid<F> sample(int64_t b) const {
    MapGrid<F> g = first;
    g.coordinates += node[b], g.kinds += node[b], g.tiles += tile[b];
    g.rows = rows[b], g.columns = columns[b], g.margin = margin[b];
    return g;
  }
};

template <class F, template <class> class Grids>
struct TilesOf {
  Grids<F> grids;
  int64_t tiles;  // of all samples
};

template <class F, template <class> class Grids>
struct ExtentsOf {
  Grids<F> grids;
  F const* quads;       // (batch, count, 8): corners
  F const* directions;  // (batch, count, 8)
  F* extents;           // (batch, count, 8)
  int64_t count, total;
};

template <class F, template <class> class Grids>
struct PointsOf {
  Grids<F> grids;
  Point<F> const* points;  // (batch, count)
  Point<F>* positions;     // (batch, count)
  uint8_t* kinds;          // (batch, count)
  int64_t count, total;
};

template <class F>
struct MapTiles : TilesOf<F, MapGrids> {};
template <class F>
struct MapTilesList : TilesOf<F, ListedGrids> {};
template <class F>
struct PreimageExtents : ExtentsOf<F, MapGrids> {};
template <class F>
struct PreimageExtentsList : ExtentsOf<F, ListedGrids> {};
template <class F>
struct PreimagePoints : PointsOf<F, MapGrids> {};
template <class F>
struct PreimagePointsList : PointsOf<F, ListedGrids> {};

KV_KERNEL(map_tiles, MapTiles)
KV_KERNEL(map_tiles_list, MapTilesList)
KV_KERNEL(preimage_extents, PreimageExtents)
KV_KERNEL(preimage_extents_list, PreimageExtentsList)
KV_KERNEL(preimage_points, PreimagePoints)
KV_KERNEL(preimage_points_list, PreimagePointsList)

}  // namespace kv::augmentation
