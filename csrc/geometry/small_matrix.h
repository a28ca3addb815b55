// Small matrices and polynomials, in double: the least squares of homogeneous equations, null spaces, real roots.
// Included by the kernels of several views, for CPU and CUDA alike.
#pragma once

#include "core/hd.h"
#include "geometry/thread_group.h"

namespace kv {

// Floating-point numbers of either width, read and written as double: what is made of them is computed in double
// anyway, and need not be compiled for each.
struct Reals {
  void const* data;
  bool wide;
  KV_HD double operator[](int64_t i) const {
    return wide ? static_cast<double const*>(data)[i] : double(static_cast<float const*>(data)[i]);
  }
  KV_HD void set(int64_t i, double x) const {
    if (wide)
      static_cast<double*>(const_cast<void*>(data))[i] = x;
    else
      static_cast<float*>(const_cast<void*>(data))[i] = float(x);
  }
};

// Long functions are called on CUDA: inlined into one kernel, the compiler of CUDA 13.0 makes NaN of 9 x 9 matrices and
// no models of five points, where calls, and one statement more that looks at a matrix, have the CPU's results.
#if defined(__CUDACC__)
#define KV_CALLED inline __host__ __device__ __noinline__
#else
#define KV_CALLED KV_HD
#endif

namespace small {

KV_HD double magnitude(double x) { return x < 0 ? -x : x; }
KV_HD bool finite(double x) { return x - x == 0; }
KV_HD double nan() { return __builtin_nan(""); }

// How often loops over large matrices are unrolled on CUDA: their code would be long, and long to compile.
template <int N>
constexpr int kUnrolled = N <= 4 ? N : 1;

// --- symmetric matrices, all N x N numbers of them -------------------------------------------------------------------

// Those of a team (thread_group.h) take rows in turns, of matrices that all of them see; alone is alone.

// Replaces a positive definite matrix by its inverse, sweeping one row after the other; gives the smallest pivot.
template <int N, class Team = Alone>
KV_HD double invert(double* m, Team team = {}) {
  double least = m[0];
#pragma unroll 1
  for (int k = 0; k < N; ++k) {
    double const inverse = 1 / m[k * N + k];
    least = min(least, m[k * N + k]);
#pragma unroll(kUnrolled<N>)
    for (int i = team.first(); i < N; i += team.step()) {
      if (i == k) continue;
      double const factor = m[i * N + k] * inverse;
      for (int j = 0; j < N; ++j)
        if (j != k) m[i * N + j] -= factor * m[k * N + j];
    }
    team.sync();
    for (int i = team.first(); i < N; i += team.step()) {
      if (i != k)
        m[i * N + k] = m[k * N + i] *= inverse;
      else
        m[k * N + k] = -inverse;
    }
    team.sync();
  }
  for (int i = team.first(); i < N * N; i += team.step()) m[i] = -m[i];
  team.sync();
  return least;
}

// Divides by the trace; false where that is not above 0 and finite.
template <int N, class Team = Alone>
KV_HD bool normalize_trace(double* m, Team team = {}) {
  double trace = 0;
  for (int i = 0; i < N; ++i) trace += m[i * N + i];
  team.sync();
  if (!(trace > 0) || !finite(trace)) return false;
  for (int i = team.first(); i < N * N; i += team.step()) m[i] /= trace;
  team.sync();
  return true;
}

// Which of v and -v is meant: a fixed mixture of the entries is positive.
template <int N>
KV_HD double sign_of(double const* v) {
  double mixture = 0, weight = 1;
  for (int i = 0; i < N; ++i, weight *= 0.7) mixture += weight * v[i];
  return mixture < 0 ? -1 : 1;
}

// A symmetric matrix, its smallest eigenvector v, and u, what its gradient is made of for the gradient g to v; and what
// they are found with.
template <int N>
struct EigenSpace {
  double matrix[N * N], v[N], g[N], u[N];
  double m[N * N], inverse[N * N], powers[N * N], square[N * N], r[N];
};

template <int N>
KV_HD double dot(double const* x, double const* y) {
  double sum = 0;
  for (int i = 0; i < N; ++i) sum += x[i] * y[i];
  return sum;
}
// x = M y.
template <int N, class Team>
KV_HD void multiply_vector(double const* m, double const* y, double* x, Team team) {
  for (int i = team.first(); i < N; i += team.step()) x[i] = dot<N>(m + i * N, y);
  team.sync();
}

// To v, the unit eigenvector of the largest eigenvalue of m, a positive semidefinite matrix of trace 1, by
// squaring it until it is v v^T; the squares of what is smaller vanish. Destroys m, `square` and w.
template <int N, class Team>
KV_HD void largest_eigenvector(double* m, double* square, double* w, double* v, Team team) {
  for (int step = 0; step < 40; ++step) {
#pragma unroll(kUnrolled<N>)
    for (int i = team.first(); i < N; i += team.step()) {
      double row[N];
      for (int k = 0; k < N; ++k) row[k] = m[i * N + k];
#pragma unroll(kUnrolled<N>)
      for (int j = 0; j <= i; ++j) square[i * N + j] = square[j * N + i] = dot<N>(row, m + j * N);
    }
    team.sync();
    double trace = 0;
    for (int i = 0; i < N; ++i) trace += square[i * N + i];
    double const scale = 1 / trace;
    for (int i = team.first(); i < N * N; i += team.step()) m[i] = square[i] * scale;
    team.sync();
    if (trace > 1 - 1e-9) break;  // what is left of the others is below 1e-9 of it, and is squared twice more
  }
  int best = 0;
  for (int i = 1; i < N; ++i)
    if (m[i * N + i] > m[best * N + best]) best = i;
  for (int i = team.first(); i < N; i += team.step()) v[i] = m[i * N + best];
  team.sync();
  for (int step = 0; step < 2; ++step) {
    multiply_vector<N>(m, v, w, team);
    double const scale = (step == 1 ? sign_of<N>(w) : 1) / sqrt(dot<N>(w, w));
    for (int i = team.first(); i < N; i += team.step()) v[i] = w[i] * scale;
    team.sync();
  }
}

// To v, the unit eigenvector of the smallest eigenvalue of a positive semidefinite matrix: of the largest one of the
// inverse of M + 1e-6, whose digits that shift keeps where several eigenvalues are 0. What rounding adds of others is
// taken away by Newton's method. NaN where the matrix is not finite; a matrix of zeros has any.
// Destroys m; the other matrices and r are for it to work with.
template <int N, class Team>
KV_HD void smallest_eigenvector_in(double* m, double* inverse, double* powers, double* square, double* r, double* v,
                                   Team team) {
  bool known = true;
  for (int i = team.first(); i < N * N; i += team.step()) known = known && finite(m[i]);
  if (!team.all(known)) {
    for (int i = team.first(); i < N; i += team.step()) v[i] = nan();
    team.sync();
    return;
  }
  team.sync();
  if (!normalize_trace<N>(m, team)) {
    for (int i = team.first(); i < N; i += team.step()) m[i * N + i] = 1.0 / N;
    team.sync();
  }
  for (int i = team.first(); i < N * N; i += team.step()) inverse[i] = m[i] + (i % (N + 1) == 0 ? 1e-6 : 0);
  team.sync();
  invert<N>(inverse, team);
  for (int i = team.first(); i < N * N; i += team.step()) powers[i] = inverse[i];
  team.sync();
  normalize_trace<N>(powers, team);
  largest_eigenvector<N>(powers, square, r, v, team);
  for (int step = 0; step < 2; ++step) {
    multiply_vector<N>(m, v, r, team);
    double const value = dot<N>(r, v);
    team.sync();
    for (int i = team.first(); i < N; i += team.step()) r[i] -= value * v[i];
    team.sync();
    for (int i = team.first(); i < N; i += team.step()) v[i] -= dot<N>(inverse + i * N, r);
    team.sync();
    double const length = sqrt(dot<N>(v, v));
    team.sync();
    for (int i = team.first(); i < N; i += team.step()) v[i] /= length;
    team.sync();
  }
}
template <int N, class Team>
KV_CALLED void smallest_eigenvector(EigenSpace<N>& space, Team team) {
  for (int i = team.first(); i < N * N; i += team.step()) space.m[i] = space.matrix[i];
  team.sync();
  smallest_eigenvector_in<N>(space.m, space.inverse, space.powers, space.square, space.r, space.v, team);
}
template <int N>
KV_CALLED void smallest_eigenvector(double* m, double* v) {
  double inverse[N * N], powers[N * N], square[N * N], r[N];
  smallest_eigenvector_in<N>(m, inverse, powers, square, r, v, Alone{});
}

// Turns a symmetric matrix into its eigenvalues, on its diagonal, and their vectors, the columns of `vectors`, by
// rotations that make one number after the other 0 (C. Jacobi, 1846).
template <int N>
KV_CALLED void diagonalize(double* m, double* vectors) {
  for (int i = 0; i < N * N; ++i) vectors[i] = i % (N + 1) == 0;
  for (int sweep = 0; sweep < 12; ++sweep) {
    double off = 0, on = 0;
    for (int i = 0; i < N; ++i)
      for (int k = 0; k < N; ++k) (i == k ? on : off) += m[i * N + k] * m[i * N + k];
    if (!(off > 1e-29 * on)) break;
#pragma unroll 1
    for (int p = 0; p < N; ++p)
#pragma unroll 1
      for (int q = p + 1; q < N; ++q) {
        double const between = m[p * N + q];
        if (between == 0) continue;
        double const slope = (m[q * N + q] - m[p * N + p]) / (2 * between);
        double const t = (slope < 0 ? -1 : 1) / (magnitude(slope) + sqrt(slope * slope + 1));
        double const c = 1 / sqrt(t * t + 1), s = t * c;
        for (int k = 0; k < N; ++k) {
          double const x = m[k * N + p], y = m[k * N + q], u = vectors[k * N + p], v = vectors[k * N + q];
          m[k * N + p] = c * x - s * y, m[k * N + q] = s * x + c * y;
          vectors[k * N + p] = c * u - s * v, vectors[k * N + q] = s * u + c * v;
        }
        for (int k = 0; k < N; ++k) {
          double const x = m[p * N + k], y = m[q * N + k];
          m[p * N + k] = c * x - s * y, m[q * N + k] = s * x + c * y;
        }
      }
  }
}

// The gradient to M, symmetric, of its smallest eigenvector v is -(u v^T + v u^T) / 2: gives u = (M - lambda)^+ g.
// Where other eigenvalues are as small there is none: 0 in their directions.
// Destroys M.
template <int N, class Team>
KV_HD void smallest_eigenvector_vjp_in(double* m, double* inverse, double* r, double const* v, double const* g,
                                       double* u, Team team) {
  multiply_vector<N>(m, v, r, team);
  double const value = dot<N>(r, v), along = dot<N>(g, v);
  double trace = 0;
  for (int i = 0; i < N; ++i) trace += m[i * N + i];
  // The inverse of M - lambda + trace v v^T is the same across v, unless other directions are null.
  for (int i = team.first(); i < N; i += team.step()) {
    for (int k = 0; k < N; ++k) inverse[i * N + k] = m[i * N + k] - (i == k ? value : 0) + trace * v[i] * v[k];
    u[i] = 0;
  }
  team.sync();
  if (invert<N>(inverse, team) > 1e-7 * trace) {
    for (int i = team.first(); i < N; i += team.step())
      for (int k = 0; k < N; ++k) u[i] += inverse[i * N + k] * (g[k] - along * v[k]);
  } else if (team.first() == 0) {
    diagonalize<N>(m, inverse);
    double least = m[0];
    for (int i = 1; i < N; ++i) least = min(least, m[i * N + i]);
    for (int k = 0; k < N; ++k) {
      double const gap = m[k * N + k] - least;
      if (!(gap > 1e-13 * trace)) continue;
      double part = 0;
      for (int i = 0; i < N; ++i) part += inverse[i * N + k] * g[i];
      for (int i = 0; i < N; ++i) u[i] += inverse[i * N + k] * (part / gap);
    }
  }
  team.sync();
}
template <int N, class Team>
KV_CALLED void smallest_eigenvector_vjp(EigenSpace<N>& space, Team team) {
  smallest_eigenvector_vjp_in<N>(space.matrix, space.inverse, space.r, space.v, space.g, space.u, team);
}
template <int N>
KV_CALLED void smallest_eigenvector_vjp(double* m, double const* v, double const* g, double* u) {
  double inverse[N * N], r[N];
  smallest_eigenvector_vjp_in<N>(m, inverse, r, v, g, u, Alone{});
}

// --- 3 x 3 -----------------------------------------------------------------------------------------------------------

KV_HD void cross(double const* a, double const* b, double* c) {
  c[0] = a[1] * b[2] - a[2] * b[1];
  c[1] = a[2] * b[0] - a[0] * b[2];
  c[2] = a[0] * b[1] - a[1] * b[0];
}
KV_HD double dot3(double const* a, double const* b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

KV_HD void multiply(double const* a, double const* b, double* c) {
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) c[3 * i + j] = a[3 * i] * b[j] + a[3 * i + 1] * b[3 + j] + a[3 * i + 2] * b[6 + j];
}

// The cross products of rows, as rows: the transpose of the inverse, times the determinant.
KV_HD void cofactors(double const* m, double* c) {
  cross(m + 3, m + 6, c);
  cross(m + 6, m, c + 3);
  cross(m, m + 3, c + 6);
}

// Removes what a matrix does to its smallest right singular vector v, which is the largest one of its cofactors. False
// where these are 0: it stays as it is.
KV_HD bool to_rank_two(double* f, double* v) {
  double c[9], square[9], again[9], w[3];
  cofactors(f, c);
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) square[3 * i + j] = c[i] * c[j] + c[3 + i] * c[3 + j] + c[6 + i] * c[6 + j];
  if (!normalize_trace<3>(square)) return false;
  largest_eigenvector<3>(square, again, w, v, Alone{});
  for (int i = 0; i < 9; i += 3) {
    double const along = dot3(f + i, v);
    for (int k = 0; k < 3; ++k) f[i + k] -= along * v[k];
  }
  return true;
}

// --- null spaces -----------------------------------------------------------------------------------------------------

// What `rows` equations in nine unknowns leave open: 9 - rows vectors, by elimination with the largest pivot of all.
// False where the equations depend on one another. Destroys them.
KV_CALLED bool null_space(double (*a)[9], int rows, double (*space)[9]) {
  int column[9];
  for (int k = 0; k < 9; ++k) column[k] = k;
  double largest = 0;
  for (int k = 0; k < rows; ++k) {
    int row = k, at = k;
    double most = -1;
    for (int i = k; i < rows; ++i)
      for (int j = k; j < 9; ++j)
        if (magnitude(a[i][column[j]]) > most) most = magnitude(a[i][column[j]]), row = i, at = j;
    if (k == 0) largest = most;
    if (!(most > 1e-12 * largest) || !finite(most)) return false;
    int const c = column[at];
    column[at] = column[k];
    column[k] = c;
    double const scale = 1 / a[row][c];
    for (int j = 0; j < 9; ++j) {
      double const t = a[row][j] * scale;
      a[row][j] = a[k][j];
      a[k][j] = t;
    }
    for (int i = 0; i < rows; ++i) {
      if (i == k) continue;
      double const factor = a[i][c];
      for (int j = 0; j < 9; ++j) a[i][j] -= factor * a[k][j];
    }
  }
  for (int f = rows; f < 9; ++f) {
    double* const v = space[f - rows];
    for (int k = 0; k < rows; ++k) v[column[k]] = -a[k][column[f]];
    for (int k = rows; k < 9; ++k) v[column[k]] = k == f;
  }
  return true;
}

// --- polynomials, the highest power first ----------------------------------------------------------------------------

constexpr int kMostRoots = 10;

KV_HD double value_at(double const* p, int degree, double x, double& slope) {
  double value = 0;
  slope = 0;
  for (int i = 0; i <= degree; ++i) {
    slope = slope * x + value;
    value = value * x + p[i];
  }
  return value;
}

// -1, 0 or 1: a value within rounding of 0 counts as 0.
KV_HD int sign_at(double const* p, int degree, double x) {
  double value = 0, size = 0;
  for (int i = 0; i <= degree; ++i) {
    value = value * x + p[i];
    size = size * magnitude(x) + magnitude(p[i]);
  }
  return magnitude(value) <= 1e-14 * size ? 0 : value < 0 ? -1 : 1;
}

// The root between two places where the signs differ, by Newton's method, held between them.
KV_HD double root_between(double const* p, int degree, double low, double high, bool rising) {
  double x = (low + high) / 2;
  for (int step = 0; step < 60 && high - low > 0; ++step) {
    double slope;
    double const value = value_at(p, degree, x, slope);
    ((value < 0) == rising ? low : high) = x;
    double const newton = x - value / slope;
    double const next = newton >= low && newton <= high ? newton : (low + high) / 2;
    if (next == x) break;
    x = next;
  }
  return x;
}

// Roots in [-1, 1], ascending, repeated ones repeated: between two neighbouring roots of its derivative a polynomial
// has one root or none.
KV_CALLED int roots_in_unit(double const* p, int degree, double* roots) {
  double critical[kMostRoots + 1], derivative[kMostRoots + 1];
  int count = 0;
  for (int d = 1; d <= degree; ++d) {
    for (int i = 0; i <= d; ++i) {
      derivative[i] = p[i];
      for (int k = 0; k < degree - d; ++k) derivative[i] *= double(degree - i - k) / double(degree - k);
    }
    int found = 0, before = sign_at(derivative, d, -1);
    double low = -1;
    auto const add = [&](double x) {
      if (found < d) roots[found++] = x;
    };
    if (before == 0 && !(count > 0 && critical[0] == -1)) add(-1);
    for (int k = 0; k <= count; ++k) {
      double const high = k < count ? critical[k] : 1;
      int const after = sign_at(derivative, d, high);
      if (before * after < 0) add(root_between(derivative, d, low, high, after > 0));
      if (after == 0) {
        add(high);
        if (k < count && (k == 0 || critical[k] != low)) add(high);  // a root of the derivative counts once more
      }
      before = after;
      low = high;
    }
    count = found;
    for (int k = 0; k < count; ++k) critical[k] = roots[k];
  }
  return count;
}

// All real roots, in no order; how many there are. Those outside of [-1, 1] are the mirrored polynomial's.
KV_CALLED int real_roots(double const* given, int degree, double* roots) {
  double p[kMostRoots + 1], mirrored[kMostRoots + 1], more[kMostRoots];
  double largest = 0;
  for (int i = 0; i <= degree; ++i) largest = max(largest, magnitude(given[i]));
  if (!(largest > 0) || !finite(largest)) return 0;
  for (int i = 0; i <= degree; ++i) p[i] = mirrored[degree - i] = given[i] / largest;
  int count = roots_in_unit(p, degree, roots);
  int const outside = roots_in_unit(mirrored, degree, more);
  for (int i = 0; i < outside; ++i)
    if (magnitude(more[i]) < 1 && more[i] != 0 && count < degree && finite(1 / more[i])) roots[count++] = 1 / more[i];
  return count;
}

}  // namespace small
}  // namespace kv
