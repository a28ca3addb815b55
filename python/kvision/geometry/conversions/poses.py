"""Poses as a rotation and a translation or as one matrix, their inverses, and the axes of vision and graphics cameras.

A vision camera has x to the right, y down and z forwards. A graphics camera has x to the right, y up and z backwards.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.compiler import is_compiling

from kvision import _check
from kvision._dtype import as_dtype
from kvision._ops import with_kernel_casts
from kvision._torch_compat import carry_tangents, in_function_transform
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
    """Combine rotations and translations to pose matrices.

    Args:
        R: rotations of shape (*, 3, 3).
        t: translations of shape (*, 3, 1).

    Returns:
        Poses of shape (*, 4, 4), whose last row is 0 0 0 1.

    Raises:
        TypeError: `R` or `t` is not a tensor of real numbers.
        ValueError: a shape is not as in Args, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.Rt_to_matrix4x4(torch.eye(3)[None], torch.ones(1, 3, 1))[0, 0]
        tensor([1., 0., 0., 1.])
    """
    _check_pose("Rt_to_matrix4x4", R, t)
    return homogeneous(torch.cat([R, t], -1))


def matrix4x4_to_Rt(extrinsics: Tensor) -> tuple[Tensor, Tensor]:
    """Split pose matrices into rotations and translations.

    Args:
        extrinsics: poses of shape (*, 4, 4).

    Returns:
        Rotations of shape (*, 3, 3) and translations of shape (*, 3, 1), both views of `extrinsics`.

    Raises:
        TypeError: `extrinsics` is not a tensor of real numbers.
        ValueError: `extrinsics` is not of shape (*, 4, 4).

    Example:
        >>> import torch, kvision as K
        >>> R, t = K.geometry.matrix4x4_to_Rt(torch.eye(4)[None])
        >>> R.shape, t.shape
        (torch.Size([1, 3, 3]), torch.Size([1, 3, 1]))
    """
    _check.trailing_shape("matrix4x4_to_Rt", "extrinsics", extrinsics, 4, 4)
    return extrinsics[..., :3, :3], extrinsics[..., :3, 3:]


def camtoworld_to_worldtocam_Rt(R: Tensor, t: Tensor, check_rotation: bool = False) -> tuple[Tensor, Tensor]:
    """Invert poses: (R, t) becomes (R^T, -R^T t).

    The formula is the same for camera-to-world and world-to-camera poses.

    Args:
        R: rotation matrices of shape (*, 3, 3).
        t: translations of shape (*, 3, 1).
        check_rotation: raise an error for matrices that are not rotations. This waits for the device.

    Returns:
        Rotations of shape (*, 3, 3), a view of `R`, and translations of shape (*, 3, 1) of the inverse poses.

    Raises:
        TypeError: `R` or `t` is not a tensor of real numbers.
        ValueError: a shape is not as in Args, or the tensors are on different devices, or with
            `check_rotation` a matrix is not a rotation.

    Example:
        >>> import torch, kvision as K
        >>> R, t = K.geometry.camtoworld_to_worldtocam_Rt(torch.eye(3)[None], torch.ones(1, 3, 1))
        >>> t.flatten()
        tensor([-1., -1., -1.])
    """
    return _inverse("camtoworld_to_worldtocam_Rt", R, t, check_rotation)


def worldtocam_to_camtoworld_Rt(R: Tensor, t: Tensor, check_rotation: bool = False) -> tuple[Tensor, Tensor]:
    """Invert poses: (R, t) becomes (R^T, -R^T t), as in :func:`camtoworld_to_worldtocam_Rt`.

    Args:
        R: rotation matrices of shape (*, 3, 3).
        t: translations of shape (*, 3, 1).
        check_rotation: raise an error for matrices that are not rotations. This waits for the device.

    Returns:
        Rotations of shape (*, 3, 3), a view of `R`, and translations of shape (*, 3, 1) of the inverse poses.

    Raises:
        TypeError: `R` or `t` is not a tensor of real numbers.
        ValueError: a shape is not as in Args, or the tensors are on different devices, or with
            `check_rotation` a matrix is not a rotation.

    Example:
        >>> import torch, kvision as K
        >>> R, t = K.geometry.worldtocam_to_camtoworld_Rt(torch.eye(3)[None], torch.ones(1, 3, 1))
        >>> t.flatten()
        tensor([-1., -1., -1.])
    """
    return _inverse("worldtocam_to_camtoworld_Rt", R, t, check_rotation)


def _inverse(op: str, R: Tensor, t: Tensor, check_rotation: bool) -> tuple[Tensor, Tensor]:
    _check_pose(op, R, t)
    if _check.switch(op, "check_rotation", check_rotation):
        check_is_rotation(op, "R", R)
    return R.mT, _rotate_back(t if t.is_floating_point() else as_dtype(t, R.dtype), R)


@with_kernel_casts
def _rotate_back(t: Tensor, R: Tensor) -> Tensor:
    # In a graph of forward mode the tangent of what beta leaves out is a zero tensor without memory, which ends torch's process.
    differentiated = is_compiling() or in_function_transform() or carry_tangents(t, R)
    if t.dim() == 3 and t.is_floating_point() and t.dtype == R.dtype and not differentiated:
        return torch.baddbmm(t.detach(), R.mT, t, beta=0, alpha=-1)  # in one launch; beta leaves the first argument out
    return (R * t).sum(-2, keepdim=True).mT.neg()


def camtoworld_graphics_to_vision_4x4(extrinsics_graphics: Tensor) -> Tensor:
    """Convert camera-to-world poses of a graphics camera to those of a vision camera, by flipping its y and z axes.

    Args:
        extrinsics_graphics: camera-to-world poses of shape (*, 4, 4).

    Returns:
        Poses of shape (*, 4, 4), with the second and third column negated.

    Raises:
        TypeError: `extrinsics_graphics` is not a tensor of real numbers.
        ValueError: `extrinsics_graphics` is not of shape (*, 4, 4).

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.camtoworld_graphics_to_vision_4x4(torch.eye(4)[None]).diagonal(dim1=1, dim2=2)
        tensor([[ 1., -1., -1.,  1.]])
    """
    _check.trailing_shape("camtoworld_graphics_to_vision_4x4", "extrinsics_graphics", extrinsics_graphics, 4, 4)
    _check.subtractable("camtoworld_graphics_to_vision_4x4", extrinsics_graphics=extrinsics_graphics)
    return _flip_y_z(extrinsics_graphics)


def camtoworld_vision_to_graphics_4x4(extrinsics_vision: Tensor) -> Tensor:
    """Convert camera-to-world poses of a vision camera to those of a graphics camera, by flipping its y and z axes.

    Args:
        extrinsics_vision: camera-to-world poses of shape (*, 4, 4).

    Returns:
        Poses of shape (*, 4, 4), with the second and third column negated.

    Raises:
        TypeError: `extrinsics_vision` is not a tensor of real numbers.
        ValueError: `extrinsics_vision` is not of shape (*, 4, 4).

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.camtoworld_vision_to_graphics_4x4(torch.eye(4)[None]).diagonal(dim1=1, dim2=2)
        tensor([[ 1., -1., -1.,  1.]])
    """
    _check.trailing_shape("camtoworld_vision_to_graphics_4x4", "extrinsics_vision", extrinsics_vision, 4, 4)
    _check.subtractable("camtoworld_vision_to_graphics_4x4", extrinsics_vision=extrinsics_vision)
    return _flip_y_z(extrinsics_vision)


def camtoworld_graphics_to_vision_Rt(R: Tensor, t: Tensor) -> tuple[Tensor, Tensor]:
    """Convert camera-to-world poses of a graphics camera to those of a vision camera, by flipping its y and z axes.

    Args:
        R: rotations, camera to world, of shape (*, 3, 3).
        t: translations, camera to world, of shape (*, 3, 1).

    Returns:
        Rotations of shape (*, 3, 3), with the second and third column negated, and a copy of `t`.

    Raises:
        TypeError: `R` or `t` is not a tensor of real numbers.
        ValueError: a shape is not as in Args, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> R, t = K.geometry.camtoworld_graphics_to_vision_Rt(torch.eye(3)[None], torch.ones(1, 3, 1))
        >>> R.diagonal(dim1=1, dim2=2)
        tensor([[ 1., -1., -1.]])
    """
    _check_pose("camtoworld_graphics_to_vision_Rt", R, t)
    return _flip_y_z(R), t.clone()


def camtoworld_vision_to_graphics_Rt(R: Tensor, t: Tensor) -> tuple[Tensor, Tensor]:
    """Convert camera-to-world poses of a vision camera to those of a graphics camera, by flipping its y and z axes.

    Args:
        R: rotations, camera to world, of shape (*, 3, 3).
        t: translations, camera to world, of shape (*, 3, 1).

    Returns:
        Rotations of shape (*, 3, 3), with the second and third column negated, and a copy of `t`.

    Raises:
        TypeError: `R` or `t` is not a tensor of real numbers.
        ValueError: a shape is not as in Args, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> R, t = K.geometry.camtoworld_vision_to_graphics_Rt(torch.eye(3)[None], torch.ones(1, 3, 1))
        >>> R.diagonal(dim1=1, dim2=2)
        tensor([[ 1., -1., -1.]])
    """
    _check_pose("camtoworld_vision_to_graphics_Rt", R, t)
    return _flip_y_z(R), t.clone()


def _flip_y_z(matrix: Tensor) -> Tensor:
    right, up, back, *rest = matrix.unbind(-1)
    return torch.stack([right, 0 - up, 0 - back, *rest], -1)  # no negative zeros


def _check_pose(op: str, R: Tensor, t: Tensor) -> None:
    _check.trailing_shape(op, "R", R, 3, 3)
    _check.trailing_shape(op, "t", t, 3, 1)
    _check.same_device(op, R=R, t=t)
    _check.subtractable(op, R=R, t=t)
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
