// gaussian_blur2d: schemas and entries, for CPU and CUDA alike.
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

}  // namespace

KV_OPERATOR(gaussian_blur2d,
            "(Tensor input, Tensor? sigma, int ky, int kx, float sigma_y, float sigma_x, int border) -> Tensor")
KV_OPERATOR(gaussian_blur2d_backward,
            "(Tensor grad, Tensor? sigma, int ky, int kx, float sigma_y, float sigma_x, int border) -> Tensor")

}  // namespace kv::filters
