"""Weighted fits of homographies, fundamental and essential matrices near given ones: the least sums of squared Sampson errors.

A model satisfies linear equations A m = 0. The Sampson error divides them by how much they change with the points, which the last
model tells; what is left is the quadratic form m^T M m of a small matrix M, which the least eigenvector or a few steps on the
manifold of the model minimize. So each correspondence is read once for each fit, whatever the model.

Source: K. Kanatani, Y. Sugaya, Y. Kanazawa, "Guide to 3D Vision Computation" (2016).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from kvision._limits import FREEDOM, NOISE_ROUNDS
from kvision._modes import MODEL, MODEL_NAMES
from kvision._ops import register
from kvision.geometry._correspondence_errors import correspondence_errors
from kvision.geometry._normalization import normalized
from kvision.geometry.homography.dlt import homography_of, of_lines
from kvision.geometry.linalg import adjugate
from kvision.geometry.solvers._minimal import epipolar_rows
from kvision.geometry.solvers._sigma_consensus import END, rising_fits
from kvision.geometry.solvers.affine import affine_of
from kvision.geometry.solvers.null_vector import eigenvectors

_STEPS = 3  # of Newton's method on the manifold of a model; each doubles the correct digits

# [e_k]x of the three axes.
_GENERATORS = (
    ((0, 0, 0), (0, 0, -1), (0, 1, 0)),
    ((0, 0, 1), (0, 0, 0), (-1, 0, 0)),
    ((0, -1, 0), (1, 0, 0), (0, 0, 0)),
)


def squared_errors(models: Tensor, x: Tensor, y: Tensor, model: str) -> Tensor:
    """Squared errors (B, K, N) of points (B, N, 2), or segments (B, N, 2, 2), for models (B, K, 3, 3)."""
    count = models.shape[1]
    has_length = (y[..., 0, :] != y[..., 1, :]).any(-1)[:, None] if model == "lines" else None
    if len(models) != 1 and count != 1:
        x, y = (p[:, None].expand(-1, count, *p.shape[1:]).flatten(0, 1) for p in (x, y))
    kind = {"affine": "transfer", "homography": "transfer", "lines": "segments"}.get(model, "sampson")
    errors = correspondence_errors(x, y, models.flatten(0, 1), kind, True).unflatten(0, models.shape[:2])
    return errors if has_length is None else torch.where(has_length, errors, torch.inf)


class TwoViewFit:
    """Errors of models (B, K, 3, 3) and fits near them, for correspondences (B, N, 2) of which those exist that `exists` marks."""

    def __init__(self, model: str, x: Tensor, y: Tensor, exists: Tensor | None) -> None:
        if exists is not None:
            exists = exists.reshape(*exists.shape, *(1,) * (x.dim() - 2))
            x, y = (torch.where(exists, p, torch.nan) for p in (x, y))
        self.model, self.x, self.y = model, x.double(), y.double()

    def errors(self, models: Tensor) -> Tensor:
        """Squared errors (B, K, N); NaN where there is no correspondence."""
        return squared_errors(models, self.x, self.y, self.model)

    def __call__(self, models: Tensor, weights: Tensor) -> Tensor:
        """Models (B, K, 3, 3) near others, for weights (B, K, N) of squared errors."""
        raise NotImplementedError

    def _finite(self) -> tuple[Tensor, Tensor]:
        """The points, with 0 for those without a correspondence, whose weight is 0."""
        return self.x.nan_to_num(0.0, 0.0, 0.0), self.y.nan_to_num(0.0, 0.0, 0.0)

    def _normalized(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        weights = (self.x + self.y).isfinite().all(-1).to(self.x.dtype)
        x, y = self._finite()
        x, T1 = normalized(x, weights)
        y, T2 = normalized(y, weights)
        return x, y, T1[:, None], T2[:, None]


class LinearFit(TwoViewFit):
    """Affine maps, and homographies of line segments (B, N, 2, 2): the least squares of their linear equations."""

    def __init__(self, model: str, x: Tensor, y: Tensor, exists: Tensor | None) -> None:
        super().__init__(model, x, y, exists)
        self.finite = self._finite()

    def __call__(self, models: Tensor, weights: Tensor) -> Tensor:
        count = models.shape[1]
        x, y = (p[:, None].expand(-1, count, *p.shape[1:]).flatten(0, 1) for p in self.finite)
        return LINEAR_FITS[self.model](x, y, weights.flatten(0, 1)).unflatten(0, models.shape[:2])


class HomographyFit(TwoViewFit):
    """The covariance of both equations of a correspondence counts by its trace."""

    def __init__(self, model: str, x: Tensor, y: Tensor, exists: Tensor | None) -> None:
        super().__init__(model, x, y, exists)
        x, y, self.T1, self.T2 = self._normalized()
        self.inverses = torch.linalg.inv_ex(self.T1).inverse, torch.linalg.inv_ex(self.T2).inverse
        p = torch.nn.functional.pad(x, (0, 1), value=1.0)
        self.p, zero = p.mT[:, None], torch.zeros_like(p)
        down = torch.cat([zero, -p, y[..., 1:] * p], -1)  # v w - q for (p, q, w) = H (x, y, 1)
        across = torch.cat([p, zero, -y[..., :1] * p], -1)  # p - u w
        self.rows = torch.cat([down, across], 1)[:, None]  # (B, 1, 2 N, 9)
        # Of the trace |h2 - v h3|^2 + |h1 - u h3|^2 + 2 w^2 var(y) / var(x), the products of the first two columns of H.
        u, v = y.mT[:, None].unbind(2)
        zero, one = torch.zeros_like(u), torch.ones_like(u)
        self.traces = torch.stack([one, zero, -u, zero, one, -v, -u, -v, u * u + v * v], -1).mT  # (B, 1, 9, N)
        self.ratio = 2 * (self.T2[..., :1, :1] / self.T1[..., :1, :1]).square()

    def __call__(self, models: Tensor, weights: Tensor) -> Tensor:
        H = self.T2 @ models @ self.inverses[0]
        w = H[..., 2:, :] @ self.p
        left = H[..., :2]
        trace = (left @ left.mT).flatten(-2)[..., None, :] @ self.traces + self.ratio * w * w
        scale = _relative(weights, trace[..., 0, :])
        M = self.rows.mT @ (torch.cat([scale, scale], -1)[..., None] * self.rows)
        return self.inverses[1] @ _least(M)[1][..., 0].unflatten(-1, (3, 3)) @ self.T1


class EpipolarFit(TwoViewFit):
    """Fits to the gradient of the Sampson error, to which the change of the variances contributes (Chojnacki's FNS)."""

    def __init__(self, model: str, x: Tensor, y: Tensor, exists: Tensor | None) -> None:
        super().__init__(model, x, y, exists)
        x, y = self._points()
        self.rows = epipolar_rows(x, y)[:, None]
        self.points = tuple(torch.nn.functional.pad(p, (0, 1), value=1.0).mT[:, None] for p in (x, y))

    def _points(self) -> tuple[Tensor, Tensor]:
        """The points in the coordinates of the fit; and their scales."""
        x, y, self.T1, self.T2 = self._normalized()
        self.scale1, self.scale2 = (T[..., :1, :1].square() for T in (self.T1, self.T2))
        return x, y

    def _forms(self, F: Tensor, weights: Tensor) -> tuple[Tensor, Tensor]:
        """M and L, (B, K, 9, 9) each: the gradient of the error is 2 (M - L) f."""
        x, y = self.points
        variances = self.scale2 * (F[..., :2, :] @ x).square().sum(-2, keepdim=True)
        variances = variances + self.scale1 * (F[..., :2].mT @ y).square().sum(-2, keepdim=True)
        scale = _relative(weights, variances[..., 0, :])[..., None, :]
        M = (self.rows.mT * scale) @ self.rows
        residuals = F.flatten(-2)[..., None, :] @ self.rows.mT
        change = scale * residuals.square() / variances.clamp(min=torch.finfo(F.dtype).tiny)
        of_x, of_y = (s * ((change * p) @ p.mT) for s, p in ((self.scale2, x), (self.scale1, y)))
        D = torch.diag(F.new_tensor([1.0, 1.0, 0.0]))
        L = D[:, None, :, None] * of_x[..., None, :, None, :] + of_y[..., :, None, :, None] * D[:, None, :]
        return M, L.flatten(-4, -3).flatten(-2, -1)


class FundamentalFit(EpipolarFit):
    def __call__(self, models: Tensor, weights: Tensor) -> Tensor:
        F = self.inverses[1].mT @ models @ self.inverses[0]
        M, L = self._forms(F / torch.linalg.vector_norm(F, dim=(-2, -1), keepdim=True), weights)
        values, vectors = _least(M - L)
        f, gap = vectors[..., 0], values[..., 1:] - values[..., :1]
        inverse = (vectors[..., 1:] / gap.clamp(min=1e-15)[..., None, :]) @ vectors[..., 1:].mT
        for _ in range(_STEPS):  # to the nearest matrix of rank 2 in the metric of M
            cofactors = adjugate(f.unflatten(-1, (3, 3))).mT
            determinant = (f[..., :3] * cofactors[..., 0, :]).sum(-1, keepdim=True)
            n = cofactors.flatten(-2)
            step = (inverse @ n[..., None])[..., 0]
            f = f - step * (determinant / (n * step).sum(-1, keepdim=True).clamp(min=torch.finfo(n.dtype).tiny))
        return self.T2.mT @ f.unflatten(-1, (3, 3)) @ self.T1

    def _points(self) -> tuple[Tensor, Tensor]:
        points = super()._points()
        self.inverses = torch.linalg.inv_ex(self.T1).inverse, torch.linalg.inv_ex(self.T2).inverse
        return points


class EssentialFit(EpipolarFit):
    def _points(self) -> tuple[Tensor, Tensor]:
        self.scale1 = self.scale2 = torch.ones((), dtype=self.x.dtype, device=self.x.device)
        return self._finite()

    def __call__(self, models: Tensor, weights: Tensor) -> Tensor:
        E = models / torch.linalg.vector_norm(models, dim=(-2, -1), keepdim=True)
        M, L = self._forms(E, weights)
        axes = torch.tensor(_GENERATORS, dtype=E.dtype, device=E.device)
        eye = torch.eye(6, dtype=E.dtype, device=E.device)
        for _ in range(_STEPS):  # tangents [a]x E + E [b]x, one of six of which is redundant
            e = E[..., None, :, :]
            tangents = torch.cat([axes @ e, e @ axes], -3).flatten(-2)  # (B, K, 6, 9)
            H, slope = tangents @ M @ tangents.mT, tangents @ ((M - L) @ E.flatten(-2)[..., None])
            damping = 1e-9 * H.diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None]
            step = -torch.linalg.solve_ex(H + damping * eye, slope).result
            E = _rotations(step[..., :3, :]) @ E @ _rotations(step[..., 3:, :])
        return E


