// Thin-plate splines: schemas and entries, for CPU and CUDA.
#include "geometry/reals_glue.h"
#include "geometry/transform/sampling_glue.h"
#include "geometry/transform/thin_plate.h"

namespace kv::geometry {
namespace {

// A spline's tensors, checked; one of each serves a batch.
struct ThinPlateInputs {
  char const* op;
  Tensor const like;
  int64_t batch;
  Tensor const centers, weights, affine;

  ThinPlateInputs(char const* op, Tensor const& centers, Tensor const& weights, Tensor const& affine)
      : op(op), like(centers), batch(1), centers(rows(centers)), weights(rows(weights)), affine(rows(affine)) {
    int64_t const count = centers.dim() == 3 ? centers.size(1) : 0;
    take("centers", centers, count);
    take("weights", weights, count);
    take("affine", affine, 3);
  }
  // `x`, one sample's numbers one after the other: as they are in a part of a larger tensor, too.
  static Tensor rows(Tensor const& x) {
    return x.dim() == 3 && x.stride(2) == 1 && (x.stride(1) == 2 || x.size(1) == 1) ? x : dense(x);
  }
  // (B, count, 2) of the same batch.
  void take(char const* name, Tensor const& x, int64_t count) {
    KV_CHECK(x.dim() == 3 && x.size(1) == count && x.size(2) == 2 && x.scalar_type() == like.scalar_type() &&
                 x.device() == like.device(),
             op, ": expected ", name, " of shape (B, ", count, ", 2), all of one type and device");
    KV_CHECK(batch == 1 || x.size(0) == 1 || x.size(0) == batch, op, ": expected ", name, " with 1 or ", batch,
             " rows, got ", x.size(0));
    if (x.size(0) != 1) batch = x.size(0);
  }
  template <class T>
  ThinPlate<T> of(int64_t count) const {
    ThinPlate<T> p{};
    p.centers = data_ptr<T const>(centers);
    p.weights = data_ptr<T const>(weights);
    p.affine = data_ptr<T const>(affine);
    p.center_stride = stride(centers);
    p.weight_stride = stride(weights);
    p.affine_stride = stride(affine);
    p.batch = batch;
    p.count = count;
    p.center_count = like.size(1);
    return p;
  }
  template <class T>
  ThinPlate<T> at_points(Tensor const& points) const {
    ThinPlate<T> p = of<T>(points.size(1));
    p.points = data_ptr<T const>(points);
    p.point_stride = stride(points);
    return p;
  }
  template <class T>
  ThinPlate<T> at_pixels(Size const& size, bool align_corners) const {
    ThinPlate<T> p = of<T>(size.height * size.width);
    int64_t const sides[] = {size.width, size.height};
    p.width = size.width;
    p.planar = true;
    for (int i = 0; i < 2; ++i) {
      p.middle[i] = T(sides[i] - 1) / 2;
      p.scale[i] = T(2) / T(max(sides[i] - align_corners, int64_t(1)));
    }
    return p;
  }

  template <class T>
  void run(ThinPlate<T> p, Tensor const& result) const {
    p.result = data_ptr<T>(result);
    KV_RUN(thin_plate, result, p, batch * thin_plate_chunks(p.count), cost());
  }
  // To centers, weights and affine, of each sample.
  template <class T>
  std::tuple<Tensor, Tensor, Tensor> run_backward(ThinPlate<T> p, Tensor const& grad) const {
    int64_t const n = p.center_count, parts = thin_plate_chunks(p.count);
    Tensor const grad_centers = empty({batch, n, 2}, grad), grad_weights = empty({batch, n, 2}, grad),
                 grad_affine = empty({batch, 3, 2}, grad), sums = empty({batch, parts, 4 * n + 6}, grad);
    p.grad = data_ptr<T const>(grad);
    p.sums = data_ptr<T>(sums);
    KV_RUN(thin_plate_backward, grad, p, batch * parts, 2 * cost());
    ThinPlateReduction<T> const total{
        p.sums, batch, parts, n, data_ptr<T>(grad_centers), data_ptr<T>(grad_weights), data_ptr<T>(grad_affine)};
    KV_RUN(reduce_thin_plate_grads, grad, total, batch, parts * total.width());
    return {grad_centers, grad_weights, grad_affine};
  }

