"""AugMix: each image is mixed with chains of operations on it.

Source: Hendrycks, Mu, Cubuk, Zoph, Gilmer and Lakshminarayanan, AugMix: a simple data processing method to improve robustness
and uncertainty, ICLR 2020. The values of the operations are those of torchvision.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import torch
from torch import Generator, Tensor

from kvision._dtype import compute_dtype
from kvision._ops import FastPath
from kvision.augmentation.auto.operation_table import (
    has_list_kernel,
    has_list_operator,
    list_operator,
    steps_reference,
    steps_vjp,
)
from kvision.augmentation.auto.policy_base import PolicyAugmentBase, check_integer
from kvision.augmentation.auto.policy_parts import Drawn
from kvision.augmentation.drawn_pass import COMPUTED_IN_FLOAT32
from kvision.augmentation.draws import Draw, Request, integer
from kvision.augmentation.engine import Chain, ParamItem, Record
from kvision.augmentation.lists.pixels import PixelRow
from kvision.augmentation.samples import per_sample
from kvision.core.exceptions import ValueCheckError
from kvision.geometry.transform.lists.arguments import fake_results

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
        execute = super()._run
        chains = _chains_of(drawn.operation, drawn.value, drawn.weights)
        weights = (per_sample(w, x) for w in drawn.weights.to(compute_dtype(x)).unbind(1))
        return _mixture(x, weights, (execute(x, Drawn(*chain))[0] for chain in chains)), Chain()

    def _run_list(self, images: Sequence[Tensor], drawn: Drawn) -> tuple[list[Tensor], list[Tensor]]:
        operation, value, weights = drawn
        assert weights is not None
        if weights.dtype == torch.float32 and not weights.requires_grad:
            if has_list_kernel(_mix, images, operation, value):
                return list(_mix.kernel(images, operation, value, weights)), []
            if has_list_operator(images, operation, value):
                return list(_mix_operations_list(images, operation, value, weights)), []
        row, execute = PixelRow(images), super()._run_list
        chains = (execute(images, Drawn(*chain))[0] for chain in _chains_of(operation, value, weights))
        weights_of_pixels = map(row.of_images, weights.to(compute_dtype(images[0])).unbind(1))
        return row.split(_mixture(row.of(images), weights_of_pixels, map(row.of, chains))), []


def _chains_of(operation: Tensor, value: Tensor, weights: Tensor) -> Iterator[tuple[Tensor, Tensor]]:
    """The operations and values of each chain."""
    count = weights.shape[1] - 1
    return zip(operation.chunk(count, 1), value.chunk(count, 1))


def _mixture(x: Tensor, weights: Iterable[Tensor], chains: Iterable[Tensor]) -> Tensor:
    """Images with what chains make of them, by the weight of the image and those of its chains."""
    image, *of_chains = weights
    mixture = image * x
    for weight, chain in zip(of_chains, chains):
        mixture = mixture + weight * chain
    mixture = mixture.round() if x.dtype == torch.uint8 else mixture
    return mixture.to(x.dtype)


# --- lists of images ------------------------------------------------------------------------------------------------

# Arguments: images (C, h, w); numbers (B, S) of the operations of all chains; their values (B, S); weights (B, 1 + chains) of the
# image and of its chains.


def _reference(images: Sequence[Tensor], *drawn: Tensor) -> list[Tensor]:
    results = []
    for x, operation, value, weights in zip(images, *(t.split(1) for t in drawn)):
        chains = (steps_reference(x[None], *chain)[0] for chain in _chains_of(operation, value, weights))
        own = (per_sample(w, x[None]) for w in weights.to(compute_dtype(x)).unbind(1))
        results.append(_mixture(x[None], own, chains)[0])
    return results


def _gradients(needs: Sequence[bool], grads: Sequence[Any], images: Sequence[Tensor], *drawn: Tensor) -> list[Any]:
    of_images = None
    if needs[0]:
        each = zip(grads, images, *(t.split(1) for t in drawn))
        of_images = [None if g is None else _vjp(g[None], x[None], *own)[0] for g, x, *own in each]
    return [of_images, None, None, None]


def _vjp(grad: Tensor, x: Tensor, operation: Tensor, value: Tensor, weights: Tensor) -> Tensor:
    """The gradient of an image (1, C, h, w) from that of its mixture."""
    image, *of_chains = weights[0].to(grad.dtype).unbind()
    gradient = grad * image
    for weight, chain in zip(of_chains, _chains_of(operation, value, weights)):
        gradient = gradient + steps_vjp(grad * weight, x, *chain)
    return gradient


_mix = FastPath("mix_operations_list", COMPUTED_IN_FLOAT32, clamps=True)
_mix_operations_list = list_operator(
    "mix_operations_list",
    _reference,
    lambda images, *_: fake_results(images, [n for x in images for n in x.shape[-2:]]),
    _gradients,
)
