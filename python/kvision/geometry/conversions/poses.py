"""Poses as a rotation and a translation, or as one matrix; of cameras to the world and back, in vision's and graphics' axes.

Vision's camera has x to the right, y down and z forwards; graphics' has y up and z backwards.
"""

from __future__ import annotations

import torch
from torch import Tensor

from kvision import _check
from kvision._ops import with_kernel_casts
from kvision.core.exceptions import ShapeError, ValueCheckError
from kvision.geometry.conversions.homogeneous import homogeneous

__all__ = [
    "Rt_to_matrix4x4",
    "camtoworld_graphics_to_vision_4x4",
    "camtoworld_graphics_to_vision_Rt",
    "camtoworld_to_worldtocam_Rt",
    "camtoworld_vision_to_graphics_4x4",
    "camtoworld_vision_to_graphics_Rt",
    "matrix4x4_to_Rt",
    "worldtocam_to_camtoworld_Rt",
]


def Rt_to_matrix4x4(R: Tensor, t: Tensor) -> Tensor:
    """Put a rotation and a translation into one matrix.

    Args:
        R: (*, 3, 3).
        t: (*, 3, 1).

    Returns:
        (*, 4, 4), with 0 0 0 1 as its last row.

    Raises:
        TypeError: not two tensors of real numbers.
        ValueError: other shapes, or not on one device.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.Rt_to_matrix4x4(torch.eye(3)[None], torch.ones(1, 3, 1))[0, 0]
        tensor([1., 0., 0., 1.])
    """
    _check_pose("Rt_to_matrix4x4", R, t)
    return homogeneous(torch.cat([R, t], -1))


def matrix4x4_to_Rt(extrinsics: Tensor) -> tuple[Tensor, Tensor]:
    """Take the rotation (*, 3, 3) and the translation (*, 3, 1) out of a pose (*, 4, 4), as views of it.

    Raises:
        TypeError: no tensor of real numbers.
        ValueError: another shape.

    Example:
        >>> import torch, kvision as K
        >>> R, t = K.geometry.matrix4x4_to_Rt(torch.eye(4)[None])
        >>> R.shape, t.shape
        (torch.Size([1, 3, 3]), torch.Size([1, 3, 1]))
    """
    _check.trailing_shape("matrix4x4_to_Rt", "extrinsics", extrinsics, 4, 4)
    return extrinsics[..., :3, :3], extrinsics[..., :3, 3:]


def camtoworld_to_worldtocam_Rt(R: Tensor, t: Tensor, check_rotation: bool = False) -> tuple[Tensor, Tensor]:
    """Invert poses: (R, t) gives (R^T, -R^T t), whichever way they lead.

    Args:
        R: (*, 3, 3).
        t: (*, 3, 1).
        check_rotation: refuse matrices that are no rotations, which waits for the device.

    Returns:
        (*, 3, 3) and (*, 3, 1).

    Raises:
        TypeError: not two tensors of real numbers.
        ValueError: other shapes, not on one device, or no rotations.

    Example:
        >>> import torch, kvision as K
        >>> R, t = K.geometry.camtoworld_to_worldtocam_Rt(torch.eye(3)[None], torch.ones(1, 3, 1))
        >>> t.flatten()
        tensor([-1., -1., -1.])
    """
    return _inverse("camtoworld_to_worldtocam_Rt", R, t, check_rotation)


def worldtocam_to_camtoworld_Rt(R: Tensor, t: Tensor, check_rotation: bool = False) -> tuple[Tensor, Tensor]:
    """Invert poses (*, 3, 3) and (*, 3, 1), as :func:`camtoworld_to_worldtocam_Rt` does.

    Example:
        >>> import torch, kvision as K
        >>> R, t = K.geometry.worldtocam_to_camtoworld_Rt(torch.eye(3)[None], torch.ones(1, 3, 1))
        >>> t.flatten()
        tensor([-1., -1., -1.])
    """
    return _inverse("worldtocam_to_camtoworld_Rt", R, t, check_rotation)


def _inverse(op: str, R: Tensor, t: Tensor, check_rotation: bool) -> tuple[Tensor, Tensor]:
    _check_pose(op, R, t)
    if check_rotation:
        check_is_rotation(op, "R", R)
    return R.mT.clone(), _turned_back(t, R)


