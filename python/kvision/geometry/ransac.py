"""Models of two views from correspondences of which many are wrong.

A round draws samples, makes the models they leave and counts who agrees with each: two operators, whatever the number of
hypotheses. On a GPU one round has them all and nothing is read back. On the CPU, where reading costs nothing, rounds are
smaller and end as soon as the best model is as sure as was asked for.
"""

from __future__ import annotations

import math
import sys
from typing import Any

import torch
from torch import Tensor, nn

from kvision import _check
from kvision._ops import register
from kvision.core.exceptions import ShapeError, ValueCheckError
from kvision.geometry._normalization import to_unit_last
from kvision.geometry._precision import in_full_precision
from kvision.geometry.epipolar.distances import sampson_epipolar_distance
from kvision.geometry.epipolar.essential import nearest_essential
from kvision.geometry.homography.dlt import find_homography_lines_dlt, homography_of
from kvision.geometry.homography.errors import line_segment_transfer_error_one_way, oneway_transfer_error
from kvision.geometry.solvers._minimal import SIZES, eight_points, minimal
from kvision.geometry.solvers.affine import affine_of

__all__ = ["RANSAC"]

# Names of models here and there.
_MODELS = {
    "affine": "affine",
    "homography": "homography",
    "homography_from_linesegments": "lines",
    "fundamental": "fundamental",
    "fundamental_7pt": "fundamental",
    "fundamental_8pt": "fundamental8",
    "essential": "essential",
}
_REFINED = 8  # hypotheses that are fitted to those who agree with them
_BATCH = 2048  # hypotheses that a unit of `max_iter` stands for


def _errors(models: Tensor, points1: Tensor, points2: Tensor, model: str) -> Tensor:
    """Squared, (M, N), of models (M, 3, 3) and points (N, 2) or segments (N, 2, 2)."""
    if model == "lines":
        error = line_segment_transfer_error_one_way(points1[None], points2[None], models, squared=True)
        some = (points2[:, 0] != points2[:, 1]).any(-1)
        return torch.where(some, error, torch.inf)
    if model in ("affine", "homography"):
        return oneway_transfer_error(points1[None], points2[None], models)
    return sampson_epipolar_distance(points1[None], points2[None], models)


def _consensus_reference(models: Tensor, points1: Tensor, points2: Tensor, threshold: float, model: str) -> Tensor:
    """(M, 2) for models (M, 3, 3) and points (2 or 4, N): the sum over those who agree of 1 - e / t^2, and their number."""
    errors = _errors(models, *_points(points1, points2, model), model)
    inliers = errors <= threshold**2
    gains = torch.where(inliers, 1 - errors / threshold**2, 0)
    return torch.stack([gains.sum(-1), inliers.sum(-1).to(gains.dtype)], -1)


def _contest_reference(
    models: Tensor,
    scores: Tensor,
    others: Tensor,
    other_scores: Tensor,
    points1: Tensor,
    points2: Tensor,
    threshold: float,
    softness: float,
    count: int,
    by_number: bool,
    model: str,
) -> tuple[Tensor, Tensor, Tensor]:
    """The best `count` of two lists of models by their consensus, of equal ones the first: models, their consensus, and
    the weights (count, N) of correspondences: 1 / (1 + softness e) of those who agree, 0 of others."""
    models, scores = torch.cat([models, others]), torch.cat([scores, other_scores])
    order = scores[:, int(by_number)].argsort(descending=True, stable=True)[:count]
    models, scores = models[order], scores[order]
    errors = _errors(models, *_points(points1, points2, model), model)
    return models, scores, torch.where(errors <= threshold**2, 1 / (1 + softness * errors), 0)


def _leaders_reference(models: Tensor, scores: Tensor, count: int, by_number: bool) -> tuple[Tensor, Tensor]:
    """The best `count` of models by their consensus, of equal ones the first, and that consensus."""
    order = scores[:, int(by_number)].argsort(descending=True, stable=True)[:count]
    return models[order], scores[order]


