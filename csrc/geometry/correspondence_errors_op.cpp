// Errors of correspondences: schemas and entries, for CPU and CUDA.
#include "geometry/correspondence_errors.h"
#include "geometry/reals_glue.h"

namespace kv::geometry {
namespace {

// Correspondences of a chunk, over which gradients to matrices are summed first.
constexpr int64_t kErrorsChunk = 2048;

ErrorKind parse_error_kind(char const* op, int64_t number) {
  KV_CHECK(number >= int64_t(ErrorKind::sampson) && number <= int64_t(ErrorKind::segments), op,
           ": kind must be 0 (sampson), 1 (symmetrical), 2 (right), 3 (left), 4 (transfer), 5 (symmetric_transfer), "
           "6 (sampson_transfer) or 7 (segments), got ",
           number);
  return ErrorKind(number);
}

// Points and matrices, checked; each has one row for the whole batch, or one for each problem.
struct ErrorArguments {
  Contiguous points1, points2, matrix;
  CorrespondenceErrors<double> params{};

  ErrorArguments(char const* op, Tensor const& x, Tensor const& y, Tensor const& m, int64_t kind, bool squared)
      : points1(op, x), points2(op, y), matrix(op, m) {
    params.kind = parse_error_kind(op, kind);
    params.squared = squared;
    params.batch = 1;
    int64_t const min_axes = params.kind == ErrorKind::segments ? 4 : 2, max_axes = min_axes == 4 ? 4 : 3;
    for (Tensor const* t : {&x, &y})
      KV_CHECK(t->dim() == 3 && t->size(1) == x.size(1) && t->size(2) >= min_axes && t->size(2) <= max_axes, op,
               ": expected points of shape (B, N, ", min_axes, max_axes > min_axes ? " or 3)" : ")");
    KV_CHECK(m.dim() == 3 && m.size(1) == 3 && m.size(2) == 3, op, ": expected matrix of shape (B, 3, 3)");
    for (Tensor const* t : {&x, &y, &m}) {
      KV_CHECK(t->device() == x.device(), op, ": expected all on one device");
      KV_CHECK(params.batch == 1 || t->size(0) == 1 || t->size(0) == params.batch, op,
               ": expected batches of one size or 1");
      if (t->size(0) != 1) params.batch = t->size(0);
    }
    auto const stride = [](Tensor const& t) { return t.size(0) == 1 ? 0 : t.size(1) * t.size(2); };
    params.points1 = points1.reals;
    params.points2 = points2.reals;
    params.matrix = matrix.reals;
    params.axes1 = int(x.size(2));
    params.axes2 = int(y.size(2));
    params.stride1 = stride(x);
    params.stride2 = stride(y);
    params.matrix_stride = stride(m);
    params.count = x.size(1);
    params.chunk_size = kErrorsChunk;
    params.rounding = matrix.reals.is_double ? 2.220446049250313e-16 : 1.1920928955078125e-07;
    params.largest = points1.reals.is_double ? 1.7976931348623157e308 : 3.4028234663852886e38;
  }
};

Tensor correspondence_errors(Tensor const& points1, Tensor const& points2, Tensor const& matrix, int64_t kind,
                             bool squared) {
  constexpr char const* op = "correspondence_errors";
  ErrorArguments arguments(op, points1, points2, matrix, kind, squared);
  CorrespondenceErrors<double>& params = arguments.params;
  Tensor const errors = empty({params.batch, params.count}, arguments.points1.tensor);
  params.errors = reals_of(op, errors);
  KV_RUN(correspondence_errors, errors, params, params.batch * params.count, 32);
  return errors;
}

// Gradients of every problem, also for arguments that all problems share.
std::tuple<Tensor, Tensor, Tensor> correspondence_errors_backward(Tensor const& grad, Tensor const& points1,
                                                                  Tensor const& points2, Tensor const& matrix,
                                                                  int64_t kind, bool squared) {
  constexpr char const* op = "correspondence_errors_backward";
  ErrorArguments arguments(op, points1, points2, matrix, kind, squared);
  CorrespondenceErrors<double>& params = arguments.params;
  int64_t const batch = params.batch, count = params.count;
  KV_CHECK(grad.dim() == 2 && grad.size(0) == batch && grad.size(1) == count && grad.device() == points1.device(), op,
           ": expected grad of shape (B, N) on the device of points1");
  Contiguous const g(op, grad);
  Tensor const grad_points1 = empty({batch, count, params.axes1}, arguments.points1.tensor);
  Tensor const grad_points2 = empty({batch, count, params.axes2}, arguments.points1.tensor);
  Tensor const grad_matrix = empty({batch, 3, 3}, arguments.points1.tensor);
  int64_t const num_chunks = params.num_chunks();
  Tensor const chunk_sums =
      num_chunks == 1 ? grad_matrix
                      : empty({batch, num_chunks, 9}, arguments.points1.tensor, Layout::planar, ScalarType::Double);
  params.grad = g.reals;
  params.grad_points1 = reals_of(op, grad_points1);
  params.grad_points2 = reals_of(op, grad_points2);
  params.grad_matrix = reals_of(op, grad_matrix);
  params.chunk_sums = reals_of(op, chunk_sums);
  KV_RUN(correspondence_errors_backward, grad_points1, params, batch * num_chunks,
         128 * (count < kErrorsChunk ? count : kErrorsChunk));
  if (num_chunks != 1) KV_RUN(correspondence_errors_sums, grad_points1, params, batch, 9 * num_chunks);
  return {grad_points1, grad_points2, grad_matrix};
}

}  // namespace

#define KV_ERROR_ARGUMENTS "Tensor points1, Tensor points2, Tensor matrix, int kind, bool squared"

KV_OPERATOR(correspondence_errors, "(" KV_ERROR_ARGUMENTS ") -> Tensor")
KV_OPERATOR(correspondence_errors_backward, "(Tensor grad, " KV_ERROR_ARGUMENTS ") -> (Tensor, Tensor, Tensor)")

#undef KV_ERROR_ARGUMENTS

}  // namespace kv::geometry
