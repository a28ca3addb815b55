"""What detectors share: masks, the choice of the strongest candidates, and modules that they compile."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from kvision import _check
from kvision.core.exceptions import ShapeError

EMPTY = float("-inf")  # the score of a position without a feature


class _FiniteGradient(torch.autograd.Function):
    generate_vmap_rule = True

    @staticmethod
    def forward(x: Tensor) -> Tensor:
        return x.view_as(x)

    @staticmethod
    def setup_context(ctx: Any, inputs: Any, output: Any) -> None: ...

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> Tensor:
        return torch.where(grad.isfinite(), grad, 0)

    @staticmethod
    def jvp(ctx: Any, tangent: Tensor) -> Tensor:
        return tangent.view_as(tangent)


def with_finite_gradient(x: Tensor) -> Tensor:
    """The same values, whose gradient is 0 where it is not finite.

    Where an image is NaN or infinite there is no feature, but its pixels times gradients of 0 would be NaN, which the
    blurs of a pyramid and the frames would spread. Compiled code has the gradient as it is: a Function with forward mode
    would break its graph.
    """
    if not x.requires_grad or torch.compiler.is_compiling():
        return x
    return _FiniteGradient.apply(x)


def check_mask(op: str, mask: Tensor | None, image: Tensor) -> None:
    """Raise unless `mask` is None or (B, 1, H, W) or (1, 1, H, W) for images (B, C, H, W)."""
    if mask is None:
        return
    _check.shape(op, "mask", mask, "B", 1, *image.shape[2:])
    _check.same_device(op, img=image, mask=mask)
    if not _check.is_one_or(mask.shape[0], image.shape[0]):
        raise ShapeError(f"{op}: expected mask with a batch of 1 or {image.shape[0]}, got {tuple(mask.shape)}")


def resized_mask(mask: Tensor, size: tuple[int, int]) -> Tensor:
    """The smallest weight, at most 1, under each pixel of a level, so that thin forbidden regions stay forbidden.

    A mask of bools or integers has the weights 0 and 1.
    """
    weights = mask.float().clamp(max=1) if mask.is_floating_point() else (mask != 0).float()
    return -F.adaptive_max_pool2d(-weights, size)


def weighted(scores: Tensor, weights: Tensor) -> Tensor:
    """Scores moved towards the worst by weights in (0, 1]; no candidates where a weight is not above 0."""
    weights = weights.to(scores.dtype)
    positive = torch.where(weights > 0, weights, 1)
    lowest = torch.finfo(scores.dtype).min  # still ahead of empty slots
    scores = torch.where(scores >= 0, scores * positive, (scores / positive).clamp(min=lowest))
    return torch.where(weights > 0, scores, EMPTY)


def no_candidates(image: Tensor) -> tuple[Tensor, Tensor]:
    """No scores (B, 0) and no frames (B, 0, 2, 3) for images, with a gradient of 0 where one is wanted."""
    none = image.flatten()[:0]
    batch = image.shape[0]
    promoted = none.to(torch.promote_types(none.dtype, torch.float32))
    return none.reshape(batch, 0), promoted.reshape(batch, 0, 2, 3)


def strongest(scores: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """The `count` largest scores of each row of (B, M), in decreasing order, and their indices; fewer if M is less."""
    return scores.topk(min(count, scores.shape[1]), 1)


def gather_frames(lafs: Tensor, index: Tensor) -> Tensor:
    return lafs.gather(1, index[..., None, None].expand(-1, -1, 2, 3))


def filled_slots(image: Tensor, scores: Tensor, lafs: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """Of candidates (B, M) the `count` strongest, and their frames; slots without a candidate are 0.

    A constant image has no features: what its levels differ by is rounding.
    """
    darkest, brightest = image.detach().flatten(1).aminmax(dim=1)
    missing = count - scores.shape[1]
    if missing > 0:
        scores = F.pad(scores, (0, missing), value=EMPTY)
        lafs = F.pad(lafs, (0, 0, 0, 0, 0, missing))
    best, index = strongest(scores, count)
    filled = (best > EMPTY) & (darkest != brightest)[:, None]
    return slots_of(filled, best, gather_frames(lafs, index))


def slots_of(filled: Tensor, scores: Tensor, lafs: Tensor) -> tuple[Tensor, Tensor]:
    """Scores (B, N) and frames (B, N, 2, 3) where slots are filled, 0 elsewhere."""
    zero = scores.new_zeros(())  # one number on the GPU for both
    return torch.where(filled, scores, zero), torch.where(filled[..., None, None], lafs, zero)


def compiled(op: str, modules: dict[str, nn.Module], selected: bool | Collection[str]) -> dict[str, nn.Module]:
    """The modules; those with selected names are wrapped in torch.compile. True selects all."""
    names = set(modules) if selected is True else set()
    if not isinstance(selected, bool) and selected is not None:
        if isinstance(selected, Tensor) or not isinstance(selected, Collection):
            raise _check.TypeCheckError(f"{op}: expected compile_modules to be a bool or names, got {selected!r}")
        names = set(selected)
    unknown = names - set(modules)
    if unknown:
        raise _check.ValueCheckError(
            f"{op}: compile_modules must be of {', '.join(modules)}; got {', '.join(sorted(unknown))}"
        )
    return {name: torch.compile(m, dynamic=True) if name in names else m for name, m in modules.items()}  # type: ignore[misc]
