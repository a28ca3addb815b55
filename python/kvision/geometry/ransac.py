"""RANSAC: models of two views from correspondences with many outliers.

A round draws minimal samples, solves for their models and scores each model by its inliers. That takes two operators,
whatever the number of hypotheses. On a GPU one round has all hypotheses and the host reads nothing back. On the CPU,
where reading is free, rounds are smaller and end as soon as the best model reaches the requested confidence.
The best hypotheses are fitted to all correspondences by sigma-consensus++, those of all pairs of a batch at once.
"""

from __future__ import annotations

import math
import sys
from typing import Any, Literal, TypeAlias, get_args

import torch
from torch import Tensor, nn

from kvision import _check
from kvision._modes import MODEL, MODEL_NAMES
from kvision._ops import register
from kvision.core.exceptions import ShapeError, ValueCheckError
from kvision.geometry._normalization import to_unit_last
from kvision.geometry._precision import in_full_precision
from kvision.geometry._sigma_consensus import best_fits, consensus
from kvision.geometry._two_view_fits import FITS, LINEAR_FITS, FundamentalFit, TwoViewFit
from kvision.geometry.epipolar.distances import sampson_epipolar_distance
from kvision.geometry.epipolar.essential import nearest_essential
from kvision.geometry.homography.errors import line_segment_transfer_error_one_way, oneway_transfer_error
from kvision.geometry.solvers._minimal import SIZES, eight_points, minimal_solver

__all__ = ["RANSAC"]

ModelType: TypeAlias = Literal[
    "affine",
    "homography",
    "homography_from_linesegments",
    "fundamental",
    "fundamental_7pt",
    "fundamental_8pt",
    "essential",
]
ScoreType: TypeAlias = Literal["msac", "ransac"]
_SCORES = get_args(ScoreType)
LocalOptimization: TypeAlias = Literal["lm", "dlt"]
_OPTIMIZATIONS = get_args(LocalOptimization)
# Model names of the API -> those of the kernels.
_MODELS: dict[ModelType, str] = {
    "affine": "affine",
    "homography": "homography",
    "homography_from_linesegments": "lines",
    "fundamental": "fundamental",
    "fundamental_7pt": "fundamental",
    "fundamental_8pt": "fundamental8",
    "essential": "essential",
}
# Hypotheses that are fitted to their inliers; 24 of models of many points, of which few samples are right.
_REFINED = {"affine": 1, "homography": 1, "lines": 1}
# The largest error that a fit uses, in thresholds. Distances from lines let more wrong correspondences in than those of points.
_REACH = {"fundamental": 2.0, "fundamental8": 2.0, "essential": 2.0}
_BATCH = 2048  # hypotheses of one `max_iter` round for batch_size "auto"


def _errors(models: Tensor, points1: Tensor, points2: Tensor, model: str) -> Tensor:
    """Squared errors (M, N) of points (N, 2) or segments (N, 2, 2) for models (M, 3, 3)."""
    if model == "lines":
        error = line_segment_transfer_error_one_way(points1[None], points2[None], models, squared=True)
        has_length = (points2[:, 0] != points2[:, 1]).any(-1)
        return torch.where(has_length, error, torch.inf)
    if model in ("affine", "homography"):
        return oneway_transfer_error(points1[None], points2[None], models)
    return sampson_epipolar_distance(points1[None], points2[None], models)


def _consensus_reference(models: Tensor, points1: Tensor, points2: Tensor, threshold: float, model: int) -> Tensor:
    """Scores (M, 2) of models (M, 3, 3) for points (2 or 4, N): sums of 1 - e / t^2 over inliers, inlier counts."""
    errors = _errors(models, *_points(points1, points2, model), MODEL_NAMES[model])
    inliers = errors <= threshold**2
    gains = torch.where(inliers, 1 - errors / threshold**2, 0)
    return torch.stack([gains.sum(-1), inliers.sum(-1).to(gains.dtype)], -1)


