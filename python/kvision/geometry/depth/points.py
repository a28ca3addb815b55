"""Points and normals of depth images, and depth from disparity or from a plane."""

from __future__ import annotations

import math
from typing import Any, Literal, overload

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import as_dtype, compute_dtype, floats
from kvision._leading import expand_to_batch
from kvision._ops import register, vjp, with_kernel_casts
from kvision.core.exceptions import ShapeError, TypeCheckError
from kvision.filters.edges.spatial_gradient import derivatives
from kvision.geometry._transform_points import met
from kvision.geometry._validity import with_validity
from kvision.geometry.transform.sampling import cast_to_image

__all__ = [
    "depth_from_disparity",
    "depth_from_plane_equation",
    "depth_to_3d",
    "depth_to_3d_v2",
    "depth_to_normals",
    "unproject_meshgrid",
]

# --- the definition -------------------------------------------------------------------------------------------------


def rays(camera: Tensor, height: int, width: int, distance: bool) -> Tensor:
    """The points at depth 1 of the pixels of cameras (*, 3, 3), (*, 3, H, W): at z = 1, or at a distance of 1."""
    like: dict[str, Any] = {"dtype": camera.dtype, "device": camera.device}
    x, y = torch.arange(width, **like), torch.arange(height, **like)[:, None]
    fx, fy, cx, cy = (camera[..., i, j, None, None] for i, j in ((0, 0), (1, 1), (0, 2), (1, 2)))
    across = ((x - cx) / fx).expand(*camera.shape[:-2], height, width)
    down = ((y - cy) / fy).expand(*camera.shape[:-2], height, width)
    ray = torch.stack([across, down, torch.ones_like(across)], -3)
    return ray / (ray * ray).sum(-3, keepdim=True).sqrt() if distance else ray


def _points(depth, camera, distance, last=False):
    points = depth * rays(camera, *depth.shape[2:], distance)
    return points.movedim(1, -1) if last else points


def _points_transposed(grad, camera, distance):
    return (grad * rays(camera, *grad.shape[2:], distance)).sum(1, keepdim=True)


def _points_backward(needs, grad, depth, camera, distance, last):
    grad = grad.movedim(-1, 1) if last else grad
    to_camera = _to_camera(grad, depth, camera, distance).sum_to_size(camera.shape) if needs[1] else None
    return [_to_depth(grad, camera, distance) if needs[0] else None, to_camera]


def _points_to_camera(grad, depth, camera, distance):
    each = camera.expand(grad.shape[0], 3, 3)
    points = depth.to(camera.dtype)
    return torch.func.vjp(lambda k: _points(points, k, distance), each)[1](grad.to(camera.dtype))[0]


def _normals(depth, camera, distance):
    return _normals_of(_points(depth, camera, distance))


def _normals_of(points):
    along = derivatives(points, "sobel", 1, True)
    normal = torch.linalg.cross(along[:, :, 0], along[:, :, 1], dim=1)
    square = (normal * normal).sum(1, keepdim=True)
    flat = square <= 1e-24
    return normal / torch.where(flat, 1e-12, torch.where(flat, 1, square).sqrt())


def _normals_backward(needs, grad, depth, camera, distance):
    if not needs[1]:
        return [_normals_to_depth(grad, depth, camera, distance), None]
    to_points = _normals_to_points(grad, depth, camera, distance)
    return _points_backward(needs, to_points, depth, camera, distance, False)


def _normals_transposed(grad, depth, camera, distance):
    return vjp(_normals_of)(grad, _points(depth, camera, distance))


# The result is (B, H, W, 3) with `last`.
depth_points = register(
    "depth_points",
    _points,
    fake=lambda depth, camera, distance, last: (
        (depth.shape[0], *depth.shape[2:], 3) if last else (depth.shape[0], 3, *depth.shape[2:])
    ),
    backward=_points_backward,
)
_to_depth = register(
    "depth_points_backward",
    _points_transposed,
    fake=lambda grad, *options: (grad.shape[0], 1, *grad.shape[2:]),
    gradients="grad: depth_points(depth=grad_grad, last=False); camera: depth_points_camera_backward(depth=grad_grad)",
)
_to_camera = register(
    "depth_points_camera_backward",
    _points_to_camera,
    fake=lambda grad, depth, camera, _: camera.new_empty(grad.shape[0], 3, 3),
    casts_outputs=True,
)
_depth_normals = register(
    "depth_normals",
    _normals,
    fake=lambda depth, *options: (depth.shape[0], 3, *depth.shape[2:]),
    backward=_normals_backward,
)
_normals_to_depth = register(
    "depth_normals_backward", vjp(_normals), fake=lambda grad, *options: (grad.shape[0], 1, *grad.shape[2:])
)
_normals_to_points = register("depth_normals_points_backward", _normals_transposed)

