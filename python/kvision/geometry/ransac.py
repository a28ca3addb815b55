"""RANSAC: models of two views from correspondences with many outliers.

A round draws minimal samples of all pairs of a batch, solves for their models and scores each model by its inliers. That
takes two operators, whatever the number of hypotheses. Rounds end as soon as the best model of every pair reaches the
requested confidence, which the host reads once a round. Where few samples are of right correspondences alone, further ones
are drawn from the inliers of the best model. The best hypotheses are fitted to all correspondences by sigma-consensus++, those
of all pairs at once. Of fundamental matrices the best fit then estimates the noise together with the model.
"""

from __future__ import annotations

import math
import sys
from typing import Any, Literal, TypeAlias, get_args

import torch
from torch import Tensor, nn

from kvision import _check
from kvision._limits import RANSAC_CHUNK, RANSAC_DEVIATIONS
from kvision._modes import MODEL, MODEL_NAMES
from kvision._ops import register
from kvision.core.exceptions import ShapeError, ValueCheckError
from kvision.geometry._normalization import is_on_line, to_unit_last
from kvision.geometry._precision import in_full_precision
from kvision.geometry.epipolar.essential import nearest_essential
from kvision.geometry.epipolar.projection import cross_product_matrix
from kvision.geometry.solvers._minimal import SIZES, eight_points, minimal_solver
from kvision.geometry.solvers._sigma_consensus import best_of, consensus
from kvision.geometry.solvers._two_view_fits import ADAPTS, LINEAR_FITS, squared_errors, two_view_fits

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
# Hypotheses that are fitted: 16 of models of many points, of which few samples are right; `_FEW` where the confidence is reached.
_REFINED = {"affine": 1, "homography": 1, "lines": 1}
_KEPT, _FEW = 16, 8
# The largest error that a fit uses, in thresholds: what far ones tell of the noise is worth more than the wrong ones among them
# cost. Distances from lines let more of these in than those of points.
# Where the confidence is not reached the first fits use `_WIDE`, because no sample may be of right correspondences alone.
# Of fits that estimate the noise afterwards the best is chosen by a smaller one.
_REACH = {"homography": 5.0, "fundamental": 2.0, "fundamental8": 2.0, "essential": 1.75}
_WIDE, _NEAR = 4.0, 1.5
_GROWTH = {"homography": 8}  # of rounds, else 4: of hypotheses that take little time
_BATCH = 2048  # hypotheses of one `max_iter` round for batch_size "auto"
_FIRST = 2**14  # hypotheses of all pairs in the first round
_SAMPLES = 2**19  # of all pairs in one round, which bounds the memory of their models
# Where more samples than these are required few are of right correspondences alone: rounds of further samples follow from the
# inliers of the best model, of which most are.
_MANY = {"fundamental": 2000, "fundamental8": 2000, "essential": 100}
_INNER_ROUNDS, _INNER = 2, {"fundamental": 64, "fundamental8": 64, "essential": 32}
_PAIRS = 512  # of points outside of a plane