def _verdict_reference(models: Tensor, weights: Tensor, least: int, model: str) -> tuple[Tensor, Tensor]:
    """The first model, and who has a weight above 0 for it; nothing where these are no more than `least`."""
    inliers = weights[0] > 0
    found = inliers.sum() > least
    first = models[:1]
    first = first / torch.linalg.vector_norm(first) if model == "essential" else to_unit_last(first)
    return torch.where(found, first[0], 0), inliers & found


def _points(points1: Tensor, points2: Tensor, model: str) -> tuple[Tensor, Tensor]:
    shape = (-1, 2, 2) if model == "lines" else (-1, 2)
    return points1.T.reshape(shape), points2.T.reshape(shape)


def _contest_sizes(
    models: Tensor, scores: Tensor, others: Tensor, other_scores: Tensor, points1: Tensor, *how: Any
) -> list[tuple[int, ...]]:
    kept = min(how[3], models.shape[0] + others.shape[0])
    return [(kept, 3, 3), (kept, 2), (kept, points1.shape[1])]


_consensus = register(
    "consensus", _consensus_reference, fake=lambda models, *args: (models.shape[0], 2), non_differentiable=(0,)
)
_leaders = register(
    "leaders",
    _leaders_reference,
    fake=lambda models, scores, count, *how: [(min(count, len(models)), *size) for size in ((3, 3), (2,))],
    non_differentiable=(0, 1),
)
_verdict = register(
    "verdict",
    _verdict_reference,
    fake=lambda models, weights, *how: [(3, 3), weights.new_empty(weights.shape[1], dtype=torch.bool)],
    non_differentiable=(0, 1),
    casts_outputs=True,
)
_contest = register("contest", _contest_reference, fake=_contest_sizes, non_differentiable=(0, 1, 2))


