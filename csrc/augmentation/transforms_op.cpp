// Matrices of chains of transforms: schemas and entries, for CPU and CUDA.
#include "augmentation/transforms_glue.h"

namespace kv::augmentation {
namespace {

Tensor transform_matrix(Tensor const& columns, std::vector<int64_t> const& plan, std::vector<double> const& numbers) {
  return chain_matrix("transform_matrix", columns, plan, numbers);
}

Tensor transform_matrix_backward(Tensor const& grad, Tensor const& columns, std::vector<int64_t> const& plan,
                                 std::vector<double> const& numbers) {
  constexpr char const* op = "transform_matrix_backward";
  check_columns(op, columns);
  KV_CHECK(grad.dim() == 3 && grad.size(0) == columns.size(0) && grad.size(1) == 3 && grad.size(2) == 3 &&
               grad.scalar_type() == columns.scalar_type() && grad.device() == columns.device(),
           op, ": expected grad of shape (B, 3, 3), of the dtype and device of columns");
  Tensor const g = dense(grad), result = empty({columns.size(0), columns.size(1)}, columns);
  dispatch_floating(op, columns, [&]<class T>(Type<T>) {
    auto params = transform_params<T>(op, columns, plan, numbers);
    params.grad = data_ptr<T const>(g);
    params.grad_parameters = data_ptr<T>(result);
    KV_RUN(transform_matrix_backward, columns, params, params.columns ? params.batch : 0,
           64 * params.count * params.columns);
  });
  return result;
}

}  // namespace

KV_OPERATOR(transform_matrix, "(Tensor columns, int[] plan, float[] numbers) -> Tensor")
KV_OPERATOR(transform_matrix_backward, "(Tensor grad, Tensor columns, int[] plan, float[] numbers) -> Tensor")

}  // namespace kv::augmentation
