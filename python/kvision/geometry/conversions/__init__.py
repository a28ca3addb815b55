"""Conversions between representations of points, boxes, rotations, homographies, poses and cameras."""

from kvision.geometry.conversions.angles import angle_to_rotation_matrix, cart2pol, deg2rad, pol2cart, rad2deg
from kvision.geometry.conversions.colmap import (
    ARKitQTVecs_to_ColmapQTVecs,
    ColmapQTVecs_to_ARKitQTVecs,
    camera_from_colmap,
    camera_to_colmap,
)
from kvision.geometry.conversions.euler import euler_from_quaternion, quaternion_from_euler
from kvision.geometry.conversions.homogeneous import (
    convert_affinematrix_to_homography,
    convert_affinematrix_to_homography3d,
    convert_points_from_homogeneous,
    convert_points_to_homogeneous,
)
from kvision.geometry.conversions.labels import convert_boxes, convert_keypoints
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
from kvision.geometry.conversions.pose_vectors import matrix4x4_to_pose_vector, pose_vector_to_matrix4x4
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
from kvision.geometry.conversions.rotations import (
    angle_axis_to_quaternion,
    angle_axis_to_rotation_matrix,
    axis_angle_to_quaternion,
    axis_angle_to_rotation_matrix,
    normalize_quaternion,
    quaternion_exp_to_log,
    quaternion_log_to_exp,
    quaternion_to_angle_axis,
    quaternion_to_axis_angle,
    quaternion_to_rotation_matrix,
    rotation_matrix_to_angle_axis,
    rotation_matrix_to_axis_angle,
    rotation_matrix_to_quaternion,
    vector_to_skew_symmetric_matrix,
)