class RANSAC(nn.Module):
    """Finds the model that most correspondences agree with, and those who do.

    Args:
        model_type: "homography", "affine", "homography_from_linesegments", "fundamental" (from seven points, as
            "fundamental_7pt"), "fundamental_8pt" or "essential".
        inl_th: how far, in the units of the points, a correspondence may be from the model: where the point goes from where
            it should, the ends of a segment from the other's line on average, Sampson's distance for the others.
        batch_size: hypotheses a round, or "auto".
        max_iter: rounds of `batch_size` hypotheses, 2048 for "auto".
        confidence: how sure to be that no better model is missed before rounds end early; 1 for never. On a GPU, which
            would have to wait for that, all hypotheses are tried.
        max_lo_iters: how often the eight best hypotheses are fitted, by least squares, to those who agree with them.
        score_type: "msac", the sum over those who agree of 1 - e^2 / inl_th^2, or "ransac", their number.
        prosac_sampling: points are in order, the most trusted first; samples are drawn from the first few of them at first.
        seed: of the random numbers, the same at every call; default: torch's generator.
        lo_sample_size: of no effect: models are fitted to all who agree.
        max_samples: hypotheses in all, instead of `batch_size * max_iter`.
        local_optimization: "lm" or "dlt", of no effect: there is one way.
        refine_iters: how often the best model is fitted to those who agree, with less weight for who agrees less.
        degensac: False or None; a search beside dominant planes is not there.
        compile: of no effect: there is nothing to compile.

    Raises:
        TypeCheckError: arguments of another kind.
        ValueCheckError: other names, numbers out of range.

    Source: P. Torr and A. Zisserman, "MLESAC" (2000); O. Chum et al., "Locally optimized RANSAC" (2003); O. Chum and
    J. Matas, "Matching with PROSAC" (2005).

    Example:
        >>> import torch, kvision as K
        >>> points = 100 * torch.rand(50, 2)
        >>> moved = 2 * points + 5
        >>> moved[:15] = 100 * torch.rand(15, 2)  # wrong
        >>> H, inliers = K.geometry.RANSAC("homography", inl_th=1.0, seed=0)(points, moved)
        >>> inliers[15:].all()
        tensor(True)
    """

    def __init__(
        self,
        model_type: str = "homography",
        inl_th: float = 2.0,
        batch_size: int | str = "auto",
        max_iter: int = 10,
        confidence: float = 0.99,
        max_lo_iters: int = 5,
        score_type: str = "msac",
        prosac_sampling: bool = False,
        seed: int | None = None,
        lo_sample_size: int | None = 32,
        max_samples: int | None = None,
        local_optimization: str | None = None,
        refine_iters: int = 3,
        degensac: bool | None = False,
        compile: bool = False,
    ) -> None:
        super().__init__()
        _check.choice("RANSAC", "model_type", model_type, tuple(_MODELS), _check.UnknownChoiceError)
        _check.choice("RANSAC", "score_type", score_type, ("msac", "ransac"))
        if local_optimization is not None:
            _check.choice("RANSAC", "local_optimization", local_optimization, ("lm", "dlt"))
        if not _check.number("RANSAC", "inl_th", inl_th) ** 2 > 0:
            raise ValueCheckError(f"RANSAC: expected inl_th above 0, got {inl_th!r}", actual_value=inl_th)
        if batch_size != "auto":
            _check.ints("RANSAC", "batch_size", batch_size, 1)
        if not 0 < _check.number("RANSAC", "confidence", confidence) <= 1:
            raise ValueCheckError(f"RANSAC: expected confidence above 0 and up to 1, got {confidence!r}")
        if degensac:
            raise ValueCheckError("RANSAC: degensac must be one of False, None; got True", actual_value=degensac)
        _check.ints("RANSAC", "max_iter", max_iter, 1)
        _check.ints("RANSAC", "max_lo_iters", max_lo_iters, 1, minimum=0)
        _check.ints("RANSAC", "refine_iters", refine_iters, 1, minimum=0)
        if max_samples is not None:
            _check.ints("RANSAC", "max_samples", max_samples, 1)
        _check.flag("RANSAC", "prosac_sampling", prosac_sampling)
        self.model_type = model_type
        self.inl_th = float(inl_th)
        self.batch_size = batch_size
        self.max_iter = max_iter
        self.confidence = confidence
        self.max_lo_iters = max_lo_iters
        self.score_type = score_type
        self.prosac_sampling = prosac_sampling
        self.seed = seed
        self.lo_sample_size = lo_sample_size
        self.max_samples = max_samples
        self.local_optimization = local_optimization
        self.refine_iters = refine_iters
        self.degensac = degensac
        self.model = _MODELS[model_type]
        self.minimal_sample_size = SIZES[self.model][0]

    def extra_repr(self) -> str:
        return f"{self.model_type!r}, inl_th={self.inl_th:g}, max_iter={self.max_iter}, confidence={self.confidence:g}"

    @property
    def sample_budget(self) -> int:
        """How many samples a call draws at most."""
        if self.max_samples is not None:
            return self.max_samples
        return self.max_iter * (_BATCH if self.batch_size == "auto" else int(self.batch_size))

    def resolve_batch_size(self, num_tc: int, device: torch.device) -> int:
        """How many samples a round draws, for `num_tc` correspondences on a device."""
        if self.batch_size != "auto":
            return int(self.batch_size)
        if device.type != "cpu":
            return self.sample_budget
        # About as much work each: models of fewer points are made and tried faster, and more of them find a better one.
        first = {"essential": 64, "fundamental": 256, "fundamental8": 256, "lines": 512}
        return min(self.sample_budget, first.get(self.model, 1024))

    @staticmethod
    def max_samples_by_conf(n_inl: int, num_tc: int, sample_size: int, conf: float) -> int:
        """How many samples to draw to have, with a probability of `conf`, one of `n_inl` of `num_tc` correspondences."""
        if n_inl < sample_size or num_tc < sample_size or conf >= 1:
            return sys.maxsize
        good = math.prod((n_inl - i) / (num_tc - i) for i in range(sample_size))
        if good >= 1 or conf <= 0:
            return 1
        return math.ceil(math.log1p(-conf) / math.log1p(-good))

    def validate_inputs(self, kp1: Tensor, kp2: Tensor, weights: Tensor | None = None) -> None:
        """Raise unless `forward` takes these arguments."""
        axes = (2, 2) if self.model == "lines" else (2,)
        for name, x in (("kp1", kp1), ("kp2", kp2)):
            _check.shape("RANSAC", name, x, "N", *axes)
            _check.floating("RANSAC", name, x)
        _check.same_shape("RANSAC", kp1=kp1, kp2=kp2)
        _check.same_device("RANSAC", kp1=kp1, kp2=kp2)
        if len(kp1) < self.minimal_sample_size:
            raise ShapeError(
                f"RANSAC: expected kp1 of at least {self.minimal_sample_size} correspondences, got {tuple(kp1.shape)}",
                actual_shape=kp1.shape,
            )

    def forward(self, kp1: Tensor, kp2: Tensor, weights: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Find the model of correspondences.

        Args:
            kp1: points of the first image, (N, 2) as (x, y), floating point; line segments (N, 2, 2) for
                "homography_from_linesegments"; in the camera's coordinates for "essential".
            kp2: what they correspond to in the second image, in the same shape.
            weights: of no effect.

        Returns:
            The model (3, 3), and bool (N,): who agrees with it. Zeros and nobody where no model has more of them than a
            sample has points. There is no gradient.

        Raises:
            TypeCheckError: no floating-point tensors.
            ShapeError: other shapes, too few points.
            DeviceError: tensors on different devices.
        """
        self.validate_inputs(kp1, kp2, weights)
        with torch.no_grad():
            return self._estimate(kp1.detach(), kp2.detach())

    @in_full_precision
    def _estimate(self, kp1: Tensor, kp2: Tensor) -> tuple[Tensor, Tensor]:
        points = kp1.flatten(1)[None], kp2.flatten(1)[None]
        across = points[0][0].T.contiguous(), points[1][0].T.contiguous()
        generator = None if self.seed is None else torch.Generator(kp1.device).manual_seed(self.seed)
        batch = self.resolve_batch_size(len(kp1), kp1.device)
        by_number = self.score_type == "ransac"
        best, scores = kp1.new_empty(0, 3, 3), kp1.new_empty(0, 2)

        def scored(models: Tensor) -> tuple[Tensor, Tensor]:
            models = models.to(kp1.dtype)
            return models, _consensus(models, *across, self.inl_th, self.model)

        def contest(models: tuple[Tensor, Tensor], others: tuple[Tensor, Tensor], softness: float, count: int) -> Any:
            return _contest(*models, *others, *across, self.inl_th, softness, count, by_number, self.model)

        drawn, enough = 0, self.sample_budget
        while drawn < enough:
            count = min(batch, self.sample_budget - drawn)
            draws = self._draws(count, len(kp1), drawn, kp1, generator)
            found, consensus = scored(minimal(*points, draws, self.model).flatten(0, 1))
            first = _leaders(found, consensus, _REFINED, by_number)
            best, scores, weights = contest(first, (best, scores), 0.0, _REFINED)
            drawn += count
            batch = min(2 * batch, 4096) if self.batch_size == "auto" else batch
            if kp1.device.type == "cpu":
                sure = self.max_samples_by_conf(int(scores[0, 1]), len(kp1), self.minimal_sample_size, self.confidence)
                enough = min(self.sample_budget, sure)
        for _ in range(self.max_lo_iters):
            best, scores, weights = contest(scored(self._fitted(kp1, kp2, weights)), (best, scores), 0.0, _REFINED)
        softness = (3 / self.inl_th) ** 2
        best, scores, weights = contest((best, scores), (best[:0], scores[:0]), softness, 1)
        for _ in range(self.refine_iters):
            best, scores, weights = contest(scored(self._fitted(kp1, kp2, weights)), (best, scores), softness, 1)
        model, inliers = _verdict(best, weights, self.minimal_sample_size, self.model)
        return model, inliers

    def _draws(
        self, count: int, population: int, before: int, like: Tensor, generator: torch.Generator | None
    ) -> Tensor:
        """(count, m + 1): random numbers, and from how many of the first points they choose."""
        size = self.minimal_sample_size
        shape = (count, size + 1)
        draws = torch.rand(shape, device=like.device, dtype=torch.float32, generator=generator)
        draws[:, size] = population
        if self.prosac_sampling:
            ends = torch.tensor(_growth(size, population, self.sample_budget), device=like.device)
            place = torch.arange(before + 1, before + count + 1, device=like.device)
            first = (torch.searchsorted(ends, place) + size).clamp(max=population)
            draws[:, size] = first
            newest = place <= ends[-1]
            draws[:, size - 1] = torch.where(newest, 1 - 2.0**-24, draws[:, size - 1])  # the last one of them
        return draws

    def _fitted(self, kp1: Tensor, kp2: Tensor, weights: Tensor) -> Tensor:
        """Models (M, 3, 3) of least squares for weights (M, N)."""
        if self.model == "lines":
            x, y = (kp.expand(len(weights), *kp.shape) for kp in (kp1, kp2))
            return find_homography_lines_dlt(x, y, weights)
        fit = {"homography": homography_of, "affine": affine_of}.get(self.model, eight_points)
        fitted: Tensor = fit(kp1[None], kp2[None], weights)
        return nearest_essential(fitted) if self.model == "essential" else fitted

    # --- the steps by themselves, for those who put them together in another way ---

    def sample(
        self,
        sample_size: int,
        pop_size: int,
        batch_size: int,
        iteration: int,
        device: torch.device | str | None = None,
        offset: int | None = None,
    ) -> Tensor:
        """Draw different numbers below `pop_size`: (batch_size, sample_size), every choice as likely as any other."""
        if not 0 < sample_size <= pop_size:
            raise ValueCheckError(f"RANSAC: expected sample_size of 1 to {pop_size}, got {sample_size}")
        device = torch.device("cpu" if device is None else device)
        generator = None if self.seed is None else torch.Generator(device).manual_seed(self.seed + iteration)
        return torch.rand(batch_size, pop_size, device=device, generator=generator).topk(sample_size, 1).indices

    def estimate_model_from_minsample(self, kp1: Tensor, kp2: Tensor) -> Tensor:
        """Models (S, candidates, 3, 3) of samples (S, m, 2), or (S, m, 2, 2) for segments; NaN for what is missing."""
        return minimal(kp1.flatten(2), kp2.flatten(2), None, self.model)

    def remove_bad_samples(self, kp1: Tensor, kp2: Tensor) -> tuple[Tensor, Tensor]:
        """Samples (S, m, 2) without those that leave no model. Their number is read from the device."""
        models = self.estimate_model_from_minsample(kp1, kp2)
        good = models.isfinite().flatten(2).all(-1).any(-1)
        return kp1[good], kp2[good]

    def remove_bad_models(self, models: Tensor) -> Tensor:
        """Models (M, 3, 3) without those that are not finite. Their number is read from the device."""
        return models[models.isfinite().flatten(1).all(-1)]

    def verify(self, kp1: Tensor, kp2: Tensor, models: Tensor, inl_th: float) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """The best of models (M, 3, 3) for a squared threshold, who agrees with it, its score and their number."""
        errors = _errors(models, kp1, kp2, self.model)
        agree = errors <= inl_th
        counts = agree.sum(-1)
        gains = torch.where(agree, 1 - errors / inl_th, 0).sum(-1)
        scores = gains if self.score_type == "msac" else counts.to(gains.dtype)
        best = scores.argmax()
        return models[best], agree[best], scores[best], counts[best]

    def polish_model(self, kp1: Tensor, kp2: Tensor, inliers: Tensor) -> Tensor:
        """The model (1, 3, 3) of least squares of those who agree."""
        return self._fitted(kp1, kp2, inliers[None].to(kp1.dtype))


def _growth(size: int, population: int, budget: int) -> list[int]:
    """After how many samples PROSAC goes on to the next point, for `size` points and more."""
    expected: float = budget * math.prod((size - i) / (population - i) for i in range(size))
    ends = [1]
    for n in range(size + 1, population + 1):
        following = expected * n / (n - size)
        ends.append(ends[-1] + max(1, math.ceil(following - expected)))
        expected = following
    return ends
