// Dominant orientations: schemas and entries, for CPU and CUDA.
#include "orientation.h"
#include "patch_glue.h"

namespace kv::feature {
namespace {

int checked_bins(char const* op, int64_t bins) {
  KV_CHECK(bins >= 3 && bins <= kMaxOrientationBins, op, ": expected bins of 3 to ", kMaxOrientationBins, ", got ",
           bins);
  return int(bins);
}

int checked_peaks(char const* op, int64_t peaks, int bins) {
  KV_CHECK(peaks >= 1 && peaks <= bins, op, ": expected peaks of 1 to ", bins, ", got ", peaks);
  return int(peaks);
}

Tensor orientation(Tensor const& patches, int64_t bins, double eps, int64_t peaks, double threshold) {
  int const n = check_patches("orientation", patches), count = checked_bins("orientation", bins);
  int const of_patch = checked_peaks("orientation", peaks, count);
  Tensor const x = dense(patches), angles = empty({x.size(0), peaks}, x);
  dispatch_floating("orientation", x, [&](auto type) {
    using T = typename decltype(type)::type;
    Orientation<T> const params{data_ptr<T const>(x), data_ptr<T>(angles),  x.size(0), n, count, of_patch,
                                Compute<T>(eps),      Compute<T>(threshold)};
    KV_RUN(orientation, x, params, params.count, 20 * n * n);
  });
  return angles;
}

Tensor orientation_backward(Tensor const& grad, Tensor const& patches, int64_t bins, double eps, int64_t peaks,
                            double threshold) {
  constexpr char const* op = "orientation_backward";
  int const n = check_patches(op, patches), count = checked_bins(op, bins), of_patch = checked_peaks(op, peaks, count);
  check_patch_gradient(op, grad, patches, {patches.size(0), peaks});
  Tensor const g = dense(grad), x = dense(patches), grad_x = empty(x.sizes(), x);
  dispatch_floating(op, x, [&](auto type) {
    using T = typename decltype(type)::type;
    OrientationBackward<T> const params{
        data_ptr<T const>(g), data_ptr<T const>(x), data_ptr<T>(grad_x), x.size(0), n, count, of_patch,
        Compute<T>(eps),      Compute<T>(threshold)};
    KV_RUN(orientation_backward, x, params, params.count, 40 * n * n);
  });
  return grad_x;
}

}  // namespace

KV_OPERATOR(orientation, "(Tensor patches, int bins, float eps, int peaks, float threshold) -> Tensor")
KV_OPERATOR(orientation_backward,
            "(Tensor grad, Tensor patches, int bins, float eps, int peaks, float threshold) -> Tensor")

}  // namespace kv::feature
