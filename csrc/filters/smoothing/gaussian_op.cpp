// gaussian_blur2d and levels of scale spaces: schemas and entries, for CPU and CUDA.
#include "filters/separable_glue.h"

namespace kv::filters {
namespace {

Tensor gaussian_blur2d(Tensor const& input, std::optional<Tensor> const& sigma, int64_t ky, int64_t kx, double sigma_y,
                       double sigma_x, int64_t border) {
  return run_gaussian("gaussian_blur2d", input, sigma, ky, kx, sigma_y, sigma_x, border, false, 1, 0);
}

Tensor gaussian_blur2d_backward(Tensor const& grad, std::optional<Tensor> const& sigma, int64_t ky, int64_t kx,
                                double sigma_y, double sigma_x, int64_t border) {
  return run_gaussian("gaussian_blur2d_backward", grad, sigma, ky, kx, sigma_y, sigma_x, border, true, 1, 0);
}

// The levels of a scale space: the image, and each level blurred to the next one, (B, C, 1 + n, H, W).
Tensor gaussian_levels(Tensor const& input, std::vector<int64_t> sizes, std::vector<double> sigmas, int64_t border) {
  constexpr char const* op = "gaussian_levels";
  check_images(op, "input", input);
  KV_CHECK(sizes.size() == sigmas.size(), op, ": expected a size for each sigma");
  int64_t const count = int64_t(sizes.size());
  Tensor const levels = empty({input.size(0), input.size(1), 1 + count, input.size(2), input.size(3)}, input);
  Tensor level = torch::stable::select(levels, 2, 0);
  torch::stable::copy_(level, input);
  for (int64_t i = 0; i < count; ++i) {
    int64_t const size = sizes[size_t(i)];
    double const sigma = sigmas[size_t(i)];
    check_window(op, size, size);
    Tensor const next = torch::stable::select(levels, 2, i + 1);
    separable_into(op, level, next, Layout::planar, {nullptr, size, true, 1, sigma}, {nullptr, size, true, 0, sigma},
                   to_border(op, border), true, false, 1, 0);
    level = next;
  }
  return levels;
}

}  // namespace

KV_OPERATOR(gaussian_blur2d,
            "(Tensor input, Tensor? sigma, int ky, int kx, float sigma_y, float sigma_x, int border) -> Tensor")
KV_OPERATOR(gaussian_blur2d_backward,
            "(Tensor grad, Tensor? sigma, int ky, int kx, float sigma_y, float sigma_x, int border) -> Tensor")
KV_OPERATOR(gaussian_levels, "(Tensor input, int[] sizes, float[] sigmas, int border) -> Tensor")

}  // namespace kv::filters
