"""AugMix: each image is mixed with chains of operations on it.

Source: Hendrycks, Mu, Cubuk, Zoph, Gilmer and Lakshminarayanan, AugMix: a simple data processing method to improve robustness
and uncertainty, ICLR 2020. The values of the operations are those of torchvision.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Generator, Tensor

from kvision._dtype import compute_dtype
from kvision.augmentation.auto.policy_base import Drawn, PolicyAugmentBase, check_integer
from kvision.augmentation.draws import Draw, Request, integer
from kvision.augmentation.engine import Chain, ParamItem, Record
from kvision.augmentation.samples import per_sample
from kvision.core.exceptions import ValueCheckError

__all__ = ["AugMix"]

_LEVELS = 10  # of the values: severity s draws one of the lowest s
_DEPTH = 3  # operations of the longest chain, where their number is drawn

# Values at the lowest and the highest level.
_RANGES = {
    "shear_x": (0.0, 0.3),
    "shear_y": (0.0, 0.3),
    "translate_x": (0.0, 1 / 3),
    "translate_y": (0.0, 1 / 3),
    "rotate": (0.0, 30.0),
    "posterize": (4.0, 0.0),
    "solarize": (1.0, 0.0),
    "auto_contrast": (0.0, 0.0),
    "equalize": (0.0, 0.0),
}
_FURTHER_RANGES = dict.fromkeys(("brightness", "color", "contrast", "sharpness"), (1.0, 1.9))


class AugMix(PolicyAugmentBase):
    """Mix each image with random chains of operations on it, as a weighted mean.

    The weight of the image is drawn from Beta(alpha, alpha). The chains share the rest by weights from Dirichlet(alpha, ...,
    alpha). Each begins with the image. Images are RGB in [0, 1], or uint8.

    Masks, boxes and key points stay as they are, because the image in the mixture does.

    Args:
        severity: how many of the 10 levels of magnitude may be drawn, from the lowest one.
        mixture_width: number of chains.
        chain_depth: number of operations of a chain; -1 draws 1, 2 or 3 for each.
        alpha: of the distributions of the weights, above 0.
        all_ops: brightness, color, contrast and sharpness are among the operations. The paper leaves them out, because the
            corruptions of ImageNet-C have them.
        same_on_batch: all samples get the same operations, values and weights.
        generator: draws the keys of each call; default: torch's generator.
        return_transform: calls return the images and identity matrices.

    Raises:
        TypeError: `severity`, `mixture_width` or `chain_depth` is not an int.
        ValueError: `severity` is not within 1 and 10, `mixture_width` below 1, `chain_depth` neither -1 nor at least 1, or
            `alpha` not above 0; width and depth take more than 64 random numbers a sample.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.auto.AugMix()(torch.rand(4, 3, 32, 32)).shape
        torch.Size([4, 3, 32, 32])
    """

    def __init__(
        self,
        severity: int = 3,
        mixture_width: int = 3,
        chain_depth: int = -1,
        alpha: float = 1.0,
        all_ops: bool = True,
        *,
        same_on_batch: bool | None = None,
        generator: Generator | None = None,
        return_transform: bool | None = None,
    ) -> None:
        severity = check_integer("AugMix", "severity", severity)
        mixture_width = check_integer("AugMix", "mixture_width", mixture_width)
        chain_depth = check_integer("AugMix", "chain_depth", chain_depth)
        if not 1 <= severity <= _LEVELS:
            raise ValueCheckError(f"AugMix: expected severity within 1 and {_LEVELS}, got {severity}")
        if mixture_width < 1:
            raise ValueCheckError(f"AugMix: expected mixture_width of at least 1, got {mixture_width}")
        if chain_depth < 1 and chain_depth != -1:
            raise ValueCheckError(f"AugMix: expected chain_depth to be -1 or at least 1, got {chain_depth}")
        if not alpha > 0:
            raise ValueCheckError(f"AugMix: expected alpha above 0, got {alpha}")
        top = (severity - 1) / (_LEVELS - 1)
        ranges = {**_RANGES, **_FURTHER_RANGES} if all_ops else _RANGES
        entries = [[(name, 1.0, low, low + top * (high - low))] for name, (low, high) in ranges.items()]
        count = mixture_width * (_DEPTH if chain_depth == -1 else chain_depth)
        super().__init__(
            entries, count=count, same_on_batch=same_on_batch, generator=generator, return_transform=return_transform
        )
        self.severity, self.mixture_width, self.chain_depth = severity, mixture_width, chain_depth
        self.alpha, self.all_ops = float(alpha), all_ops
        self._top_level = severity - 1
        self._check_draws("mixture_width and chain_depth")

    def extra_repr(self) -> str:
        names = ("severity", "mixture_width", "chain_depth", "alpha", "all_ops")
        return ", ".join(f"{name}={getattr(self, name)}" for name in names)

    def is_intensity_only(self, strict: bool = True) -> bool:
        return True

    def _request(self) -> Request:
        """After the operations of all chains: their depths, where these are drawn, and the breaks of a stick.

        A part Beta(alpha, alpha) of the stick is the weight of the image. A part Beta(alpha, n alpha) of what is left is that
        of a chain with n chains after it, which gives the chains their Dirichlet distribution.
        """
        request, a = super()._request(), self.alpha
        depths = [integer(1, _DEPTH)] * self.mixture_width if self.chain_depth == -1 else []
        after = range(self.mixture_width - 1, 0, -1)
        breaks = [Draw("beta", (a, a, 0.0)), *[Draw("beta", (a, n * a, 0.0)) for n in after]]
        return request._replace(draws=[*request.draws, *depths, *breaks])

    def _of_columns(self, columns: Tensor) -> Drawn:
        width = self.mixture_width
        columns, breaks = columns[:, :-width], columns[:, -width:]
        one = torch.ones_like(breaks[:, :1])
        weights = torch.cat([breaks, one], 1) * torch.cat([one, (1 - breaks).cumprod(1)], 1)
        if self.chain_depth != -1:
            return super()._of_columns(columns)._replace(weights=weights)
        columns, depths = columns[:, :-width], columns[:, -width:]
        operation, value, _ = super()._of_columns(columns)
        step = torch.arange(operation.shape[1], device=operation.device) % _DEPTH
        is_executed = step < depths.repeat_interleave(_DEPTH, 1)
        return Drawn(torch.where(is_executed, operation, -1), value, weights)

    def _redrawn(self, params: Sequence[ParamItem], x: Tensor) -> Drawn:
        drawn = super()._redrawn(params, x)
        if "weights" not in params[0].data:
            raise ValueCheckError("AugMix: expected params with 'weights' in the first step")
        return drawn._replace(weights=params[0].data["weights"].to(x.device))

    def _items(self, record: Record) -> list[Any]:
        items = super()._items(record)
        if record.drawn is not None:
            items[0].data["weights"] = record.drawn.weights.cpu()
        return items

    def _run(self, x: Tensor, drawn: Drawn) -> tuple[Tensor, Chain]:
        assert drawn.weights is not None
        image, *of_chains = drawn.weights.to(compute_dtype(x)).unbind(1)
        mixture = per_sample(image, x) * x
        operations, values = (t.chunk(self.mixture_width, 1) for t in (drawn.operation, drawn.value))
        for operation, value, weight in zip(operations, values, of_chains):
            chain, _ = super()._run(x, Drawn(operation, value))
            mixture = mixture + per_sample(weight, x) * chain
        mixture = mixture.round() if x.dtype == torch.uint8 else mixture
        return mixture.to(x.dtype), Chain()
