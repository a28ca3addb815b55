"""Two views of one scene: fundamental and essential matrices, projections, triangulation."""

from kvision.geometry.epipolar.distances import (
    left_to_right_epipolar_distance,
    right_to_left_epipolar_distance,
    sampson_epipolar_distance,
    symmetrical_epipolar_distance,
)
from kvision.geometry.epipolar.essential import (
    decompose_essential_matrix,
    decompose_essential_matrix_no_svd,
    essential_from_fundamental,
    essential_from_Rt,
    find_essential,
    motion_from_essential,
    motion_from_essential_choose_solution,
    project_to_essential,
    relative_camera_motion,
)
from kvision.geometry.epipolar.fundamental import (
    compute_correspond_epilines,
    find_fundamental,
    fundamental_from_essential,
    fundamental_from_projections,
    get_closest_point_on_epipolar_line,
    get_perpendicular,
)
from kvision.geometry.epipolar.normalization import normalize_points, normalize_transformation
from kvision.geometry.epipolar.projection import (
    KRt_from_projection,
    cross_product_matrix,
    depth_from_point,
    intrinsics_like,
    projection_from_KRt,
    projections_from_fundamental,
    random_intrinsics,
    scale_intrinsics,
)
from kvision.geometry.epipolar.scene import generate_scene
from kvision.geometry.epipolar.triangulation import triangulate_points

__all__ = [
    "KRt_from_projection",
    "compute_correspond_epilines",
    "cross_product_matrix",
    "decompose_essential_matrix",
    "decompose_essential_matrix_no_svd",
    "depth_from_point",
    "essential_from_Rt",
    "essential_from_fundamental",
    "find_essential",
    "find_fundamental",
    "fundamental_from_essential",
    "fundamental_from_projections",
    "generate_scene",
    "get_closest_point_on_epipolar_line",
    "get_perpendicular",
    "intrinsics_like",
    "left_to_right_epipolar_distance",
    "motion_from_essential",
    "motion_from_essential_choose_solution",
    "normalize_points",
    "normalize_transformation",
    "project_to_essential",
    "projection_from_KRt",
    "projections_from_fundamental",
    "random_intrinsics",
    "relative_camera_motion",
    "right_to_left_epipolar_distance",
    "sampson_epipolar_distance",
    "scale_intrinsics",
    "symmetrical_epipolar_distance",
    "triangulate_points",
]