def _rotations(a: Tensor) -> Tensor:
    """Cayley's rotations (*, 3, 3) of small vectors a (*, 3, 1): 1 + (A + A A / 2) 4 / (4 + a a), A = [a]x."""
    A = (a[..., None] * torch.tensor(_GENERATORS, dtype=a.dtype, device=a.device)).sum(-3)
    eye = torch.eye(3, dtype=a.dtype, device=a.device)
    return eye + 4 / (4 + a.square().sum(-2, keepdim=True)) * (A + A @ A / 2)


def _relative(weights: Tensor, variances: Tensor) -> Tensor:
    """Weights (B, K, N) over variances, of sum 1."""
    tiny = torch.finfo(weights.dtype).tiny
    scale = weights / variances.clamp(min=tiny)
    return scale / scale.sum(-1, keepdim=True).clamp(min=tiny)


def _least(M: Tensor) -> tuple[Tensor, Tensor]:
    """Eigenvalues (B, K, 9) and vectors of symmetric matrices (B, K, 9, 9); NaN where these are not finite."""
    is_finite = M.sum((-2, -1), keepdim=True).isfinite()
    values, vectors = eigenvectors(torch.where(is_finite, M, 0).flatten(0, 1))
    return values.unflatten(0, M.shape[:2]), torch.where(is_finite, vectors.unflatten(0, M.shape[:2]), torch.nan)


