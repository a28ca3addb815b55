"""Robust fits by sigma-consensus++: models are fitted again and again with weights that no noise scale decides alone.

Inliers have noise of an unknown scale sigma, anywhere from 0 to a largest one. Averaged over sigma the likelihood gives a residual
r the weight of Barath et al., an incomplete gamma function of x = r^2 / (2 sigma_max^2). With three degrees of freedom, between
those of one pixel and those of a pair, it is elementary: exp(-x) - exp(-x_end), and 0 beyond the 99% quantile x_end of the largest
scale. Its integral is the loss that ranks models.

Source: D. Barath, J. Noskova, M. Ivashechkin, J. Matas, "MAGSAC++, a fast, reliable and accurate robust estimator" (2020).
"""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

from kvision._ops import is_compiling
from kvision._torch_compat import in_function_transform

_QUANTILE = 11.345  # 99% of the squared norms of three normal numbers are below
END = _QUANTILE / 2
_REST = math.exp(-END)

_TOLERANCE = 1e-5  # relative increase of a score that further fits are worth

Errors = Callable[
    [Tensor], Tensor
]  # squared errors (B, K, N) of models (B, K, m, n), NaN where there is no correspondence
Fit = Callable[[Tensor, Tensor], Tensor]  # models (B, K, m, n) near others, for weights (B, K, N) of squared errors


def consensus(errors: Tensor, reach: float | Tensor) -> tuple[Tensor, Tensor]:
    """Weights of squared errors in a fit, and what they contribute to the score of a model; 0 from `reach` on and for NaN."""
    x = (errors * (END / reach**2)).nan_to_num(END, END).clamp(max=END)
    weights = ((-x).exp() - _REST).clamp(min=0)  # below 0 by rounding
    return weights, weights + _REST * (x - END)


def rising_fits(
    models: Tensor, errors: Errors, fit: Fit, reach: float | Tensor, rounds: int, weights: Tensor | None = None
) -> tuple[Tensor, Tensor, Tensor]:
    """Of each of models (B, K, m, n) and up to `rounds` fits that start from it the one with the highest score, its score (B, K)
    and its squared errors (B, K, N). `weights` (B, N) multiply those of the consensus. Fits end when the score does not rise.
    """
    factors = None if weights is None else weights[:, None]
    best = models
    for i in range(rounds + 1):
        e = errors(models)
        w, gains = consensus(e, reach)
        score = (gains if factors is None else gains * factors).sum(-1)
        if i == 0:
            best_score, best_errors, rises = score, e, score > 0
        else:
            is_better = rises & (score > best_score)
            rises = rises & (score > best_score * (1 + _TOLERANCE))
            best_score = torch.where(is_better, score, best_score)
            best = torch.where(is_better[..., None, None], models, best)
            best_errors = torch.where(is_better[..., None], e, best_errors)
        has_values = score.is_cpu and not is_compiling() and not in_function_transform()
        if i == rounds or (has_values and not bool(rises.any())):
            break
        models = fit(models, w if factors is None else w * factors)
    return best, best_score, best_errors


def best_of(models: Tensor, scores: Tensor, count: int) -> Tensor:
    """The `count` models (B, count, m, n) of (B, K, m, n) with the best scores (B, K)."""
    chosen = scores.argsort(dim=1, descending=True, stable=True)[:, :count]
    return models[torch.arange(len(models), device=models.device)[:, None], chosen]
