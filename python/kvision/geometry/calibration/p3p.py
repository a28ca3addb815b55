"""Camera poses from three points in space and their projections."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision import _check
from kvision.geometry._precision import in_full_precision
from kvision.geometry.calibration.pnp import _before_camera, check_correspondences
from kvision.geometry.solvers.roots import real_roots, value_and_derivative

__all__ = ["solve_p3p"]

_TOLERANCE = 1e-6  # of the squared sides of what counts as a solution, relative to the largest
_POLISHING = 2  # steps of Newton's method on the distances, which rounding of the quartic's coefficients moves


@in_full_precision
def solve_p3p(world_points: Tensor, img_points: Tensor, intrinsics: Tensor) -> Tensor:
    """Estimate the camera poses that see three points in space at their pixels: up to four.

    Args:
        world_points: (B, 3, 3), floating point, three points that are not on one line.
        img_points: (B, 3, 2) as (x, y) in pixels, without distortion.
        intrinsics: camera matrices, (B, 3, 3), upper triangular.

    Returns:
        [R | t] from world to camera, (B, 4, 3, 4), with all points in front of the camera; NaN for those that are missing.
        Gradients are those of each solution; where two solutions meet they are infinite.

    Raises:
        TypeCheckError: an argument is not a floating-point tensor.
        ShapeError: a shape is not as in Args.
        DeviceError: the tensors are on different devices.

    Source: R. M. Haralick et al., "Review and analysis of solutions of the three point perspective pose estimation problem"
    (1994), the elimination of Grunert.

    Example:
        >>> import torch, kvision as K
        >>> points = torch.tensor([[[0.0, 0, 4], [1, 0, 5], [0, 1, 6]]]).double()
        >>> pixels = points[..., :2] / points[..., 2:]
        >>> poses = K.geometry.solve_p3p(points, pixels, torch.eye(3).double()[None])
        >>> (poses - torch.eye(3, 4)).abs().amax((2, 3)).nan_to_num(torch.inf).amin() < 1e-9
        tensor(True)
    """
    _check.shape("solve_p3p", "world_points", world_points, "B", 3, 3)
    check_correspondences("solve_p3p", world_points, img_points, intrinsics, None, 3, "three")
    dtype = world_points.dtype
    X, x, K = world_points.double(), img_points.double(), intrinsics.double()
    return poses_of_triangles(X, torch.nn.functional.pad(_before_camera(x, K), (0, 1), value=1.0)).to(dtype)


def poses_of_triangles(X: Tensor, rays: Tensor) -> Tensor:
    """[R | t] (B, 4, 3, 4) of triangles X (B, 3, 3) that are seen along rays (B, 3, 3), in float64; NaN for missing ones."""
    f = torch.nn.functional.normalize(rays, dim=-1)
    cosines = (f[:, [1, 0, 0]] * f[:, [2, 2, 1]]).sum(-1)[
        :, None
    ]  # between the rays of the sides opposite to each point
    squares = (X[:, [1, 0, 0]] - X[:, [2, 2, 1]]).square().sum(-1)[:, None]
    with torch.no_grad():
        d = _distances(cosines, squares)
        is_found = d.isfinite().all(-1) & ~_is_flat(X)[:, None]
        d = torch.where(is_found[..., None], d, 1)
    d = _newton(d, cosines, squares)  # whose derivative is that of the solution
    Y = d[..., None] * f[:, None]
    R = _frame(Y) @ _frame(X)[:, None].mT
    t = Y.mean(-2) - (R @ X.mean(-2)[:, None, :, None])[..., 0]
    return torch.where(is_found[..., None, None], torch.cat([R, t[..., None]], -1), torch.nan)


def _distances(cosines: Tensor, squares: Tensor) -> Tensor:
    """Distances (B, 4, 3) of the points from the camera, by the law of cosines for the three sides; NaN for missing ones.

    With the second and third distance as u and v times the first, two quotients of sides leave two quadratic equations in u; their
    difference is linear in u, and puts u = n(v) / m(v) into a quartic of v.
    """
    ca, cb, cc = cosines[:, 0].unbind(-1)
    a, b, c = squares[:, 0].unbind(-1)
    p, q = a / b, c / b
    n = torch.stack([p - q - 1, 2 * (q - p) * cb, 1 + p - q], -1)  # highest power first
    m = torch.stack([-2 * ca, 2 * cc], -1)
    rest = torch.stack([-q, 2 * q * cb, 1 - q], -1)
    quartic = _product(_product(m, m), rest) + _product(n, n)
    quartic = quartic - torch.nn.functional.pad(2 * cc[:, None] * _product(n, m), (1, 0))
    v = real_roots(quartic)
    u = value_and_derivative(n, v)[0] / value_and_derivative(m, v)[0]
    first = (b[:, None] / (1 + v * v - 2 * v * cb[:, None])).sqrt()
    d = first[..., None] * torch.stack([torch.ones_like(v), u, v], -1)
    for _ in range(_POLISHING):
        d = _newton(d, cosines, squares)
    is_solution = _errors(d, cosines, squares).abs().amax(-1) <= _TOLERANCE * squares.amax(-1)
    return torch.where((is_solution & (d > 0).all(-1))[..., None], d, torch.nan)


def _errors(d: Tensor, cosines: Tensor, squares: Tensor) -> Tensor:
    """The squared sides (B, 4, 3) between points at distances d, less the given ones."""
    first, second = d[..., [1, 0, 0]], d[..., [2, 2, 1]]
    return first.square() + second.square() - 2 * cosines * first * second - squares


def _newton(d: Tensor, cosines: Tensor, squares: Tensor) -> Tensor:
    """A step towards the distances whose sides have the given squares. Singular systems keep what they have."""
    first, second = d[..., [1, 0, 0]], d[..., [2, 2, 1]]
    error = _errors(d, cosines, squares)
    of_first, of_second = 2 * (first - cosines * second), 2 * (second - cosines * first)
    p0, p1, p2 = of_first.unbind(-1)
    q0, q1, q2 = of_second.unbind(-1)
    e0, e1, e2 = error.unbind(-1)
    # The rows of the matrix are (0, p0, q0), (p1, 0, q1) and (p2, q2, 0); Cramer's rule solves it.
    determinant = p0 * q1 * p2 + q0 * p1 * q2
    safe = torch.where(determinant.abs() > 1e-12 * squares.amax(-1) ** 1.5, determinant, torch.inf)
    step = torch.stack(
        [
            q0 * q2 * e1 + p0 * q1 * e2 - q1 * q2 * e0,
            q1 * p2 * e0 + q0 * p1 * e2 - q0 * p2 * e1,
            p1 * q2 * e0 + p0 * p2 * e1 - p0 * p1 * e2,
        ],
        -1,
    )
    return d - step / safe[..., None]


def _frame(X: Tensor) -> Tensor:
    """Orthonormal columns (..., 3, 3) of triangles: one along the first side, one in their plane, and the normal."""
    side, other = X[..., 1, :] - X[..., 0, :], X[..., 2, :] - X[..., 0, :]
    first = torch.nn.functional.normalize(side, dim=-1)
    last = torch.nn.functional.normalize(torch.linalg.cross(side, other), dim=-1)
    return torch.stack([first, torch.linalg.cross(last, first), last], -1)


def _is_flat(X: Tensor) -> Tensor:
    """Whether the points of triangles (B, 3, 3) are on one line, or coincide."""
    side, other = X[:, 1] - X[:, 0], X[:, 2] - X[:, 0]
    area = torch.linalg.cross(side, other).square().sum(-1)
    return ~(area > 1e-20 * side.square().sum(-1) * other.square().sum(-1))


def _product(a: Tensor, b: Tensor) -> Tensor:
    """Products of polynomials (B, m) and (B, n)."""
    rows = [torch.nn.functional.pad(a * b[:, i, None], (i, b.shape[-1] - 1 - i)) for i in range(b.shape[-1])]
    return torch.stack(rows).sum(0)
