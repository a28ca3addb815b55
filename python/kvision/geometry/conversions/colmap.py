"""COLMAP's cameras, and conversions between ARKit's poses (graphics camera to world) and COLMAP's (world to vision camera)."""

from __future__ import annotations

from typing import Literal, TypeAlias, get_args

import torch
from torch import Tensor

from kvision import _check
from kvision._ops import with_kernel_casts
from kvision.core.exceptions import ShapeError
from kvision.geometry._intrinsics import camera_matrix_of
from kvision.geometry.conversions.poses import (
    camtoworld_graphics_to_vision_Rt,
    camtoworld_to_worldtocam_Rt,
    camtoworld_vision_to_graphics_Rt,
    worldtocam_to_camtoworld_Rt,
)
from kvision.geometry.conversions.rotations import quaternion_to_rotation_matrix, rotation_matrix_to_quaternion

__all__ = ["ARKitQTVecs_to_ColmapQTVecs", "ColmapQTVecs_to_ARKitQTVecs", "camera_from_colmap", "camera_to_colmap"]

Model: TypeAlias = Literal[
    "SIMPLE_PINHOLE",
    "PINHOLE",
    "SIMPLE_RADIAL",
    "RADIAL",
    "OPENCV",
    "FULL_OPENCV",
    "SIMPLE_FISHEYE",
    "FISHEYE",
    "SIMPLE_RADIAL_FISHEYE",
    "RADIAL_FISHEYE",
    "OPENCV_FISHEYE",
]
FullModel: TypeAlias = Literal["OPENCV", "FULL_OPENCV", "OPENCV_FISHEYE"]
_WITH_ALL = get_args(FullModel)


def ARKitQTVecs_to_ColmapQTVecs(qvec: Tensor, tvec: Tensor) -> tuple[Tensor, Tensor]:
    """Convert ARKit's camera poses to COLMAP's.

    ARKit's camera has y up and z backwards; COLMAP's has y down and z forwards.

    Args:
        qvec: quaternions (w, x, y, z) of shape (*, 4), camera to world.
        tvec: positions of the cameras in the world, of shape (*, 3, 1).

    Returns:
        Unit quaternions (*, 4), of either sign, and translations (*, 3, 1), world to camera.

    Raises:
        TypeError: `qvec` or `tvec` is not a floating-point tensor.
        ValueError: a shape is not as in Args, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> q, t = K.geometry.ARKitQTVecs_to_ColmapQTVecs(torch.tensor([[1.0, 0, 0, 0]]), torch.ones(1, 3, 1))
        >>> q, t.flatten()
        (tensor([[0., 1., 0., 0.]]), tensor([-1.,  1.,  1.]))
    """
    R = _rotation("ARKitQTVecs_to_ColmapQTVecs", qvec, tvec)
    R, t = camtoworld_to_worldtocam_Rt(*camtoworld_graphics_to_vision_Rt(R, tvec))
    return rotation_matrix_to_quaternion(R), t


def ColmapQTVecs_to_ARKitQTVecs(qvec: Tensor, tvec: Tensor) -> tuple[Tensor, Tensor]:
    """Convert COLMAP's camera poses to ARKit's: the inverse of :func:`ARKitQTVecs_to_ColmapQTVecs`.

    Args:
        qvec: quaternions (w, x, y, z) of shape (*, 4), world to camera.
        tvec: translations, world to camera, of shape (*, 3, 1).

    Returns:
        Unit quaternions (*, 4), of either sign, camera to world, and positions (*, 3, 1) of the cameras in the world.

    Raises:
        TypeError: `qvec` or `tvec` is not a floating-point tensor.
        ValueError: a shape is not as in Args, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> q, t = K.geometry.ColmapQTVecs_to_ARKitQTVecs(torch.tensor([[0.0, 1, 0, 0]]), torch.ones(1, 3, 1))
        >>> q, t.flatten()
        (tensor([[1., 0., 0., 0.]]), tensor([-1.,  1.,  1.]))
    """
    R = _rotation("ColmapQTVecs_to_ARKitQTVecs", qvec, tvec)
    R, t = camtoworld_vision_to_graphics_Rt(*worldtocam_to_camtoworld_Rt(R, tvec))
    return rotation_matrix_to_quaternion(R), t


def _rotation(op: str, qvec: Tensor, tvec: Tensor) -> Tensor:
    _check.trailing_shape(op, "qvec", qvec, 4)
    _check.shape(op, "tvec", tvec, *qvec.shape[:-1], 3, 1)
    _check.floating(op, "qvec", qvec)
    _check.floating(op, "tvec", tvec)
    _check.same_device(op, qvec=qvec, tvec=tvec)
    return quaternion_to_rotation_matrix(qvec)


# The models of COLMAP that kvision has too: the number of focal lengths, and of coefficients in OpenCV's order. Models of
# fisheye lenses are Kannala-Brandt, others Brown-Conrady.
_MODELS: dict[Model, tuple[int, int]] = {
    "SIMPLE_PINHOLE": (1, 0),
    "PINHOLE": (2, 0),
    "SIMPLE_RADIAL": (1, 1),
    "RADIAL": (1, 2),
    "OPENCV": (2, 4),
    "FULL_OPENCV": (2, 8),
    "SIMPLE_FISHEYE": (1, 0),
    "FISHEYE": (2, 0),
    "SIMPLE_RADIAL_FISHEYE": (1, 1),
    "RADIAL_FISHEYE": (1, 2),
    "OPENCV_FISHEYE": (2, 4),
}