# --- points ---------------------------------------------------------------------------------------------------------


def _depth_and_camera(op: str, depth: Any, camera_matrix: Any, normalize_points: Any) -> tuple[Tensor, Tensor]:
    """Depth and cameras in the layout of the operators. A batch of 1 of either broadcasts to the other."""
    _check.shape(op, "depth", depth, "B", 1, "H", "W")
    _check.images(op, "depth", depth)
    _check.shape(op, "camera_matrix", camera_matrix, "B", 3, 3)
    _check.flag(op, "normalize_points", normalize_points)
    depth = floats(depth)
    if depth.shape[0] == 1 and camera_matrix.shape[0] != 1:
        depth = depth.expand(camera_matrix.shape[0], -1, -1, -1)
    return depth, cast_to_image(op, depth, "camera_matrix", camera_matrix)


def depth_to_3d(depth: Tensor, camera_matrix: Tensor, normalize_points: bool = False) -> Tensor:
    """Back-project the pixels of depth images to points in the camera's frame.

    Args:
        depth: (B, 1, H, W), z in any unit. Integers are computed in float32.
        camera_matrix: (B, 3, 3), of which the focal lengths and the principal point are used. One serves a batch of
            depth images, and one depth image a batch of cameras.
        normalize_points: depth is the distance from the camera, not z.

    Returns:
        (B, 3, H, W), x to the right, y down and z forwards, of the type of `depth`.

    Raises:
        TypeError: an argument does not have its documented type.
        ValueError: a shape is not as in Args, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> camera = torch.tensor([[[2.0, 0, 1], [0, 2, 0], [0, 0, 1]]])
        >>> K.geometry.depth_to_3d(torch.full((1, 1, 1, 3), 4.0), camera)[0, :, 0]
        tensor([[-2.,  0.,  2.],
                [ 0.,  0.,  0.],
                [ 4.,  4.,  4.]])
    """
    depth, camera = _depth_and_camera("depth_to_3d", depth, camera_matrix, normalize_points)
    points: Tensor = depth_points(depth, camera, normalize_points, False)
    return points


def depth_to_normals(depth: Tensor, camera_matrix: Tensor, normalize_points: bool = False) -> Tensor:
    """Compute the unit surface normals of depth images.

    It is the cross product of the Sobel derivatives of the points to the right and down, so that a wall in front of the
    camera has (0, 0, 1). It is 0 where these are.

    Args:
        depth: (B, 1, H, W), H and W at least 2. Integers are computed in float32.
        camera_matrix: (B, 3, 3), as :func:`depth_to_3d` takes it.
        normalize_points: depth is the distance from the camera, not z.

    Returns:
        (B, 3, H, W), of the type of `depth`.

    Raises:
        TypeError: an argument does not have its documented type.
        ValueError: a shape is not as in Args, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.depth_to_normals(torch.ones(1, 1, 4, 4), torch.eye(3)[None])[0, :, 2, 2]
        tensor([0., 0., 1.])
    """
    depth, camera = _depth_and_camera("depth_to_normals", depth, camera_matrix, normalize_points)
    if min(depth.shape[2:]) < 2:
        raise ShapeError(
            f"depth_to_normals: expected depth with H, W of at least 2, got {tuple(depth.shape)}",
            actual_shape=depth.shape,
        )
    normals: Tensor = _depth_normals(depth, camera, normalize_points)
    return normals


def unproject_meshgrid(
    height: int,
    width: int,
    camera_matrix: Tensor,
    normalize_points: bool = False,
    device: torch.device | None = None,
    dtype: torch.dtype | None = None,
) -> Tensor:
    """Back-project all pixels of cameras to depth 1. :func:`depth_to_3d_v2` multiplies these points by depths.

    Args:
        height: of the images.
        width: of the images.
        camera_matrix: (*, 3, 3).
        normalize_points: at a distance of 1, not at z = 1.
        device: of the result; None for that of `camera_matrix`.
        dtype: of the result; None for that of `camera_matrix`.

    Returns:
        (*, H, W, 3) as (x, y, z).

    Raises:
        TypeError: an argument does not have its documented type.
        ValueError: `camera_matrix` is not (*, 3, 3); a size is not positive.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.unproject_meshgrid(1, 2, torch.eye(3)[None])
        tensor([[[[0., 0., 1.],
                  [1., 0., 1.]]]])
    """
    op = "unproject_meshgrid"
    (height,), (width,) = _check.ints(op, "height", height, 1), _check.ints(op, "width", width, 1)
    _check_cameras(op, camera_matrix)
    _check.flag(op, "normalize_points", normalize_points)
    camera = floats(camera_matrix).to(device=_check.device(op, device), dtype=dtype)
    one = torch.ones((), device=camera.device, dtype=camera.dtype)
    return _points_last(one.expand(height, width), camera, normalize_points)