def _merge_top_k_reference(
    models: Tensor,
    scores: Tensor,
    other_models: Tensor,
    other_scores: Tensor,
    points1: Tensor,
    points2: Tensor,
    threshold: float,
    softness: float,
    count: int,
    by_count: bool,
    model: int,
) -> tuple[Tensor, Tensor, Tensor]:
    """Merge two lists of models into the `count` best by score; the first of equal ones wins. Returns models, their
    scores and weights (count, N) of correspondences: 1 / (1 + softness e) for inliers, 0 for outliers."""
    models, scores = torch.cat([models, other_models]), torch.cat([scores, other_scores])
    order = scores[:, int(by_count)].argsort(descending=True, stable=True)[:count]
    models, scores = models[order], scores[order]
    errors = _errors(models, *_points(points1, points2, model), MODEL_NAMES[model])
    return models, scores, torch.where(errors <= threshold**2, 1 / (1 + softness * errors), 0)


def _top_k_models_reference(models: Tensor, scores: Tensor, count: int, by_count: bool) -> tuple[Tensor, Tensor]:
    """The `count` models with the best scores, and these scores. The first of equal ones wins."""
    order = scores[:, int(by_count)].argsort(descending=True, stable=True)[:count]
    return models[order], scores[order]


def _points(points1: Tensor, points2: Tensor, model: int) -> tuple[Tensor, Tensor]:
    shape = (-1, 2, 2) if model == MODEL["lines"] else (-1, 2)
    return points1.T.reshape(shape), points2.T.reshape(shape)


def _merge_top_k_sizes(
    models: Tensor, scores: Tensor, other_models: Tensor, other_scores: Tensor, points1: Tensor, *options: Any
) -> list[tuple[int, ...]]:
    top_k = min(options[3], models.shape[0] + other_models.shape[0])
    return [(top_k, 3, 3), (top_k, 2), (top_k, points1.shape[1])]


_consensus = register(
    "consensus", _consensus_reference, fake=lambda models, *args: (models.shape[0], 2), non_differentiable=(0,)
)
_top_k_models = register(
    "top_k_models",
    _top_k_models_reference,
    fake=lambda models, scores, count, *options: [(min(count, len(models)), *size) for size in ((3, 3), (2,))],
    non_differentiable=(0, 1),
)
_merge_top_k = register("merge_top_k", _merge_top_k_reference, fake=_merge_top_k_sizes, non_differentiable=(0, 1, 2))


