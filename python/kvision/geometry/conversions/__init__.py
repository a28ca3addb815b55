"""Conversions between representations of points, rotations, homographies and poses."""

from kvision.geometry.conversions.angles import angle_to_rotation_matrix, cart2pol, deg2rad, pol2cart, rad2deg
from kvision.geometry.conversions.homogeneous import (
    convert_affinematrix_to_homography,
    convert_affinematrix_to_homography3d,
    convert_points_from_homogeneous,
    convert_points_to_homogeneous,
)
from kvision.geometry.conversions.pixels import (
    denormalize_homography,
    denormalize_homography3d,
    denormalize_pixel_coordinates,
    denormalize_pixel_coordinates3d,
    denormalize_points_with_intrinsics,
    normal_transform_pixel,
    normal_transform_pixel3d,
    normalize_homography,
    normalize_homography3d,
    normalize_pixel_coordinates,
    normalize_pixel_coordinates3d,
    normalize_points_with_intrinsics,
)
from kvision.geometry.conversions.poses import (
    Rt_to_matrix4x4,
    camtoworld_graphics_to_vision_4x4,
    camtoworld_graphics_to_vision_Rt,
    camtoworld_to_worldtocam_Rt,
    camtoworld_vision_to_graphics_4x4,
    camtoworld_vision_to_graphics_Rt,
    matrix4x4_to_Rt,
    worldtocam_to_camtoworld_Rt,
)