 private:
  static int64_t stride(Tensor const& x) { return x.size(0) == 1 ? 0 : x.stride(0); }
  int64_t cost() const { return 8 * kThinPlateChunk * (1 + like.size(1)); }
};

void check_grad(char const* op, Tensor const& grad, std::vector<int64_t> const& sizes, Tensor const& like) {
  bool fits =
      grad.dim() == int64_t(sizes.size()) && grad.scalar_type() == like.scalar_type() && grad.device() == like.device();
  for (size_t i = 0; fits && i < sizes.size(); ++i) fits = grad.size(int64_t(i)) == sizes[i];
  KV_CHECK(fits, op, ": grad does not fit what it is the gradient of");
}

// Points (B, count, 2), checked.
int64_t count_of(char const* op, Tensor const& points) {
  KV_CHECK(points.dim() == 3, op, ": expected points of shape (B, N, 2)");
  return points.size(1);
}

Tensor thin_plate_points(Tensor const& points, Tensor const& centers, Tensor const& weights, Tensor const& affine) {
  char const* const op = "thin_plate_points";
  ThinPlateInputs inputs(op, centers, weights, affine);
  int64_t const count = count_of(op, points);
  inputs.take("points", points, count);
  Tensor const from = ThinPlateInputs::rows(points), result = empty({inputs.batch, count, 2}, points);
  dispatch_compute_dtype(op, points, [&](auto type) {
    using T = typename decltype(type)::type;
    inputs.run(inputs.at_points<T>(from), result);
  });
  return result;
}

std::tuple<Tensor, Tensor, Tensor, Tensor> thin_plate_points_backward(Tensor const& grad, Tensor const& points,
                                                                      Tensor const& centers, Tensor const& weights,
                                                                      Tensor const& affine) {
  char const* const op = "thin_plate_points_backward";
  ThinPlateInputs inputs(op, centers, weights, affine);
  int64_t const count = count_of(op, points);
  inputs.take("points", points, count);
  check_grad(op, grad, {inputs.batch, count, 2}, points);
  Tensor const from = ThinPlateInputs::rows(points), g = dense(grad),
               grad_points = empty({inputs.batch, count, 2}, points);
  std::tuple<Tensor, Tensor, Tensor> to;
  dispatch_compute_dtype(op, points, [&](auto type) {
    using T = typename decltype(type)::type;
    ThinPlate<T> p = inputs.at_points<T>(from);
    p.grad_points = data_ptr<T>(grad_points);
    to = inputs.run_backward(p, g);
  });
  return {grad_points, std::get<0>(to), std::get<1>(to), std::get<2>(to)};
}

Tensor thin_plate_map(Tensor const& centers, Tensor const& weights, Tensor const& affine, std::vector<int64_t> sides,
                      bool align_corners) {
  char const* const op = "thin_plate_map";
  ThinPlateInputs const inputs(op, centers, weights, affine);
  Size const size = map_size(op, sides);
  Tensor const result = empty({inputs.batch, 2, size.height, size.width}, centers);
  dispatch_compute_dtype(op, centers, [&](auto type) {
    using T = typename decltype(type)::type;
    inputs.run(inputs.at_pixels<T>(size, align_corners), result);
  });
  return result;
}

std::tuple<Tensor, Tensor, Tensor> thin_plate_map_backward(Tensor const& grad, Tensor const& centers,
                                                           Tensor const& weights, Tensor const& affine,
                                                           bool align_corners) {
  char const* const op = "thin_plate_map_backward";
  ThinPlateInputs const inputs(op, centers, weights, affine);
  KV_CHECK(grad.dim() == 4, op, ": expected grad of shape (B, 2, H, W)");
  Size const size = map_size(op, {grad.size(2), grad.size(3)});
  check_grad(op, grad, {inputs.batch, 2, size.height, size.width}, centers);
  Tensor const g = dense(grad);
  std::tuple<Tensor, Tensor, Tensor> to;
  dispatch_compute_dtype(op, centers, [&](auto type) {
    using T = typename decltype(type)::type;
    to = inputs.run_backward(inputs.at_pixels<T>(size, align_corners), g);
  });
  return to;
}

Tensor thin_plate_weights(Tensor const& centers, Tensor const& rhs) {
  char const* const op = "thin_plate_weights";
  KV_CHECK(centers.dim() == 3 && centers.size(2) == 2 && rhs.dim() == 3, op,
           ": expected centers of shape (B, N, 2) and right of shape (B, N + 3, 2)");
  int64_t const n = centers.size(1), batch = max(centers.size(0), rhs.size(0));
  KV_CHECK(n <= 8192, op, ": expected at most 8192 centers, got ", n);
  KV_CHECK(rhs.size(1) == n + 3 && rhs.size(2) == 2 && rhs.scalar_type() == centers.scalar_type() &&
               rhs.device() == centers.device(),
           op, ": expected right of shape (B, ", n + 3, ", 2), of the type and on the device of centers");
  KV_CHECK((centers.size(0) == 1 || centers.size(0) == batch) && (rhs.size(0) == 1 || rhs.size(0) == batch), op,
           ": expected as many centers as right sides");
  Contiguous const c(op, centers), r(op, rhs);
  Tensor const result = empty({batch, n + 3, 2}, centers);
  ThinPlateWeights<double> params{c.reals,
                                  r.reals,
                                  reals_of(op, result),
                                  centers.size(0) == 1 ? 0 : 2 * n,
                                  rhs.size(0) == 1 ? 0 : 2 * (n + 3),
                                  batch,
                                  n,
                                  nullptr};
  Tensor const systems = empty({batch, params.size(), params.width()}, centers, Layout::planar, ScalarType::Double);
  params.systems = data_ptr<double>(systems);
  KV_RUN(thin_plate_weights, centers, params, batch, (n + 3) * (n + 3) * (n + 3));
  return result;
}

}  // namespace

#define KV_THIN_PLATE "Tensor centers, Tensor weights, Tensor affine"

KV_OPERATOR(thin_plate_points, "(Tensor points, " KV_THIN_PLATE ") -> Tensor")
KV_OPERATOR(thin_plate_points_backward,
            "(Tensor grad, Tensor points, " KV_THIN_PLATE ") -> (Tensor, Tensor, Tensor, Tensor)")
KV_OPERATOR(thin_plate_map, "(" KV_THIN_PLATE ", SymInt[] size, bool align_corners) -> Tensor")
KV_OPERATOR(thin_plate_map_backward, "(Tensor grad, " KV_THIN_PLATE ", bool align_corners) -> (Tensor, Tensor, Tensor)")
KV_OPERATOR(thin_plate_weights, "(Tensor centers, Tensor rhs) -> Tensor")

#undef KV_THIN_PLATE

}  // namespace kv::geometry
