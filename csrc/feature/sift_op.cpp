// SIFT descriptors: schemas and entries, for CPU and CUDA.
#include "patch_glue.h"
#include "sift.h"

namespace kv::feature {
namespace {

constexpr int64_t kMaxSiftBins = 64, kMaxSiftCells = 32, kLargestSift = 1024;

SiftGrid sift_grid(char const* op, int n, int64_t bins, int64_t cells) {
  KV_CHECK(bins >= 2 && bins <= kMaxSiftBins, op, ": expected angular_bins of 2 to ", kMaxSiftBins, ", got ", bins);
  KV_CHECK(cells >= 1 && cells <= kMaxSiftCells, op, ": expected spatial_bins of 1 to ", kMaxSiftCells, ", got ",
           cells);
  KV_CHECK(bins * cells * cells <= kLargestSift, op, ": expected descriptors of at most ", kLargestSift, " numbers");
  SiftGrid grid{n, int(cells), int(bins), n / int(cells), 2 * (n / (int(cells) + 1))};
  int const padding =
      grid.width - n + (grid.cells - 1) * grid.stride;  // twice the pixels that a window is out of bounds
  grid.width += padding % 2 != 0;
  KV_CHECK(grid.stride > 0 && grid.width > 0 && padding >= -1, op, ": patches of ", n, " pixels do not fit ", cells,
           " cells");
  return grid;
}

Tensor sift(Tensor const& patches, int64_t angular_bins, int64_t spatial_bins, double clip, bool root) {
  int const n = check_patches("sift", patches);
  SiftGrid const grid = sift_grid("sift", n, angular_bins, spatial_bins);
  Tensor const x = dense(patches), descriptors = empty({x.size(0), grid.size()}, x);
  dispatch_floating("sift", x, [&](auto type) {
    using T = typename decltype(type)::type;
    Sift<T> const params{data_ptr<T const>(x), data_ptr<T>(descriptors), x.size(0), grid, Compute<T>(clip), root};
    KV_RUN(sift, x, params, params.count, 20 * n * n);
  });
  return descriptors;
}

Tensor sift_backward(Tensor const& grad, Tensor const& patches, int64_t angular_bins, int64_t spatial_bins, double clip,
                     bool root) {
  constexpr char const* op = "sift_backward";
  int const n = check_patches(op, patches);
  SiftGrid const grid = sift_grid(op, n, angular_bins, spatial_bins);
  check_patch_gradient(op, grad, patches, {patches.size(0), grid.size()});
  Tensor const g = dense(grad), x = dense(patches), grad_x = empty(x.sizes(), x);
  dispatch_floating(op, x, [&](auto type) {
    using T = typename decltype(type)::type;
    SiftBackward<T> const params{
        data_ptr<T const>(g), data_ptr<T const>(x), data_ptr<T>(grad_x), x.size(0), grid, Compute<T>(clip), root};
    KV_RUN(sift_backward, x, params, params.count, 40 * n * n);
  });
  return grad_x;
}

}  // namespace

KV_OPERATOR(sift, "(Tensor patches, int angular_bins, int spatial_bins, float clip, bool root) -> Tensor")
KV_OPERATOR(sift_backward,
            "(Tensor grad, Tensor patches, int angular_bins, int spatial_bins, float clip, bool root) -> Tensor")

}  // namespace kv::feature
