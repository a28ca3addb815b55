// Maps of lenses, vortices, grids and splines from the numbers of each sample: where the pixels of a result read an
// image. distortion/displacement_map.py of kvision.augmentation defines them.
#pragma once

#include "augmentation/lists/listed_maps.h"
#include "core/isa.h"
#include "geometry/transform/thin_plate.h"
#if !defined(__CUDACC__)
#include "core/lanes.h"
#endif

namespace kv::augmentation {

enum class MapKind : int { camera, fisheye_lens, swirl, cells, triangles, fisheye, thin_plate };
constexpr int kMapKinds = 7, kMapNumbers = 3;

// T is float or double.
template <class T>
struct DisplacementMap {
  T const* rows;  // (B, columns): the numbers of a sample
  T* y;           // (B, 2, height, width)
  int64_t batch, columns, height, width;
  MapKind kind;
  T numbers[kMapNumbers];  // of all samples
};

KV_KERNEL(displacement_map, DisplacementMap)

// Maps of a list, in one block of memory.
template <class T>
struct DisplacementMapList {
  DisplacementMap<T> all;
  float const* chosen;  // (B,), 0 for samples whose map is 0; null: all have theirs
  int64_t chosen_stride;
  ListedMaps list;

  KV_HD bool is_chosen(int b) const { return !chosen || chosen[b * chosen_stride] != 0; }
  KV_HD DisplacementMap<T> sample(int b) const {
    DisplacementMap<T> one = all;
    one.rows += b * one.columns;
    one.y += int64_t(kMapUnit) * list.begin[b];
    one.batch = 1, one.height = list.height[b], one.width = list.width[b];
    return one;
  }
};

KV_KERNEL(displacement_map_list, DisplacementMapList)

template <class F>
struct Displacement {
  F x, y;
};

// x^2 + y^2, rounded alike by all kernels.
template <class F>
KV_HD F sum_of_squares(F x, F y) {
#if defined(__CUDACC__)
  return ::fma(x, x, y * y);
#else
  return x * x + y * y;
#endif
}

// A lens by Brown and Conrady with the coefficients k1 and k2, whose focal lengths are width and height; or, with one
// coefficient, by Kannala and Brandt, whose corners are at an angle of 1 radian.
template <class F, bool IsFisheye>
struct LensMap {
  F k1, k2, center_x, center_y, per_pixel_x, per_pixel_y;

  KV_HD LensMap(DisplacementMap<F> const& p, F const* row) : k1(row[0]), k2(IsFisheye ? F(0) : row[1]) {
    F const width = F(p.width), height = F(p.height);
    center_x = (width - IsFisheye) / 2, center_y = (height - IsFisheye) / 2;
    F const corner = sqrt(width * width + height * height) / 2;
    per_pixel_x = 1 / (IsFisheye ? corner : width), per_pixel_y = 1 / (IsFisheye ? corner : height);
  }
  KV_HD Displacement<F> at(int column, int row) const {
    F const x = F(column) - center_x, y = F(row) - center_y, u = x * per_pixel_x, v = y * per_pixel_y;
    F const square = sum_of_squares(u, v), more = square * (k1 + square * k2);
    return {x * more, y * more};
  }
};

// 2^x, x^y, log2 x, and the sine and the cosine of an angle, by the C library or CUDA.
#if defined(__CUDACC__)
KV_HD float power(float x, float y) { return ::powf(x, y); }
KV_HD double power(double x, double y) { return ::pow(x, y); }
KV_HD float binary_logarithm(float x) { return ::log2f(x); }
KV_HD double binary_logarithm(double x) { return ::log2(x); }
KV_HD float power_of_two(float x) { return ::exp2f(x); }
KV_HD double power_of_two(double x) { return ::exp2(x); }
KV_HD void sine_and_cosine(float x, float& sine, float& cosine) { ::sincosf(x, &sine, &cosine); }
KV_HD void sine_and_cosine(double x, double& sine, double& cosine) { ::sincos(x, &sine, &cosine); }
#else
KV_HD float power(float x, float y) { return __builtin_powf(x, y); }
KV_HD double power(double x, double y) { return __builtin_pow(x, y); }
KV_HD float binary_logarithm(float x) { return vlog2<float, 1>(x); }
KV_HD double binary_logarithm(double x) { return vlog2<double, 1>(x); }
KV_HD float power_of_two(float x) { return __builtin_exp2f(x); }
KV_HD double power_of_two(double x) { return __builtin_exp2(x); }
KV_HD void sine_and_cosine(float x, float& s, float& c) { s = __builtin_sinf(x), c = __builtin_cosf(x); }
KV_HD void sine_and_cosine(double x, double& s, double& c) { s = __builtin_sin(x), c = __builtin_cos(x); }
#endif

// A vortex of a strength and a radius about a center.
template <class F>
struct SwirlMap {
  F strength, decay, center_x, center_y;

