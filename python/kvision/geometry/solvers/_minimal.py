"""Minimal solvers: models from the fewest correspondences, for samples of points or for draws from all points."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision._dtype import promoted
from kvision._modes import MODEL, MODEL_NAMES
from kvision._ops import no_derivative, register
from kvision.geometry._normalization import normalized, to_unit_last
from kvision.geometry.homography.dlt import of_lines
from kvision.geometry.homography.errors import sample_is_valid_for_homography
from kvision.geometry.linalg import adjugate
from kvision.geometry.solvers.affine import find_affine
from kvision.geometry.solvers.correspondences import register_fit
from kvision.geometry.solvers.null_vector import null_space, null_vector, null_vector_3x3
from kvision.geometry.solvers.polynomials import (
    determinant_to_polynomial,
    multiply_deg_one_poly,
    multiply_deg_two_one_poly,
)
from kvision.geometry.solvers.roots import real_roots
from kvision.geometry.transform.matrices import from_unit_square

# Points of a sample, and the largest number of models that a sample has.
SIZES = {
    "affine": (3, 1),
    "homography": (4, 1),
    "lines": (4, 1),
    "fundamental": (7, 3),
    "fundamental8": (8, 1),
    "essential": (5, 10),
}


def _reference(points1: Tensor, points2: Tensor, draws: Tensor | None, number: int) -> Tensor:
    """Models (S, candidates, 3, 3) of norm 1; affine maps are not scaled. Missing candidates are NaN.

    Takes samples (S, m, 2), or (S, m, 4) for line segments. Or takes points (B, N, ...) and `draws` (S, m + 1), S / B in turn
    for each pair: a row has m numbers in [0, 1) that choose from the first points, and last how many points these are. Too few
    have no model.
    """
    model = MODEL_NAMES[number]
    if draws is not None:
        chosen = _distinct(draws, points1.shape[1])
        pair = torch.arange(len(draws), device=draws.device) // max(len(draws) // max(len(points1), 1), 1)
        has_sample = (draws[:, -1:] >= chosen.shape[1])[..., None]
        points1, points2 = (torch.where(has_sample, p[pair[:, None], chosen], torch.nan) for p in (points1, points2))
    if model == "affine":
        return find_affine(points1, points2)[:, None]
    if model == "homography":
        models = _four_points(points1, points2)
    elif model == "lines":
        models = of_lines(points1.unflatten(-1, (2, 2)), points2.unflatten(-1, (2, 2)), None)[:, None]
    elif model == "fundamental":
        models = seven_points(points1, points2)
    elif model == "fundamental8":
        models = eight_points(points1, points2, None)[:, None]
    else:
        return five_points(points1, points2)
    return models / torch.linalg.vector_norm(models, dim=(-2, -1), keepdim=True)


def _distinct(draws: Tensor, count: int) -> Tensor:
    """Samples (S, m) of distinct points, uniform over each row's population, by R. Floyd's method."""
    size = draws.shape[1] - 1
    population = draws[:, size].long().clamp(size, count)
    chosen: list[Tensor] = []
    for i in range(size):
        last = population - size + i
        pick = torch.minimum((draws[:, i] * (last + 1)).long(), last)
        for other in chosen:
            pick = torch.where(other == pick, last, pick)
        chosen.append(pick)
    return torch.stack(chosen, -1)


def _sizes(points1: Tensor, points2: Tensor, draws: Tensor | None, model: int) -> tuple[int, ...]:
    return (points1 if draws is None else draws).shape[0], SIZES[MODEL_NAMES[model]][1], 3, 3


_minimal_solver = register("minimal_solver", _reference, fake=_sizes, supports=no_derivative)


def minimal_solver(points1: Tensor, points2: Tensor, draws: Tensor | None, model: str) -> Tensor:
    return _minimal_solver(points1, points2, draws, MODEL[model])


def _four_points(points1: Tensor, points2: Tensor) -> Tensor:
    """Homographies of four points. NaN where three points change orientation: a point between them maps to infinity."""
    H = from_unit_square(promoted(points2)) @ adjugate(from_unit_square(promoted(points1)))
    is_valid = sample_is_valid_for_homography(points1, points2)
    return torch.where(is_valid[:, None, None], H, torch.nan)[:, None].to(points1.dtype)


# --- epipolar geometry ------------------------------------------------------------------------------------------------


def _eight_points(points1: Tensor, points2: Tensor, weights: Tensor | None) -> Tensor:
    w = None if weights is None else promoted(weights)
    x, T1 = normalized(promoted(points1), w)
    y, T2 = normalized(promoted(points2), w)
    F = null_vector(epipolar_rows(x, y), w).unflatten(-1, (3, 3))
    return to_unit_last(T2.mT @ of_rank_two(F) @ T1).to(points1.dtype)


# The least-squares fundamental matrices (B, 3, 3).
eight_points = register_fit("fundamental_dlt", _eight_points)


def seven_points(points1: Tensor, points2: Tensor) -> Tensor:
    """(B, 3, 3, 3), NaN for missing ones: a F1 + (1 - a) F2 is of rank 2 for the roots a of a cubic."""
    x, T1 = normalized(promoted(points1), None)
    y, T2 = normalized(promoted(points2), None)
    F1, F2 = null_space(epipolar_rows(x, y), 2).unflatten(-2, (3, 3)).unbind(-1)
    D = F1 - F2
    one, two = adjugate(D), adjugate(F2)
    mixed = [(m.mT * n).sum((-2, -1)) for m, n in ((one, F2), (two, D))]
    det = [(m * n.mT).sum((-2, -1)) / 3 for m, n in ((one, D), (two, F2))]
    a = real_roots(torch.stack([det[0], mixed[0], mixed[1], det[1]], -1))[..., None, None]
    F = a * D[:, None] + F2[:, None]
    return (T2.mT[:, None] @ F @ T1[:, None]).to(points1.dtype)


def epipolar_rows(x: Tensor, y: Tensor) -> Tensor:
    """Rows (B, N, 9) for points (B, N, 2): the product with the entries of F is y^T F x."""
    x, y = (torch.cat([p, torch.ones_like(p[..., :1])], -1) for p in (x, y))
    return (y[..., None] * x[..., None, :]).flatten(-2)


def of_rank_two(F: Tensor) -> Tensor:
    """The nearest matrix of rank 2: F - F v v^T for its smallest right singular vector v."""
    v = null_vector_3x3(F)
    return F - (F @ v[..., None]) * v[..., None, :]


def five_points(points1: Tensor, points2: Tensor) -> Tensor:
    """det E = 0 and 2 E E^T E = tr(E E^T) E for E = x X + y Y + z Z + W, ten cubic equations in x, y and z."""
    basis = null_space(epipolar_rows(promoted(points1), promoted(points2)), 4).unflatten(-2, (3, 3))  # (B, 3, 3, 4)
    is_defined = basis.isfinite().flatten(1).all(-1)[:, None]
    E = torch.where(is_defined[..., None, None], basis, 0)
    # Each equation keeps one of the first ten monomials. The last six of them are x^2 z, x^2, y^2 z, y^2, xyz, xy.
    equations = _constraints(E)
    left, right = equations[..., :10], equations[..., 10:]
    solved = _solved(left, right)
    is_defined = is_defined & solved.isfinite().flatten(1).all(-1)[:, None]
    solved = torch.where(is_defined[..., None], solved, 0)
    # A row with z minus z times the row without: three equations in x, y and 1 with polynomials in z as coefficients.
    top, bottom = (rows.split([3, 3, 4], -1) for rows in (solved[:, 4::2], solved[:, 5::2]))
    pad = torch.nn.functional.pad
    system = [pad(t, (1, 0)) - pad(b, (0, 1)) for t, b in zip(top, bottom)]
    z = real_roots(determinant_to_polynomial(torch.cat(system, -1)).flip(-1))
    is_root = is_defined & z.isfinite()
    z = torch.where(is_root, z, 0)
    at_z = torch.stack([_polynomial(p, z) for p in system], -1)  # (B, 10, 3, 3)
    a, b, c = at_z.unbind(-2)
    crosses = torch.stack([torch.linalg.cross(a, b), torch.linalg.cross(b, c), torch.linalg.cross(c, a)], -2)
    best = crosses.detach().square().sum(-1).argmax(-1)[..., None, None].expand(*z.shape, 1, 3)
    xy1 = crosses.gather(-2, best)[..., 0, :]
    is_root = is_root & (xy1[..., 2] != 0)
    xy = xy1[..., :2] / torch.where(is_root, xy1[..., 2], 1)[..., None]
    factors = torch.cat([xy, torch.stack([z, torch.ones_like(z)], -1)], -1)
    candidates = (basis[:, None] * factors[..., None, None, :]).sum(-1)
    candidates = candidates / torch.linalg.vector_norm(candidates, dim=(-2, -1), keepdim=True)
    return torch.where(is_root[..., None, None], candidates, torch.nan).to(points1.dtype)


def _solved(left: Tensor, right: Tensor) -> Tensor:
    """Solve linear equations (B, n, n) for (B, n, m). Not finite if singular."""
    return torch.linalg.solve_ex(left, right)[0] if left.is_cpu else eliminated(left, right)


def eliminated(left: Tensor, right: Tensor) -> Tensor:
    """`_solved` by Gaussian elimination of pointwise operators only, since CUDA graphs cannot capture library solvers."""
    system = torch.cat([left, right], -1)
    order = torch.arange(left.shape[1], device=left.device)
    for k in range(left.shape[1]):
        best = system[:, k:, k].detach().abs().argmax(-1, keepdim=True) + k
        swapped = torch.where(order == k, best, torch.where(order == best, k, order))
        system = system.gather(1, swapped[..., None].expand_as(system))
        row = system[:, k : k + 1] / system[:, k : k + 1, k : k + 1]
        system = torch.where((order == k)[:, None], row, system - system[:, :, k : k + 1] * row)
    return system[..., left.shape[1] :]


def _constraints(E: Tensor) -> Tensor:
    """Coefficients (B, 10, 20) of the constraints on E (B, 3, 3, 4), as `multiply_deg_two_one_poly` orders monomials."""
    EEt = multiply_deg_one_poly(E[:, :, None], E[:, None]).sum(3)  # (B, 3, 3, 10)
    half_trace = EEt.diagonal(dim1=1, dim2=2).sum(-1) / 2
    eye = torch.eye(3, device=E.device, dtype=E.dtype)
    inner = EEt - eye[..., None] * half_trace[:, None, None]
    trace = multiply_deg_two_one_poly(inner[:, :, :, None], E[:, None]).sum(2).flatten(1, 2)
    first, second, third = E.unbind(1)

    def minor(i: int, k: int) -> Tensor:
        return multiply_deg_one_poly(first[:, i], second[:, k]) - multiply_deg_one_poly(first[:, k], second[:, i])

    minors = torch.stack([minor(1, 2), minor(2, 0), minor(0, 1)], 1)
    det = multiply_deg_two_one_poly(minors, third).sum(1, keepdim=True)
    return torch.cat([trace, det], 1)


def _polynomial(p: Tensor, z: Tensor) -> Tensor:
    """Evaluate polynomials (B, 3, n), the highest power first, at z (B, k): (B, k, 3)."""
    value = torch.zeros_like(z)[..., None]
    for c in p.unbind(-1):
        value = value * z[..., None] + c[:, None]
    return value
