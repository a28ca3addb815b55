"""Projections without a camera matrix: perspective onto the plane at depth 1, and orthographic."""

from __future__ import annotations

from typing import Literal, overload

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import as_dtype, floats
from kvision.core.exceptions import ShapeError
from kvision.geometry._validity import NEAREST, with_validity

__all__ = [
    "dx_project_points_orthographic",
    "dx_project_points_z1",
    "project_points_orthographic",
    "project_points_z1",
    "unproject_points_orthographic",
    "unproject_points_z1",
]


@overload
def project_points_z1(points_in_camera: Tensor, return_valid: Literal[False] = False) -> Tensor: ...
@overload
def project_points_z1(points_in_camera: Tensor, return_valid: bool) -> Tensor | tuple[Tensor, Tensor]: ...
def project_points_z1(points_in_camera: Tensor, return_valid: bool = False) -> Tensor | tuple[Tensor, Tensor]:
    """Project points in a camera's frame onto the plane at depth 1: (x / z, y / z).

    Args:
        points_in_camera: points (x, y, z) in the camera's frame, of shape (*, 3). Integers give float32.
        return_valid: also return which points are in front of the camera, z > 1e-8.

    Returns:
        Projected points of shape (*, 2). They are not finite where z is 0, and mirrored where it is negative. With
        `return_valid` also a mask (*); other points have no gradient then.

    Raises:
        TypeError: `points_in_camera` is not a tensor of real numbers; `return_valid` is not a bool.
        ValueError: `points_in_camera` is not of shape (*, 3).

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.camera.project_points_z1(torch.tensor([2.0, 4.0, 2.0]))
        tensor([1., 2.])
    """
    _check.trailing_shape("project_points_z1", "points_in_camera", points_in_camera, 3)
    _check.flag("project_points_z1", "return_valid", return_valid)
    points = floats(points_in_camera)
    return with_validity(_project_z1, points, points[..., 2] > NEAREST) if return_valid else _project_z1(points)


def _project_z1(points: Tensor) -> Tensor:
    return points[..., :2] / points[..., 2:]


def unproject_points_z1(points_in_cam_canonical: Tensor, extension: Tensor | None = None) -> Tensor:
    """Back-project points of the plane at depth 1 to points in a camera's frame.

    Args:
        points_in_cam_canonical: points (x, y) in the plane at depth 1, of shape (*, 2). Integers give float32.
        extension: depths of the points, of shape (*) or (*, 1). None means depth 1.

    Returns:
        Points (x, y, z) of shape (*, 3).

    Raises:
        TypeError: `points_in_cam_canonical` or `extension` is not a tensor of real numbers.
        ValueError: a shape is not as in Args, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.camera.unproject_points_z1(torch.tensor([1.0, 2.0]), torch.tensor(2.0))
        tensor([2., 4., 2.])
    """
    op = "unproject_points_z1"
    _check.trailing_shape(op, "points_in_cam_canonical", points_in_cam_canonical, 2)
    points = floats(points_in_cam_canonical)
    if extension is None:
        return torch.cat([points, torch.ones_like(points[..., :1])], -1)
    points, depth = _with_depths(op, points, extension)
    return torch.cat([points * depth, depth], -1)


def dx_project_points_z1(points_in_camera: Tensor) -> Tensor:
    """The Jacobian of :func:`project_points_z1` with respect to its points.

    Args:
        points_in_camera: points (x, y, z) in the camera's frame, of shape (*, 3). Integers give float32.

    Returns:
        Jacobians of shape (*, 2, 3), whose rows belong to the projected x and y.

    Raises:
        TypeError: `points_in_camera` is not a tensor of real numbers.
        ValueError: `points_in_camera` is not of shape (*, 3).

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.camera.dx_project_points_z1(torch.tensor([2.0, 4.0, 2.0]))
        tensor([[ 0.5000,  0.0000, -0.5000],
                [ 0.0000,  0.5000, -1.0000]])
    """
    _check.trailing_shape("dx_project_points_z1", "points_in_camera", points_in_camera, 3)
    x, y, z = floats(points_in_camera).unbind(-1)
    inverse = 1 / z
    zero = torch.zeros_like(z)
    entries = [inverse, zero, -x * inverse * inverse, zero, inverse, -y * inverse * inverse]
    return torch.stack(entries, -1).unflatten(-1, (2, 3))


