// Matrices of chains of transforms: schemas and entries, for CPU and CUDA alike.
#include "augmentation/transforms.h"
#include "glue/glue.h"

namespace kv::augmentation {
namespace {

// The plan has for each transform its kind and the columns of its inputs.
template <class T>
TransformMatrix<T> transform_params(char const* op, Tensor const& columns, std::vector<int64_t> const& plan,
                                    std::vector<double> const& numbers) {
  TransformMatrix<T> p;
  p.parameters = data_ptr<T const>(columns);
  p.stride = columns.stride(0);
  p.column_stride = columns.stride(1);
  p.batch = columns.size(0);
  p.columns = int(columns.size(1));
  p.count = 0;
  size_t number = 0;
  for (size_t at = 0; at < plan.size(); ++p.count) {
    KV_CHECK(p.count < kMaxTransforms, op, ": expected at most ", kMaxTransforms, " transforms");
    int64_t const kind = plan[at++];
    KV_CHECK(kind >= 0 && kind < kTransformKinds, op, ": there is no kind of transform ", kind);
    p.kinds[p.count] = TransformKind(kind);
    size_t const count = size_t(num_inputs_of(TransformKind(kind)));
    KV_CHECK(at + count <= plan.size() && number + count <= kMaxTransformNumbers, op, ": expected ", count,
             " columns of inputs, and at most ", kMaxTransformNumbers, " in all");
    for (size_t i = 0; i < count; ++i, ++at, ++number) {
      KV_CHECK(plan[at] >= -1 && plan[at] < p.columns, op, ": there is no column ", plan[at]);
      p.indices[number] = int16_t(plan[at]);
    }
  }
  KV_CHECK(numbers.size() == number, op, ": expected ", number, " numbers, got ", numbers.size());
  for (size_t i = 0; i < number; ++i) p.numbers[i] = numbers[i];
  return p;
}

void check_columns(char const* op, Tensor const& columns) {
  KV_CHECK(columns.dim() == 2 && columns.size(1) <= INT16_MAX, op, ": expected columns of shape (B, P)");
}

Tensor transform_matrix(Tensor const& columns, std::vector<int64_t> const& plan, std::vector<double> const& numbers) {
  constexpr char const* op = "transform_matrix";
  check_columns(op, columns);
  Tensor const result = empty({columns.size(0), 3, 3}, columns);
  dispatch_floating(op, columns, [&]<class T>(Type<T>) {
    auto params = transform_params<T>(op, columns, plan, numbers);
    params.result = data_ptr<T>(result);
    KV_RUN(transform_matrix, columns, params, params.batch, 64 * params.count);
  });
  return result;
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
