// Homographies of points and segments, as python/kvision/geometry/homography has them. A second derivative is an error.
#pragma once

#include "kvision/ops/geometry.h"
#include "kvision/types.h"

namespace kvision {

// The homographies (B, 3, 3) that take points (B, N, 2) nearest to others, with weights (B, N).
inline Tensor find_homography_dlt(Tensor const& points1, Tensor const& points2,
                                  std::optional<Tensor> const& weights = {}) {
  detail::same_shape("find_homography_dlt", "points2", points2,
                     detail::shaped("find_homography_dlt", "points1", points1, 3, "(B, N, 2)"));
  return ops::homography_dlt(points1, points2, weights);
}
// That take the ends of segments (B, N, 2, 2) nearest to the lines of others.
inline Tensor find_homography_lines_dlt(Tensor const& ls1, Tensor const& ls2,
                                        std::optional<Tensor> const& weights = {}) {
  detail::same_shape("find_homography_lines_dlt", "ls2", ls2,
                     detail::shaped("find_homography_lines_dlt", "ls1", ls1, 4, "(B, N, 2, 2)"));
  return ops::homography_lines_dlt(ls1, ls2, weights);
}

// How far points (B, N, 2) under homographies are from others, (B, N).
inline Tensor oneway_transfer_error(Tensor const& pts1, Tensor const& pts2, Tensor const& H, bool squared = true) {
  return ops::correspondence_errors(pts1, pts2, H, int64_t(ops::CorrespondenceError::transfer), squared);
}
inline Tensor symmetric_transfer_error(Tensor const& pts1, Tensor const& pts2, Tensor const& H, bool squared = true) {
  return ops::correspondence_errors(pts1, pts2, H, int64_t(ops::CorrespondenceError::symmetric_transfer), squared);
}
inline Tensor line_segment_transfer_error_one_way(Tensor const& ls1, Tensor const& ls2, Tensor const& H,
                                                  bool squared = false) {
  return ops::correspondence_errors(ls1.flatten(2), ls2.flatten(2), H, int64_t(ops::CorrespondenceError::segments),
                                    squared);
}

}  // namespace kvision