  KV_HD SwirlMap(DisplacementMap<F> const& p, F const* row) : strength(row[0]) {
    decay = -5 / (row[1] * F(min(p.height, p.width)));
    center_x = row[2] * F(p.width) - F(0.5), center_y = row[3] * F(p.height) - F(0.5);
  }
  KV_HD Displacement<F> at(int column, int row) const {
    F const x = F(column) - center_x, y = F(row) - center_y;
    F const angle = strength * power_of_two(decay * sqrt(sum_of_squares(x, y)));
    F sine, cosine;
    sine_and_cosine(angle, sine, cosine);
    return {x * (cosine - 1) - y * sine, x * sine + y * (cosine - 1)};
  }
};

// Cells of a grid whose columns and rows are changed by factors; where `normalized`, these are divided by their mean.
template <class F>
struct CellsMap {
  F const *of_columns, *of_rows;
  int count, width, height;
  F total_x, total_y;

  KV_HD CellsMap(DisplacementMap<F> const& p, F const* row)
      : of_columns(row),
        of_rows(row + p.columns / 2),
        count(int(p.columns / 2)),
        width(int(p.width)),
        height(int(p.height)),
        total_x(F(count)),
        total_y(F(count)) {
    if (p.numbers[0] == 0) return;
    total_x = total_y = 0;
    for (int i = 0; i < count; ++i) total_x += of_columns[i], total_y += of_rows[i];
  }
  KV_HD Displacement<F> at(int column, int row) const {
    return {along(of_columns, total_x, column, width), along(of_rows, total_y, row, height)};
  }
  KV_HD F along(F const* factors, F total, int i, int size) const {
    F const at = (F(i) + F(0.5)) * (F(count) / F(size));
    int const cell = min(int(at), count - 1);
    F before = 0;
    for (int k = 0; k < cell; ++k) before += factors[k];
    return ((before + factors[cell] * (at - F(cell))) / total - at / F(count)) * F(size);
  }
};

// Nodes of a grid that move, within the image; between them maps are affine in triangles. A row is the scale of moves,
// in pixels or as a fraction of the shorter side, the numbers of rows and of columns of nodes, and the moves along x
// and y of as many rows and columns as nodes have at most.
template <class F>
struct TrianglesMap {
  F const* moves;
  int most_rows, most_columns, rows, columns, width, height;
  F scale, cell_width, cell_height, per_column, per_row;  // in pixels; cells in a pixel

  KV_HD TrianglesMap(DisplacementMap<F> const& p, F const* row)
      : moves(row + 3),
        most_rows(int(p.numbers[0])),
        most_columns(int(p.numbers[1])),
        rows(clamp(int(row[1]), 2, most_rows)),
        columns(clamp(int(row[2]), 2, most_columns)),
        width(int(p.width)),
        height(int(p.height)),
        scale(row[0] / 3 * F(p.numbers[2] != 0 ? 1 : min(p.width, p.height))) {
    cell_width = F(width - 1) / F(columns - 1), cell_height = F(height - 1) / F(rows - 1);
    per_column = F(columns - 1) / F(max(width - 1, 1)), per_row = F(rows - 1) / F(max(height - 1, 1));
  }
  // How far a node moves.
  KV_HD Displacement<F> node(int i, int j) const {
    F const* const move = moves + i * most_columns + j;
    F const x = F(j) * cell_width, y = F(i) * cell_height;
    return {clamp(x + scale * move[0], F(0), F(width - 1)) - x,
            clamp(y + scale * move[most_rows * most_columns], F(0), F(height - 1)) - y};
  }
  KV_HD Displacement<F> at(int column, int row) const {
    F const x = F(column) * per_column, y = F(row) * per_row;
    int const j = min(int(x), columns - 2), i = min(int(y), rows - 2);
    F const u = x - F(j), v = y - F(i);
    bool const is_upper = u + v <= 1;  // to the left of the diagonal from the upper right corner to the lower left one
    Displacement<F> const own = is_upper ? node(i, j) : node(i + 1, j + 1), right = node(i, j + 1),
                          below = node(i + 1, j);
    F const to_right = is_upper ? u : 1 - v, to_below = is_upper ? v : 1 - u;
    return {own.x + (right.x - own.x) * to_right + (below.x - own.x) * to_below,
            own.y + (right.y - own.y) * to_right + (below.y - own.y) * to_below};
  }
};

// The pixel at g, in coordinates from -1 to 1, reads the image at g (1 + |g - center| ** gamma).
template <class F>
struct FisheyeMap {
  static constexpr F kNearest = F(0x1p-10);  // so that the center of a negative gamma reads a finite position
  F center_x, center_y, gamma, half_x, half_y;

