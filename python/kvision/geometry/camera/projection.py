"""Projections without a camera matrix: to the plane at depth 1, and along parallel rays."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import floats
from kvision.core.exceptions import ShapeError

__all__ = [
    "dx_project_points_orthographic",
    "dx_project_points_z1",
    "project_points_orthographic",
    "project_points_z1",
    "unproject_points_orthographic",
    "unproject_points_z1",
]


def project_points_z1(points_in_camera: Tensor) -> Tensor:
    """Project points (*, 3) of a camera's frame to the plane at depth 1: (x / z, y / z), (*, 2); not finite where z is 0.

    Raises:
        TypeError: no tensor of real numbers.
        ValueError: another shape.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.camera.project_points_z1(torch.tensor([2.0, 4.0, 2.0]))
        tensor([1., 2.])
    """
    _check.trailing_shape("project_points_z1", "points_in_camera", points_in_camera, 3)
    points = floats(points_in_camera)
    return points[..., :2] / points[..., 2:]


def unproject_points_z1(points_in_cam_canonical: Tensor, extension: Tensor | None = None) -> Tensor:
    """Find the points of a camera's frame whose projections to the plane at depth 1 are known.

    Args:
        points_in_cam_canonical: (*, 2).
        extension: their depths, (*) or (*, 1); None for 1.

    Returns:
        (*, 3).

    Raises:
        TypeError: not tensors of real numbers.
        ValueError: other shapes, or not on one device.

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
    depth = _depth(op, points, extension)
    moved = points * depth
    return torch.cat([moved, depth.expand_as(moved[..., :1])], -1)


def dx_project_points_z1(points_in_camera: Tensor) -> Tensor:
    """The Jacobians (*, 2, 3) of :func:`project_points_z1` at points (*, 3).

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
    """Project points (*, 3) along z: (x, y), (*, 2).

    Raises:
        TypeError: no tensor of real numbers.
        ValueError: another shape.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.camera.project_points_orthographic(torch.tensor([2.0, 4.0, 2.0]))
        tensor([2., 4.])
    """
    _check.trailing_shape("project_points_orthographic", "points_in_camera", points_in_camera, 3)
    return points_in_camera[..., :2].clone()


def unproject_points_orthographic(points_in_camera: Tensor, extension: Tensor) -> Tensor:
    """Put points (*, 2) at depths (*) or (*, 1): (*, 3).

    Raises:
        TypeError: not tensors of real numbers.
        ValueError: other shapes, or not on one device.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.camera.unproject_points_orthographic(torch.tensor([2.0, 4.0]), torch.tensor(3.0))
        tensor([2., 4., 3.])
    """
    op = "unproject_points_orthographic"
    _check.trailing_shape(op, "points_in_camera", points_in_camera, 2)
    depth = _depth(op, points_in_camera, extension)
    points, depth = torch.broadcast_tensors(points_in_camera, depth.to(points_in_camera.dtype))
    return torch.cat([points, depth[..., :1]], -1)


def dx_project_points_orthographic(points_in_camera: Tensor) -> Tensor:
    """The derivative (*, 1) of :func:`project_points_orthographic` at points (*, 3): 1 for both coordinates.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.camera.dx_project_points_orthographic(torch.tensor([2.0, 4.0, 2.0]))
        tensor([1.])
    """
    _check.trailing_shape("dx_project_points_orthographic", "points_in_camera", points_in_camera, 3)
    return torch.ones_like(points_in_camera[..., :1])


def _depth(op: str, points: Tensor, extension: Tensor) -> Tensor:
    """Depths (*) or (*, 1) as (*, 1)."""
    _check.numbers(op, "extension", extension)
    _check.same_device(op, points=points, extension=extension)
    if extension.dim() == points.dim() - 1:
        extension = extension[..., None]
    if extension.shape[-1] != 1:
        raise ShapeError(f"{op}: expected extension of shape (*) or (*, 1), got {tuple(extension.shape)}")
    _check.broadcastable(op, points=points.shape[:-1], extension=extension.shape[:-1])
    return extension