def _check_cameras(op: str, camera_matrix: Any) -> None:
    _check.numbers(op, "camera_matrix", camera_matrix)
    if camera_matrix.dim() < 2 or camera_matrix.shape[-2:] != (3, 3):
        raise ShapeError(
            f"{op}: expected camera_matrix of shape (*, 3, 3), got {tuple(camera_matrix.shape)}",
            actual_shape=camera_matrix.shape,
        )


def depth_to_3d_v2(
    depth: Tensor, camera_matrix: Tensor, normalize_points: bool = False, xyz_grid: Tensor | None = None
) -> Tensor:
    """Back-project the pixels of depth images to points with their coordinates last; see :func:`depth_to_3d`.

    Args:
        depth: (*, H, W), z. Integers are computed in float32.
        camera_matrix: (*, 3, 3), leading axes broadcast.
        normalize_points: depth is the distance from the camera, not z.
        xyz_grid: (*, H, W, 3), what :func:`unproject_meshgrid` gives for the camera, which is not read then.

    Returns:
        (*, H, W, 3) as (x, y, z), of the type of `depth`.

    Raises:
        TypeError: an argument does not have its documented type.
        ValueError: a shape is not as in Args, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.depth_to_3d_v2(torch.rand(4, 5), torch.eye(3).repeat(2, 1, 1)).shape
        torch.Size([2, 4, 5, 3])
    """
    op = "depth_to_3d_v2"
    _check.numbers(op, "depth", depth)
    if depth.dim() < 2 or 0 in depth.shape[-2:]:
        raise ShapeError(f"{op}: expected depth of shape (*, H, W), got {tuple(depth.shape)}", actual_shape=depth.shape)
    _check_cameras(op, camera_matrix)
    _check.flag(op, "normalize_points", normalize_points)
    camera_matrix = _check.to_device_of(op, depth, "camera_matrix", camera_matrix, of="depth")
    depth = floats(depth)
    if xyz_grid is None:
        _check.leading_axes(op, 2, depth=depth, camera_matrix=camera_matrix)
        return _points_last(depth, camera_matrix, normalize_points)
    _check.numbers(op, "xyz_grid", xyz_grid)
    if xyz_grid.shape[-3:] != (*depth.shape[-2:], 3):
        raise ShapeError(
            f"{op}: expected xyz_grid of shape (*, {depth.shape[-2]}, {depth.shape[-1]}, 3), got {tuple(xyz_grid.shape)}",
            actual_shape=xyz_grid.shape,
        )
    _check.same_device(op, depth=depth, xyz_grid=xyz_grid)
    return (depth[..., None] * xyz_grid).to(depth.dtype)


def _points_last(depth: Tensor, camera: Tensor, distance: bool) -> Tensor:
    """Points (*, H, W, 3) from depth (*, H, W) and cameras (*, 3, 3). Leading axes broadcast."""
    camera, size = as_dtype(camera, compute_dtype(depth)), depth.shape[-2:]
    leading = torch.broadcast_shapes(depth.shape[:-2], camera.shape[:-2])
    depths = depth.expand(*leading, *size).reshape(math.prod(leading), 1, *size)
    points: Tensor = depth_points(depths, expand_to_batch(camera, leading, 2), distance, True)
    return points.reshape(*leading, *size, 3)


# --- depth from other quantities ------------------------------------------------------------------------------------


@overload
def depth_from_disparity(
    disparity: Tensor, baseline: float | Tensor, focal: float | Tensor, return_valid: Literal[False] = False
) -> Tensor: ...
@overload
def depth_from_disparity(
    disparity: Tensor, baseline: float | Tensor, focal: float | Tensor, return_valid: bool
) -> Tensor | tuple[Tensor, Tensor]: ...
def depth_from_disparity(
    disparity: Tensor, baseline: float | Tensor, focal: float | Tensor, return_valid: bool = False
) -> Tensor | tuple[Tensor, Tensor]:
    """Depth of a stereo pair: baseline * focal / (disparity + 1e-8).

    Args:
        disparity: (*, H, W), in pixels. Integers are computed in float32.
        baseline: distance between the cameras; a number, a tensor of one, or (B,), one for each along the first axis.
        focal: focal length in pixels, likewise.
        return_valid: also return where the disparity is above 0.

    Returns:
        (*, H, W), in the unit of `baseline` and of the type of `disparity`; far, but finite in float32, where the
        disparity is 0, and negative where it is. With `return_valid` also a mask (*, H, W); other pixels have no gradient
        then.

    Raises:
        TypeError: an argument does not have its documented type.
        ValueError: a shape is not as in Args, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.depth_from_disparity(torch.full((1, 1, 2), 2.0), 0.5, 100.0)
        tensor([[[25., 25.]]])
    """
    op = "depth_from_disparity"
    _check.numbers(op, "disparity", disparity)
    if disparity.dim() < 2:
        raise ShapeError(
            f"{op}: expected disparity of shape (*, H, W), got {tuple(disparity.shape)}", actual_shape=disparity.shape
        )
    _check.flag(op, "return_valid", return_valid)
    disparity = floats(disparity)
    stereo = _of_samples(op, "baseline", baseline, disparity), _of_samples(op, "focal", focal, disparity)
    if not return_valid:
        return _from_disparity(disparity, *stereo)
    return with_validity(_from_disparity, disparity, disparity > 0, *stereo, axes=0)