LINEAR_FITS: dict[str, Callable[..., Tensor]] = {"affine": affine_of, "homography": homography_of, "lines": of_lines}
FITS: dict[str, Callable[..., TwoViewFit]] = {
    "affine": LinearFit,
    "homography": HomographyFit,
    "lines": LinearFit,
    "fundamental": FundamentalFit,
    "fundamental8": FundamentalFit,
    "essential": EssentialFit,
}
ADAPTS = ("fundamental", "fundamental8")  # whose fits can estimate the noise, too


def _reference(
    models: Tensor,
    points1: Tensor,
    points2: Tensor,
    weights: Tensor | None,
    reaches: Tensor,
    rounds: int,
    number: int,
    adapts: bool,
) -> tuple[Tensor, Tensor]:
    model = MODEL_NAMES[number]
    x, y = points1.mT, points2.mT
    if model == "lines":
        x, y = x.unflatten(-1, (2, 2)), y.unflatten(-1, (2, 2))
    fit = FITS[model](model, x, y, None if weights is None else weights > 0)
    is_known = models.isfinite().flatten(2).all(-1)[..., None, None]
    models = torch.where(is_known, models, torch.nan)
    if adapts:
        assert isinstance(fit, FundamentalFit)
        best, scores = _adapted_fits(models.double(), fit, reaches[:, None, None], rounds, weights)
        return best.to(models.dtype), scores.to(models.dtype)
    best, scores, _ = rising_fits(models.double(), fit.errors, fit, reaches[:, None, None], rounds, weights)
    return best.to(models.dtype), scores.to(models.dtype)


