// Small matrices and polynomials in double: homogeneous least squares, null spaces, real roots. Included by the CPU and
// CUDA kernels of geometry that solve equations.
#pragma once

#include "core/hd.h"
#include "core/matrix3.h"
#include "geometry/thread_group.h"

namespace kv::geometry {

// float32 or float64 numbers, read and written as double. Kernels compute in double for both, so they are compiled
// once.
struct Reals {
  void const* data;
  bool is_double;
  KV_HD double operator[](int64_t i) const {
    return is_double ? static_cast<double const*>(data)[i] : double(static_cast<float const*>(data)[i]);
  }
  KV_HD void set(int64_t i, double x) const {
    if (is_double)
      static_cast<double*>(const_cast<void*>(data))[i] = x;
    else
      static_cast<float*>(const_cast<void*>(data))[i] = float(x);
  }
};

// Keeps long functions from being inlined on CUDA. If inlined into one kernel, CUDA 13.0 compiles them to wrong code:
// NaN for 9 x 9 matrices, and no models from five points. With calls the results are those of the CPU.
#if defined(__CUDACC__)
#define KV_CALLED inline __host__ __device__ __noinline__
#else
#define KV_CALLED KV_HD
#endif

namespace small {

KV_HD double magnitude(double x) { return x < 0 ? -x : x; }
KV_HD bool finite(double x) { return x - x == 0; }
KV_HD double nan() { return __builtin_nan(""); }

// The unroll factor of loops over matrices on CUDA. Loops over large matrices are not unrolled, for short compile
// times.
template <int N>
constexpr int kUnrolled = N <= 4 ? N : 1;

// --- symmetric matrices, stored as all N x N entries -----------------------------------------------------------------

// The threads of a group (thread_group.h) take rows or entries in turns, of matrices in shared storage.

// Inverts a positive definite matrix in place, sweeping row by row, and returns the smallest pivot.
template <int N, class Group = SingleThread>
KV_HD double invert(double* m, Group group = {}) {
  double min_pivot = m[0];
#pragma unroll 1
  for (int k = 0; k < N; ++k) {
    double const inverse = 1 / m[k * N + k];
    min_pivot = min(min_pivot, m[k * N + k]);
    if (group.num_threads() == 1) {
#pragma unroll(kUnrolled<N>)
      for (int i = 0; i < N; ++i) {
        if (i == k) continue;
        double const factor = m[i * N + k] * inverse;
        for (int j = 0; j < N; ++j)
          if (j != k) m[i * N + j] -= factor * m[k * N + j];
      }
    } else {
      for (int e = group.thread_rank(); e < N * N; e += group.num_threads())
        if (e / N != k && e % N != k) m[e] -= m[e / N * N + k] * inverse * m[k * N + e % N];
    }
    group.sync();
    for (int i = group.thread_rank(); i < N; i += group.num_threads()) {
      if (i != k)
        m[i * N + k] = m[k * N + i] *= inverse;
      else
        m[k * N + k] = -inverse;
    }
    group.sync();
  }
  for (int i = group.thread_rank(); i < N * N; i += group.num_threads()) m[i] = -m[i];
  group.sync();
  return min_pivot;
}

// Divides a matrix by its trace. Returns false, and leaves it unchanged, unless the trace is positive and finite.
template <int N, class Group = SingleThread>
KV_HD bool normalize_trace(double* m, Group group = {}) {
  double trace = 0;
  for (int i = 0; i < N; ++i) trace += m[i * N + i];
  group.sync();
  if (!(trace > 0) || !finite(trace)) return false;
  for (int i = group.thread_rank(); i < N * N; i += group.num_threads()) m[i] /= trace;
  group.sync();
  return true;
}

// The sign of an eigenvector, v or -v, is the one for which a fixed weighted sum of the entries is positive.
template <int N>
KV_HD double sign_convention(double const* v) {
  double sum = 0, weight = 1;
  for (int i = 0; i < N; ++i, weight *= 0.7) sum += weight * v[i];
  return sum < 0 ? -1 : 1;
}

// Memory for a symmetric matrix, the eigenvector v of its smallest eigenvalue, the gradient g to v, and u, which
// determines the gradient to the matrix. The second line is scratch memory.
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
template <int N, class Group>
KV_HD void multiply_vector(double const* m, double const* y, double* x, Group group) {
  for (int i = group.thread_rank(); i < N; i += group.num_threads()) x[i] = dot<N>(m + i * N, y);
  group.sync();
}

// Sets v to the unit eigenvector of the largest eigenvalue of m, a positive semidefinite matrix of trace 1. Squares m
// until it is v v^T, because powers of smaller eigenvalues vanish. Destroys m, `square` and w.
template <int N, class Group>
KV_HD void largest_eigenvector(double* m, double* square, double* w, double* v, Group group) {
  for (int step = 0; step < 40; ++step) {
    if (group.num_threads() == 1) {
#pragma unroll(kUnrolled<N>)
      for (int i = 0; i < N; ++i) {
        double row[N];
        for (int k = 0; k < N; ++k) row[k] = m[i * N + k];
#pragma unroll(kUnrolled<N>)
        for (int j = 0; j <= i; ++j) square[i * N + j] = square[j * N + i] = dot<N>(row, m + j * N);
      }
    } else {
      for (int e = group.thread_rank(); e < N * N; e += group.num_threads())
        square[e] = dot<N>(m + e / N * N, m + e % N * N);
    }
    group.sync();
    double trace = 0;
    for (int i = 0; i < N; ++i) trace += square[i * N + i];
    double const scale = 1 / trace;
    for (int i = group.thread_rank(); i < N * N; i += group.num_threads()) m[i] = square[i] * scale;
    group.sync();
    if (trace > 1 - 1e-9) break;  // the other eigenvalues are below 1e-9 of the largest; two more products follow
  }
  int best = 0;
  for (int i = 1; i < N; ++i)
    if (m[i * N + i] > m[best * N + best]) best = i;
  for (int i = group.thread_rank(); i < N; i += group.num_threads()) v[i] = m[i * N + best];
  group.sync();
  for (int step = 0; step < 2; ++step) {
    multiply_vector<N>(m, v, w, group);
    double const scale = (step == 1 ? sign_convention<N>(w) : 1) / sqrt(dot<N>(w, w));
    for (int i = group.thread_rank(); i < N; i += group.num_threads()) v[i] = w[i] * scale;
    group.sync();
  }
}

// Sets v to the unit eigenvector of the smallest eigenvalue of a positive semidefinite matrix M: that of the largest
// eigenvalue of the inverse of M + 1e-6. The shift keeps digits if several eigenvalues are 0. Newton's method then
// removes what rounding adds of other eigenvectors. NaN if M is not finite; any vector if M is 0. Destroys m; the other
// matrices and r are scratch memory.
template <int N, class Group>
KV_HD void smallest_eigenvector_in(double* m, double* inverse, double* powers, double* square, double* r, double* v,
                                   Group group) {
  bool is_known = true;
  for (int i = group.thread_rank(); i < N * N; i += group.num_threads()) is_known = is_known && finite(m[i]);
  if (!group.all(is_known)) {
    for (int i = group.thread_rank(); i < N; i += group.num_threads()) v[i] = nan();
    group.sync();
    return;
  }
  group.sync();
  if (!normalize_trace<N>(m, group)) {
    for (int i = group.thread_rank(); i < N; i += group.num_threads()) m[i * N + i] = 1.0 / N;
    group.sync();
  }
  for (int i = group.thread_rank(); i < N * N; i += group.num_threads())
    inverse[i] = m[i] + (i % (N + 1) == 0 ? 1e-6 : 0);
  group.sync();
  invert<N>(inverse, group);
  for (int i = group.thread_rank(); i < N * N; i += group.num_threads()) powers[i] = inverse[i];
  group.sync();
  normalize_trace<N>(powers, group);
  largest_eigenvector<N>(powers, square, r, v, group);
  for (int step = 0; step < 2; ++step) {
    multiply_vector<N>(m, v, r, group);
    double const value = dot<N>(r, v);
    group.sync();
    for (int i = group.thread_rank(); i < N; i += group.num_threads()) r[i] -= value * v[i];
    group.sync();
    for (int i = group.thread_rank(); i < N; i += group.num_threads()) v[i] -= dot<N>(inverse + i * N, r);
    group.sync();
    double const length = sqrt(dot<N>(v, v));
    group.sync();
    for (int i = group.thread_rank(); i < N; i += group.num_threads()) v[i] /= length;
    group.sync();
  }
}
template <int N, class Group>
KV_CALLED void smallest_eigenvector(EigenSpace<N>& space, Group group) {
  for (int i = group.thread_rank(); i < N * N; i += group.num_threads()) space.m[i] = space.matrix[i];
  group.sync();
  smallest_eigenvector_in<N>(space.m, space.inverse, space.powers, space.square, space.r, space.v, group);
}
template <int N>
KV_CALLED void smallest_eigenvector(double* m, double* v) {
  double inverse[N * N], powers[N * N], square[N * N], r[N];
  smallest_eigenvector_in<N>(m, inverse, powers, square, r, v, SingleThread{});
}

// Jacobi's method (1846): rotations make a symmetric matrix diagonal. Its diagonal becomes the eigenvalues, and the
// columns of `vectors` become the eigenvectors.
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
        double const cotangent = (m[q * N + q] - m[p * N + p]) / (2 * between);
        double const t = (cotangent < 0 ? -1 : 1) / (magnitude(cotangent) + sqrt(cotangent * cotangent + 1));
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

// Computes u = (M - lambda)^+ g, from the gradient g to the eigenvector v of M's smallest eigenvalue. The gradient to
// M, symmetric, is -(u v^T + v u^T) / 2. In directions of other eigenvalues that are as small it is undefined, and set
// to 0. Destroys M.
template <int N, class Group>
KV_HD void smallest_eigenvector_vjp_in(double* m, double* inverse, double* r, double const* v, double const* g,
                                       double* u, Group group) {
  multiply_vector<N>(m, v, r, group);
  double const value = dot<N>(r, v), projection = dot<N>(g, v);
  double trace = 0;
  for (int i = 0; i < N; ++i) trace += m[i * N + i];
  // On vectors orthogonal to v the pseudoinverse is the inverse of M - lambda + trace v v^T, unless other directions
  // are null.
  for (int i = group.thread_rank(); i < N; i += group.num_threads()) {
    for (int k = 0; k < N; ++k) inverse[i * N + k] = m[i * N + k] - (i == k ? value : 0) + trace * v[i] * v[k];
    u[i] = 0;
  }
  group.sync();
  if (invert<N>(inverse, group) > 1e-7 * trace) {
    for (int i = group.thread_rank(); i < N; i += group.num_threads())
      for (int k = 0; k < N; ++k) u[i] += inverse[i * N + k] * (g[k] - projection * v[k]);
  } else if (group.thread_rank() == 0) {
    diagonalize<N>(m, inverse);
    double min_pivot = m[0];
    for (int i = 1; i < N; ++i) min_pivot = min(min_pivot, m[i * N + i]);
    for (int k = 0; k < N; ++k) {
      double const gap = m[k * N + k] - min_pivot;
      if (!(gap > 1e-13 * trace)) continue;
      double part = 0;
      for (int i = 0; i < N; ++i) part += inverse[i * N + k] * g[i];
      for (int i = 0; i < N; ++i) u[i] += inverse[i * N + k] * (part / gap);
    }
  }
  group.sync();
}
template <int N, class Group>
KV_CALLED void smallest_eigenvector_vjp(EigenSpace<N>& space, Group group) {
  smallest_eigenvector_vjp_in<N>(space.matrix, space.inverse, space.r, space.v, space.g, space.u, group);
}
template <int N>
KV_CALLED void smallest_eigenvector_vjp(double* m, double const* v, double const* g, double* u) {
  double inverse[N * N], r[N];
  smallest_eigenvector_vjp_in<N>(m, inverse, r, v, g, u, SingleThread{});
}

// --- 3 x 3 -----------------------------------------------------------------------------------------------------------

// Projects a matrix f to the nearest one of rank 2, f - f v v^T. The right singular vector v of the smallest singular
// value is that of the largest one of the cofactor matrix. Returns false, and leaves f unchanged, if the cofactors are
// 0.
KV_HD bool project_to_rank_two(double* f, double* v) {
  double c[9], square[9], again[9], w[3];
  cofactors3(f, c);
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) square[3 * i + j] = c[i] * c[j] + c[3 + i] * c[3 + j] + c[6 + i] * c[6 + j];
  if (!normalize_trace<3>(square)) return false;
  largest_eigenvector<3>(square, again, w, v, SingleThread{});
  for (int i = 0; i < 9; i += 3) {
    double const projection = dot3(f + i, v);
    for (int k = 0; k < 3; ++k) f[i + k] -= projection * v[k];
  }
  return true;
}

// --- null spaces -----------------------------------------------------------------------------------------------------

// The null space of `rows` equations in nine unknowns: 9 - rows vectors, by Gaussian elimination with full pivoting.
// Returns false if the equations are linearly dependent. Destroys the equations.
KV_CALLED bool null_space(double (*a)[9], int rows, double (*space)[9]) {
  int column[9];
  for (int k = 0; k < 9; ++k) column[k] = k;
  double largest = 0;
  for (int k = 0; k < rows; ++k) {
    int row = k, at = k;
    double largest_entry = -1;
    for (int i = k; i < rows; ++i)
      for (int j = k; j < 9; ++j)
        if (magnitude(a[i][column[j]]) > largest_entry) largest_entry = magnitude(a[i][column[j]]), row = i, at = j;
    if (k == 0) largest = largest_entry;
    if (!(largest_entry > 1e-12 * largest) || !finite(largest_entry)) return false;
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

constexpr int kMaxRoots = 10;

KV_HD double evaluate_polynomial(double const* p, int degree, double x, double& derivative) {
  double value = 0;
  derivative = 0;
  for (int i = 0; i <= degree; ++i) {
    derivative = derivative * x + value;
    value = value * x + p[i];
  }
  return value;
}

// -1, 0 or 1: a value within rounding of 0 counts as 0.
KV_HD int sign_of_polynomial(double const* p, int degree, double x) {
  double value = 0, size = 0;
  for (int i = 0; i <= degree; ++i) {
    value = value * x + p[i];
    size = size * magnitude(x) + magnitude(p[i]);
  }
  return magnitude(value) <= 1e-14 * size ? 0 : value < 0 ? -1 : 1;
}

// The root between two points where the polynomial has different signs, by Newton's method safeguarded by bisection.
KV_HD double root_between(double const* p, int degree, double low, double high, bool rising) {
  double x = (low + high) / 2;
  for (int step = 0; step < 60 && high - low > 0; ++step) {
    double derivative;
    double const value = evaluate_polynomial(p, degree, x, derivative);
    ((value < 0) == rising ? low : high) = x;
    double const newton = x - value / derivative;
    double const next = newton >= low && newton <= high ? newton : (low + high) / 2;
    if (next == x) break;
    x = next;
  }
  return x;
}

// Roots in [-1, 1], ascending, with multiplicity. Between neighboring roots of its derivative a polynomial has at most
// one root.
KV_CALLED int roots_in_unit(double const* p, int degree, double* roots) {
  double critical[kMaxRoots + 1], derivative[kMaxRoots + 1];
  int count = 0;
  for (int d = 1; d <= degree; ++d) {
    for (int i = 0; i <= d; ++i) {
      derivative[i] = p[i];
      for (int k = 0; k < degree - d; ++k) derivative[i] *= double(degree - i - k) / double(degree - k);
    }
    int num_roots = 0, sign_low = sign_of_polynomial(derivative, d, -1);
    double low = -1;
    auto const add = [&](double x) {
      if (num_roots < d) roots[num_roots++] = x;
    };
    if (sign_low == 0 && !(count > 0 && critical[0] == -1)) add(-1);
    for (int k = 0; k <= count; ++k) {
      double const high = k < count ? critical[k] : 1;
      int const sign_high = sign_of_polynomial(derivative, d, high);
      if (sign_low * sign_high < 0) add(root_between(derivative, d, low, high, sign_high > 0));
      if (sign_high == 0) {
        add(high);
        if (k < count && (k == 0 || critical[k] != low)) add(high);  // a root of the derivative counts once more
      }
      sign_low = sign_high;
      low = high;
    }
    count = num_roots;
    for (int k = 0; k < count; ++k) critical[k] = roots[k];
  }
  return count;
}

// Simple roots in [-1, 1] of a polynomial of a degree up to kMaxRoots, by Sturm's sequence: how often its signs change
// at two points tells how many roots are between. It takes a fifth of the time of roots_in_unit, and counts a root of
// several once or not at all.
struct SturmSequence {
  double p[kMaxRoots + 1][kMaxRoots + 1];
  int degree[kMaxRoots + 1], length;

  KV_HD SturmSequence(double const* polynomial, int n) : length(2) {
    for (int i = 0; i <= n; ++i) p[0][i] = polynomial[i];
    for (int i = 0; i < n; ++i) p[1][i] = polynomial[i] * (n - i);
    degree[0] = n, degree[1] = n - 1;
    while (degree[length - 1] > 0) {  // the negative remainder of the last two, up to a positive factor
      double const *const a = p[length - 2], *const b = p[length - 1];
      int const na = degree[length - 2], nb = degree[length - 1];
      double rest[kMaxRoots + 1], *const r = p[length], largest = 0;
      for (int i = 0; i <= na; ++i) rest[i] = a[i];
      double const inverse = 1 / b[0];
      for (int k = 0; k <= na - nb; ++k) {
        double const factor = rest[k] * inverse;
        for (int i = 1; i <= nb; ++i) rest[k + i] -= factor * b[i];
      }
      for (int i = na - nb + 1; i <= na; ++i) largest = max(largest, magnitude(rest[i]));
      if (!(largest > 1e-14 * magnitude(b[0])) || !finite(largest)) return;
      int first = na - nb + 1;
      while (first < na && magnitude(rest[first]) <= 1e-14 * largest) ++first;
      double const scale = -1 / largest;
      for (int i = first; i <= na; ++i) r[i - first] = rest[i] * scale;
      degree[length++] = na - first;
    }
  }
  KV_HD int sign_changes(double x) const {
    int changes = 0;
    double last = 0;
    for (int k = 0; k < length; ++k) {
      double value = p[k][0];
      for (int i = 1; i <= degree[k]; ++i) value = value * x + p[k][i];
      changes += last * value < 0;
      last = value != 0 ? value : last;
    }
    return changes;
  }
};
KV_CALLED int simple_roots_in_unit(double const* p, int degree, double* roots) {
  SturmSequence const sequence(p, degree);
  struct Interval {
    double low, high;
    int changes_low, changes_high;
  };
  Interval open[64];
  int num_open = 1, count = 0;
  open[0] = {-1, 1, sequence.sign_changes(-1), sequence.sign_changes(1)};
  while (num_open > 0 && count < degree) {
    Interval const at = open[--num_open];
    int const num_roots = at.changes_low - at.changes_high;
    if (num_roots <= 0 || at.high - at.low < 1e-12) continue;
    if (num_roots == 1) {
      double derivative;
      double const low = evaluate_polynomial(p, degree, at.low, derivative),
                   high = evaluate_polynomial(p, degree, at.high, derivative);
      if (low * high < 0) {
        roots[count++] = root_between(p, degree, at.low, at.high, high > 0);
        continue;
      }
    }
    double const middle = (at.low + at.high) / 2;
    int const changes = sequence.sign_changes(middle);
    if (num_open + 2 > 64) break;
    open[num_open++] = {middle, at.high, changes, at.changes_high};
    open[num_open++] = {at.low, middle, at.changes_low, changes};
  }
  return count;
}

// Returns the number of real roots, which are in no order. Roots outside of [-1, 1] are reciprocals of roots of the
// mirrored polynomial. With kSimple, roots of several may be missing.
template <bool kSimple = false>
KV_CALLED int real_roots(double const* coefficients, int degree, double* roots) {
  double p[kMaxRoots + 1], mirrored[kMaxRoots + 1], mirrored_roots[kMaxRoots];
  double largest = 0;
  for (int i = 0; i <= degree; ++i) largest = max(largest, magnitude(coefficients[i]));
  if (!(largest > 0) || !finite(largest)) return 0;
  for (int i = 0; i <= degree; ++i) p[i] = mirrored[degree - i] = coefficients[i] / largest;
  if (kSimple && (p[0] == 0 || mirrored[0] == 0)) return 0;
  int count = kSimple ? simple_roots_in_unit(p, degree, roots) : roots_in_unit(p, degree, roots);
  int const outside = kSimple ? simple_roots_in_unit(mirrored, degree, mirrored_roots)
                              : roots_in_unit(mirrored, degree, mirrored_roots);
  for (int i = 0; i < outside; ++i)
    if (magnitude(mirrored_roots[i]) < 1 && mirrored_roots[i] != 0 && count < degree && finite(1 / mirrored_roots[i]))
      roots[count++] = 1 / mirrored_roots[i];
  return count;
}

}  // namespace small
}  // namespace kv::geometry
