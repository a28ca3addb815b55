// Thin-plate splines: schemas and entries, for CPU and CUDA alike.
#include "geometry/reals_glue.h"
#include "geometry/transform/sampling_glue.h"
#include "geometry/transform/thin_plate.h"

namespace kv {
namespace {

// A spline's tensors, checked; one of each serves a batch.
struct GivenSpline {
  char const* op;
  Tensor const like;
  int64_t batch;
  Tensor const centers, weights, affine;

  GivenSpline(char const* op, Tensor const& centers, Tensor const& weights, Tensor const& affine)
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
  Spline<T> of(int64_t count) const {
    Spline<T> p{};
    p.centers = data_ptr<T const>(centers);
    p.weights = data_ptr<T const>(weights);
    p.affine = data_ptr<T const>(affine);
    p.center_stride = stride(centers);
    p.weight_stride = stride(weights);
    p.affine_stride = stride(affine);
    p.batch = batch;
    p.count = count;
    p.centres = like.size(1);
    return p;
  }
  template <class T>
  Spline<T> at_points(Tensor const& points) const {
    Spline<T> p = of<T>(points.size(1));
    p.points = data_ptr<T const>(points);
    p.point_stride = stride(points);
    return p;
  }
  template <class T>
  Spline<T> at_pixels(Size const& size, bool align_corners) const {
    Spline<T> p = of<T>(size.height * size.width);
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
  void run(Spline<T> p, Tensor const& result) const {
    p.result = data_ptr<T>(result);
    KV_RUN(spline, result, p, batch * spline_parts(p.count), cost());
  }
  // To centers, weights and affine, of each sample.
  template <class T>
  std::tuple<Tensor, Tensor, Tensor> run_backward(Spline<T> p, Tensor const& grad) const {
    int64_t const n = p.centres, parts = spline_parts(p.count);
    Tensor const to_centers = empty({batch, n, 2}, grad), to_weights = empty({batch, n, 2}, grad),
                 to_affine = empty({batch, 3, 2}, grad), sums = empty({batch, parts, 4 * n + 6}, grad);
    p.grad = data_ptr<T const>(grad);
    p.sums = data_ptr<T>(sums);
    KV_RUN(spline_backward, grad, p, batch * parts, 2 * cost());
    SplineSums<T> const total{
        p.sums, batch, parts, n, data_ptr<T>(to_centers), data_ptr<T>(to_weights), data_ptr<T>(to_affine)};
    KV_RUN(spline_sums, grad, total, batch, parts * total.width());
    return {to_centers, to_weights, to_affine};
  }

 private:
  static int64_t stride(Tensor const& x) { return x.size(0) == 1 ? 0 : x.stride(0); }
  int64_t cost() const { return 8 * kSplinePart * (1 + like.size(1)); }
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

Tensor spline_points(Tensor const& points, Tensor const& centers, Tensor const& weights, Tensor const& affine) {
  char const* const op = "spline_points";
  GivenSpline given(op, centers, weights, affine);
  int64_t const count = count_of(op, points);
  given.take("points", points, count);
  Tensor const from = GivenSpline::rows(points), result = empty({given.batch, count, 2}, points);
  for_computed(op, points, [&](auto type) {
    using T = typename decltype(type)::type;
    given.run(given.at_points<T>(from), result);
  });
  return result;
}

std::tuple<Tensor, Tensor, Tensor, Tensor> spline_points_backward(Tensor const& grad, Tensor const& points,
                                                                  Tensor const& centers, Tensor const& weights,
                                                                  Tensor const& affine) {
  char const* const op = "spline_points_backward";
  GivenSpline given(op, centers, weights, affine);
  int64_t const count = count_of(op, points);
  given.take("points", points, count);
  check_grad(op, grad, {given.batch, count, 2}, points);
  Tensor const from = GivenSpline::rows(points), g = dense(grad), to_points = empty({given.batch, count, 2}, points);
  std::tuple<Tensor, Tensor, Tensor> to;
  for_computed(op, points, [&](auto type) {
    using T = typename decltype(type)::type;
    Spline<T> p = given.at_points<T>(from);
    p.to_points = data_ptr<T>(to_points);
    to = given.run_backward(p, g);
  });
  return {to_points, std::get<0>(to), std::get<1>(to), std::get<2>(to)};
}

Tensor spline_map(Tensor const& centers, Tensor const& weights, Tensor const& affine, std::vector<int64_t> sides,
                  bool align_corners) {
  char const* const op = "spline_map";
  GivenSpline const given(op, centers, weights, affine);
  Size const size = map_size(op, sides);
  Tensor const result = empty({given.batch, 2, size.height, size.width}, centers);
  for_computed(op, centers, [&](auto type) {
    using T = typename decltype(type)::type;
    given.run(given.at_pixels<T>(size, align_corners), result);
  });
  return result;
}

std::tuple<Tensor, Tensor, Tensor> spline_map_backward(Tensor const& grad, Tensor const& centers, Tensor const& weights,
                                                       Tensor const& affine, bool align_corners) {
  char const* const op = "spline_map_backward";
  GivenSpline const given(op, centers, weights, affine);
  KV_CHECK(grad.dim() == 4, op, ": expected grad of shape (B, 2, H, W)");
  Size const size = map_size(op, {grad.size(2), grad.size(3)});
  check_grad(op, grad, {given.batch, 2, size.height, size.width}, centers);
  Tensor const g = dense(grad);
  std::tuple<Tensor, Tensor, Tensor> to;
  for_computed(op, centers, [&](auto type) {
    using T = typename decltype(type)::type;
    to = given.run_backward(given.at_pixels<T>(size, align_corners), g);
  });
  return to;
}

Tensor spline_weights(Tensor const& centers, Tensor const& right) {
  char const* const op = "spline_weights";
  KV_CHECK(centers.dim() == 3 && centers.size(2) == 2 && right.dim() == 3, op,
           ": expected centers of shape (B, N, 2) and right of shape (B, N + 3, 2)");
  int64_t const n = centers.size(1), batch = max(centers.size(0), right.size(0));
  KV_CHECK(n <= 8192, op, ": expected at most 8192 centers, got ", n);
  KV_CHECK(right.size(1) == n + 3 && right.size(2) == 2 && right.scalar_type() == centers.scalar_type() &&
               right.device() == centers.device(),
           op, ": expected right of shape (B, ", n + 3, ", 2), of the type and on the device of centers");
  KV_CHECK((centers.size(0) == 1 || centers.size(0) == batch) && (right.size(0) == 1 || right.size(0) == batch), op,
           ": expected as many centers as right sides");
  Contiguous const c(op, centers), r(op, right);
  Tensor const result = empty({batch, n + 3, 2}, centers);
  SplineWeights<double> params{c.reals,
                               r.reals,
                               reals_of(op, result),
                               centers.size(0) == 1 ? 0 : 2 * n,
                               right.size(0) == 1 ? 0 : 2 * (n + 3),
                               batch,
                               n,
                               nullptr};
  Tensor const systems = empty({batch, params.size(), params.width()}, centers, Layout::planar, ScalarType::Double);
  params.systems = data_ptr<double>(systems);
  KV_RUN(spline_weights, centers, params, batch, (n + 3) * (n + 3) * (n + 3));
  return result;
}

}  // namespace

#define KV_SPLINE "Tensor centers, Tensor weights, Tensor affine"

KV_OPERATOR(spline_points, "(Tensor points, " KV_SPLINE ") -> Tensor")
KV_OPERATOR(spline_points_backward, "(Tensor grad, Tensor points, " KV_SPLINE ") -> (Tensor, Tensor, Tensor, Tensor)")
KV_OPERATOR(spline_map, "(" KV_SPLINE ", int[] size, bool align_corners) -> Tensor")
KV_OPERATOR(spline_map_backward, "(Tensor grad, " KV_SPLINE ", bool align_corners) -> (Tensor, Tensor, Tensor)")
KV_OPERATOR(spline_weights, "(Tensor centers, Tensor right) -> Tensor")

#undef KV_SPLINE

}  // namespace kv