def _adapted_fits(
    models: Tensor, fit: EpipolarFit, reach: Tensor, rounds: int, weights: Tensor | None
) -> tuple[Tensor, Tensor]:
    """Models (B, K, 3, 3) near others, and how many of their correspondences are right, (B, K), by expectation maximization.

    Residuals of right correspondences are normal numbers, those of wrong ones equally frequent everywhere within the size of
    the images. Each round weighs correspondences by their probability to be right, and estimates from these weights how many
    are right, the variance of the noise and, but for the first rounds, the model.
    """
    exists = (fit.x + fit.y).isfinite().all(-1)[:, None]  # (B, 1, N)
    count = exists.sum(-1, keepdim=True).double()
    w = exists.double() if weights is None else torch.where(exists, weights[:, None], 0.0)
    mean_weight = w.sum(-1, keepdim=True) / count.clamp(min=1)
    extent = 2**0.5 * (1 / fit.T1[..., 0, :1] + 1 / fit.T2[..., 0, :1])[:, None, 0]
    limit = reach.square()
    variance, right, best = limit / (2 * END), count / 2, models
    score = models.new_zeros(*models.shape[:2], 1)
    for i in range(rounds + 1):
        e = fit.errors(models)
        odds = right / ((count - right + 1) / extent * (2 * torch.pi * variance).sqrt())
        ratio = odds * (-e / (2 * variance)).exp()
        s = torch.where(e < 4 * limit, w * (ratio / (1 + ratio)), 0)
        right, squares = ((x / mean_weight).sum(-1, keepdim=True) for x in (s, s * e.nan_to_num(0.0, 0.0)))
        is_better = right > FREEDOM
        best = torch.where(is_better[..., None], models, best)
        score = torch.where(is_better, right, score)
        if i == rounds:
            break
        variance = (squares / (right - FREEDOM).clamp(min=1)).clamp(1e-6 * limit, limit / 4)
        following = fit(models, s) if i >= NOISE_ROUNDS else models
        models = torch.where(is_better[..., None], following, torch.nan)
    return best, score[..., 0]


def _supports(*args: Any) -> str | None:
    """Line segments have no kernel, nor have numbers of single precision."""
    if args[-2] == MODEL["lines"]:
        return "no kernel fits homographies to line segments"
    return None if args[0].dtype == torch.float64 else "the kernel takes float64"


# Takes models (B, K, 3, 3), points (B, 2, N) or the ends of segments (B, 4, N), weights (B, N) or None, and the largest errors
# (B) that count, in double. Returns the fits (B, K, 3, 3) with the highest scores (B, K) among up to `rounds` from each model; NaN
# and 0 for models that are not finite. Fits of fundamental matrices can adapt to the noise, which the reaches bound; their scores
# are the numbers of right correspondences.
_two_view_fits = register(
    "two_view_fits",
    _reference,
    fake=lambda models, *args: [models.new_empty(models.shape), models.new_empty(models.shape[:2])],
    non_differentiable=(0, 1),
    supports=_supports,
)


def two_view_fits(
    models: Tensor,
    points1: Tensor,
    points2: Tensor,
    weights: Tensor | None,
    reaches: Tensor,
    rounds: int,
    model: str,
    adapts: bool = False,
) -> tuple[Tensor, Tensor]:
    result: tuple[Tensor, Tensor] = _two_view_fits(
        models, points1, points2, weights, reaches, rounds, MODEL[model], adapts
    )
    return result