def camera_from_colmap(params: Tensor, model: Model) -> tuple[Tensor, Tensor]:
    """Convert COLMAP's camera parameters to a camera matrix and coefficients of distortion.

    COLMAP's pixel coordinates begin at the edge of the first pixel, kvision's and OpenCV's at its center: principal points become
    half a pixel less, as key points do by `convert_keypoints(points, "edges", "centers")`.

    Args:
        params: parameters of shape (*, n) in COLMAP's order: one or two focal lengths and the principal point, in pixels, then the
            coefficients.
        model: "SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV", "SIMPLE_FISHEYE", "FISHEYE",
            "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE" or "OPENCV_FISHEYE".

    Returns:
        Camera matrices (*, 3, 3) in pixels, and coefficients in OpenCV's order: (*, 4), or (*, 8) of "FULL_OPENCV", for
        :func:`distort_points`; of the models of fisheye lenses k1, k2, k3, k4 (*, 4) of
        :func:`distort_points_kannala_brandt`. Coefficients that the model lacks are 0.

    Raises:
        TypeError: `params` is not a floating-point tensor.
        ValueError: `model` is none of those above, or `params` has another number of parameters.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.camera_from_colmap(torch.tensor([500.0, 320, 240, -0.1]), "SIMPLE_RADIAL")
        (tensor([[500.0000,   0.0000, 319.5000],
                [  0.0000, 500.0000, 239.5000],
                [  0.0000,   0.0000,   1.0000]]), tensor([-0.1000,  0.0000,  0.0000,  0.0000]))
    """
    _check.choice("camera_from_colmap", "model", model, tuple(_MODELS))
    focal, count = _MODELS[model]
    _check.floating_trailing_shape("camera_from_colmap", "params", params, focal + 2 + count)
    return _camera(params, focal, max(count, 4) - count)


@with_kernel_casts
def _camera(params: Tensor, focal: int, missing: int) -> tuple[Tensor, Tensor]:
    fx, fy, cx, cy = params[..., 0], params[..., focal - 1], params[..., focal], params[..., focal + 1]
    matrix = camera_matrix_of(fx, fy, cx - 0.5, cy - 0.5)
    return matrix, torch.nn.functional.pad(params[..., focal + 2 :], (0, missing))


def camera_to_colmap(camera_matrix: Tensor, coefficients: Tensor, model: FullModel = "OPENCV") -> Tensor:
    """Convert camera matrices and coefficients of distortion to COLMAP's parameters: back from :func:`camera_from_colmap`.

    Args:
        camera_matrix: camera matrices of shape (*, 3, 3) in pixels, the first pixel's center at 0. COLMAP has no skew.
        coefficients: coefficients in OpenCV's order, of shape (*, n): at most 4 of "OPENCV" and "OPENCV_FISHEYE", at most 8 of
            "FULL_OPENCV". Those that are missing are 0.
        model: "OPENCV" or "FULL_OPENCV" for Brown-Conrady's coefficients, "OPENCV_FISHEYE" for Kannala-Brandt's.

    Returns:
        Parameters (*, 8), or (*, 12) of "FULL_OPENCV", in COLMAP's order: fx, fy, cx, cy and the coefficients.

    Raises:
        TypeError: a tensor is not of floating-point type.
        ValueError: a shape is not as in Args, leading axes differ, `model` is unknown, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> camera = torch.tensor([[500.0, 0, 319.5], [0, 500, 239.5], [0, 0, 1]])
        >>> K.geometry.camera_to_colmap(camera, torch.zeros(4))
        tensor([500., 500., 320., 240.,   0.,   0.,   0.,   0.])
    """
    op = "camera_to_colmap"
    _check.choice(op, "model", model, _WITH_ALL)
    _check.floating_trailing_shape(op, "camera_matrix", camera_matrix, 3, 3)
    _check.floating_trailing_shape(op, "coefficients", coefficients, "n")
    count = _MODELS[model][1]
    leading, n = camera_matrix.shape[:-2], coefficients.shape[-1]
    if coefficients.shape[:-1] != leading or n > count:
        listed = ", ".join(map(str, (*leading, "n")))
        raise ShapeError(
            f"{op}: expected coefficients of shape ({listed}) with n at most {count}, got {tuple(coefficients.shape)}",
            actual_shape=coefficients.shape,
        )
    _check.same_device(op, camera_matrix=camera_matrix, coefficients=coefficients)
    return _parameters(camera_matrix, coefficients, count - n)


@with_kernel_casts
def _parameters(matrix: Tensor, coefficients: Tensor, missing: int) -> Tensor:
    focal, center = matrix.diagonal(dim1=-2, dim2=-1)[..., :2], matrix[..., :2, 2]
    return torch.cat([focal, center + 0.5, torch.nn.functional.pad(coefficients, (0, missing))], -1)
