// Sums of products by group: schema and entry, for CPU and CUDA.
#include "geometry/optim/group_products.h"
#include "glue/glue.h"

namespace kv::geometry {
namespace {

// Dense numbers (1, count) of int32; any count for -1.
struct Indices {
  Tensor tensor;
  Indices(char const* op, char const* name, Tensor const& x, int64_t count, Tensor const& like) : tensor(dense(x)) {
    KV_CHECK(x.dim() == 2 && x.size(0) == 1 && (count < 0 || x.size(1) == count) &&
                 x.scalar_type() == ScalarType::Int && x.device() == like.device(),
             op, ": expected ", name, " of one row of int32 on the device of left, one for each pair or row of left");
  }
  int32_t const* data() const { return data_ptr<int32_t>(tensor); }
};

// What a call multiplies, checked.
template <class T>
Tensor sums_of_products(char const* op, Tensor const& left, Tensor const& right, Tensor const& left_rows,
                        Tensor const& right_rows, Tensor const& offsets, std::optional<Tensor> const& middle,
                        std::optional<Tensor> const& middle_rows) {
  GroupProducts<T> params{};
  params.batch = left.size(0);
  params.num_left = left.size(1);
  params.num_right = right.size(1);
  params.inner = left.size(2);
  params.rows = left.size(3);
  params.columns = right.size(3);
  params.pairs = left_rows.size(1);
  params.groups = offsets.size(1) - 1;
  params.left = data_ptr<T>(left);
  params.right = data_ptr<T>(right);
  for (int i = 0; i < 4; ++i) params.left_strides[i] = left.stride(i), params.right_strides[i] = right.stride(i);
  Indices const i(op, "left_rows", left_rows, -1, left), j(op, "right_rows", right_rows, params.pairs, left);
  Indices const bounds(op, "offsets", offsets, -1, left);
  Indices const k(op, "middle_rows", middle_rows ? *middle_rows : left_rows, middle ? params.num_left : -1, left);
  params.left_rows = i.data();
  params.right_rows = j.data();
  params.offsets = bounds.data();
  KV_CHECK(params.pairs == 0 || (params.num_left > 0 && params.num_right > 0), op, ": expected rows for the pairs");
  Tensor const between = middle ? dense(*middle) : left;
  if (middle) {
    params.num_middle = between.size(1);
    params.middle = data_ptr<T>(between);
    params.middle_rows = k.data();
    KV_CHECK(params.pairs == 0 || params.num_middle > 0, op, ": expected rows of middle for the pairs");
  }
  Tensor const result = empty({params.batch, params.groups, params.rows, params.columns}, left);
  params.result = data_ptr<T>(result);
  if (params.groups * params.rows * params.columns > 0)
    KV_RUN(group_products, result, params, params.batch * params.groups,
           params.pairs * params.inner * params.rows * params.columns / params.groups);
  return result;
}

Tensor group_products(Tensor const& left, Tensor const& right, Tensor const& left_rows, Tensor const& right_rows,
                      Tensor const& offsets, std::optional<Tensor> const& middle,
                      std::optional<Tensor> const& middle_rows) {
  constexpr char const* op = "group_products";
  bool const is_double = left.scalar_type() == ScalarType::Double;
  KV_CHECK(left.dim() == 4 && (is_double || left.scalar_type() == ScalarType::Float), op,
           ": expected left of shape (B, N, n, a), float32 or float64");
  auto const is_like = [&](Tensor const& x) {
    return x.dim() == 4 && x.size(0) == left.size(0) && x.size(2) == left.size(2) &&
           x.scalar_type() == left.scalar_type() && x.device() == left.device();
  };
  KV_CHECK(is_like(right), op, ": expected right of shape (B, M, n, b), of the type and device of left");
  KV_CHECK(left_rows.dim() == 2 && offsets.dim() == 2 && offsets.size(1) > 0, op,
           ": expected left_rows (1, P) and offsets (1, G + 1)");
  KV_CHECK(middle.has_value() == middle_rows.has_value(), op, ": expected middle with middle_rows");
  KV_CHECK(!middle || (is_like(*middle) && middle->size(3) == left.size(2)), op,
           ": expected middle of shape (B, K, n, n), of the type and device of left");
  return (is_double ? sums_of_products<double> : sums_of_products<float>)(op, left, right, left_rows, right_rows,
                                                                          offsets, middle, middle_rows);
}

}  // namespace

KV_OPERATOR(group_products,
            "(Tensor left, Tensor right, Tensor left_rows, Tensor right_rows, Tensor offsets, Tensor? middle, Tensor? "
            "middle_rows) -> Tensor")

}  // namespace kv::geometry
