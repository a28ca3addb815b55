"""Fundamental matrices: x2^T F x1 = 0 for the projections x1 and x2 of one point, in pixels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, TypeAlias, get_args

import torch
from torch import Tensor
from torch.nn.functional import pad

from kvision import _check
from kvision.core.exceptions import ShapeError
from kvision.geometry._correspondence_errors import check_correspondence_shapes
from kvision.geometry._formula import of_all, of_rows, register_formula
from kvision.geometry._normalization import to_unit_last
from kvision.geometry._precision import in_full_precision
from kvision.geometry.linalg import adjugate, product_plus
from kvision.geometry.solvers._minimal import eight_points, minimal_solver
from kvision.geometry.solvers.correspondences import check_correspondences

__all__ = [
    "compute_correspond_epilines",
    "find_fundamental",
    "fundamental_from_essential",
    "fundamental_from_projections",
    "get_closest_point_on_epipolar_line",
    "get_perpendicular",
]

Method: TypeAlias = Literal["8POINT", "7POINT"]
_METHODS = get_args(Method)


@in_full_precision
def find_fundamental(
    points1: Tensor, points2: Tensor, weights: Tensor | None = None, method: Method = "8POINT"
) -> Tensor:
    """Estimate fundamental matrices from correspondences.

    Args:
        points1: (B, N, 2) as (x, y) in the first image, floating point.
        points2: the same points in the second image, (B, N, 2).
        weights: of the squared errors of "8POINT", (B, N), at least 0; only their ratios matter.
        method: "8POINT": least squares from at least eight points, of rank 2; "7POINT": the matrices of rank 2 that
            seven points leave.

    Returns:
        "8POINT": (B, 3, 3); "7POINT": (B, 3, 3, 3), one to three matrices, zeros for those that are missing. Divided by
        the last entry unless that is 0. NaN where points or weights are not finite.

    Raises:
        TypeCheckError: an argument is not a floating-point tensor.
        ShapeError: a shape is not as in Args, too few points.
        DeviceError: the tensors are on different devices.
        ValueCheckError: another method.

    Source: R. Hartley, "In defense of the eight-point algorithm" (1997).

    Example:
        >>> import torch, kvision as K
        >>> scene = K.geometry.epipolar.generate_scene(2, 20)
        >>> x1, x2 = scene["points2d"].double().split(1)
        >>> F = K.geometry.find_fundamental(x1, x2)
        >>> K.geometry.sampson_epipolar_distance(x1, x2, F).max() < 1e-3
        tensor(True)
    """
    op = "find_fundamental"
    _check.choice(op, "method", method, _METHODS)
    weights = check_correspondences(op, points1, points2, weights, min_points=8 if method == "8POINT" else 7)
    if method == "7POINT":
        if points1.shape[1] != 7:
            raise ShapeError(f"{op}: expected points1 of shape (B, 7, 2), got {tuple(points1.shape)}")
        return to_unit_last(minimal_solver(points1, points2, None, "fundamental")).nan_to_num(0.0)
    return eight_points(points1, points2, weights)


@in_full_precision
def fundamental_from_essential(E_mat: Tensor, K1: Tensor, K2: Tensor) -> Tensor:
    """Convert essential matrices to fundamental ones: K2^-T E K1^-1.

    Args:
        E_mat: (*, 3, 3), floating point.
        K1: camera matrices of the first image, (*, 3, 3).
        K2: those of the second image, (*, 3, 3).

    Returns:
        (*, 3, 3); NaN where a camera matrix has no inverse.

    Raises:
        TypeCheckError: an argument is not a floating-point tensor.
        ShapeError: a shape is not as in Args.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.fundamental_from_essential(torch.ones(3, 3), torch.diag(torch.tensor([2.0, 2, 1])), torch.eye(3))
        tensor([[0.5000, 0.5000, 1.0000],
                [0.5000, 0.5000, 1.0000],
                [0.5000, 0.5000, 1.0000]])
    """
    for name, x in (("E_mat", E_mat), ("K1", K1), ("K2", K2)):
        _check.floating_trailing_shape("fundamental_from_essential", name, x, 3, 3)
    _check.same_device("fundamental_from_essential", E_mat=E_mat, K1=K1, K2=K2)
    _check.leading_axes("fundamental_from_essential", 2, E_mat=E_mat, K1=K1, K2=K2)
    return of_all(_from_essential, 2, E_mat, K1, K2)


def _from_essential_reference(E: Tensor, K1: Tensor, K2: Tensor) -> Tensor:
    return _inverse(K2).mT @ E @ _inverse(K1)


def _inverse(K: Tensor) -> Tensor:
    A = adjugate(K)
    det = (K[..., 0, :] * A[..., :, 0]).sum(-1)[..., None, None]
    return torch.where(det == 0, torch.nan, A / torch.where(det == 0, 1, det))


_from_essential = register_formula("fundamental_from_essential", _from_essential_reference, lambda *args: (3, 3))


@in_full_precision
def fundamental_from_projections(P1: Tensor, P2: Tensor) -> Tensor:
    """Compute the fundamental matrices of two cameras.

    Args:
        P1: projections of the first image, (*, 3, 4), floating point.
        P2: those of the second image, (*, 3, 4).

    Returns:
        (*, 3, 3), whose entries are 4 x 4 minors of both; 0 for two cameras with the same center.

    Raises:
        TypeCheckError: an argument is not a floating-point tensor.
        ShapeError: a shape is not as in Args.
        DeviceError: the tensors are on different devices.

    Source: R. Hartley and A. Zisserman, "Multiple View Geometry" (2003), equation 17.3.

    Example:
        >>> import torch, kvision as K
        >>> P2 = torch.eye(3, 4)
        >>> P2[0, 3] = 1.0  # moved along x
        >>> K.geometry.fundamental_from_projections(torch.eye(3, 4), P2)
        tensor([[ 0.,  0.,  0.],
                [ 0.,  0.,  1.],
                [ 0., -1.,  0.]])
    """
    op = "fundamental_from_projections"
    _check.floating_trailing_shape(op, "P1", P1, 3, 4)
    _check.floating_trailing_shape(op, "P2", P2, 3, 4)
    _check.same_device(op, P1=P1, P2=P2)
    _check.leading_axes(op, 2, P1=P1, P2=P2)
    return of_all(_from_projections, 2, P1, P2)


def _from_projections_reference(P1: Tensor, P2: Tensor) -> Tensor:
    # Laplace expansion: a 4 x 4 determinant is a signed sum of products of complementary 2 x 2 minors.
    columns, rest = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)), ((2, 3), (3, 1), (1, 2), (0, 3), (2, 0), (0, 1))
    return _minors(P2, rest) @ _minors(P1, columns).mT + 0  # no negative zeros


def _minors(P: Tensor, columns: Sequence[tuple[int, int]]) -> Tensor:
    """The 2 x 2 minors (*, 3, pairs) of projections: one row omitted, for each pair of columns."""
    a, b = P.roll(-1, -2), P.roll(-2, -2)
    return torch.stack([a[..., i] * b[..., k] - a[..., k] * b[..., i] for i, k in columns], -1)


_from_projections = register_formula("fundamental_from_projections", _from_projections_reference, lambda *args: (3, 3))


# --- lines ----------------------------------------------------------------------------------------------------------


@in_full_precision
def compute_correspond_epilines(points: Tensor, F_mat: Tensor) -> Tensor:
    """Compute the epipolar lines of points in the other image.

    Args:
        points: (*, N, 2) as (x, y), or (*, N, 3) homogeneous, floating point.
        F_mat: from the image of the points to the other one, (*, 3, 3); its transpose goes the other way.

    Returns:
        (a, b, c) with a x + b y + c = 0 and a^2 + b^2 = 1, (*, N, 3); unscaled where a and b are 0.

    Raises:
        TypeCheckError: an argument is not a floating-point tensor.
        ShapeError: a shape is not as in Args.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> F = torch.tensor([[0.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # moved along x
        >>> K.geometry.compute_correspond_epilines(torch.tensor([[3.0, 7.0]]), F)
        tensor([[ 0., -1.,  7.]])
    """
    check_points("compute_correspond_epilines", "points", points)
    _check.floating_trailing_shape("compute_correspond_epilines", "F_mat", F_mat, 3, 3)
    _check.same_device("compute_correspond_epilines", points=points, F_mat=F_mat)
    _check.leading_axes("compute_correspond_epilines", 2, points=points, F_mat=F_mat)
    return scaled_lines(lines(points, F_mat))


def lines(points: Tensor, F: Tensor) -> Tensor:
    """F x for points (*, N, 2 or 3)."""
    if points.shape[-1] == 3:
        return points @ F.mT
    linear, last = F.mT.split((2, 1), -2)
    return product_plus(points, linear, last)


def scaled_lines(line: Tensor) -> Tensor:
    return of_rows(_normalize_line, line, 1)


def _normalize_line_reference(line: Tensor) -> Tensor:
    # No norm: its second derivative at 0 is not finite.
    square = line[..., :2].square().sum(-1, keepdim=True)
    return line / square.masked_fill(square == 0, 1).sqrt()


_normalize_line = register_formula("normalize_line", _normalize_line_reference, lambda *args: (3,))


def check_points(op: str, name: str, x: Tensor) -> None:
    _check.floating_trailing_shape(op, name, x, "N", "2 or 3")
    if x.shape[-1] not in (2, 3):
        raise ShapeError(f"{op}: expected {name} of shape (*, N, 2 or 3), got {tuple(x.shape)}", actual_shape=x.shape)


@in_full_precision
def get_perpendicular(lines: Tensor, points: Tensor) -> Tensor:
    """Compute the lines through points that are perpendicular to other lines.

    Args:
        lines: (a, b, c) with a x + b y + c = 0, (*, N, 3), floating point.
        points: (*, N, 2) as (x, y), or (*, N, 3) homogeneous.

    Returns:
        (*, N, 3).

    Raises:
        TypeCheckError: an argument is not a floating-point tensor.
        ShapeError: a shape is not as in Args.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.get_perpendicular(torch.tensor([[0.0, 1, -2]]), torch.tensor([[3.0, 7.0]]))  # y = 2
        tensor([[-1.,  0.,  3.]])
    """
    _check.floating_trailing_shape("get_perpendicular", "lines", lines, "N", 3)
    check_points("get_perpendicular", "points", points)
    _check.same_device("get_perpendicular", lines=lines, points=points)
    _check.leading_axes("get_perpendicular", 1, lines=lines, points=points)
    direction = pad(lines[..., :2], (0, 1))  # a point at infinity
    if points.shape[-1] == 2:
        points = pad(points, (0, 1), value=1.0)
    if direction.dim() != points.dim():
        direction, points = torch.broadcast_tensors(direction, points)
    return torch.linalg.cross(points, direction)


@in_full_precision
def get_closest_point_on_epipolar_line(pts1: Tensor, pts2: Tensor, Fm: Tensor) -> Tensor:
    """Project points of the second image onto the epipolar lines of their correspondences in the first.

    Args:
        pts1: (*, N, 2) as (x, y), or (*, N, 3) homogeneous, floating point.
        pts2: likewise, in the second image.
        Fm: (*, 3, 3), from the first image to the second.

    Returns:
        (*, N, 2); where they are if there is no line.

    Raises:
        TypeCheckError: an argument is not a floating-point tensor.
        ShapeError: a shape is not as in Args.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> F = torch.tensor([[0.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # moved along x
        >>> K.geometry.get_closest_point_on_epipolar_line(torch.tensor([[3.0, 7.0]]), torch.tensor([[5.0, 8.0]]), F)
        tensor([[5., 7.]])
    """
    op = "get_closest_point_on_epipolar_line"
    check_points(op, "pts1", pts1)
    check_points(op, "pts2", pts2)
    _check.floating_trailing_shape(op, "Fm", Fm, 3, 3)
    _check.same_device(op, pts1=pts1, pts2=pts2, Fm=Fm)
    check_correspondence_shapes(op, pts1=pts1, pts2=pts2, Fm=Fm)
    line = scaled_lines(lines(pts1, Fm))
    point = pts2 if pts2.shape[-1] == 2 else pts2[..., :2] / pts2[..., 2:]
    normal = line[..., :2]
    away = ((normal * point).sum(-1, keepdim=True) + line[..., 2:]) * normal.square().sum(-1, keepdim=True)
    return point - away * normal