@with_kernel_casts
def _from_disparity(disparity: Tensor, baseline: float | Tensor, focal: float | Tensor) -> Tensor:
    return baseline * focal / (disparity + 1e-8)


def _of_samples(op: str, name: str, value: Any, x: Tensor) -> float | Tensor:
    if not isinstance(value, Tensor):
        if isinstance(value, bool):
            raise TypeCheckError(f"{op}: expected {name} to be a number or a Tensor, got {value!r}")
        return _check.number(op, name, value)
    _check.numbers(op, name, value)
    value = _check.to_device_of(op, x, name, value, of="disparity")
    if value.dim() == 0 or value.shape == (1,):
        return value.reshape(())
    if value.dim() != 1 or x.dim() < 3 or value.shape[0] != x.shape[0]:
        raise ShapeError(
            f"{op}: expected {name} of shape (), (1,) or the first axis of {tuple(x.shape)}, got {tuple(value.shape)}",
            actual_shape=value.shape,
        )
    return value.reshape(-1, *[1] * (x.dim() - 1))


def depth_from_plane_equation(
    plane_normals: Tensor, plane_offsets: Tensor, points_uv: Tensor, camera_matrix: Tensor, eps: float = 1e-8
) -> Tensor:
    """Depth z of planes n . X = d of the camera's frame along the rays of pixels.

    A ray whose product with the normal is between -eps and eps takes eps with its sign for that, so that depth stays
    finite.

    Args:
        plane_normals: n, (B, 3).
        plane_offsets: d, (B, 1).
        points_uv: (B, N, 2), (x, y) in pixels.
        camera_matrix: (B, 3, 3).
        eps: see above.

    Returns:
        (B, N), of the type of `plane_normals`.

    Raises:
        TypeError: an argument does not have its documented type.
        ValueError: a shape is not as in Args, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> normal, offset = torch.tensor([[0.0, 0, 1]]), torch.tensor([[2.0]])
        >>> K.geometry.depth_from_plane_equation(normal, offset, torch.rand(1, 3, 2), torch.eye(3)[None])
        tensor([[2., 2., 2.]])
    """
    op = "depth_from_plane_equation"
    _check.shape(op, "plane_normals", plane_normals, "B", 3)
    _check.shape(op, "plane_offsets", plane_offsets, "B", 1)
    _check.shape(op, "points_uv", points_uv, "B", "N", 2)
    _check.shape(op, "camera_matrix", camera_matrix, "B", 3, 3)
    eps = _check.number(op, "eps", eps, minimum=0)
    tensors = {
        "plane_normals": plane_normals,
        "plane_offsets": plane_offsets,
        "points_uv": points_uv,
        "camera_matrix": camera_matrix,
    }
    _check.same_device(op, **tensors)
    batch = max(x.shape[0] for x in tensors.values())
    if any(x.shape[0] not in (1, batch) for x in tensors.values()):
        got = ", ".join(f"{name} {tuple(x.shape)}" for name, x in tensors.items())
        raise ShapeError(f"{op}: expected tensors of one batch, got {got}")
    result, points = floats(plane_normals).dtype, floats(points_uv)
    points = as_dtype(points, torch.promote_types(points.dtype, result)).expand(batch, -1, -1)
    normals, offsets, camera = (
        as_dtype(x, compute_dtype(points)) for x in (plane_normals, plane_offsets, camera_matrix)
    )
    length = 1 if all(x.shape[0] == 1 for x in (normals, offsets, camera)) else batch
    row = (camera[:, 0, :1], camera[:, 1, 1:2], camera[:, :2, 2], normals, offsets, camera.new_full((1, 1), eps))
    plane = torch.cat([numbers.expand(length, -1) for numbers in row], 1)
    return as_dtype(met(points, plane), result)
