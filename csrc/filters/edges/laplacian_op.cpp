// Laplacian with a kernel of ones around a negative center: a window sum (smoothing/box.h), less the center times the
// number of weights.
#include "filters/smoothing/box_glue.h"

namespace kv::filters {
namespace {

// Ones with 1 - n in the center; the sum of their magnitudes is 2 (n - 1).
double laplacian_divisor(int64_t ky, int64_t kx, bool normalized) {
  return normalized ? 2 * (double(ky) * double(kx) - 1) : 1;
}

Tensor laplacian(Tensor const& input, int64_t ky, int64_t kx, bool normalized, int64_t border) {
  return run_box<false>("laplacian", input, ky, kx, border, -double(ky) * double(kx),
                        laplacian_divisor(ky, kx, normalized));
}

Tensor laplacian_backward(Tensor const& grad, int64_t ky, int64_t kx, bool normalized, int64_t border) {
  return run_box<true>("laplacian_backward", grad, ky, kx, border, -double(ky) * double(kx),
                       laplacian_divisor(ky, kx, normalized));
}

}  // namespace

KV_OPERATOR(laplacian, "(Tensor input, int ky, int kx, bool normalized, int border) -> Tensor")
KV_OPERATOR(laplacian_backward, "(Tensor grad, int ky, int kx, bool normalized, int border) -> Tensor")

}  // namespace kv::filters