  KV_HD FisheyeMap(DisplacementMap<F> const& p, F const* row)
      : center_x(row[0]), center_y(row[1]), gamma(row[2]), half_x(F(p.width - 1) / 2), half_y(F(p.height - 1) / 2) {}
  KV_HD Displacement<F> at(int column, int row) const {
    F const along_x = F(column) - half_x, along_y = F(row) - half_y;
    F const x = (half_x > 0 ? along_x / half_x : -1) - center_x, y = (half_y > 0 ? along_y / half_y : -1) - center_y;
    F const distance = sqrt(sum_of_squares(x, y)),
            farther = power(gamma < 0 ? max(distance, kNearest) : distance, gamma);
    return {along_x * farther, along_y * farther};
  }
};

// A thin-plate spline in coordinates from -1 to 1, with align_corners between the centers of the outermost pixels. A
// row is the centers, their weights and the affine part.
template <class F>
struct ThinPlateMap {
  F const *centers, *weights, *affine;
  int count;
  F middle_x, middle_y, half_x, half_y;

  KV_HD ThinPlateMap(DisplacementMap<F> const& p, F const* row) : centers(row), count(int(p.columns - 6) / 4) {
    weights = centers + 2 * count, affine = weights + 2 * count;
    F const less = p.numbers[0] != 0 ? 1 : 0;
    middle_x = F(p.width - 1) / 2, middle_y = F(p.height - 1) / 2;
    half_x = (F(p.width) - less) / 2, half_y = (F(p.height) - less) / 2;
  }
  KV_HD Displacement<F> at(int column, int row) const {
    F const x = half_x > 0 ? (F(column) - middle_x) / half_x : 0, y = half_y > 0 ? (F(row) - middle_y) / half_y : 0;
    F to_x = affine[0] + x * affine[2] + y * affine[4], to_y = affine[1] + x * affine[3] + y * affine[5];
    for (int i = 0; i < count; ++i) {
      F const dx = x - centers[2 * i], dy = y - centers[2 * i + 1], square = sum_of_squares(dx, dy);
      F const value = geometry::radial_basis<F>(square, binary_logarithm(square));
      to_x += weights[2 * i] * value, to_y += weights[2 * i + 1] * value;
    }
    return {(to_x - x) * half_x, (to_y - y) * half_y};
  }
};

// Calls run with a kind's map, as a type.
template <class Map>
struct MapOf {
  using type = Map;
};
template <class T, class Run>
auto with_map(MapKind kind, Run run) {
  switch (kind) {
    case MapKind::camera:
      return run(MapOf<LensMap<T, false>>{});
    case MapKind::fisheye_lens:
      return run(MapOf<LensMap<T, true>>{});
    case MapKind::swirl:
      return run(MapOf<SwirlMap<T>>{});
    case MapKind::cells:
      return run(MapOf<CellsMap<T>>{});
    case MapKind::triangles:
      return run(MapOf<TrianglesMap<T>>{});
    case MapKind::fisheye:
      return run(MapOf<FisheyeMap<T>>{});
    default:
      return run(MapOf<ThinPlateMap<T>>{});
  }
}

}  // namespace kv::augmentation
