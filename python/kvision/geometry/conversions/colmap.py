"""Poses of ARKit, which are of a graphics camera to the world, and of COLMAP, which are of the world to a vision camera."""

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
    """ARKit's poses as COLMAP's.

    Args:
        qvec: quaternions (*, 4) as (w, x, y, z), camera to world.
        tvec: (*, 3, 1), the places of the cameras in the world.

    Returns:
        Unit quaternions (*, 4), of either sign, and translations (*, 3, 1), world to camera.

    Raises:
        TypeError: not two floating-point tensors.
        ValueError: other shapes, or not on one device.

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
    """COLMAP's poses as ARKit's: the inverse of :func:`ARKitQTVecs_to_ColmapQTVecs`, of the same shapes.

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
