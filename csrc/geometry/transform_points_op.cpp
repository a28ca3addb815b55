// Points transformed by matrices: schemas and entries, for CPU and CUDA.
#include "geometry/transform_points.h"
#include "glue/glue.h"

namespace kv::geometry {
namespace {

// The values of the argument `kind`. For `transform`, the shape of the matrix selects PointMap's plane, space or image.
enum class PointMapKind : int64_t { transform, project, unproject, unproject_distance, intersect };

template <class T>
T* data_ptr(std::optional<Tensor> const& x) {
  return x ? static_cast<T*>(const_cast<void*>(x->const_data_ptr())) : nullptr;
}

// Points (B, N, D), depths (B, N, 1) and matrices (B or 1, ., .), checked and contiguous.
struct PointTransform {
  Tensor points, matrix;
  std::optional<Tensor> depth;
  PointMap map{};
  bool distance = false;
  int64_t out = 3;

  PointTransform(char const* op, Tensor const& p, std::optional<Tensor> const& d, Tensor const& m, int64_t kind)
      : points(p), matrix(m) {
    KV_CHECK(p.dim() == 3 && m.dim() == 3 && (m.size(0) == 1 || m.size(0) == p.size(0)) &&
                 m.scalar_type() == compute_dtype(p) && m.device() == p.device(),
             op, ": matrix does not fit the points");
    int64_t const in = p.size(2), rows = m.size(1), columns = m.size(2);
    KV_CHECK(kind >= int64_t(PointMapKind::transform) && kind <= int64_t(PointMapKind::intersect), op,
             ": kind must be 0 (transform), 1 (project), 2 (unproject), 3 (unproject_distance) or 4 (intersect), got ",
             kind);
    auto const named = PointMapKind(kind);
    distance = named == PointMapKind::unproject_distance;
    bool const camera = rows == 3 && columns == 3, unprojects = named == PointMapKind::unproject || distance;
    if (named == PointMapKind::transform) {
      bool const plane = camera && in == 2, space = columns == 4 && in == 3 && (rows == 3 || rows == 4);
      KV_CHECK(plane || space, op, ": there is no map of ", in, " numbers by ", rows, " x ", columns);
      map = plane ? PointMap::plane : rows == 4 ? PointMap::space : PointMap::image;
      out = rows - 1;
    } else if (named == PointMapKind::project) {
      KV_CHECK(camera && in == 3, op, ": expected points (B, N, 3) and cameras (B, 3, 3)");
      map = PointMap::project;
      out = 2;
    } else if (named == PointMapKind::intersect) {
      KV_CHECK(in == 2 && rows == 1 && columns == 9, op, ": expected points (B, N, 2) and planes (B, 1, 9)");
      map = PointMap::intersect;
      out = 1;
    } else {
      KV_CHECK(unprojects && camera && in == 2, op, ": expected points (B, N, 2) and cameras (B, 3, 3)");
      map = PointMap::unproject;
    }
    KV_CHECK(d.has_value() == unprojects, op, ": depth is for unproject");
    if (d) {
      bool const fits = d->dim() == 3 && d->size(0) == p.size(0) && d->size(1) == p.size(1) && d->size(2) == 1 &&
                        d->scalar_type() == p.scalar_type() && d->device() == p.device();
      KV_CHECK(fits, op, ": depth does not fit the points");
      depth = dense(*d);
    }
    points = dense(p);
    matrix = dense(m);
  }
  int64_t matrices() const { return matrix.size(0); }
  int64_t entries() const { return matrix.size(1) * matrix.size(2); }
  int64_t total() const { return points.size(0) * points.size(1); }
  // The points of one matrix; 0 without matrices.
  int64_t count() const { return matrices() > 0 ? total() / matrices() : 0; }
};

#if !defined(KV_CUDA)
// Adds the sums of chunks. The CUDA kernel adds them itself.
template <class T>
void add_parts(TransformPointsBackward<T> const& p, int64_t entries) {
  int64_t const parts = p.parts();
  for (int64_t i = 0; i < p.matrices_count * entries; ++i) {
    double sum = 0;
    for (int64_t k = 0; k < parts; ++k) sum += p.partial[(i / entries * parts + k) * entries + i % entries];
    p.grad_matrix[i] = Compute<T>(sum);
  }
}
#endif

Tensor transform_points(Tensor const& points, std::optional<Tensor> const& depth, Tensor const& matrix, int64_t kind) {
  PointTransform const args("transform_points", points, depth, matrix, kind);
  Tensor const y = empty({points.size(0), points.size(1), args.out}, points);
  dispatch_floating("transform_points", points, [&](auto type) {
    using T = typename decltype(type)::type;
    TransformPoints<T> const params{data_ptr<T const>(args.points),
                                    data_ptr<T const>(args.depth),
                                    data_ptr<Compute<T> const>(args.matrix),
                                    data_ptr<T>(y),
                                    args.entries(),
                                    args.count(),
                                    args.total(),
                                    args.map,
                                    args.distance};
    KV_RUN(transform_points, points, params, params.total, 8);
  });
  return y;
}

std::tuple<Tensor, Tensor, Tensor> transform_points_backward(Tensor const& grad, Tensor const& points,
                                                             std::optional<Tensor> const& depth, Tensor const& matrix,
                                                             int64_t kind, bool wants_matrix) {
  char const* const op = "transform_points_backward";
  PointTransform const args(op, points, depth, matrix, kind);
  KV_CHECK(grad.dim() == 3 && grad.size(0) == points.size(0) && grad.size(1) == points.size(1) &&
               grad.size(2) == args.out && grad.scalar_type() == points.scalar_type() &&
               grad.device() == points.device(),
           op, ": expected grad to be that of the points");
  Tensor const g = dense(grad);
  // One gradient for each sample, also if one matrix serves all: vmap over samples needs them apart.
  int64_t const count = points.size(1), matrices = points.size(0), entries = args.entries();
#if defined(KV_CUDA)
  // Enough blocks to keep the device busy, each with at least one thousand points.
  int64_t const blocks = matrices < 1024 ? (1024 + matrices - 1) / (matrices > 0 ? matrices : 1) : 1;
  int64_t const thousands = (count / blocks + 1023) / 1024, part = 1024 * (thousands > 0 ? thousands : 1);
#else
  int64_t const part = 4096;
#endif
  int64_t const parts = ceil_div(count, part);
  ScalarType const type = compute_dtype(points);
  Tensor const grad_points = empty({matrices, count, points.size(2)}, points),
               grad_depth = empty({matrices, count, depth ? 1 : 0}, points),
               partial = empty({wants_matrix ? matrices : 0, parts, entries}, points, Layout::planar, type);
  Tensor sums = empty({matrices, wants_matrix ? matrix.size(1) : 0, matrix.size(2)}, points, Layout::planar, type);
  dispatch_floating(op, points, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    TransformPointsBackward<T> const params{data_ptr<T const>(g),
                                            data_ptr<T const>(args.points),
                                            data_ptr<T const>(args.depth),
                                            data_ptr<F const>(args.matrix),
                                            data_ptr<T>(grad_points),
                                            data_ptr<T>(grad_depth),
                                            wants_matrix ? data_ptr<F>(partial) : nullptr,
                                            wants_matrix ? data_ptr<F>(sums) : nullptr,
                                            args.matrices() == 1 ? 0 : entries,
                                            count,
                                            matrices,
                                            part,
                                            args.map,
                                            args.distance};
    KV_RUN(transform_points_backward, points, params, matrices * parts, 16 * part);
#if !defined(KV_CUDA)
    if (wants_matrix) add_parts(params, entries);
#endif
  });
#if defined(KV_CUDA)
  if (parts == 0) torch::stable::zero_(sums);
#endif
  return {grad_points, grad_depth, sums};
}

}  // namespace

KV_OPERATOR(transform_points, "(Tensor points, Tensor? depth, Tensor matrix, int kind) -> Tensor")
KV_OPERATOR(
    transform_points_backward,
    "(Tensor grad, Tensor points, Tensor? depth, Tensor matrix, int kind, bool wants_matrix) -> (Tensor, Tensor, "
    "Tensor)")

}  // namespace kv::geometry
