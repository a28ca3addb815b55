// Essential matrices of five points by 16 threads, whose registers hold the rows of the equations: up to ten of norm 1
// (D. Nister, 2004), NaN for missing ones. 3.3x of the solver by one thread in minimal.h on an H200, where the
// equations of all threads exceed the caches. All threads of a warp take the same steps.
//
//   null space    Householder's reflections make the five rows triangular; the same of the rows of the identity matrix
//                 are the rows of an orthonormal basis e of what is orthogonal to them
//   equations     det E = 0 and (E E^T - tr(E E^T) / 2) E = 0, one in each of ten threads, solved for ten monomials
//   determinant   of three equations in x, y, 1, whose coefficients are polynomials in z: a polynomial of degree ten
//   roots         Sturm's sequence at 32 points of the projective line tells how many are between neighbors; then one
//                 thread approaches each root by Newton's method within its bracket
//
// `Group` has the thread's rank and
//
//   from(x, rank)   the value of another thread of the group
//   max(x)          the largest of a group
//   any(x)          whether x is true in any thread of a warp
//   sync()          makes writes to shared memory visible
#pragma once

#include "geometry/solvers/minimal.h"

namespace kv::geometry::five_points {

constexpr int kGroup = 16;
constexpr int kDegree = 10, kTerms = kDegree + 1;
constexpr int kNewtonSteps = 60, kBisections = 40;

struct Scratch {
  double e[9][4];
  double quadratics[12][10];  // of E E^T, of the minors of the first two rows of E, of the diagonal of the difference
  double rows[6][10];         // the equations of x^2 z, x^2, y^2 z, y^2, xyz, xy
  double system[3][13];       // polynomials of degree 3, 3, 4, the highest power first
  double minors[3][7];
  double sequence[kTerms][kTerms + 1];  // Sturm's, the highest power first
  double reversed[kTerms];              // its first polynomial, the lowest power first
  int cells[kDegree];
};

KV_HD int symmetric_index(int i, int k) { return i + k + (i > 0 && k > 0); }

// Polynomial k of the sequence has degree 10 - k. Of |x| above 1 the argument is 1 / x: only signs matter.
struct Point {
  double at;
  bool is_reciprocal, is_negative;
};

KV_HD int sign_changes(Scratch const& s, Point const& x) {
  int changes = 0, last = 0;
#pragma unroll
  for (int k = 0; k < kTerms; ++k) {
    int const degree = kDegree - k;
    double value = 0;
#pragma unroll
    for (int i = 0; i <= degree; ++i) value = value * x.at + s.sequence[k][x.is_reciprocal ? degree - i : i];
    int const sign = value > 0 ? 1 : value < 0 ? -1 : 0;
    int const mirrored = x.is_reciprocal && x.is_negative && degree % 2 ? -sign : sign;
    changes += last * mirrored < 0;
    last = mirrored != 0 ? mirrored : last;
  }
  return changes;
}

KV_HD double value_at(double const* p, double x, double& derivative) {
  double value = 0;
  derivative = 0;
#pragma unroll
  for (int i = 0; i <= kDegree; ++i) {
    derivative = derivative * x + value;
    value = value * x + p[i];
  }
  return value;
}

// The order of numbers is that of their bits.
KV_HD unsigned order_of(double x) {
  float const y = float(x < 0 ? -x : x);
  unsigned bits;
  __builtin_memcpy(&bits, &y, 4);
  return bits;
}
KV_HD double number_of(unsigned order) {
  float y;
  __builtin_memcpy(&y, &order, 4);
  return y;
}

// Rows of the equations and of the identity matrix -> e; false if equations are linearly dependent. x and y are the
// point of this thread, of the first five.
template <class Group>
KV_HD bool null_space(double const* x, double const* y, Scratch& s, Group group) {
  int const rank = group.rank();
  double const u[] = {x[0], x[1], 1}, v[] = {y[0], y[1], 1};
  double row[9], first = 0;
  bool is_independent = true;
#pragma unroll
  for (int i = 0; i < 9; ++i) row[i] = rank < 5 ? v[i / 3] * u[i % 3] : double(rank == 5 + i);
#pragma unroll
  for (int k = 0; k < 5; ++k) {
    double normal[9], square = 0, projection = 0;
#pragma unroll
    for (int i = k; i < 9; ++i) normal[i] = group.from(row[i], k), square += normal[i] * normal[i];
    double const norm = sqrt(square), signed_norm = normal[k] < 0 ? -norm : norm;
    if (k == 0) first = square;
    is_independent = is_independent && square > 1e-24 * first;
    double const scale = 1 / (square + normal[k] * signed_norm);
    normal[k] += signed_norm;
#pragma unroll
    for (int i = k; i < 9; ++i) projection += normal[i] * row[i];
    projection *= scale;
#pragma unroll
    for (int i = k; i < 9; ++i) row[i] -= projection * normal[i];
  }
  if (rank >= 5 && rank < 14)
#pragma unroll
    for (int c = 0; c < 4; ++c) s.e[rank - 5][c] = row[5 + c];
  group.sync();
  return is_independent;
}

// Equation `rank` in `q`; 0 for the threads behind.
template <class Group>
KV_HD void equations(Scratch& s, double (&q)[20], Group group) {
  int const rank = group.rank();
  if (rank < 9) {
    int const j = rank - 6, a = (j + 1) % 3, b = (j + 2) % 3, row = rank < 3 ? 0 : rank < 5 ? 1 : 2;
    int const column = rank < 3 ? rank : rank < 5 ? rank - 2 : 2;
    double quadratic[10] = {};
#pragma unroll
    for (int t = 0; t < 3; ++t) {
      int const one = rank < 6 ? 3 * row + t : t == 0 ? a : b, two = rank < 6 ? 3 * column + t : 3 + (t == 0 ? b : a);
      double const sign = rank < 6 || t == 0 ? 1 : t == 1 ? -1 : 0;
#pragma unroll
      for (int i = 0; i < 4; ++i)
#pragma unroll
        for (int k = 0; k < 4; ++k) quadratic[QuadraticMonomials::index(i, k)] += sign * s.e[one][i] * s.e[two][k];
    }
#pragma unroll
    for (int n = 0; n < 10; ++n) s.quadratics[rank][n] = quadratic[n];
  }
  group.sync();
  for (int item = rank; item < 30; item += kGroup) {
    int const i = item / 10, n = item % 10;
    double const trace = s.quadratics[0][n] + s.quadratics[3][n] + s.quadratics[5][n];
    s.quadratics[9 + i][n] = s.quadratics[symmetric_index(i, i)][n] - trace / 2;
  }
  group.sync();
#pragma unroll
  for (int n = 0; n < 20; ++n) q[n] = 0;
  if (rank < 10) {
#pragma unroll
    for (int k = 0; k < 3; ++k) {
      int const i = rank / 3, j = rank % 3;
      double const* const quadratic = s.quadratics[rank == 9 ? 6 + k : i == k ? 9 + i : symmetric_index(i, k)];
      double const* const linear = s.e[rank == 9 ? 6 + k : 3 * k + j];
#pragma unroll
      for (int n = 0; n < 10; ++n)
#pragma unroll
        for (int c = 0; c < 4; ++c) q[CubicMonomials::index(n, c)] += quadratic[n] * linear[c];
    }
  }
}

// Gauss-Jordan elimination; the six last rows go to shared memory.
template <class Group>
KV_HD void eliminate(Scratch& s, double (&q)[20], Group group) {
  unsigned const rank = unsigned(group.rank());
  int solved = rank < 10 ? -1 : 10;  // the monomial of this row
  double scale = 0;
#pragma unroll
  for (int k = 0; k < 10; ++k) {
    unsigned const key = solved < 0 ? (order_of(q[k]) & ~15u) | rank : 0;
    int const pivot = int(group.max(key) & 15);
    double const inverse = 1 / group.from(q[k], pivot), factor = int(rank) == pivot ? 0 : q[k] * inverse;
    if (int(rank) == pivot) solved = k, scale = inverse;
#pragma unroll
    for (int j = k + 1; j < 20; ++j) q[j] -= factor * group.from(q[j], pivot);
  }
  if (solved >= 4 && solved < 10)
#pragma unroll
    for (int n = 0; n < 10; ++n) s.rows[solved - 4][n] = q[10 + n] * scale;
  group.sync();
}

// Coefficient `rank` of the determinant, 0 for the threads behind. An equation with z minus z times that without gives
// a row of the system.
template <class Group>
KV_HD double determinant(Scratch& s, Group group) {
  int const rank = group.rank();
  if (rank < 13) {
    int const c = rank < 4 ? 0 : rank < 8 ? 1 : 2, i = rank - 4 * c, size = c < 2 ? 3 : 4;
#pragma unroll
    for (int r = 0; r < 3; ++r)
      s.system[r][rank] = (i > 0 ? s.rows[2 * r][3 * c + i - 1] : 0) - (i < size ? s.rows[2 * r + 1][3 * c + i] : 0);
  }
  group.sync();
  if (rank < 7)
#pragma unroll
    for (int r = 0; r < 3; ++r) {
      double const *const one = s.system[(r + 1) % 3], *const two = s.system[(r + 2) % 3];
      double minor = 0;
#pragma unroll
      for (int i = 0; i < 4; ++i) {
        int const k = rank - i;
        if (k >= 0 && k < 4) minor += one[i] * two[4 + k] - two[i] * one[4 + k];
      }
      s.minors[r][rank] = minor;
    }
  group.sync();
  double sum = 0;
#pragma unroll
  for (int r = 0; r < 3; ++r)
#pragma unroll
    for (int i = 0; i < 5; ++i) {
      int const k = rank - i;
      if (k >= 0 && k < 7) sum += s.minors[r][k] * s.system[r][8 + i];
    }
  return sum;
}

// A polynomial, its derivative and negative remainders of the last two, each up to a positive factor; 0 behind the
// last.
template <class Group>
KV_HD void set_sequence(Scratch& s, double a, Group group) {
  int const rank = group.rank();
  a *= 1 / number_of(group.max(order_of(a)));
  double b = rank < kDegree ? a * (kDegree - rank) : 0;
  if (rank < kTerms) s.sequence[0][rank] = a, s.sequence[1][rank] = b, s.reversed[kDegree - rank] = a;
  for (int k = 2; k < kTerms; ++k) {
    double const leading = group.from(b, 0), inverse = leading != 0 ? 1 / leading : 0;
    double const next_a = group.from(a, (rank + 1) % kGroup), next_b = group.from(b, (rank + 1) % kGroup);
    double const t = next_a - group.from(a, 0) * inverse * next_b;
    double const next_t = group.from(t, (rank + 1) % kGroup), rest = group.from(t, 0) * inverse * next_b - next_t;
    double const largest = number_of(group.max(order_of(rank < kTerms - k ? rest : 0)));
    bool const exists = largest > 1e-14 * (leading < 0 ? -leading : leading) && largest < 1e30;
    a = b;
    b = exists && rank < kTerms - k ? rest * (1 / largest) : 0;
    if (rank < kTerms) s.sequence[k][rank] = b;
  }
  group.sync();
}

// Root `rank` of the polynomial, or NaN.
template <class Group>
KV_HD double root(Scratch& s, Group group) {
  int const rank = group.rank();
  // Points -1, -7/8, ..., 7/8, then the reciprocals 1, 6/7, ..., 0 and -0, -1/8, ..., -7/8.
  auto const inner = [](int i) KV_INLINE { return -1 + i / 8.0; };
  auto const outer = [](int i) KV_INLINE { return i < 8 ? 1 - i / 7.0 : (8 - i) / 8.0; };
  int const next = (rank + 1) % kGroup;
  int const changes_inner = sign_changes(s, {inner(rank), false, false});
  int const changes_outer = sign_changes(s, {outer(rank), true, rank >= 8});
  int const next_inner = group.from(changes_inner, next), next_outer = group.from(changes_outer, next);
  int const first_inner = group.from(changes_inner, 0), first_outer = group.from(changes_outer, 0);
  int const end_inner = rank == 15 ? first_outer : next_inner, end_outer = rank == 15 ? first_inner : next_outer;
  int const in = max(changes_inner - end_inner, 0), out = rank == 7 ? 0 : max(changes_outer - end_outer, 0);
  int before = in + out;
#pragma unroll
  for (int k = 1; k < kGroup; k *= 2) {
    int const other = group.from(before, max(rank - k, 0));
    before += rank >= k ? other : 0;
  }
  int const total = min(group.from(before, 15), kDegree);
  before -= in + out;
  for (int i = 0; i < in + out;
       ++i)  // the cell, how many of its roots are before and in it, and the sign changes at its start
    if (before + i < kDegree)
      s.cells[before + i] = i < in ? (rank | i << 8 | in << 16 | changes_inner << 24)
                                   : (rank + 16 | (i - in) << 8 | out << 16 | changes_outer << 24);
  group.sync();
  bool const exists = rank < total;
  int const code = exists ? s.cells[rank] : 0, cell = code & 15, wanted = code >> 8 & 255, changes = code >> 24;
  bool const is_reciprocal = code & 16, is_negative = is_reciprocal && cell >= 8;
  double start = is_reciprocal ? outer(cell) : inner(cell);
  double end = is_reciprocal ? (cell == 15 ? -1 : outer(cell + 1)) : (cell == 15 ? 1 : inner(cell + 1));
  int at_start = 0, at_end = code >> 16 & 255;
  for (int step = 0; step < kBisections; ++step) {
    bool const is_open = exists && (at_start < wanted || at_end > wanted + 1);
    if (!group.any(is_open)) break;
    double const middle = (start + end) / 2;
    int const at_middle = changes - sign_changes(s, {middle, is_reciprocal, is_negative});
    if (!is_open) continue;
    (at_middle > wanted ? end : start) = middle;
    (at_middle > wanted ? at_end : at_start) = at_middle;
  }
  double derivative;
  double low = min(start, end), high = max(start, end), x = (low + high) / 2;
  double const* const p = is_reciprocal ? s.reversed : s.sequence[0];
  double const at_low = value_at(p, low, derivative), at_high = value_at(p, high, derivative);
  bool const has_root = exists && at_low * at_high < 0, rises = at_high > 0;
  bool is_open = has_root;
  for (int step = 0; step < kNewtonSteps; ++step) {
    if (!group.any(is_open)) break;
    double const value = value_at(p, x, derivative);
    if (!is_open) continue;
    ((value < 0) == rises ? low : high) = x;
    double const newton = x - value / derivative;
    double const following = newton >= low && newton <= high ? newton : (low + high) / 2;
    is_open = small::magnitude(following - x) > 2e-16 * small::magnitude(following) && high > low;
    x = following;
  }
  return has_root ? (is_reciprocal ? 1 / x : x) : small::nan();
}

// The essential matrix of a root z.
KV_HD void matrix_of(Scratch const& s, double z, double* m) {
  double rows[3][3], best[3] = {}, largest = 0, norm = 0;
#pragma unroll
  for (int r = 0; r < 3; ++r)
#pragma unroll
    for (int c = 0; c < 3; ++c) {
      double value = 0;
#pragma unroll
      for (int i = 0; i < (c < 2 ? 4 : 5); ++i) value = value * z + s.system[r][4 * c + i];
      rows[r][c] = value;
    }
#pragma unroll
  for (int r = 0; r < 3; ++r) {
    double v[3];
    cross3(rows[r], rows[(r + 1) % 3], v);
    double const size = dot3(v, v);
    if (size > largest) largest = size, best[0] = v[0], best[1] = v[1], best[2] = v[2];
  }
  double const factors[] = {best[0] / best[2], best[1] / best[2], z, 1};
#pragma unroll
  for (int k = 0; k < 9; ++k) {
    m[k] = 0;
#pragma unroll
    for (int v = 0; v < 4; ++v) m[k] += factors[v] * s.e[k][v];
    norm += m[k] * m[k];
  }
  double const scale = small::finite(norm) ? 1 / sqrt(norm) : small::nan();
#pragma unroll
  for (int k = 0; k < 9; ++k) m[k] *= scale;
}

// Matrix `rank` of the first ten threads, NaN for missing ones.
template <class Group>
KV_HD void solve(double const* x, double const* y, Scratch& s, double* m, Group group) {
  double q[20];
  bool const is_independent = null_space(x, y, s, group);
  equations(s, q, group);
  eliminate(s, q, group);
  set_sequence(s, determinant(s, group), group);
  double const z = root(s, group);
  matrix_of(s, is_independent ? z : small::nan(), m);
}

}  // namespace kv::geometry::five_points
