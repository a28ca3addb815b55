// Depth images (B or 1, 1, H, W), as python/kvision/geometry/depth has them. A second derivative is an error.
#pragma once

#include "kvision/ops/geometry.h"
#include "kvision/types.h"

namespace kvision {

// The points (B, 3, H, W) of depth and a camera matrix (B or 1, 3, 3); depth is z, or with normalize_points a distance.
inline Tensor depth_to_3d(Tensor const& depth, Tensor const& camera_matrix, bool normalize_points = false) {
  Tensor const x = detail::floats(detail::images("depth_to_3d", "depth", depth));
  return ops::depth_points(x, detail::computed(camera_matrix, x), normalize_points, false);
}
// As (B, H, W, 3).
inline Tensor depth_to_3d_v2(Tensor const& depth, Tensor const& camera_matrix, bool normalize_points = false) {
  Tensor const x = detail::floats(detail::shaped("depth_to_3d_v2", "depth", depth, 3, "(B, H, W)")).unsqueeze(1);
  return ops::depth_points(x, detail::computed(camera_matrix, x), normalize_points, true);
}
inline Tensor depth_to_normals(Tensor const& depth, Tensor const& camera_matrix, bool normalize_points = false) {
  Tensor const x = detail::floats(detail::images("depth_to_normals", "depth", depth));
  return ops::depth_normals(x, detail::computed(camera_matrix, x), normalize_points);
}

// The depth (B, N) where rays through pixels (B, N, 2) meet planes n . p = offset.
inline Tensor depth_from_plane_equation(Tensor const& plane_normals, Tensor const& plane_offsets,
                                        Tensor const& points_uv, Tensor const& camera_matrix, double eps = 1e-8) {
  Tensor const k = detail::shaped("depth_from_plane_equation", "camera_matrix", camera_matrix, 3, "(B, 3, 3)");
  auto const entry = [&](int64_t i, int64_t j) { return k.select(1, i).narrow(1, j, 1); };
  Tensor const plane = at::cat({entry(0, 0), entry(1, 1), entry(0, 2), entry(1, 2), plane_normals, plane_offsets,
                                at::full_like(plane_offsets, eps)},
                               1);
  return ops::transform_points(points_uv, {}, plane.unsqueeze(1), int64_t(ops::PointMap::intersect)).squeeze(2);
}

// The source where the pixels of the depth of the destination are seen in it, by the motion (B, 4, 4) between the two.
// Its camera is that of the destination unless it is given.
inline Tensor warp_frame_depth(Tensor const& image_src, Tensor const& depth_dst, Tensor const& src_trans_dst,
                               Tensor const& camera_matrix,
                               std::optional<Tensor> const& camera_matrix_src = std::nullopt) {
  Tensor const x = detail::floats(detail::images("warp_frame_depth", "image_src", image_src));
  Tensor const camera = detail::computed(camera_matrix, x);
  Tensor const camera_src = detail::computed(camera_matrix_src.value_or(camera_matrix), x);
  Tensor const projection = ops::reprojection(camera_src, detail::computed(src_trans_dst, x), camera, {}, true);
  return ops::depth_warp(x, detail::computed(depth_dst, x), projection, int64_t(Interpolation::bilinear),
                         detail::padding_number(PaddingMode::zeros), true);
}

// The mean distance (B,) of targets (B, C, h, w) from views (B, V, C, H, W) warped by depth and projections (B or 1, V,
// 3, 4), which it has gradients to.
inline Tensor photometric_depth_loss(Tensor const& views, Tensor const& target, Tensor const& depth,
                                     Tensor const& projections, Distance distance = Distance::l1, double eps = 1e-3) {
  detail::shaped("photometric_depth_loss", "views", views, 5, "(B, V, C, H, W)");
  return std::get<0>(ops::photometric_depth(views, target, detail::computed(depth, views),
                                            detail::computed(projections, views), int64_t(distance), eps));
}

}  // namespace kvision