class RANSAC(nn.Module):
    """Find the model with the most inliers among correspondences, and these inliers (RANSAC).

    Args:
        model_type: "homography", "affine", "homography_from_linesegments", "fundamental" (from seven points, as
            "fundamental_7pt"), "fundamental_8pt" or "essential".
        inl_th: how far, in the units of the points, a correspondence may be from the model: where the point goes from where
            it should, the ends of a segment from the other's line on average, Sampson's distance for the other_models.
        batch_size: hypotheses of one round, or "auto".
        max_iter: rounds of `batch_size` hypotheses, 2048 for "auto".
        confidence: probability, in (0, 1], that no better model is missed when rounds end early; 1 never ends early. On a GPU
            all hypotheses are tried, because ending early would synchronize with the host.
        max_lo_iters: the most fits of the best hypotheses by sigma-consensus++.
        score_type: what ranks hypotheses before they are fitted: "msac", the sum of 1 - e^2 / inl_th^2 over inliers, or "ransac",
            their number. Fits are ranked by the loss of MAGSAC++.
        prosac_sampling: points are sorted, the most reliable first; the first samples are drawn from the first points.
        seed: seed of every call; None draws from torch's default generator.
        lo_sample_size: no effect, since models are fitted to all correspondences.
        max_samples: total number of hypotheses, instead of `batch_size * max_iter`.
        local_optimization: "lm" or "dlt"; no effect, since there is one method.
        refine_iters: the most further fits of the best model, after as many as `max_lo_iters`.
        degensac: False or None; a search outside of dominant planes does not exist.
        compile: no effect.

    Raises:
        TypeCheckError: an argument is of the wrong type.
        ValueCheckError: an unknown name, or a number out of range.

    Source: P. Torr and A. Zisserman, "MLESAC" (2000); D. Barath et al., "MAGSAC++" (2020); W. Chojnacki et al., "On the fitting of
    surfaces to data with covariances" (2000); O. Chum and J. Matas, "Matching with PROSAC" (2005).

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
        model_type: ModelType = "homography",
        inl_th: float = 2.0,
        batch_size: int | Literal["auto"] = "auto",
        max_iter: int = 10,
        confidence: float = 0.99,
        max_lo_iters: int = 5,
        score_type: ScoreType = "msac",
        prosac_sampling: bool = False,
        seed: int | None = None,
        lo_sample_size: int | None = 32,
        max_samples: int | None = None,
        local_optimization: LocalOptimization | None = None,
        refine_iters: int = 3,
        degensac: bool | None = False,
        compile: bool = False,
    ) -> None:
        super().__init__()
        _check.choice("RANSAC", "model_type", model_type, tuple(_MODELS), _check.UnknownChoiceError)
        _check.choice("RANSAC", "score_type", score_type, _SCORES)
        if local_optimization is not None:
            _check.choice("RANSAC", "local_optimization", local_optimization, _OPTIMIZATIONS)
        if not _check.number("RANSAC", "inl_th", inl_th) ** 2 > 0:
            raise ValueCheckError(f"RANSAC: expected inl_th above 0, got {inl_th!r}", actual_value=inl_th)
        if batch_size != "auto":
            _check.ints("RANSAC", "batch_size", batch_size, 1)
        if not 0 < _check.number("RANSAC", "confidence", confidence) <= 1:
            raise ValueCheckError(f"RANSAC: expected confidence above 0 and up to 1, got {confidence!r}")
        if _check.switch("RANSAC", "degensac", degensac):
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
        self.seed = None if seed is None else _check.ints("RANSAC", "seed", seed, 1, -(2**63), 2**64 - 1)[0]
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
        """The largest number of samples that a call draws."""
        if self.max_samples is not None:
            return self.max_samples
        return self.max_iter * (_BATCH if self.batch_size == "auto" else int(self.batch_size))

    def resolve_batch_size(self, num_tc: int, device: torch.device) -> int:
        """The number of samples of the first round, for `num_tc` correspondences on a device."""
        if self.batch_size != "auto":
            return int(self.batch_size)
        if device.type != "cpu":
            return self.sample_budget
        # Rounds take similar time. Models with few points are faster to solve, so their rounds have more hypotheses.
        first = {"fundamental": 128, "fundamental8": 128}
        return min(self.sample_budget, first.get(self.model, 64))

    @staticmethod
    def max_samples_by_conf(n_inl: int, num_tc: int, sample_size: int, conf: float) -> int:
        """The number of samples among which one has only inliers, `n_inl` of `num_tc`, with probability `conf`."""
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
            _check.is_tensor("RANSAC", name, x)
            is_batch = x.dim() > 1 + len(axes)
            _check.shape("RANSAC", name, x, *(("B", "N") if is_batch else ("N",)), *axes)
            _check.floating("RANSAC", name, x)
        _check.same_shape("RANSAC", kp1=kp1, kp2=kp2)
        _check.same_device("RANSAC", kp1=kp1, kp2=kp2)
        if weights is not None:
            _check.shape("RANSAC", "weights", weights, *kp1.shape[: -len(axes)])
            _check.same_device("RANSAC", kp1=kp1, weights=weights)
        if kp1.shape[-1 - len(axes)] < self.minimal_sample_size:
            raise ShapeError(
                f"RANSAC: expected kp1 of at least {self.minimal_sample_size} correspondences, got {tuple(kp1.shape)}",
                actual_shape=kp1.shape,
            )

    def forward(self, kp1: Tensor, kp2: Tensor, weights: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Find the model of correspondences, or the models of a batch of pairs.

        Args:
            kp1: points of the first image, (N, 2) or (B, N, 2) as (x, y), floating point; line segments (N, 2, 2) or (B, N, 2, 2)
                for "homography_from_linesegments"; in the camera's coordinates for "essential".
            kp2: the corresponding points of the second image, in the same shape.
            weights: of the squared errors of correspondences, at least 0, (N,) or (B, N); None for 1. Correspondences of weight 0
                do not exist, so pairs of a batch may have different numbers of them.

        Returns:
            The model (3, 3) or (B, 3, 3) and its inliers, bool (N,) or (B, N). Zeros and no inliers where no model has more inliers
            than a sample has points, or as many if there are no more. Gradients to points and weights are those of the linear
            least squares of all correspondences near the model, with the weights that sigma-consensus++ gives them.

        Raises:
            TypeCheckError: an argument is not a floating-point tensor.
            ShapeError: shapes differ from the ones above, or there are too few points.
            DeviceError: the tensors are on different devices.
        """
        self.validate_inputs(kp1, kp2, weights)
        is_one = kp1.dim() == (3 if self.model == "lines" else 2)
        if is_one:
            kp1, kp2, weights = kp1[None], kp2[None], None if weights is None else weights[None]
        model, inliers = self._estimate(kp1, kp2, weights)
        return (model[0], inliers[0]) if is_one else (model, inliers)

    @in_full_precision
    def _estimate(self, kp1: Tensor, kp2: Tensor, weights: Tensor | None) -> tuple[Tensor, Tensor]:
        with torch.no_grad():
            x, y = kp1.detach(), kp2.detach()
            w = None if weights is None else weights.detach()
            generator = None if self.seed is None else torch.Generator(kp1.device).manual_seed(self.seed)
            each = [self._searched(x[b], y[b], None if w is None else w[b] > 0, generator) for b in range(len(x))]
            models = torch.stack(each) if each else x.new_empty(0, 1, 3, 3)
            model, errors = self._refined(models, x, y, w)
            exists = torch.ones_like(errors, dtype=torch.bool) if w is None else w > 0
            inliers = (errors <= self.inl_th**2) & exists
            # Inliers of a sample alone say nothing for its model, but where these are all correspondences.
            least = (exists.sum(1, keepdim=True) - 1).clamp(max=self.minimal_sample_size)
            has_consensus = (inliers.sum(1, keepdim=True) > least) & model.isfinite().flatten(1).all(1)[:, None]
            inliers = inliers & has_consensus
            model = torch.where(has_consensus[..., None], self._scaled(model), 0).to(kp1.dtype)
        if torch.is_grad_enabled() and any(t is not None and t.requires_grad for t in (kp1, kp2, weights)):
            model = self._with_gradient(model, errors, inliers, kp1, kp2, weights)
        return model, inliers

    def _scaled(self, models: Tensor) -> Tensor:
        if self.model == "essential":
            return models / torch.linalg.vector_norm(models, dim=(-2, -1), keepdim=True)
        return to_unit_last(models)

    def _searched(self, kp1: Tensor, kp2: Tensor, exists: Tensor | None, generator: torch.Generator | None) -> Tensor:
        """The best hypotheses (K, 3, 3) for one pair; NaN where there are fewer. On a GPU the host waits for nothing."""
        population: int | Tensor = len(kp1)
        is_readable = kp1.device.type == "cpu"
        if exists is not None and is_readable:
            kp1, kp2 = kp1[exists], kp2[exists]
            population = len(kp1)
        elif exists is not None:  # others come last, and no error below is that of a NaN
            order = exists.to(torch.uint8).argsort(descending=True, stable=True)
            shape = (-1, *(1,) * (kp1.dim() - 1))
            kp1, kp2 = (torch.where(exists.view(shape), p, torch.nan)[order] for p in (kp1, kp2))
            population = exists.sum()
        kept = _REFINED.get(self.model, 24)
        if len(kp1) < self.minimal_sample_size:
            return kp1.new_full((1, 3, 3), torch.nan)
        points = kp1.flatten(1)[None], kp2.flatten(1)[None]
        rows = points[0][0].T.contiguous(), points[1][0].T.contiguous()
        batch = self.resolve_batch_size(len(kp1), kp1.device)
        by_count, number = self.score_type == "ransac", MODEL[self.model]
        models, scores = kp1.new_empty(0, 3, 3), kp1.new_empty(0, 2)

        def merged(candidates: Tensor, limit: int) -> tuple[Tensor, Tensor]:
            others = candidates, _consensus(candidates, *rows, self.inl_th, number)
            top = _top_k_models(*others, limit, by_count)
            if not len(models):
                return top
            return _merge_top_k(*top, models, scores, *rows, self.inl_th, 0.0, limit, by_count, number)[:2]

        num_drawn, num_required, best = 0, self.sample_budget, 0.0
        fit: TwoViewFit | None = None
        while num_drawn < num_required:
            count = min(batch, self.sample_budget - num_drawn)
            draws = self._draws(count, len(kp1), population, num_drawn, kp1, generator)
            models, scores = merged(minimal_solver(*points, draws, self.model).flatten(0, 1), kept)
            num_drawn += count
            batch = min(2 * batch, 2048) if self.batch_size == "auto" else batch
            if not is_readable:
                continue
            num_required = self._required(scores, len(kp1))
            if num_drawn < num_required and float(scores[0, int(by_count)]) > best and self.max_lo_iters:
                fit = self._fit(kp1[None], kp2[None], None) if fit is None else fit
                improved, _ = best_fits(models[None, :1].double(), fit.errors, fit, self._reach, 2)
                models, scores = merged(improved.to(kp1.dtype), kept)
                num_required = self._required(scores, len(kp1))
                best = float(scores[0, int(by_count)])
        if is_readable and num_drawn < self.sample_budget:
            return models[:1]  # what was found early is found often: one hypothesis stands for all
        if is_readable:
            fit = self._fit(kp1[None], kp2[None], None) if fit is None else fit
            return best_fits(models[None].double(), fit.errors, fit, self._reach, self.max_lo_iters)[0].to(kp1.dtype)
        missing = kept - len(models)
        return models if missing <= 0 else torch.cat([models, models.new_full((missing, 3, 3), torch.nan)])

    def _required(self, scores: Tensor, count: int) -> int:
        """The number of samples after which the best model so far has the requested confidence."""
        num_confident = self.max_samples_by_conf(int(scores[0, 1]), count, self.minimal_sample_size, self.confidence)
        return min(self.sample_budget, num_confident)

    @property
    def _reach(self) -> float:
        """The largest error of a correspondence that a fit uses."""
        return self.inl_th * _REACH.get(self.model, 4.0)

    def _fit(self, kp1: Tensor, kp2: Tensor, exists: Tensor | None) -> TwoViewFit:
        return FITS.get(self.model, FundamentalFit)(kp1, kp2, exists)

    def _refined(self, models: Tensor, kp1: Tensor, kp2: Tensor, weights: Tensor | None) -> tuple[Tensor, Tensor]:
        """The best (B, 3, 3) of models (B, K, 3, 3) after fits near all of them and then near the best one, and its errors."""
        fit = self._fit(kp1, kp2, None if weights is None else weights > 0)
        models = models.double()
        if models.shape[1] > 1:
            models = best_fits(models, fit.errors, fit, self._reach, self.max_lo_iters, weights)[0][:, None]
        return best_fits(models, fit.errors, fit, self._reach, self.max_lo_iters + self.refine_iters, weights)

    def _with_gradient(
        self, model: Tensor, errors: Tensor, inliers: Tensor, kp1: Tensor, kp2: Tensor, weights: Tensor | None
    ) -> Tensor:
        """The model with the gradient of the weighted linear least squares of what it was fitted to."""
        has_model = inliers.any(1)
        w = consensus(torch.where(has_model[:, None], errors, 0), self._reach)[0].to(kp1.dtype)
        kp1, kp2 = kp1.nan_to_num(0.0, 0.0, 0.0), kp2.nan_to_num(0.0, 0.0, 0.0)  # of weight 0
        fitted = self._scaled(self._fitted(kp1, kp2, w if weights is None else w * weights))
        if self.model == "essential":
            fitted = fitted * (fitted * model).sum((1, 2), keepdim=True).sign().detach()
        valued = model + (fitted - fitted.detach())
        return torch.where(has_model[:, None, None], valued, model)

    def _draws(
        self,
        count: int,
        num_points: int,
        population: int | Tensor,
        num_drawn: int,
        like: Tensor,
        generator: torch.Generator | None,
    ) -> Tensor:
        """Draw samples (count, m + 1): m random numbers, then how many of the first points they choose from."""
        size = self.minimal_sample_size
        shape = (count, size + 1)
        draws = torch.rand(shape, device=like.device, dtype=torch.float32, generator=generator)
        draws[:, size] = population
        if self.prosac_sampling:
            ends = torch.tensor(_growth(size, num_points, self.sample_budget), device=like.device)
            number = torch.arange(num_drawn + 1, num_drawn + count + 1, device=like.device)
            first = (torch.searchsorted(ends, number) + size).clamp(max=population)
            draws[:, size] = first
            takes_newest = number <= ends[-1]
            draws[:, size - 1] = torch.where(takes_newest, 1 - 2.0**-24, draws[:, size - 1])  # chooses the newest point
        return draws

    def _fitted(self, kp1: Tensor, kp2: Tensor, weights: Tensor) -> Tensor:
        """Linear least squares (B, 3, 3) of points (B, N, ...) for weights (B, N)."""
        fitted: Tensor = LINEAR_FITS.get(self.model, eight_points)(kp1, kp2, weights)
        return nearest_essential(fitted) if self.model == "essential" else fitted

    # --- the steps of `forward`, for callers that combine them in another way ---

    def sample(
        self,
        sample_size: int,
        pop_size: int,
        batch_size: int,
        iteration: int,
        device: torch.device | str | None = None,
        offset: int | None = None,
    ) -> Tensor:
        """Draw samples (batch_size, sample_size) of different numbers below `pop_size`, uniformly."""
        if not 0 < sample_size <= pop_size:
            raise ValueCheckError(f"RANSAC: expected sample_size of 1 to {pop_size}, got {sample_size}")
        device = torch.device("cpu" if device is None else device)
        generator = None if self.seed is None else torch.Generator(device).manual_seed(self.seed + iteration)
        return torch.rand(batch_size, pop_size, device=device, generator=generator).topk(sample_size, 1).indices

    def estimate_model_from_minsample(self, kp1: Tensor, kp2: Tensor) -> Tensor:
        """Models (S, candidates, 3, 3) of samples (S, m, 2), or (S, m, 2, 2) for segments; NaN for missing ones."""
        return minimal_solver(kp1.flatten(2), kp2.flatten(2), None, self.model)

    def remove_bad_samples(self, kp1: Tensor, kp2: Tensor) -> tuple[Tensor, Tensor]:
        """Samples (S, m, 2) without degenerate ones. Synchronizes, since their number is read from the device."""
        models = self.estimate_model_from_minsample(kp1, kp2)
        good = models.isfinite().flatten(2).all(-1).any(-1)
        return kp1[good], kp2[good]

    def remove_bad_models(self, models: Tensor) -> Tensor:
        """Models (M, 3, 3) without those that are not finite. Synchronizes, since their number is read from the device."""
        return models[models.isfinite().flatten(1).all(-1)]

    def verify(self, kp1: Tensor, kp2: Tensor, models: Tensor, inl_th: float) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """The best of models (M, 3, 3) for a squared threshold, its inliers, its score and their number."""
        errors = _errors(models, kp1, kp2, self.model)
        inliers = errors <= inl_th
        counts = inliers.sum(-1)
        gains = torch.where(inliers, 1 - errors / inl_th, 0).sum(-1)
        scores = gains if self.score_type == "msac" else counts.to(gains.dtype)
        best = scores.argmax()
        return models[best], inliers[best], scores[best], counts[best]

    def polish_model(self, kp1: Tensor, kp2: Tensor, inliers: Tensor) -> Tensor:
        """The least-squares model (1, 3, 3) of the inliers."""
        return self._fitted(kp1[None], kp2[None], inliers[None].to(kp1.dtype))


def _growth(size: int, population: int, budget: int) -> list[int]:
    """The number of samples after which PROSAC adds the next point, for `size` points and more."""
    expected: float = budget * math.prod((size - i) / (population - i) for i in range(size))
    ends = [1]
    for n in range(size + 1, population + 1):
        following = expected * n / (n - size)
        ends.append(ends[-1] + max(1, math.ceil(following - expected)))
        expected = following
    return ends
