// Bundles on the CPU: cameras, points or problems [begin, end) of all problems, for each phase of a step. In double:
// the AVX-512 build uses the AVX2 code.
#include "geometry/optim/fit_bundle.h"

#if !defined(__AVX512F__)
namespace kv::geometry::KV_ISA {
namespace {

constexpr int kSums = 8;  // of a product of rows that are formed at once

KV_HD double product(double const* a, double const* b, int64_t count) {
  double sums[kSums] = {}, sum = 0;
  int64_t k = 0;
  for (; k + kSums <= count; k += kSums)
    for (int i = 0; i < kSums; ++i) sums[i] += a[k + i] * b[k + i];
  for (; k < count; ++k) sum += a[k] * b[k];
  for (double const x : sums) sum += x;
  return sum;
}

}  // namespace

template <class T>
void bundle_start(FitBundle<T> const& p, int64_t begin, int64_t end) {
  int64_t const all = p.num_cameras + p.num_points;
  for (int64_t at = begin; at < end; ++at) bundles::start(p, at / all, at % all);
}

template <class T>
void bundle_points(FitBundle<T> const& p, int64_t begin, int64_t end) {
  for (int64_t at = begin; at < end; ++at)
    bundles::linearize_point(p, at / p.num_points, at % p.num_points, SingleThread{});
}

template <class T>
void bundle_cameras(FitBundle<T> const& p, int64_t begin, int64_t end) {
  for (int64_t at = begin; at < end; ++at) {
    int64_t const b = at / p.num_cameras, c = at % p.num_cameras;
    if (p.is_idle(b)) continue;
    double own[27], y[18];
    bundles::linearize_camera(p, b, c, own, SingleThread{});
    double* const rows = p.row(b, 6 * c);
    for (int i = 0; i < 6; ++i)
      for (int64_t k = 0; k < 6 * (c + 1); ++k) rows[i * p.pitch + k] = 0;
    bundles::add_couplings(p, b, c, 0, 1, rows, p.pitch, y, SingleThread{});
    for (int i = 0; i < 6; ++i) {
      for (int64_t k = 0; k < 6 * (c + 1); ++k) rows[i * p.pitch + k] = -rows[i * p.pitch + k];
      for (int k = 0; k <= i; ++k) rows[i * p.pitch + 6 * c + k] += own[pose_fits::entry(i, k)];
      p.row(b, p.size())[6 * c + i] = own[21 + i];
    }
  }
}

// Cholesky's method by rows of the lower triangle, which become those of L.
template <class T>
void bundle_factor(FitBundle<T> const& p, int64_t begin, int64_t end) {
  for (int64_t b = begin; b < end; ++b) {
    if (p.is_idle(b)) continue;
    for (int64_t i = 0; i <= p.size(); ++i)
      for (int64_t k = 0; k <= i && k < p.size(); ++k) {
        double& x = p.row(b, i)[k];
        x -= product(p.row(b, i), p.row(b, k), k);
        x = i == k ? (x > 0 ? sqrt(x) : small::nan()) : x / p.row(b, k)[k];
      }
  }
}

template <class T>
void bundle_solve(FitBundle<T> const& p, int64_t begin, int64_t end) {
  for (int64_t b = begin; b < end; ++b) {
    if (p.is_idle(b)) continue;
    double* const x = p.row(b, p.size());
    for (int64_t i = p.size() - 1; i >= 0; --i) {
      double const* const row = p.row(b, i);
      x[i] /= row[i];
      for (int64_t k = 0; k < i; ++k) x[k] -= row[k] * x[i];
    }
    for (int64_t c = 0; c < p.num_cameras; ++c) {
      for (int i = 0; i < 6; ++i) p.camera_terms[18 * (b * p.num_cameras + c) + 12 + i] = x[6 * c + i];
      bundles::move_camera(p, b, c);
    }
  }
}

template <class T>
void bundle_evaluate(FitBundle<T> const& p, int64_t begin, int64_t end) {
  for (int64_t at = begin; at < end; ++at)
    bundles::evaluate_point(p, at / p.num_points, at % p.num_points, SingleThread{});
}

template <class T>
void bundle_accept(FitBundle<T> const& p, int64_t begin, int64_t end) {
  for (int64_t b = begin; b < end; ++b) bundles::accept(p, b, SingleThread{});
}

template <class T>
void bundle_finish(FitBundle<T> const& p, int64_t begin, int64_t end) {
  int64_t const all = p.num_cameras + p.num_points;
  for (int64_t at = begin; at < end; ++at) bundles::finish(p, at / all, at % all);
}

KV_INSTANTIATE_ONE(bundle_start, FitBundle, double)
KV_INSTANTIATE_ONE(bundle_points, FitBundle, double)
KV_INSTANTIATE_ONE(bundle_cameras, FitBundle, double)
KV_INSTANTIATE_ONE(bundle_factor, FitBundle, double)
KV_INSTANTIATE_ONE(bundle_solve, FitBundle, double)
KV_INSTANTIATE_ONE(bundle_evaluate, FitBundle, double)
KV_INSTANTIATE_ONE(bundle_accept, FitBundle, double)
KV_INSTANTIATE_ONE(bundle_finish, FitBundle, double)

}  // namespace kv::geometry::KV_ISA
#endif
