// Minimal solvers: models from as few correspondences as possible, which are arguments or are drawn at random from all
// correspondences.
//
//   affine         3 points          1 map, last row 0, 0, 1
//   homography     4 points          1, composed of the maps from the unit square to both quadrilaterals
//   lines          4 line segments   1 homography that maps the ends of segments to lines
//   fundamental    7 points          1 to 3 matrices of rank 2
//   fundamental8   8 points          1, projected to rank 2 in normalized coordinates
//   essential      5 points          up to 10 of norm 1 (D. Nister, 2004), in normalized camera coordinates
//
// Missing models are NaN.
#pragma once

#include "core/isa.h"
#include "geometry/small_matrix.h"
#include "geometry/solvers/polynomials.h"
#include "geometry/solvers/seven_points.h"

namespace kv::geometry {

enum class Model : int { affine, homography, lines, fundamental, fundamental8, essential };

KV_HD int sample_size(Model m) {
  constexpr int sizes[] = {3, 4, 4, 7, 8, 5};
  return sizes[int(m)];
}
KV_HD int candidates(Model m) { return m == Model::essential ? 10 : m == Model::fundamental ? 3 : 1; }

// With `draws`, (S, m + 1), the points are (B, N, .), and S / B rows in turn are of one pair. Each row of draws has m
// numbers in [0, 1), which select a sample among the first points; the last number of the row says how many, and fewer
// than m have no model. Without draws, sample s is the points (s, m, .) of (S, m, .).
template <class T>
struct Minimal {
  Reals points1, points2, draws;  // draws.data may be null
  Model model;
  int64_t samples, samples_per_pair, count;
  Reals models;  // (S, candidates, 9)
};

KV_KERNEL(minimal_solver, Minimal)

namespace minimal_solvers {

constexpr int kMaxPoints = 8;

using Points = double[kMaxPoints][4];  // (x, y), or both ends of a line segment

// Chooses distinct indices below `population`; all choices are equally likely (R. Floyd's method). False if these are
// too few.
template <class T>
KV_HD bool choose_distinct(Minimal<T> const& p, int64_t sample, int size, int64_t* indices) {
  int64_t const row = sample * (size + 1);
  int64_t const population = min(int64_t(p.draws[row + size]), p.count), start = sample / p.samples_per_pair * p.count;
  if (population < size) return false;
  for (int i = 0; i < size; ++i) {
    int64_t const last = population - size + i;
    int64_t pick = clamp(int64_t(p.draws[row + i] * double(last + 1)), int64_t(0), last);
    for (int k = 0; k < i; ++k)
      if (indices[k] == pick) pick = last;
    indices[i] = pick;
  }
  for (int i = 0; i < size; ++i) indices[i] += start;
  return true;
}

// --- affine maps and homographies ------------------------------------------------------------------------------------

KV_HD double signed_area(double const* a, double const* b, double const* c) {
  return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
}

KV_HD void affine(Points const& x, Points const& y, double* m) {
  double const scale = 1 / signed_area(x[0], x[1], x[2]);
  for (int i = 0; i < 2; ++i) {
    double const u = (y[1][i] - y[0][i]) * scale, v = (y[2][i] - y[0][i]) * scale;
    m[3 * i] = u * (x[2][1] - x[0][1]) - v * (x[1][1] - x[0][1]);
    m[3 * i + 1] = v * (x[1][0] - x[0][0]) - u * (x[2][0] - x[0][0]);
    m[3 * i + 2] = y[0][i] - m[3 * i] * x[0][0] - m[3 * i + 1] * x[0][1];
  }
  m[6] = m[7] = 0, m[8] = small::finite(scale) ? 1 : small::nan();
}

// The homography from (0, 0), (1, 0), (1, 1), (0, 1) to four points (P. Heckbert, 1989).
KV_HD void from_unit_square(Points const& p, double* m) {
  double const u[] = {p[1][0] - p[2][0], p[1][1] - p[2][1]}, v[] = {p[3][0] - p[2][0], p[3][1] - p[2][1]};
  double const skew[] = {p[0][0] - p[1][0] - v[0], p[0][1] - p[1][1] - v[1]};
  double const g = skew[0] * v[1] - skew[1] * v[0], h = u[0] * skew[1] - u[1] * skew[0], w = u[0] * v[1] - u[1] * v[0];
  for (int i = 0; i < 2; ++i) {
    m[3 * i] = w * (p[1][i] - p[0][i]) + g * p[1][i];
    m[3 * i + 1] = w * (p[3][i] - p[0][i]) + h * p[3][i];
    m[3 * i + 2] = w * p[0][i];
  }
  m[6] = g, m[7] = h, m[8] = w;
}

// No model if three points have the opposite orientation in the second image: a line between them would go to infinity.
KV_HD void homography(Points const& x, Points const& y, double* m) {
  bool keeps_orientation = true;
  for (int skip = 0; skip < 4; ++skip) {
    int const a = skip == 0, b = skip <= 1 ? 2 : 1, c = skip <= 2 ? 3 : 2;
    double const one = signed_area(x[a], x[b], x[c]), other = signed_area(y[a], y[b], y[c]);
    keeps_orientation = keeps_orientation && one * other > 0;
  }
  double src[9], dst[9], inverse[9];
  from_unit_square(x, src);
  from_unit_square(y, dst);
  adjugate3(src, inverse);
  multiply3(dst, inverse, m);
  if (!keeps_orientation) m[0] = small::nan();
}

// --- equations in nine unknowns --------------------------------------------------------------------------------------

// Normalizes points: their mean becomes 0 and their mean distance from it sqrt(2). T is the matrix of this map.
struct Normalization {
  double scale, x, y;
  KV_HD Normalization(Points& p, int points, int ends) : scale(0), x(0), y(0) {
    double const weight = 1.0 / (points * ends);
    for (int i = 0; i < points; ++i)
      for (int e = 0; e < 2 * ends; e += 2) x += p[i][e] * weight, y += p[i][e + 1] * weight;
    for (int i = 0; i < points; ++i)
      for (int e = 0; e < 2 * ends; e += 2) {
        double const u = p[i][e] -= x, v = p[i][e + 1] -= y;
        scale += sqrt(u * u + v * v) * weight;
      }
    scale = 1.4142135623730951 / scale;
    for (int i = 0; i < points; ++i)
      for (int e = 0; e < 2 * ends; ++e) p[i][e] *= scale;
  }
  // m T, for the rows of m.
  KV_HD void multiply_right(double* m) const {
    for (int i = 0; i < 9; i += 3) {
      m[i] *= scale, m[i + 1] *= scale;
      m[i + 2] -= m[i] * x + m[i + 1] * y;
    }
  }
  // T^T m.
  KV_HD void multiply_left_transposed(double* m) const {
    for (int k = 0; k < 3; ++k) {
      m[k] *= scale, m[3 + k] *= scale;
      m[6 + k] -= m[k] * x + m[3 + k] * y;
    }
  }
  // T^-1 m, up to a factor.
  KV_HD void multiply_left_inverse(double* m) const {
    for (int k = 0; k < 3; ++k) {
      m[k] += scale * x * m[6 + k];
      m[3 + k] += scale * y * m[6 + k];
      m[6 + k] *= scale;
    }
  }
};

KV_CALLED bool lines(Points& x, Points& y, double* m) {
  Normalization const normalize1(x, 4, 2), normalize2(y, 4, 2);
  double rows[8][9], null_vectors[1][9];
  for (int i = 0; i < 4; ++i) {
    double const start[] = {y[i][0], y[i][1], 1}, end[] = {y[i][2], y[i][3], 1};
    double line[3];
    cross3(start, end, line);
    for (int e = 0; e < 2; ++e)
      for (int k = 0; k < 3; ++k) {
        rows[2 * i + e][3 * k] = line[k] * x[i][2 * e];
        rows[2 * i + e][3 * k + 1] = line[k] * x[i][2 * e + 1];
        rows[2 * i + e][3 * k + 2] = line[k];
      }
  }
  if (!small::null_space(rows, 8, null_vectors)) return false;
  for (int k = 0; k < 9; ++k) m[k] = null_vectors[0][k];
  normalize1.multiply_right(m);
  normalize2.multiply_left_inverse(m);
  return true;
}

KV_HD void epipolar_rows(Points const& x, Points const& y, int points, double (*rows)[9]) {
  for (int i = 0; i < points; ++i) {
    double const u[] = {x[i][0], x[i][1], 1}, v[] = {y[i][0], y[i][1], 1};
    for (int k = 0; k < 9; ++k) rows[i][k] = v[k / 3] * u[k % 3];
  }
}

KV_CALLED int eight_points(Points& x, Points& y, double* m) {
  Normalization const normalize1(x, 8, 1), normalize2(y, 8, 1);
  double rows[8][9], null_vectors[1][9], v[3];
  epipolar_rows(x, y, 8, rows);
  if (!small::null_space(rows, 8, null_vectors)) return 0;
  for (int k = 0; k < 9; ++k) m[k] = null_vectors[0][k];
  small::project_to_rank_two(m, v);
  normalize1.multiply_right(m);
  normalize2.multiply_left_transposed(m);
  return 1;
}

// --- five points -----------------------------------------------------------------------------------------------------

KV_HD void add_product(double const* a, double const* b, double scale, double* to) {
  for (int i = 0; i < 4; ++i)
    for (int k = 0; k < 4; ++k) to[QuadraticMonomials::index(i, k)] += scale * a[i] * b[k];
}
KV_HD void add_cubic(double const* a, double const* b, double* to) {
  for (int i = 0; i < 10; ++i)
    for (int k = 0; k < 4; ++k) to[CubicMonomials::index(i, k)] += a[i] * b[k];
}

// The coefficients of det E = 0 and (E E^T - tr(E E^T) / 2) E = 0, for entries e (9, 4) of E that are linear in x, y,
// z.
KV_CALLED void constraints(double const (*e)[4], double (*q)[20]) {
  for (int r = 0; r < 10; ++r)
    for (int k = 0; k < 20; ++k) q[r][k] = 0;
  double half_trace[10] = {};
  for (int i = 0; i < 9; ++i) add_product(e[i], e[i], 0.5, half_trace);
  for (int i = 0; i < 3; ++i)
    for (int k = 0; k < 3; ++k) {
      double inner[10] = {};
      for (int j = 0; j < 3; ++j) add_product(e[3 * i + j], e[3 * k + j], 1, inner);
      if (i == k)
        for (int n = 0; n < 10; ++n) inner[n] -= half_trace[n];
      for (int j = 0; j < 3; ++j) add_cubic(inner, e[3 * k + j], q[3 * i + j]);
    }
  for (int j = 0; j < 3; ++j) {
    int const a = (j + 1) % 3, b = (j + 2) % 3;
    double minor[10] = {};
    add_product(e[a], e[3 + b], 1, minor);
    add_product(e[b], e[3 + a], -1, minor);
    add_cubic(minor, e[6 + j], q[9]);
  }
}

// Gauss-Jordan elimination: solves ten equations for the first ten monomials. False if they are linearly dependent.
KV_CALLED bool eliminate(double (*q)[20]) {
  for (int k = 0; k < 10; ++k) {
    int row = k;
    for (int i = k + 1; i < 10; ++i)
      if (small::magnitude(q[i][k]) > small::magnitude(q[row][k])) row = i;
    if (q[row][k] == 0 || !small::finite(q[row][k])) return false;
    double const scale = 1 / q[row][k];
    for (int j = k; j < 20; ++j) {
      double const t = q[row][j] * scale;
      q[row][j] = q[k][j];
      q[k][j] = t;
    }
    for (int i = 0; i < 10; ++i) {
      if (i == k) continue;
      double const factor = q[i][k];
      for (int j = k; j < 20; ++j) q[i][j] -= factor * q[k][j];
    }
  }
  return true;
}

KV_HD void add_polynomials(double const* a, int na, double const* b, int nb, double scale, double* to) {
  for (int i = 0; i < na; ++i)
    for (int k = 0; k < nb; ++k) to[i + k] += scale * a[i] * b[k];
}

KV_CALLED int essential(Points const& x, Points const& y, double (*models)[9]) {
  double rows[5][9], basis[4][9], e[9][4], q[10][20];
  epipolar_rows(x, y, 5, rows);
  if (!small::null_space(rows, 5, basis)) return 0;
  for (int v = 0; v < 4; ++v) {  // an orthonormal basis, for accuracy below
    for (int w = 0; w < v; ++w) {
      double projection = 0;
      for (int k = 0; k < 9; ++k) projection += basis[v][k] * basis[w][k];
      for (int k = 0; k < 9; ++k) basis[v][k] -= projection * basis[w][k];
    }
    double norm = 0;
    for (int k = 0; k < 9; ++k) norm += basis[v][k] * basis[v][k];
    for (int k = 0; k < 9; ++k) e[k][v] = basis[v][k] /= sqrt(norm);
  }
  constraints(e, q);
  if (!eliminate(q)) return 0;
  // Each equation with z minus z times that without: three equations in x, y, 1, whose coefficients are polynomials in
  // z of degree 3, 3, 4.
  double system[3][3][5];
  for (int r = 0; r < 3; ++r)
    for (int c = 0, column = 10; c < 3; column += c < 2 ? 3 : 4, ++c) {
      int const size = c < 2 ? 3 : 4;
      double const *const with_z = q[4 + 2 * r] + column, *const without_z = q[5 + 2 * r] + column;
      for (int i = 0; i <= size; ++i) system[r][c][i] = (i > 0 ? with_z[i - 1] : 0) - (i < size ? without_z[i] : 0);
    }
  double determinant[11] = {};
  for (int r = 0; r < 3; ++r) {
    int const i = (r + 1) % 3, k = (r + 2) % 3;
    double minor[7] = {};
    add_polynomials(system[i][0], 4, system[k][1], 4, 1, minor);
    add_polynomials(system[k][0], 4, system[i][1], 4, -1, minor);
    add_polynomials(minor, 7, system[r][2], 5, 1, determinant);
  }
  double roots[small::kMaxRoots];
  int const num_roots = small::real_roots<true>(determinant, 10, roots);
  int count = 0;
  for (int n = 0; n < num_roots; ++n) {
    double rows[3][3], best[3] = {}, largest = 0, derivative;
    for (int r = 0; r < 3; ++r)
      for (int c = 0; c < 3; ++c)
        rows[r][c] = small::evaluate_polynomial(system[r][c], c < 2 ? 3 : 4, roots[n], derivative);
    for (int r = 0; r < 3; ++r) {
      double v[3];
      cross3(rows[r], rows[(r + 1) % 3], v);
      double const size = dot3(v, v);
      if (size > largest) largest = size, best[0] = v[0], best[1] = v[1], best[2] = v[2];
    }
    if (best[2] == 0) continue;
    double const factors[] = {best[0] / best[2], best[1] / best[2], roots[n], 1};
    double norm = 0, *const m = models[count];
    for (int k = 0; k < 9; ++k) {
      m[k] = 0;
      for (int v = 0; v < 4; ++v) m[k] += factors[v] * e[k][v];
      norm += m[k] * m[k];
    }
    for (int k = 0; k < 9; ++k) m[k] /= sqrt(norm);
    if (small::finite(norm)) ++count;
  }
  return count;
}

}  // namespace minimal_solvers

// The points of a sample; false if too many are asked for.
template <class T>
KV_HD bool read_sample(Minimal<T> const& p, int64_t sample, minimal_solvers::Points& x, minimal_solvers::Points& y) {
  int const size = sample_size(p.model), numbers = p.model == Model::lines ? 4 : 2;
  int64_t indices[minimal_solvers::kMaxPoints];
  if (!p.draws.data)
    for (int i = 0; i < size; ++i) indices[i] = sample * size + i;
  else if (!minimal_solvers::choose_distinct(p, sample, size, indices))
    return false;
  for (int i = 0; i < size; ++i)
    for (int k = 0; k < numbers; ++k) {
      x[i][k] = p.points1[indices[i] * numbers + k];
      y[i][k] = p.points2[indices[i] * numbers + k];
    }
  return true;
}

// Samples first, ..., first + samples - 1 of seven points, at most as many as V has lanes.
template <class V, class T>
KV_HD void solve_seven_points(Minimal<T> const& p, int64_t first, int samples) {
  auto const lane = [](V& x, int i) KV_INLINE -> double& { return reinterpret_cast<double*>(&x)[i]; };
  V x[7][2] = {}, y[7][2] = {}, models[3][9];
  for (int s = 0; s < samples; ++s) {
    minimal_solvers::Points one = {}, two = {};
    bool const exists = read_sample(p, first + s, one, two);
    for (int i = 0; i < 7; ++i)
      for (int k = 0; k < 2; ++k) {
        lane(x[i][k], s) = exists ? one[i][k] : small::nan();
        lane(y[i][k], s) = two[i][k];
      }
  }
  seven_points::solve<V>(x, y, models);
  for (int s = 0; s < samples; ++s)
    for (int c = 0; c < 3; ++c)
      for (int k = 0; k < 9; ++k) p.models.set(((first + s) * 3 + c) * 9 + k, lane(models[c][k], s));
}

template <class T>
KV_HD void solve_minimal_sample(Minimal<T> const& p, int64_t sample) {
  using namespace minimal_solvers;
  int const max_models = candidates(p.model);
  Points x = {}, y = {};
  if (!read_sample(p, sample, x, y)) {
    for (int k = 0; k < 9 * max_models; ++k) p.models.set(9 * sample * max_models + k, small::nan());
    return;
  }
  double models[10][9];
  int count = 1;
  switch (p.model) {
    case Model::affine:
      affine(x, y, models[0]);
      break;
    case Model::homography:
      homography(x, y, models[0]);
      break;
    case Model::lines:
      count = lines(x, y, models[0]);
      break;
#if !defined(__CUDACC__)  // minimal.cu has kernels for samples of five points and of seven
    case Model::essential:
      count = essential(x, y, models);
      break;
#endif
    default:
      count = eight_points(x, y, models[0]);
  }
  for (int c = 0; c < max_models; ++c) {
    double scale = 0;
    if (c < count)
      for (int k = 0; k < 9; ++k) scale += models[c][k] * models[c][k];
    scale = p.model == Model::affine ? 1 : 1 / sqrt(scale);
    for (int k = 0; k < 9; ++k)
      p.models.set((sample * max_models + c) * 9 + k, c < count ? models[c][k] * scale : small::nan());
  }
}

}  // namespace kv::geometry
