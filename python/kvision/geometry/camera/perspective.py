"""Points between a camera's frame and its pixels, by the camera matrix."""

from __future__ import annotations

from typing import Literal, overload

from torch import Tensor

from kvision import _check
from kvision._dtype import floats
from kvision.geometry._transform_points import map_points
from kvision.geometry._validity import NEAREST, with_validity
from kvision.geometry.conversions.pixels import check_camera

__all__ = ["project_points", "unproject_points"]


@overload
def project_points(point_3d: Tensor, camera_matrix: Tensor, return_valid: Literal[False] = False) -> Tensor: ...
@overload
def project_points(point_3d: Tensor, camera_matrix: Tensor, return_valid: bool) -> Tensor | tuple[Tensor, Tensor]: ...
def project_points(
    point_3d: Tensor, camera_matrix: Tensor, return_valid: bool = False
) -> Tensor | tuple[Tensor, Tensor]:
    """Project points of a camera's frame to its pixels: f * (x, y) / z + c. Skew is ignored.

    A point is not divided by a z between -1e-8 and 1e-8. One behind the camera, with a negative z, gives a mirrored pixel.

    Args:
        point_3d: (*, 3) as (x, y, z), z forwards; integers give float32.
        camera_matrix: (*, 3, 3), leading axes broadcast. With fewer of them than the points each matrix serves all points
            of an axis before the coordinates: (B, 3, 3) goes with (B, N, 3).
        return_valid: also return which points are in front of the camera, z > 1e-8.

    Returns:
        (*, 2) as (x, y), the center of the first pixel being (0, 0). With `return_valid` also a mask (*); pixels of other
        points have no gradient then.

    Raises:
        TypeError: `point_3d` or `camera_matrix` is not a tensor of real numbers; `return_valid` is not a bool.
        ValueError: a shape is not as in Args, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> camera = torch.tensor([[100.0, 0, 320], [0, 200, 240], [0, 0, 1]])
        >>> K.geometry.project_points(torch.tensor([[2.0, 2.0, 2.0]]), camera)
        tensor([[420., 440.]])
        >>> K.geometry.project_points(torch.tensor([[2.0, 2.0, -2.0]]), camera, return_valid=True)
        (tensor([[220.,  40.]]), tensor([False]))
    """
    _check.trailing_shape("project_points", "point_3d", point_3d, 3)
    check_camera("project_points", "point_3d", point_3d, camera_matrix)
    _check.flag("project_points", "return_valid", return_valid)
    points = floats(point_3d)
    if not return_valid:
        return _project(points, camera_matrix)
    return with_validity(_project, points, points[..., 2] > NEAREST, camera_matrix)


def _project(points: Tensor, camera_matrix: Tensor) -> Tensor:
    return map_points(points, None, camera_matrix, "project")


def unproject_points(point_2d: Tensor, depth: Tensor, camera_matrix: Tensor, normalize: bool = False) -> Tensor:
    """Back-project pixels at a depth to points in the camera's frame. Skew is ignored.

    Args:
        point_2d: (*, 2) as (x, y) in pixels; integers give float32.
        depth: (*, 1), z; leading axes broadcast.
        camera_matrix: (*, 3, 3); see :func:`project_points`.
        normalize: `depth` is the distance from the camera, not z.

    Returns:
        (*, 3) as (x, y, z).

    Raises:
        TypeError: `point_2d`, `depth` or `camera_matrix` is not a tensor of real numbers, or `normalize` is not a bool.
        ValueError: a shape is not as in Args, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> camera = torch.tensor([[100.0, 0, 320], [0, 200, 240], [0, 0, 1]])
        >>> K.geometry.unproject_points(torch.tensor([[420.0, 440.0]]), torch.tensor([[2.0]]), camera)
        tensor([[2., 2., 2.]])
    """
    op = "unproject_points"
    _check.trailing_shape(op, "point_2d", point_2d, 2)
    _check.trailing_shape(op, "depth", depth, 1)
    _check.flag(op, "normalize", normalize)
    check_camera(op, "point_2d", point_2d, camera_matrix)
    _check.same_device(op, point_2d=point_2d, depth=depth)
    _check.broadcastable(op, point_2d=point_2d.shape[:-1], depth=depth.shape[:-1])
    return map_points(floats(point_2d), depth, camera_matrix, "unproject_distance" if normalize else "unproject")
