"""Transforms of many points by one matrix: the operator behind transform_points, cameras, boxes and keypoints."""

from __future__ import annotations

from math import prod

import torch
from torch import Tensor

from kvision._dtype import as_dtype, compute_dtype
from kvision._modes import POINT_MAP, POINT_MAP_NAMES
from kvision._ops import register
from kvision.geometry.conversions.homogeneous import divisor
from kvision.geometry.conversions.pixels import focal_and_center

# --- the definition -------------------------------------------------------------------------------------------------


def _reference(points, depth, matrix, kind):
    """`points` (B, N, D), `depth` (B, N, 1) or None, `matrix` (B or 1, ., .); maps: csrc/geometry/transform_points.h."""
    kind = POINT_MAP_NAMES[kind]
    if kind == "transform":
        columns = matrix.unsqueeze(1).unbind(-1)
        moved = columns[-1]
        for x, column in zip(points.split(1, -1), columns):  # no matmul: torch's settings decide its precision
            moved = moved + x * column
        return moved[..., :-1] / divisor(moved[..., -1:])
    if kind == "intersect":
        focal, center, normal, offset, eps = matrix.split((2, 2, 3, 1, 1), -1)
        ray = (points - center) / focal
        along = (ray * normal[..., :2]).sum(-1, keepdim=True) + normal[..., 2:]
        return offset / torch.where(along.abs() < eps, torch.where(along < 0, -eps, eps), along)
    focal, center = focal_and_center(points, matrix)
    if kind == "project":
        return points[..., :2] / divisor(points[..., 2:]) * focal + center
    plane = (points - center) / focal
    if kind == "unproject_distance":
        depth = depth / (1 + plane.square().sum(-1, keepdim=True)).sqrt()
    return torch.cat([plane * depth, depth], -1)


def _shape(points, depth, matrix, kind):
    width = {"transform": matrix.shape[1] - 1, "project": 2, "intersect": 1}.get(POINT_MAP_NAMES[kind], 3)
    return (*points.shape[:2], width)


def _backward_reference(grad, points, depth, matrix, kind, to_matrix):
    computes = matrix.dtype
    args = [points.to(computes), matrix.expand(points.shape[0], -1, -1)]
    args += [] if depth is None else [depth.to(computes)]

    def of_tensors(points: Tensor, matrix: Tensor, depth: Tensor | None = None) -> Tensor:
        return _reference(points, depth, matrix, kind)

    _, vjp_fn = torch.func.vjp(of_tensors, *args)
    grads = vjp_fn(grad.to(computes))
    to_depth = points.new_empty(*points.shape[:2], 0) if depth is None else grads[2].to(depth.dtype)
    return grads[0].to(points.dtype), to_depth, grads[1] if to_matrix else grads[1][:, :0]


def _backward_shapes(grad, points, depth, matrix, kind, to_matrix):
    """The gradient of the matrix has one row a sample, even where one matrix broadcasts over the batch."""
    to_depth = points.new_empty(*points.shape[:2], 0 if depth is None else 1)
    to_matrix = matrix.new_empty(points.shape[0], matrix.shape[1] if to_matrix else 0, matrix.shape[2])
    return [points.shape, to_depth, to_matrix]


def _supports(points, depth, matrix, kind):
    """Transforms are 3 x 3 of the plane, or 3 x 4 or 4 x 4 of space."""
    sizes = (points.shape[-1], *matrix.shape[-2:])
    if kind != POINT_MAP["transform"] or sizes in ((2, 3, 3), (3, 3, 4), (3, 4, 4)):
        return None
    return f"there is no kernel for points of {sizes[0]} numbers and matrices {sizes[1]} x {sizes[2]}"


_transform_points = register(
    "transform_points",
    _reference,
    fake=_shape,
    gradients="points, depth, matrix: transform_points_backward(wants_matrix=needs(matrix))",
    supports=_supports,
)
register("transform_points_backward", _backward_reference, fake=_backward_shapes, casts_outputs=True)


def met(points: Tensor, plane: Tensor) -> Tensor:
    """Depths (B, N) of planes at pixels (B, N, 2), by rows (B or 1, 9): focal lengths, principal point, normal, offset, eps."""
    depth: Tensor = _transform_points(points, None, plane[:, None], POINT_MAP["intersect"])
    return depth[..., 0]


# --- with any leading axes ------------------------------------------------------------------------------------------


def transformed(points: Tensor, matrix: Tensor) -> Tensor:
    """Points (B, *, n) by matrices (B, m + 1, n + 1), (1, ...) or (m + 1, n + 1): (B, *, m)."""
    if matrix.dim() == 2:
        matrix = matrix[None]
    batch = matrix.shape[0]
    matrix = as_dtype(matrix, compute_dtype(points))
    if points.dim() == 3 and points.shape[0] == batch:  # the common case
        return _transform_points(points, None, matrix, POINT_MAP["transform"])
    flat = points.reshape(batch, prod(points.shape[:-1]) // batch if batch else 0, points.shape[-1])
    y = _transform_points(flat, None, matrix, POINT_MAP["transform"])
    return y.reshape(*points.shape[:-1], y.shape[-1])


def map_points(points: Tensor, depth: Tensor | None, camera_matrix: Tensor, kind: str) -> Tensor:
    """Points (*, D) by cameras (*, 3, 3). Leading axes broadcast; with fewer, a camera applies to the last axis."""
    camera_matrix = as_dtype(camera_matrix, compute_dtype(points))
    depth = None if depth is None else as_dtype(depth, points.dtype)
    leading = points.shape[:-1]
    if points.dim() == camera_matrix.dim() == 3 and points.shape[0] == camera_matrix.shape[0]:  # the common case
        if depth is None or depth.shape[:-1] == leading:
            return _transform_points(points, depth, camera_matrix, POINT_MAP[kind])
    cameras: tuple[int, ...] = camera_matrix.shape[:-2]
    if len(cameras) < len(leading):
        cameras = (*cameras, 1)
    if len(cameras) > len(leading) or any(c not in (1, n) for c, n in zip(reversed(cameras), reversed(leading))):
        leading = torch.broadcast_shapes(leading, cameras)
        points = points.expand(*leading, points.shape[-1])
    if depth is not None and depth.shape[:-1] != leading:
        leading = torch.broadcast_shapes(leading, depth.shape[:-1])
        points, depth = points.expand(*leading, points.shape[-1]), depth.expand(*leading, 1)
    cameras = (*(1,) * (len(leading) - len(cameras)), *cameras)
    own = len(cameras)  # leading axes along which cameras differ; the others have one camera
    while own > 0 and cameras[own - 1] == 1:
        own -= 1
    outer, inner = prod(leading[:own]), prod(leading[own:])
    matrix = camera_matrix
    if cameras[:own] != tuple(leading[:own]):
        matrix = matrix.reshape(*cameras[:own], 3, 3).expand(*leading[:own], 3, 3)
    depth = None if depth is None else depth.reshape(outer, inner, 1)
    y = _transform_points(
        points.reshape(outer, inner, points.shape[-1]), depth, matrix.reshape(outer, 3, 3), POINT_MAP[kind]
    )
    return y.reshape(*leading, y.shape[-1])
