"""Conversions between ARKit's poses (graphics camera to world) and COLMAP's (world to vision camera)."""

from __future__ import annotations

from torch import Tensor

from kvision import _check
from kvision.geometry.conversions.poses import (
    camtoworld_graphics_to_vision_Rt,
    camtoworld_to_worldtocam_Rt,
    camtoworld_vision_to_graphics_Rt,
    worldtocam_to_camtoworld_Rt,
)
from kvision.geometry.conversions.rotations import quaternion_to_rotation_matrix, rotation_matrix_to_quaternion

__all__ = ["ARKitQTVecs_to_ColmapQTVecs", "ColmapQTVecs_to_ARKitQTVecs"]


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