def _consensus(
    models: Tensor, points1: Tensor, points2: Tensor, least: Tensor, thresholds: Tensor, model: str
) -> Tensor:
    """Scores (B, M, 2) of models (B, M, 3, 3) for points (B, 2 or 4, N): sums of 1 - e / t^2 over inliers, inlier counts. After
    every 64 points models are given up whose sum is too far below what one of sum `least` (B) has by then."""
    x, y = points1.mT, points2.mT
    if model == "lines":
        x, y = x.unflatten(-1, (2, 2)), y.unflatten(-1, (2, 2))
    errors = squared_errors(models, x, y, model)
    squares = thresholds.square()[:, None, None]
    inliers = errors <= squares
    gains = torch.stack([torch.where(inliers, 1 - errors / squares, 0), inliers.to(errors.dtype)], -1)
    seen = RANSAC_CHUNK * torch.arange(1, errors.shape[-1] // RANSAC_CHUNK + 1, device=errors.device)
    if not len(seen):
        return gains.sum(-2)
    sums = gains.cumsum(-2)[..., seen - 1, :]
    mean = least[:, None] * (seen / errors.shape[-1])
    is_given_up = sums[..., 0] < (mean - RANSAC_DEVIATIONS * mean.sqrt())[:, None]
    first = is_given_up.to(torch.uint8).argmax(-1, keepdim=True)[..., None].expand(*models.shape[:2], 1, 2)
    return torch.where(is_given_up.any(-1, keepdim=True), sums.gather(2, first)[:, :, 0], gains.sum(-2))


def _keep_best_reference(
    models: Tensor,
    points1: Tensor,
    points2: Tensor,
    kept: Tensor,
    kept_scores: Tensor,
    thresholds: Tensor,
    existing: Tensor,
    count: int,
    by_count: bool,
    number: int,
    confidence: float,
    budget: int,
) -> tuple[Tensor, Tensor, Tensor]:
    """The `count` best of models (B, M, 3, 3) and of those kept so far (B, L, 3, 3), and their scores (B, count, 2). The first of
    equal ones wins. Models need not be scored to the end that would not be kept, or have less than half the best sum. And how many
    samples (B), at most the budget, are required until one has only inliers of the best model with this probability: 0 of too few
    correspondences, of which there are `existing` (B)."""
    least = thresholds.new_zeros(len(models))
    if kept.shape[1] == count and not by_count:
        least = torch.maximum(kept_scores[:, -1, 0], kept_scores[:, 0, 0] / 2)
    scores = _consensus(models, points1, points2, least, thresholds, MODEL_NAMES[number])
    models, scores = torch.cat([models, kept], 1), torch.cat([scores, kept_scores], 1)
    order = scores[..., int(by_count)].argsort(dim=1, descending=True, stable=True)[:, :count]
    row = torch.arange(len(models), device=models.device)[:, None]
    models, scores = models[row, order], scores[row, order]
    inliers, total, size = scores[:, 0, 1].double(), existing.double(), SIZES[MODEL_NAMES[number]][0]
    good = torch.stack([(inliers - i).clamp(min=0) / (total - i) for i in range(size)]).prod(0)
    failure = math.log1p(-confidence) if confidence < 1 else -math.inf
    required = (failure / (-good).log1p()).ceil().nan_to_num(budget, budget).clamp(1, budget).long()
    return models, scores, torch.where(total < size, 0, required)


_keep_best_models = register(
    "keep_best_models",
    _keep_best_reference,
    fake=lambda models, x, y, kept, scores, thresholds, existing, count, *options: [
        *(
            models.new_empty(len(models), min(count, models.shape[1] + kept.shape[1]), *shape)
            for shape in ((3, 3), (2,))
        ),
        models.new_empty(len(models), dtype=torch.int64),
    ],
    non_differentiable=(0, 1, 2),
    casts_outputs=True,
)


def _select_inliers_reference(
    points1: Tensor, points2: Tensor, weights: Tensor | None, thresholds: Tensor, models: Tensor, number: int
) -> tuple[Tensor, Tensor]:
    """Models (B, 3, 3) in the type of points (B, N, 2 or 4), scaled, and their inliers, bool (B, N), among correspondences of
    positive weights (B, N). Inliers of a sample alone say nothing for its model, but where there are no more correspondences,
    nor do points on one line for a map: then both are zeros."""
    model = MODEL_NAMES[number]
    x, y = points1.double(), points2.double()
    if model == "lines":
        x, y = x.unflatten(-1, (2, 2)), y.unflatten(-1, (2, 2))
    errors = squared_errors(models.double()[:, None], x, y, model)[:, 0]
    exists = torch.ones_like(errors, dtype=torch.bool) if weights is None else weights > 0
    inliers = exists & (errors <= thresholds.double().square()[:, None])
    least = (exists.sum(1, keepdim=True) - 1).clamp(0, SIZES[model][0])
    has_consensus = inliers.sum(1, keepdim=True) > least
    if model in ("affine", "homography"):
        has_consensus &= ~is_on_line(points1, inliers)[:, None]
    models = _scaled(models.contiguous(), model)  # the sum of a norm depends on strides
    scaled = torch.where(has_consensus[..., None], models, 0)
    return scaled.to(points1.dtype), inliers & has_consensus


_select_inliers = register(
    "select_inliers",
    _select_inliers_reference,
    fake=lambda x, *args: [x.new_empty(len(x), 3, 3), x.new_empty(x.shape[:2], dtype=torch.bool)],
    non_differentiable=(0, 1),
    casts_outputs=True,
)


def _scaled(models: Tensor, model: str) -> Tensor:
    if model == "essential":
        return models / torch.linalg.vector_norm(models, dim=(-2, -1), keepdim=True)
    return to_unit_last(models)


class RANSAC(nn.Module):
    """Find the model with the most inliers among correspondences, and these inliers (RANSAC).

    Args:
        model_type: "homography", "affine", "homography_from_linesegments", "fundamental" (from seven points, as
            "fundamental_7pt"), "fundamental_8pt" or "essential".
        inl_th: how far, in the units of the points, a correspondence may be from the model: where the point goes from where
            it should, the ends of a segment from the other's line on average, Sampson's distance for the other_models.
        batch_size: hypotheses of one round, or "auto".
        max_iter: rounds of `batch_size` hypotheses, 2048 for "auto".
        confidence: probability, in (0, 1], that no better model is missed when rounds end early; 1 never ends early, and on a GPU
            does not synchronize with the host.
        max_lo_iters: the most fits of the best hypotheses by sigma-consensus++.
        score_type: what ranks hypotheses before they are fitted: "msac", the sum of 1 - e^2 / inl_th^2 over inliers, or "ransac",
            their number. Fits are ranked by the loss of MAGSAC++. The last fits of a fundamental matrix estimate the noise, too,
            by expectation maximization; `inl_th` is the largest deviation of it.
        prosac_sampling: points are sorted, the most reliable first; the first samples are drawn from the first points.
        seed: seed of every call; None draws from torch's default generator.
        lo_sample_size: no effect, since models are fitted to all correspondences.
        max_samples: total number of hypotheses, instead of `batch_size * max_iter`.
        local_optimization: "lm" or "dlt"; no effect, since there is one method.
        refine_iters: the most further fits of the best model, after as many as `max_lo_iters`.
        degensac: True, for "fundamental" and "fundamental_7pt": further hypotheses of the homography of most points and two points
            outside of its plane, for scenes of which most is a plane; None is False.
        compile: no effect.

    Raises:
        TypeCheckError: an argument is of the wrong type.
        ValueCheckError: an unknown name, or a number out of range.

    Source: P. Torr and A. Zisserman, "MLESAC" (2000); D. Barath et al., "MAGSAC++" (2020); W. Chojnacki et al., "On the fitting of
    surfaces to data with covariances" (2000); O. Chum and J. Matas, "Matching with PROSAC" (2005); O. Chum, T. Werner, J. Matas,
    "Two-view geometry estimation unaffected by a dominant plane" (2005); O. Chum, J. Matas, J. Kittler, "Locally optimized RANSAC"
    (2003).

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
        if _check.switch("RANSAC", "degensac", degensac) and _MODELS[model_type] != "fundamental":
            raise ValueCheckError(
                f"RANSAC: expected degensac False or None for {model_type!r}, got True", actual_value=degensac
            )
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
            return min(self.sample_budget, 1024)
        return min(self.sample_budget, 64 if self.model == "essential" else 128)  # which take long to solve

    @staticmethod
    def max_samples_by_conf(n_inl: int, num_tc: int, sample_size: int, conf: float) -> int:
        """The number of samples among which one has only inliers, `n_inl` of `num_tc`, with probability `conf`."""
        if n_inl < sample_size or num_tc < sample_size or conf >= 1:
            return sys.maxsize
        good = math.prod((n_inl - i) / (num_tc - i) for i in range(sample_size))
        return 1 if good >= 1 or conf <= 0 else math.ceil(math.log1p(-conf) / math.log1p(-good))

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

    def forward(
        self,
        kp1: Tensor,
        kp2: Tensor,
        weights: Tensor | None = None,
        K1: Tensor | None = None,
        K2: Tensor | None = None,
    ) -> tuple[Tensor, Tensor]:
        """Find the model of correspondences, or the models of a batch of pairs.

        Args:
            kp1: points of the first image, (N, 2) or (B, N, 2) as (x, y), floating point; line segments (N, 2, 2) or (B, N, 2, 2)
                for "homography_from_linesegments"; for "essential" in the camera's coordinates, or in pixels with `K1`.
            kp2: the corresponding points of the second image, in the same shape.
            weights: of the squared errors of correspondences, at least 0, (N,) or (B, N); None for 1. Correspondences of weight 0
                do not exist, so pairs of a batch may have different numbers of them.
            K1: for "essential", camera matrices (3, 3) or (B, 3, 3) of the first images. Points and `inl_th` are then in pixels;
                the mean of the focal lengths converts `inl_th`.
            K2: those of the second images; None for `K1`.

        Returns:
            The model (3, 3) or (B, 3, 3) and its inliers, bool (N,) or (B, N). Zeros and no inliers where no model has more inliers
            than a sample has points, or as many if there are no more, and for "affine" and "homography" where all are on one line.
            Where the camera only turns, or the scene is a plane, many fundamental matrices have the same inliers, and where it
            only turns many essential ones: then one of them is returned. Gradients to points and weights are those of the linear
            least squares of all correspondences near the model, with the weights that sigma-consensus++ gives them.

        Raises:
            TypeCheckError: an argument is not a floating-point tensor.
            ShapeError: shapes differ from the ones above, or there are too few points.
            DeviceError: the tensors are on different devices.
            ValueCheckError: camera matrices for another model, or `K2` without `K1`.
        """
        self.validate_inputs(kp1, kp2, weights)
        is_one = kp1.dim() == (3 if self.model == "lines" else 2)
        if is_one:
            kp1, kp2, weights = kp1[None], kp2[None], None if weights is None else weights[None]
        cameras = None if K1 is None and K2 is None else self._cameras(kp1, K1, K2)
        model, inliers = self._estimate(kp1, kp2, weights, cameras)
        return (model[0], inliers[0]) if is_one else (model, inliers)

    def _cameras(self, kp1: Tensor, K1: Tensor | None, K2: Tensor | None) -> tuple[Tensor, Tensor]:
        """Both camera matrices (B or 1, 3, 3), checked."""
        if self.model != "essential":
            raise ValueCheckError(
                f"RANSAC: expected no K1 and K2 for {self.model_type!r}, whose points are in any unit"
            )
        if K1 is None:
            raise ValueCheckError("RANSAC: expected K1 where there is K2")
        cameras = []
        for name, M in (("K1", K1), ("K2", K1 if K2 is None else K2)):
            _check.floating_trailing_shape("RANSAC", name, M, 3, 3)
            if M.dim() != 2 and tuple(M.shape) not in ((len(kp1), 3, 3), (1, 3, 3)):
                raise ShapeError(
                    f"RANSAC: expected {name} of shape (3, 3) or ({len(kp1)}, 3, 3), got {tuple(M.shape)}",
                    actual_shape=M.shape,
                )
            _check.same_device("RANSAC", kp1=kp1, **{name: M})
            cameras.append(M.reshape(-1, 3, 3))
        return cameras[0], cameras[1]

    @in_full_precision
    def _estimate(
        self, kp1: Tensor, kp2: Tensor, weights: Tensor | None, cameras: tuple[Tensor, Tensor] | None
    ) -> tuple[Tensor, Tensor]:
        thresholds = kp1.new_full((len(kp1),), self.inl_th)
        if cameras is not None:
            focals = torch.cat([K.diagonal(dim1=1, dim2=2)[:, :2].expand(len(kp1), -1) for K in cameras], 1)
            thresholds = thresholds / focals.detach().mean(1)
            kp1, kp2 = (_in_camera(points, K) for points, K in zip((kp1, kp2), cameras))
        with torch.no_grad():
            w = None if weights is None else weights.detach()
            exists = None if w is None else w > 0
            points = torch.stack([kp1.detach(), kp2.detach()]).flatten(3)
            if exists is not None:
                points = torch.where(exists[None, :, :, None], points, torch.nan)
            fitted = self._best_models(points, exists, w, thresholds)
            model, inliers = _select_inliers(*points, w, thresholds, fitted, MODEL[self.model])
        if torch.is_grad_enabled() and any(t is not None and t.requires_grad for t in (kp1, kp2, weights)):
            model = self._with_gradient(model, fitted, inliers, kp1, kp2, weights, thresholds)
        return model, inliers

    def _best_models(self, points: Tensor, exists: Tensor | None, weights: Tensor | None, thresholds: Tensor) -> Tensor:
        """The best models (B, 3, 3) in double, of the points of both images (2, B, N, 2 or 4): hypotheses, fits near all of them,
        near the best of these and near the best one."""
        count = points.shape[2]
        if not points.shape[1]:
            return points.new_empty(0, 3, 3, dtype=torch.float64)
        # Scores give models up after some of the points, which therefore come in an order without meaning.
        stride = _stride(count)
        order = torch.arange(0, count * stride, stride, device=points.device) % count
        rows = points.mT[..., order]
        exact = rows.double()
        w = None if weights is None else weights.double()[:, order]
        limits = thresholds.double()
        reaches, wide = self._reaches(limits), _WIDE * limits

        def fits(
            models: Tensor, w: Tensor | None, rounds: int, reaches: Tensor = reaches, adapts: bool = False
        ) -> tuple[Tensor, Tensor]:
            return two_view_fits(models.double(), exact[0], exact[1], w, reaches, rounds, self.model, adapts)

        models = self._hypotheses(points, rows, exists, thresholds, fits)
        most = self.max_lo_iters
        if models.shape[1] > _FEW:
            models = fits(models, w, min(most, 2), wide)[0]
        adapts = most > 0 and self.model in ADAPTS
        near = _NEAR * limits if adapts else reaches
        for rounds, kept in ((1, 4), (4 if adapts else most, 1)):
            if models.shape[1] > kept:
                models = best_of(*fits(models, w, min(rounds, most), near), kept)
        return fits(models, w, most + self.refine_iters, reaches, adapts)[0][:, 0]

    def _reaches(self, thresholds: Tensor) -> Tensor:
        """The largest errors of correspondences that fits use."""
        return thresholds * _REACH.get(self.model, _WIDE)

    def _hypotheses(self, points: Tensor, rows: Tensor, exists: Tensor | None, thresholds: Tensor, fits: Any) -> Tensor:
        """The best hypotheses (B, K, 3, 3) of pairs. Rounds end when the best of every pair has the requested confidence."""
        batch, num_points = points.shape[1:3]
        x, y = points
        existing = x.new_full((batch,), num_points) if exists is None else exists.sum(1).to(x.dtype)
        population, reads = existing, self.confidence < 1 or x.is_cpu
        if exists is not None:  # the others last
            first = exists.to(torch.uint8).argsort(dim=1, descending=True, stable=True)
            x, y = points.gather(2, first[None, :, :, None].expand_as(points))
        generator = None if self.seed is None else torch.Generator(x.device).manual_seed(self.seed)
        kept, by_count, number = _REFINED.get(self.model, _KEPT), self.score_type == "ransac", MODEL[self.model]
        models, scores = x.new_empty(batch, 0, 3, 3), x.new_empty(batch, 0, 2)

        def merged(candidates: Tensor) -> tuple[Tensor, Tensor, Tensor]:
            options = kept, by_count, number, self.confidence, self.sample_budget
            result: tuple[Tensor, Tensor, Tensor] = _keep_best_models(
                candidates, *rows, models, scores, thresholds, existing, *options
            )
            return result

        most = max(_SAMPLES // batch, 64)
        size = min(self.resolve_batch_size(num_points, x.device), most)
        if self.batch_size == "auto":  # of many pairs few each, whose best score lets later rounds give models up
            size = min(size, max(_FIRST // batch, 64))
        num_drawn, best = 0, existing.new_zeros(batch)
        while True:
            count = min(size, self.sample_budget - num_drawn)
            draws = self._draws(count, num_points, population, num_drawn, generator)
            models, scores, needs = merged(minimal_solver(x, y, draws, self.model).view(batch, -1, 3, 3))
            num_drawn += count
            # The best models of pairs that need more samples are fitted, if they are new.
            if self.max_lo_iters:
                is_new = (scores[:, 0, int(by_count)] > best) & (needs > num_drawn)
                if not x.is_cpu or bool(is_new.any()):
                    start = torch.where(is_new[:, None, None, None], models[:, :1], torch.nan)
                    models, scores, needs = merged(fits(start, None, 2)[0].to(x.dtype))
                    best = scores[:, 0, int(by_count)]
            required = needs.tolist() if reads else [self.sample_budget] * batch  # where the host waits
            if num_drawn >= max(required):
                break
            if num_drawn >= min(required):  # pairs that have their model draw no samples
                population = torch.where(needs > num_drawn, existing, 0)
            size = min(_GROWTH.get(self.model, 4) * size, most) if self.batch_size == "auto" else size
            size = min(size, max(required) - num_drawn)
        if max(required) > _MANY.get(self.model, math.inf) and self.max_lo_iters:
            for _ in range(_INNER_ROUNDS):
                models, scores, _ = merged(fits(models[:, :1], None, 3)[0].to(x.dtype))
                errors = squared_errors(models[:, :1], points[0], points[1], self.model)[:, 0]
                is_inlier = errors <= thresholds.square()[:, None]
                first = is_inlier.to(torch.uint8).argsort(dim=1, descending=True, stable=True)
                a, b = points.gather(2, first[None, :, :, None].expand_as(points))
                draws = torch.rand(
                    batch, _INNER[self.model], self.minimal_sample_size + 1, device=x.device, generator=generator
                )
                draws[..., -1] = is_inlier.sum(1, keepdim=True)
                models, scores, _ = merged(minimal_solver(a, b, draws.flatten(0, 1), self.model).view(batch, -1, 3, 3))
        if self.degensac:
            return merged(self._off_plane(points[0], points[1], exists, generator))[0]
        # What was found early is found often: few hypotheses stand for all.
        is_early = [r < self.sample_budget for r in required]
        if all(is_early):
            return models[:, :_FEW]
        if any(is_early):
            others = (needs < self.sample_budget)[:, None, None, None]
            models = torch.cat([models[:, :_FEW], models[:, _FEW:].masked_fill(others, torch.nan)], 1)
        return models

    def _off_plane(self, x: Tensor, y: Tensor, exists: Tensor | None, generator: torch.Generator | None) -> Tensor:
        """Fundamental matrices (B, S, 3, 3): of the plane that most correspondences are in, and pairs of those outside of it."""
        plane = RANSAC("homography", self.inl_th, confidence=self.confidence, seed=self.seed, max_samples=_BATCH)
        weights = None if exists is None else exists.to(x.dtype)
        H, is_in_plane = plane(x, y, weights)
        is_outside = ~is_in_plane if exists is None else ~is_in_plane & exists
        order = is_outside.to(torch.uint8).argsort(dim=1, descending=True, stable=True)
        count = is_outside.sum(1)[:, None]
        draws = torch.rand(len(x), 2, _PAIRS, device=x.device, generator=generator)
        first = (draws[:, 0] * count).long().clamp(max=x.shape[1] - 1)
        second = (draws[:, 1] * (count - 1)).long().clamp(0, x.shape[1] - 2)
        chosen = order.gather(1, torch.cat([first, second + (second >= first)], 1))[..., None].expand(-1, -1, 2)
        a, b = (torch.nn.functional.pad(p.gather(1, chosen), (0, 1), value=1.0) for p in (x, y))
        one, two = torch.linalg.cross(a @ H.mT, b).chunk(2, 1)  # lines through the epipole
        F = cross_product_matrix(torch.linalg.cross(one, two)) @ H[:, None]
        F = F / torch.linalg.vector_norm(F, dim=(-2, -1), keepdim=True)
        return torch.where((count > 1)[..., None, None], F, torch.nan)

    def _with_gradient(
        self,
        model: Tensor,
        near: Tensor,
        inliers: Tensor,
        kp1: Tensor,
        kp2: Tensor,
        weights: Tensor | None,
        thresholds: Tensor,
    ) -> Tensor:
        """The model with the gradient of the weighted linear least squares of what it was fitted to, `near` this model."""
        has_model = inliers.any(1)
        x, y = kp1.detach().double(), kp2.detach().double()
        errors = torch.where(has_model[:, None], squared_errors(near[:, None], x, y, self.model)[:, 0], 0)
        w = consensus(errors, self._reaches(thresholds)[:, None])[0].to(kp1.dtype)
        kp1, kp2 = kp1.nan_to_num(0.0, 0.0, 0.0), kp2.nan_to_num(0.0, 0.0, 0.0)  # of weight 0
        fitted = _scaled(self._fitted(kp1, kp2, w if weights is None else w * weights), self.model)
        if self.model == "essential":
            fitted = fitted * (fitted * model).sum((1, 2), keepdim=True).sign().detach()
        valued = model + (fitted - fitted.detach())
        return torch.where(has_model[:, None, None], valued, model)

    def _draws(
        self, count: int, num_points: int, population: Tensor, num_drawn: int, generator: torch.Generator | None
    ) -> Tensor:
        """Draw samples (B * count, m + 1): m random numbers, then how many of the first points they choose from, at most
        `population` (B); none for pairs of 0."""
        size, device = self.minimal_sample_size, population.device
        draws = torch.rand(len(population), count, size + 1, device=device, dtype=torch.float32, generator=generator)
        draws[..., size] = population[:, None]
        if self.prosac_sampling:
            ends = torch.tensor(_growth(size, num_points, self.sample_budget), device=device)
            number = torch.arange(num_drawn + 1, num_drawn + count + 1, device=device)
            first = (torch.searchsorted(ends, number) + size).to(population.dtype)
            draws[..., size] = torch.minimum(first, population[:, None])
            takes_newest = number <= ends[-1]
            draws[..., size - 1] = torch.where(
                takes_newest, 1 - 2.0**-24, draws[..., size - 1]
            )  # chooses the newest point
        return draws.flatten(0, 1)

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
        errors = squared_errors(models[None], kp1[None], kp2[None], self.model)[0]
        inliers = errors <= inl_th
        counts = inliers.sum(-1)
        gains = torch.where(inliers, 1 - errors / inl_th, 0).sum(-1)
        scores = gains if self.score_type == "msac" else counts.to(gains.dtype)
        best = scores.argmax()
        return models[best], inliers[best], scores[best], counts[best]

    def polish_model(self, kp1: Tensor, kp2: Tensor, inliers: Tensor) -> Tensor:
        """The least-squares model (1, 3, 3) of the inliers."""
        return self._fitted(kp1[None], kp2[None], inliers[None].to(kp1.dtype))


def _in_camera(points: Tensor, K: Tensor) -> Tensor:
    """Pixels (B, N, 2) in the coordinates of cameras of matrices (B or 1, 3, 3)."""
    x, y = (points - K[:, None, :2, 2]).unbind(-1)
    y = y / K[:, None, 1, 1]
    return torch.stack([(x - K[:, None, 0, 1] * y) / K[:, None, 0, 0], y], -1)


def _stride(count: int) -> int:
    """A number without common divisors with `count`, near its golden section: its multiples visit all numbers below `count`."""
    stride = max(int(0.618 * count), 1)
    while math.gcd(stride, count) > 1:
        stride += 1
    return stride


def _growth(size: int, population: int, budget: int) -> list[int]:
    """The number of samples after which PROSAC adds the next point, for `size` points and more."""
    expected: float = budget * math.prod((size - i) / (population - i) for i in range(size))
    ends = [1]
    for n in range(size + 1, population + 1):
        following = expected * n / (n - size)
        ends.append(ends[-1] + max(1, math.ceil(following - expected)))
        expected = following
    return ends
