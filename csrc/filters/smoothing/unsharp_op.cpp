// unsharp_mask: schemas and entries, for CPU and CUDA.
#include "filters/separable_glue.h"

namespace kv::filters {
namespace {

Tensor unsharp_mask(Tensor const& input, std::optional<Tensor> const& sigma, int64_t ky, int64_t kx, double sigma_y,
                    double sigma_x, int64_t border) {
  return run_gaussian("unsharp_mask", input, sigma, ky, kx, sigma_y, sigma_x, border, false, -1, 2);
}

Tensor unsharp_mask_backward(Tensor const& grad, std::optional<Tensor> const& sigma, int64_t ky, int64_t kx,
                             double sigma_y, double sigma_x, int64_t border) {
  return run_gaussian("unsharp_mask_backward", grad, sigma, ky, kx, sigma_y, sigma_x, border, true, -1, 2);
}

}  // namespace

KV_OPERATOR(unsharp_mask,
            "(Tensor input, Tensor? sigma, int ky, int kx, float sigma_y, float sigma_x, int border) -> Tensor")
KV_OPERATOR(unsharp_mask_backward,
            "(Tensor grad, Tensor? sigma, int ky, int kx, float sigma_y, float sigma_x, int border) -> Tensor")

}  // namespace kv::filters