@with_kernel_casts
def _turned_back(t: Tensor, R: Tensor) -> Tensor:
    return -(R * t).sum(-2)[..., None]


def camtoworld_graphics_to_vision_4x4(extrinsics_graphics: Tensor) -> Tensor:
    """Camera-to-world poses of a graphics camera as those of a vision camera: its y and z axes turn round.

    Args:
        extrinsics_graphics: (*, 4, 4).

    Returns:
        (*, 4, 4), the second and third column negated.

    Raises:
        TypeError: no tensor of real numbers.
        ValueError: another shape.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.camtoworld_graphics_to_vision_4x4(torch.eye(4)[None]).diagonal(dim1=1, dim2=2)
        tensor([[ 1., -1., -1.,  1.]])
    """
    _check.trailing_shape("camtoworld_graphics_to_vision_4x4", "extrinsics_graphics", extrinsics_graphics, 4, 4)
    return _flipped(extrinsics_graphics)


def camtoworld_vision_to_graphics_4x4(extrinsics_vision: Tensor) -> Tensor:
    """Camera-to-world poses (*, 4, 4) of a vision camera as those of a graphics camera: the same flip of y and z.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.camtoworld_vision_to_graphics_4x4(torch.eye(4)[None]).diagonal(dim1=1, dim2=2)
        tensor([[ 1., -1., -1.,  1.]])
    """
    _check.trailing_shape("camtoworld_vision_to_graphics_4x4", "extrinsics_vision", extrinsics_vision, 4, 4)
    return _flipped(extrinsics_vision)


def camtoworld_graphics_to_vision_Rt(R: Tensor, t: Tensor) -> tuple[Tensor, Tensor]:
    """:func:`camtoworld_graphics_to_vision_4x4` of a rotation (*, 3, 3) and a translation (*, 3, 1), which it keeps.

    Example:
        >>> import torch, kvision as K
        >>> R, t = K.geometry.camtoworld_graphics_to_vision_Rt(torch.eye(3)[None], torch.ones(1, 3, 1))
        >>> R.diagonal(dim1=1, dim2=2)
        tensor([[ 1., -1., -1.]])
    """
    _check_pose("camtoworld_graphics_to_vision_Rt", R, t)
    return _flipped(R), t.clone()


def camtoworld_vision_to_graphics_Rt(R: Tensor, t: Tensor) -> tuple[Tensor, Tensor]:
    """:func:`camtoworld_vision_to_graphics_4x4` of a rotation (*, 3, 3) and a translation (*, 3, 1), which it keeps.

    Example:
        >>> import torch, kvision as K
        >>> R, t = K.geometry.camtoworld_vision_to_graphics_Rt(torch.eye(3)[None], torch.ones(1, 3, 1))
        >>> R.diagonal(dim1=1, dim2=2)
        tensor([[ 1., -1., -1.]])
    """
    _check_pose("camtoworld_vision_to_graphics_Rt", R, t)
    return _flipped(R), t.clone()


def _flipped(matrix: Tensor) -> Tensor:
    right, up, back, *rest = matrix.unbind(-1)
    return torch.stack([right, 0 - up, 0 - back, *rest], -1)  # no negative zeros


def _check_pose(op: str, R: Tensor, t: Tensor) -> None:
    _check.trailing_shape(op, "R", R, 3, 3)
    _check.trailing_shape(op, "t", t, 3, 1)
    _check.same_device(op, R=R, t=t)
    if R.shape[:-2] != t.shape[:-2]:
        raise ShapeError(f"{op}: expected t of shape {(*R.shape[:-2], 3, 1)}, got {tuple(t.shape)}")


def check_is_rotation(op: str, name: str, matrix: Tensor, within: float = 1e-3) -> None:
    """Raise ValueCheckError unless all matrices (*, 3, 3) are rotations. Waits for the device."""
    R = matrix.detach().double()
    eye = torch.eye(3, dtype=R.dtype, device=R.device)
    volume = (torch.linalg.cross(R[..., 0, :], R[..., 1, :]) * R[..., 2, :]).sum(-1)
    off = torch.maximum((R @ R.mT - eye).abs().amax((-2, -1)), (volume - 1).abs())
    if not bool((off <= within).all()):
        raise ValueCheckError(f"{op}: expected {name} of rotations, got matrices that are {off.max().item():.1e} off")
