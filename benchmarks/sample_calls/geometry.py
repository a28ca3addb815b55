"""Calls of the functions of geometry."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import normalize, pad

from benchmarks.sample_calls.model import Derived, Size, calls, half, length, made, rand
from benchmarks.sample_calls.tensors import (
    AFFINE,
    AFFINE3D,
    BOX,
    BOX3D,
    BOXES_ROTATED,
    BOXES_XYXY,
    CAMERA,
    CAMERA_OF_POINTS,
    CORNERS,
    CORNERS3D,
    DEPTH,
    ESSENTIAL,
    GRID,
    GRID3D,
    HOMOGRAPHY,
    HOMOGRAPHY3D,
    IMAGE,
    NUMBERS,
    POINTS,
    POINTS3,
    POSE,
    POSES,
    PROJECTION,
    QUATERNIONS,
    ROTATION,
    ROTATIONS,
    SEGMENTS,
    TRANSLATION,
    VECTORS,
    VISIBLE,
    VOLUME,
    WEIGHTS,
    boxes_xyxy,
    camera,
    grid,
    projections,
)


def intrinsics(s: Size) -> Tensor:
    return torch.eye(4) + pad(camera(s) - torch.eye(3), (0, 1, 0, 1))


def pinhole(library: Any, tensors: Mapping[str, Tensor], extrinsics: Tensor) -> Any:
    intrinsics, depth = tensors["_intrinsics"], tensors["depth_src"]
    height, width = (intrinsics.new_ones(intrinsics.shape[0]) * n for n in depth.shape[-2:])
    return library.geometry.PinholeCamera(intrinsics, extrinsics.expand_as(intrinsics), height, width)


def lens_camera(library: Any, tensors: Mapping[str, Tensor], model: str) -> Any:
    size = library.image.ImageSize(*tensors["image"].shape[-2:])
    return getattr(library.sensors.camera, model)(size, tensors["_params"])


def affine_weights(s: Size) -> Tensor:
    """Of a thin-plate spline that moves nothing but by its kernels."""
    return torch.cat([torch.zeros(s.b, 1, 2), torch.eye(2).expand(s.b, 2, 2)], 1)


def triangles(s: Size) -> Tensor:
    """In front of a camera at the origin, by which three points are seen that are not on one line."""
    return torch.eye(3).expand(s.b, 3, 3) + torch.rand(s.b, 3, 3) / 8 + torch.tensor([0.0, 0, 3])


LIKE_IMAGE = dict(_like=IMAGE, height=length("_like", 2), width=length("_like", 3))
ANGLE, ANGLES = rand("B", 0, 90), rand("B 3", 0, 90)

GEOMETRY = {
    "bbox_generator": dict(
        x_start=rand("B", 1, 2), y_start=rand("B", 1, 2), width=rand("B", 1, 2), height=rand("B", 1, 2)
    ),
    "bbox_generator3d": dict(
        x_start=rand("B", 1, 2),
        y_start=rand("B", 1, 2),
        z_start=rand("B", 1, 2),
        width=rand("B", 1, 2),
        height=rand("B", 1, 2),
        depth=rand("B", 1, 2),
    ),
    "bbox_to_mask": dict(_like=IMAGE, boxes=BOX, width=length("_like", 3), height=length("_like", 2)),
    "bbox_to_mask3d": dict(boxes=BOX3D, size=(6, 20, 24)),
    "infer_bbox_shape validate_bbox": dict(boxes=BOX),
    "infer_bbox_shape3d validate_bbox3d": dict(boxes=BOX3D),
    "nms nms_mask": dict(boxes=BOXES_XYXY, scores=rand("N"), iou_threshold=0.5),
    "batched_nms": dict(
        boxes=BOXES_XYXY, scores=rand("N"), idxs=made("N", lambda s: torch.arange(s.number("N")) % 3), iou_threshold=0.5
    ),
    "soft_nms": dict(boxes=BOXES_XYXY, scores=rand("N")),
    "nms_rotated": dict(boxes=BOXES_ROTATED, scores=rand("N"), iou_threshold=0.5),
    "box_area": dict(boxes=BOXES_XYXY),
    "clip_boxes_to_image": dict(boxes=BOXES_XYXY, size=(12, 14)),
    "remove_small_boxes": dict(boxes=BOXES_XYXY, min_size=4.0),
    "masks_to_boxes": dict(masks=made("B H W", lambda s: (torch.rand(s.b, s.h, s.w) > 0.9).float())),
    "transform_bbox": dict(trans_mat=HOMOGRAPHY, boxes=made("B N 4", lambda s: boxes_xyxy(s).repeat(s.b, 1, 1))),
    "distort_points undistort_points": dict(points=POINTS, K=CAMERA, dist=rand("B 4", 0, 0.05)),
    "solve_p3p": dict(
        world_points=made("B 3 3", triangles),
        img_points=made("B 3 2", lambda s: (triangles(s) @ camera(s).mT)[..., :2] / 3.3),
        intrinsics=CAMERA,
    ),
    "solve_pnp_dlt": dict(world_points=POINTS3, img_points=POINTS, intrinsics=CAMERA),
    "tilt_projection": dict(taux=rand("B", 0, 0.1), tauy=rand("B", 0, 0.1)),
    "reproject_image": dict(
        image=IMAGE,
        _params=rand("B 4", "W/4", "W/2"),
        camera_from=Derived(lambda library, t: lens_camera(library, t, "PinholeModel")),
        camera_to=Derived(lambda library, t: lens_camera(library, t, "EquirectangularModel")),
        R=made("3 3", lambda _: torch.eye(3)),
    ),
    "undistort_image": dict(image=IMAGE, K=CAMERA, dist=rand("B 4", 0, 0.05)),
    "distort_points_affine dx_distort_points_affine": dict(
        projected_points_in_camera_z1_plane=rand("B N 2", 0, 0.5), params=rand("B 1 4", 0.1, 0.15)
    ),
    "distort_points_kannala_brandt dx_distort_points_kannala_brandt": dict(
        projected_points_in_camera_z1_plane=rand("B N 2", 0, 0.5), params=rand("B 1 8", 0.1, 0.15)
    ),
    "undistort_points_affine": dict(distorted_points_in_camera=rand("B N 2", 0, 0.5), params=rand("B 1 4", 0.1, 0.15)),
    "undistort_points_kannala_brandt": dict(
        distorted_points_in_camera=rand("B N 2", 0, 0.5), params=rand("B 1 8", 0.1, 0.15)
    ),
    "project_points": dict(point_3d=VISIBLE, camera_matrix=CAMERA_OF_POINTS),
    "unproject_points": dict(point_2d=POINTS, depth=rand("B N 1", 1, 2), camera_matrix=CAMERA_OF_POINTS),
    "cam2pixel": dict(cam_coords_src=rand("B H W 3", 1, 2), dst_proj_src=POSE),
    "pixel2cam": dict(
        depth=DEPTH, intrinsics_inv=POSE, pixel_coords=made("B H W 3", lambda s: pad(grid(s), (0, 1), value=1.0))
    ),
    "dx_project_points_orthographic dx_project_points_z1 project_points_orthographic project_points_z1": dict(
        points_in_camera=VISIBLE
    ),
    "unproject_points_orthographic": dict(points_in_camera=POINTS, extension=rand("B N 1", 1, 2)),
    "unproject_points_z1": dict(points_in_cam_canonical=POINTS),
    "angle_to_rotation_matrix": dict(angle=NUMBERS),
    "cart2pol": dict(x=NUMBERS, y=NUMBERS),
    "deg2rad rad2deg": dict(tensor=IMAGE),
    "pol2cart": dict(rho=NUMBERS, phi=NUMBERS),
    "ARKitQTVecs_to_ColmapQTVecs ColmapQTVecs_to_ARKitQTVecs": dict(
        qvec=made("B 4", lambda s: normalize(torch.rand(s.b, 4), dim=1)), tvec=TRANSLATION
    ),
    "camera_from_colmap": dict(params=rand("B 8"), model="OPENCV"),
    "camera_to_colmap": dict(camera_matrix=CAMERA, coefficients=rand("B 4", 0, 0.1)),
    "convert_boxes": dict(boxes=BOXES_XYXY, in_mode="xyxy", out_mode="normalized_cxcywh", image_size=(20, 24)),
    "convert_keypoints": dict(keypoints=POINTS, in_mode="centers", out_mode="normalized_edges", image_size=(20, 24)),
    "pose_vector_to_matrix4x4": dict(pose=rand("B 7", 0.1, 1), order="t_xyzw"),
    "matrix4x4_to_pose_vector": dict(extrinsics=POSES, order="t_xyzw"),
    "affine_ras_to_lps affine_to_spacing": dict(affine=POSES),
    "affine_from_spacing": dict(spacing=rand("B 3", 1, 2), origin=rand("B 3"), direction=ROTATION),
    "voxel_transform": dict(affine_src=POSES, affine_dst=POSES),
    "euler_from_quaternion": dict(w=NUMBERS, x=NUMBERS, y=NUMBERS, z=NUMBERS),
    "quaternion_from_euler": dict(roll=NUMBERS, pitch=NUMBERS, yaw=NUMBERS),
    "convert_affinematrix_to_homography": dict(A=AFFINE),
    "convert_affinematrix_to_homography3d": dict(A=AFFINE3D),
    "convert_points_from_homogeneous": dict(points=VISIBLE),
    "convert_points_to_homogeneous normalize_points fit_line": dict(points=POINTS),
    "denormalize_homography normalize_homography": dict(
        dst_pix_trans_src_pix=HOMOGRAPHY, dsize_src=(20, 24), dsize_dst=(16, 18)
    ),
    "denormalize_homography3d normalize_homography3d": dict(
        dst_pix_trans_src_pix=HOMOGRAPHY3D, dsize_src=(6, 20, 24), dsize_dst=(5, 16, 18)
    ),
    "denormalize_pixel_coordinates normalize_pixel_coordinates": dict(
        pixel_coordinates=GRID, height=length("pixel_coordinates", 1), width=length("pixel_coordinates", 2)
    ),
    "denormalize_pixel_coordinates3d normalize_pixel_coordinates3d": dict(
        pixel_coordinates=GRID3D, depth=4, height=length("pixel_coordinates", 2), width=length("pixel_coordinates", 3)
    ),
    "denormalize_points_with_intrinsics": dict(point_2d_norm=POINTS, camera_matrix=CAMERA),
    "normal_transform_pixel create_meshgrid": dict(**LIKE_IMAGE),
    "normal_transform_pixel3d create_meshgrid3d": dict(
        _like=IMAGE, depth=4, height=length("_like", 2), width=length("_like", 3)
    ),
    "normalize_points_with_intrinsics": dict(point_2d=POINTS, camera_matrix=CAMERA),
    "Rt_to_matrix4x4 camtoworld_graphics_to_vision_Rt camtoworld_to_worldtocam_Rt camtoworld_vision_to_graphics_Rt "
    "worldtocam_to_camtoworld_Rt": dict(R=ROTATION, t=TRANSLATION),
    "camtoworld_graphics_to_vision_4x4": dict(extrinsics_graphics=POSES),
    "camtoworld_vision_to_graphics_4x4": dict(extrinsics_vision=POSES),
    "matrix4x4_to_Rt": dict(extrinsics=POSES),
    "angle_axis_to_quaternion angle_axis_to_rotation_matrix": dict(axis_angle=VECTORS),
    "normalize_quaternion quaternion_exp_to_log quaternion_to_angle_axis quaternion_to_rotation_matrix": dict(
        quaternion=QUATERNIONS
    ),
    "quaternion_log_to_exp": dict(quaternion=VECTORS),
    "rotation_matrix_to_angle_axis rotation_matrix_to_quaternion": dict(rotation_matrix=ROTATIONS),
    "vector_to_skew_symmetric_matrix": dict(vec=VECTORS),
    "photometric_depth_loss": dict(
        views=rand("1 B C H W"),
        target=rand("1 C H W"),
        depth=rand("1 1 H W", 1, 2),
        projections=made("1 B 3 4", lambda s: projections(s)[None]),
    ),
    "depth_from_disparity": dict(disparity=DEPTH, baseline=0.1, focal=50.0),
    "depth_from_plane_equation": dict(
        plane_normals=rand("B 3", 1, 2), plane_offsets=rand("B 1", 1, 2), points_uv=POINTS, camera_matrix=CAMERA
    ),
    "depth_to_3d depth_to_3d_v2 depth_to_normals": dict(depth=DEPTH, camera_matrix=CAMERA),
    "unproject_meshgrid": dict(**LIKE_IMAGE, camera_matrix=CAMERA, device=Derived(lambda _, t: t["_like"].device)),
    "depth_warp": dict(
        _intrinsics=made("B 4 4", intrinsics),
        _extrinsics=POSE,
        pinhole_dst=Derived(lambda library, t: pinhole(library, t, t["_extrinsics"])),
        pinhole_src=Derived(lambda library, t: pinhole(library, t, torch.eye(4, device=t["_extrinsics"].device))),
        depth_src=DEPTH,
        patch_dst=IMAGE,
        height=length("depth_src", -2),
        width=length("depth_src", -1),
    ),
    "warp_frame_depth": dict(image_src=IMAGE, depth_dst=DEPTH, src_trans_dst=POSE, camera_matrix=CAMERA),
    "KRt_from_projection": dict(P=PROJECTION),
    "compute_correspond_epilines": dict(points=POINTS, F_mat=HOMOGRAPHY),
    "cross_product_matrix batched_squared_norm": dict(x=VECTORS),
    "decompose_essential_matrix decompose_essential_matrix_no_svd motion_from_essential project_to_essential": dict(
        E_mat=ESSENTIAL
    ),
    "depth_from_point": dict(R=ROTATION, t=TRANSLATION, X=VISIBLE),
    "essential_from_Rt relative_camera_motion": dict(R1=ROTATION, t1=TRANSLATION, R2=ROTATION, t2=TRANSLATION),
    "essential_from_fundamental": dict(F_mat=HOMOGRAPHY, K1=CAMERA, K2=CAMERA),
    "find_essential find_fundamental find_homography_dlt find_affine": dict(points1=POINTS, points2=POINTS),
    "fundamental_from_essential": dict(E_mat=ESSENTIAL, K1=CAMERA, K2=CAMERA),
    "fundamental_from_projections": dict(P1=PROJECTION, P2=PROJECTION),
    "get_closest_point_on_epipolar_line left_to_right_epipolar_distance right_to_left_epipolar_distance "
    "sampson_epipolar_distance symmetrical_epipolar_distance": dict(pts1=POINTS, pts2=POINTS, Fm=HOMOGRAPHY),
    "get_perpendicular": dict(lines=POINTS3, points=POINTS),
    "intrinsics_like": dict(focal=50.0, input=IMAGE),
    "motion_from_essential_choose_solution": dict(E_mat=ESSENTIAL, K1=CAMERA, K2=CAMERA, x1=POINTS, x2=POINTS),
    "normalize_transformation": dict(M=HOMOGRAPHY),
    "projection_from_KRt": dict(K=CAMERA, R=ROTATION, t=TRANSLATION),
    "projections_from_fundamental": dict(F_mat=HOMOGRAPHY),
    "random_intrinsics": dict(low=0.5, high=1.5),
    "scale_intrinsics": dict(camera_matrix=CAMERA, scale_factor=0.5),
    "triangulate_points": dict(P1=PROJECTION, P2=PROJECTION, points1=POINTS, points2=POINTS),
    "find_homography_dlt_iterated": dict(points1=POINTS, points2=POINTS, weights=WEIGHTS),
    "find_homography_lines_dlt": dict(ls1=SEGMENTS, ls2=SEGMENTS),
    "find_homography_lines_dlt_iterated": dict(ls1=SEGMENTS, ls2=SEGMENTS, weights=WEIGHTS),
    "line_segment_transfer_error_one_way": dict(ls1=SEGMENTS, ls2=SEGMENTS, H=HOMOGRAPHY),
    "oneway_transfer_error sampson_homography_distance symmetric_transfer_error": dict(
        pts1=POINTS, pts2=POINTS, H=HOMOGRAPHY
    ),
    "sample_is_valid_for_homography": dict(points1=CORNERS, points2=CORNERS),
    "batched_dot_product euclidean_distance": dict(x=VECTORS, y=VECTORS),
    "compose_transformations": dict(trans_01=POSES, trans_12=POSES),
    "inverse_transformation": dict(trans_12=POSES),
    "point_line_distance": dict(point=POINTS, line=POINTS3),
    "relative_transformation": dict(trans_01=POSES, trans_02=POSES),
    "transform_points": dict(trans_01=HOMOGRAPHY, points_1=POINTS),
    "fit_plane": dict(points=POINTS3),
    "average_quaternions": dict(_q=QUATERNIONS, Q=Derived(lambda library, t: library.geometry.Quaternion(t["_q"]))),
    "determinant_to_polynomial": dict(A=rand("B 3 13")),
    "multiply_deg_one_poly": dict(a=rand("B 4"), b=rand("B 4")),
    "multiply_deg_two_one_poly": dict(a=rand("B 10"), b=rand("B 4")),
    "null_vector_3x4": dict(A=rand("B 3 4")),
    "solve_cubic": dict(coeffs=rand("B 4", -0.5, 0.5)),
    "solve_quadratic": dict(coeffs=rand("B 3", -0.5, 0.5)),
    "solve_quartic": dict(coeffs=rand("B 5", -0.5, 0.5)),
    "conv_quad_interp3d conv_soft_argmax3d iterative_quad_interp3d nms3d_minmax": dict(input=VOLUME),
    "conv_soft_argmax2d spatial_expectation2d spatial_soft_argmax2d spatial_softmax2d hflip rot180 vflip pyrdown "
    "pyrup": dict(input=IMAGE),
    "refine_corners": dict(image=rand("B 1 H W"), corners=rand("B N 2", "W/4", "W/2"), radius=3, max_iterations=1),
    "nms2d": dict(input=IMAGE, kernel_size=(3, 3)),
    "nms3d": dict(input=VOLUME, kernel_size=(3, 3, 3)),
    "render_gaussian2d": dict(mean=rand("B 2", -0.5, 0.5), std=rand("B 2", 0.1, 1.1), size=(20, 24)),
    "affine": dict(tensor=IMAGE, matrix=AFFINE),
    "rotate": dict(tensor=IMAGE, angle=ANGLE),
    "scale": dict(tensor=IMAGE, scale_factor=rand("B 2", 0.5, 1.5)),
    "shear": dict(tensor=IMAGE, shear=rand("B 2", 0, 0.3)),
    "translate": dict(tensor=IMAGE, translation=rand("B 2", 0, 4)),
    "resize": dict(input=IMAGE, size=half("input")),
    "center_crop": dict(input_tensor=IMAGE, size=half("input_tensor")),
    "crop_and_resize": dict(input_tensor=IMAGE, boxes=BOX, size=half("input_tensor")),
    "crop_by_boxes": dict(input_tensor=IMAGE, src_box=BOX, dst_box=BOX),
    "crop_by_indices": dict(input_tensor=IMAGE, src_box=BOX),
    "crop_by_transform_mat": dict(input_tensor=IMAGE, transform=HOMOGRAPHY, out_size=half("input_tensor")),
    "center_crop3d": dict(tensor=VOLUME, size=half("tensor", 3)),
    "crop_and_resize3d": dict(tensor=VOLUME, boxes=BOX3D, size=half("tensor", 3)),
    "crop_by_boxes3d": dict(tensor=VOLUME, src_box=BOX3D, dst_box=BOX3D),
    "crop_by_transform_mat3d": dict(tensor=VOLUME, transform=HOMOGRAPHY3D, out_size=half("tensor", 3)),
    "elastic_transform2d": dict(image=IMAGE, noise=rand("B 2 H W", -1, 1), kernel_size=(15, 15), sigma=(4.0, 4.0)),
    "get_affine_matrix2d": dict(
        translations=rand("B 2"),
        center=rand("B 2", 0, 10),
        scale=rand("B 2", 0.5, 1.5),
        angle=ANGLE,
        sx=rand("B", 0, 0.3),
        sy=rand("B", 0, 0.3),
    ),
    "get_affine_matrix3d": dict(
        translations=rand("B 3"), center=rand("B 3"), scale=rand("B 3", 0.5, 1.5), angles=ANGLES
    ),
    "get_perspective_transform": dict(points_src=CORNERS, points_dst=CORNERS),
    "get_perspective_transform3d": dict(src=CORNERS3D, dst=CORNERS3D),
    "get_projective_transform": dict(center=rand("B 3"), angles=ANGLES, scales=rand("B 3", 0.5, 1.5)),
    "get_rotation_matrix2d": dict(center=rand("B 2", 0, 10), angle=ANGLE, scale=rand("B 2", 0.5, 1.5)),
    "get_shear_matrix2d": dict(center=rand("B 2"), sx=rand("B", 0, 0.3), sy=rand("B", 0, 0.3)),
    "get_shear_matrix3d": dict(center=rand("B 3"), sxy=rand("B", 0, 0.3)),
    "get_translation_matrix2d": dict(translations=rand("B 2")),
    "invert_affine_transform": dict(matrix=AFFINE),
    "projection_from_Rt": dict(rmat=ROTATION, tvec=TRANSLATION),
    "photometric_homography_loss photometric_normal_equations": dict(
        source=IMAGE, target=IMAGE, src_homo_dst=HOMOGRAPHY
    ),
    "build_laplacian_pyramid build_pyramid": dict(input=IMAGE, max_level=2),
    "rescale": dict(input=IMAGE, factor=0.7),
    "resize_to_be_divisible": dict(input=IMAGE, divisible_factor=4),
    "get_tps_transform": dict(points_src=rand("B 9 2"), points_dst=rand("B 9 2")),
    "warp_image_tps": dict(
        image=IMAGE,
        kernel_centers=rand("B 9 2"),
        kernel_weights=rand("B 9 2", 0, 0.05),
        affine_weights=made("B 3 2", affine_weights),
    ),
    "warp_points_tps": dict(
        points_src=POINTS, kernel_centers=rand("B 9 2"), kernel_weights=rand("B 9 2"), affine_weights=rand("B 3 2")
    ),
    "homography_warp": dict(patch_src=IMAGE, src_homo_dst=HOMOGRAPHY, dsize=half("patch_src")),
    "remap": dict(image=IMAGE, map_x=rand("B H W", 0, "W"), map_y=rand("B H W", 0, "H")),
    "warp_affine": dict(src=IMAGE, M=AFFINE, dsize=half("src")),
    "warp_grid": dict(grid=GRID, src_homo_dst=HOMOGRAPHY),
    "warp_perspective": dict(src=IMAGE, M=HOMOGRAPHY, dsize=half("src")),
    "affine3d": dict(tensor=VOLUME, matrix=AFFINE3D),
    "homography_warp3d": dict(patch_src=VOLUME, src_homo_dst=HOMOGRAPHY3D, dsize=half("patch_src", 3)),
    "rotate3d": dict(tensor=VOLUME, yaw=rand("B", 0, 30), pitch=rand("B", 0, 30), roll=rand("B", 0, 30)),
    "warp_affine3d": dict(src=VOLUME, M=AFFINE3D, dsize=half("src", 3)),
    "warp_grid3d": dict(grid=GRID3D, src_homo_dst=HOMOGRAPHY3D),
    "warp_perspective3d": dict(src=VOLUME, M=HOMOGRAPHY3D, dsize=half("src", 3)),
}
CALLS = calls("geometry", GEOMETRY)
