// The photometric distance of views by depth: schema and entry, for CPU and CUDA.
#include "geometry/depth/photometric.h"
#include "geometry/depth/warp_glue.h"
#include "geometry/photometric_glue.h"

namespace kv::geometry {
namespace {

// Views (B, V, C, H, W), targets (B, C, h, w), depths (B, 1, h, w), projections (B, V, 3, 4). Returns the loss, its
// gradient to depth times the number of terms, one over that number, and its gradient to the projections.
std::tuple<Tensor, Tensor, Tensor, Tensor> photometric_depth(Tensor const& views, Tensor const& target,
                                                             Tensor const& depth, Tensor const& projections,
                                                             int64_t distance, double eps) {
  char const* const op = "photometric_depth";
  KV_CHECK(views.dim() == 5, op, ": expected views of 5 axes, got ", views.dim());
  check_images(op, "target", target);
  int64_t const batch = views.size(0), count = views.size(1), channels = views.size(2);
  KV_CHECK(count > 0 && count <= INT32_MAX && (target.size(0) == 1 || target.size(0) == batch) &&
               target.size(1) == channels && target.scalar_type() == views.scalar_type() &&
               target.device() == views.device(),
           op, ": target does not fit the views");
  KV_CHECK(projections.dim() == 4 && projections.size(1) == count, op, ": projections do not fit the views");
  Depths const depths(op, depth, projections, views);
  Size const source = checked_size(op, {views.size(3), views.size(4)}), output = depths.size();
  KV_CHECK(target.size(2) == output.height && target.size(3) == output.width, op, ": depth does not fit the target");
  SamplingOptions const options(op, Interpolation::bilinear, Padding::fill, true, views, {});
  int64_t const parts = projection_parts(output);
  Tensor const loss = empty({batch}, depths.depth), inverse_terms = empty({batch}, depths.depth);
  Tensor const grad_depth = empty({batch, 1, output.height, output.width}, depths.depth);
  Tensor const to_projections = empty({batch, count, 3, 4}, depths.depth);
  Tensor const sums = empty({batch, parts, count, kProjectionSums}, views, Layout::planar, ScalarType::Double);
  dispatch_floating(op, views, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    PhotometricDepth<T> params{};
    depths.set(params, options, source, batch);
    params.x = {data_ptr<T const>(views),
                views.stride(0),
                views.stride(2),
                views.stride(3),
                views.stride(4),
                batch,
                views.size(3),
                views.size(4),
                int(channels)};
    params.target = images<T const>(target, batch);
    params.target.batch = batch;
    params.view_stride = views.stride(1);
    params.projection_view_stride = 12;
    params.views = int(count);
    params.distance = parse_distance(op, distance);
    params.eps = F(eps);
    params.grad_depth = data_ptr<F>(grad_depth);
    params.sums = data_ptr<double>(sums);
    params.parts = parts;
    KV_RUN(photometric_depth, views, params, batch * output.height, 8 * count * channels * output.width);
    ProjectionTotal<F> const total{data_ptr<double const>(sums),
                                   parts,
                                   batch,
                                   int(count),
                                   int(channels),
                                   data_ptr<F>(to_projections),
                                   data_ptr<F>(loss),
                                   data_ptr<F>(inverse_terms)};
    KV_RUN(projection_total, views, total, batch, 14 * count * parts);
  });
  return {loss, grad_depth, inverse_terms, to_projections};
}

}  // namespace

KV_OPERATOR(photometric_depth,
            "(Tensor views, Tensor target, Tensor depth, Tensor projections, int distance, float eps) -> "
            "(Tensor, Tensor, Tensor, Tensor)")

}  // namespace kv::geometry