def project_points_orthographic(points_in_camera: Tensor) -> Tensor:
    """Project points in a camera's frame orthographically, along z.

    Args:
        points_in_camera: points (x, y, z) in the camera's frame, of shape (*, 3).

    Returns:
        Points (x, y) of shape (*, 2), a view of `points_in_camera`.

    Raises:
        TypeError: `points_in_camera` is not a tensor of real numbers.
        ValueError: `points_in_camera` is not of shape (*, 3).

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.camera.project_points_orthographic(torch.tensor([2.0, 4.0, 2.0]))
        tensor([2., 4.])
    """
    _check.trailing_shape("project_points_orthographic", "points_in_camera", points_in_camera, 3)
    return points_in_camera[..., :2]


def unproject_points_orthographic(points_in_camera: Tensor, extension: Tensor) -> Tensor:
    """Append depths to orthographically projected points: the inverse of :func:`project_points_orthographic`.

    Args:
        points_in_camera: points (x, y) of shape (*, 2).
        extension: depths of the points, of shape (*) or (*, 1).

    Returns:
        Points (x, y, z) of shape (*, 3), of the type of `points_in_camera`.

    Raises:
        TypeError: `points_in_camera` or `extension` is not a tensor of real numbers.
        ValueError: a shape is not as in Args, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.camera.unproject_points_orthographic(torch.tensor([2.0, 4.0]), torch.tensor(3.0))
        tensor([2., 4., 3.])
    """
    op = "unproject_points_orthographic"
    _check.trailing_shape(op, "points_in_camera", points_in_camera, 2)
    points, depth = _with_depths(op, points_in_camera, extension)
    return torch.cat([points, as_dtype(depth, points.dtype)], -1)


def dx_project_points_orthographic(points_in_camera: Tensor) -> Tensor:
    """The derivative of :func:`project_points_orthographic`, which is 1 for both coordinates.

    Args:
        points_in_camera: points (x, y, z) in the camera's frame, of shape (*, 3).

    Returns:
        Ones of shape (*, 1), of the type of `points_in_camera`.

    Raises:
        TypeError: `points_in_camera` is not a tensor of real numbers.
        ValueError: `points_in_camera` is not of shape (*, 3).

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.camera.dx_project_points_orthographic(torch.tensor([2.0, 4.0, 2.0]))
        tensor([1.])
    """
    _check.trailing_shape("dx_project_points_orthographic", "points_in_camera", points_in_camera, 3)
    return torch.ones_like(points_in_camera[..., :1])


def _with_depths(op: str, points: Tensor, extension: Tensor) -> tuple[Tensor, Tensor]:
    """Points (*, 2) and depths (*, 1) with the same leading axes, from depths of shape (*) or (*, 1)."""
    _check.numbers(op, "extension", extension)
    if extension.device != points.device:
        _check.same_device(op, points=points, extension=extension)
    depth = extension.unsqueeze(-1) if extension.dim() == points.dim() - 1 else extension
    leading = points.shape[:-1]
    if depth.shape == (*leading, 1):
        return points, depth
    if depth.dim() == 0 or depth.shape[-1] != 1:
        raise ShapeError(f"{op}: expected extension of shape (*) or (*, 1), got {tuple(extension.shape)}")
    other = depth.shape[:-1]
    _check.broadcastable(op, points=leading, extension=other)
    leading = torch.broadcast_shapes(leading, other)
    return points.expand(*leading, 2), depth.expand(*leading, 1)
