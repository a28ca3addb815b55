"""Instances of one sample that are pasted into another, with their masks, boxes and labels."""

from __future__ import annotations

from typing import Any

import torch
from torch import Generator, Tensor

from kvision import _check, geometry
from kvision._dtype import compute_dtype
from kvision.augmentation.draws import integer
from kvision.augmentation.engine import Execution, Params
from kvision.augmentation.keys import Seed
from kvision.augmentation.labels import BOX_FORMATS
from kvision.augmentation.mixing.mix import check_signed
from kvision.augmentation.mixing.transplantation import MaskMixBase
from kvision.augmentation.random_generator.base import RandomGeneratorBase, Shape
from kvision.augmentation.random_generator.windows import random_numbers
from kvision.constants import DataKey, DataKeys
from kvision.core.exceptions import ShapeError, ValueCheckError
from kvision.filters.smoothing.gaussian import gaussian_blur2d

__all__ = ["RandomCopyPaste"]


class _WordsGenerator(RandomGeneratorBase):
    """Draws three numbers of each sample: from two those of its instances follow, from the third its donor."""

    fields = (("words", 2), ("donor", 0))

    def draws(self, shape: Shape) -> list[Any]:
        return [integer(0, 2**24 - 1)] * 3  # exact in float32


def _other_samples(words: Tensor) -> Tensor:
    """Another sample of the batch for each, all equally likely, by words (B,) of 24 bits; of one sample itself."""
    samples = words.shape[0]
    steps = 1 + ((words.long() * (samples - 1)) >> 24)
    return (torch.arange(samples, device=words.device) + steps) % samples


class RandomCopyPaste(MaskMixBase):
    """Paste random instances of one sample into another one of the batch: simple copy-paste of instance segmentation.

    The donor of a sample is a random other one of the batch, all equally likely. What is pasted hides what was there: masks lose
    these pixels, boxes become those around what is left of their masks, and instances of which too little is left are removed. So
    of N instances there are 2 N: those of the image, and behind them those of the donor. Instances that are removed or not pasted
    have a mask and a box of zeros and the label -1. For the published recipe put scale jitter, as of :class:`RandomZoomOut` and
    :class:`RandomResizedCrop`, before it.

    Masks are those of instances, (B, N, H, W), what is not 0 is inside; boxes "bbox_xyxy" (B, N, 4), and labels "class"
    (B, N, ...) are those of the same instances, in the same order.

    Args:
        select_p: probability that an instance of the donor is pasted.
        blend_sigma: standard deviation in pixels of the Gaussian that softens the edges of what is pasted into images; 0 for none.
        min_visibility: instances of which a smaller fraction of the pixels is left are removed, and those without any.
        p: probability that a sample receives instances.
        p_batch: probability that samples of a batch do at all.
        data_keys: what the arguments of a call are; default: the first one is the image, the second one its masks.

    Raises:
        TypeError: a number is not one.
        ValueError: a probability or fraction is not within 0 and 1, `blend_sigma` is below 0; in a call, there are no masks, or
            shapes do not fit.

    Source: G. Ghiasi et al., "Simple copy-paste is a strong data augmentation method for instance segmentation" (2021).

    Example:
        >>> import torch, kvision as K
        >>> images = torch.tensor([1.0, 2.0]).reshape(2, 1, 1, 1).expand(2, 1, 1, 4)
        >>> masks = torch.tensor([[1, 1, 0, 0], [0, 1, 1, 1]]).reshape(2, 1, 1, 4)
        >>> boxes = torch.tensor([[[0.0, 0, 2, 1]], [[1.0, 0, 4, 1]]])
        >>> paste = K.augmentation.RandomCopyPaste(1.0, p=1.0, data_keys=["image", "mask", "bbox_xyxy"])
        >>> images, masks, boxes = paste(images, masks, boxes)
        >>> images[1, 0, 0], masks[1, :, 0], boxes[1]
        (tensor([1., 1., 2., 2.]), tensor([[0, 0, 1, 1],
                [1, 1, 0, 0]]), tensor([[2., 0., 4., 1.],
                [0., 0., 2., 1.]]))
    """

    def __init__(
        self,
        select_p: float = 0.5,
        blend_sigma: float = 0.0,
        min_visibility: float = 0.0,
        p: float = 0.5,
        p_batch: float = 1.0,
        data_keys: DataKeys | None = None,
        **options: Any,
    ) -> None:
        super().__init__(p, p_batch, data_keys=["input", "mask"] if data_keys is None else data_keys, **options)
        op = "RandomCopyPaste"
        self.select_p = _check.fraction(op, "select_p", select_p)
        self.min_visibility = _check.fraction(op, "min_visibility", min_visibility)
        self.blend_sigma = _check.number(op, "blend_sigma", blend_sigma)
        if self.blend_sigma < 0:
            raise ValueCheckError(f"{op}: expected blend_sigma of at least 0, got {blend_sigma}")
        self._param_generator = _WordsGenerator()

    def _run_with_masks(
        self, x: Tensor, masks: Any, params: Params | None, seed: Seed, generator: Generator | None
    ) -> tuple[Tensor, Execution]:
        masks = x[:, :0] if masks is None and params is not None else self._masks_of_call(masks)
        execution = self.__dict__["_execution"] = self._drawn(masks, params, seed, generator)
        return self._pasted(DataKey.INPUT, x, execution), execution

    def _drawn(self, masks: Tensor, params: Params | None, seed: Seed, generator: Generator | None) -> Execution:
        shape = tuple(masks.shape)
        if len(shape) != 4:
            raise ShapeError(f"RandomCopyPaste: expected masks of instances, (B, N, H, W), got {shape}")
        if params is not None:
            return Execution(shape, None, None, True, params)
        execution = self._draw(masks.new_empty(1, dtype=torch.float32).expand(shape), seed, generator)
        columns, applied = execution.columns, execution.applied
        selected = torch.zeros(shape[:2], dtype=torch.bool, device=masks.device)
        donors = torch.arange(shape[0], device=masks.device)
        if applied and columns is not None and shape[0]:
            donors = _other_samples(columns.values[:, 2])
            selected = random_numbers(columns.values[:, :2], shape[1]) < self.select_p
            if columns.chosen is not None:
                selected = selected & (columns.chosen[:, None] > 0.5)
        inside = masks != 0
        theirs = inside[donors]
        selected = selected & theirs.flatten(2).any(2)
        pasted = (theirs & selected[..., None, None]).any(1, keepdim=True)
        visible = inside & ~pasted
        before, after = (x.flatten(2).sum(2, dtype=torch.int32) for x in (inside, visible))
        is_left = (after > 0) & (after >= self.min_visibility * before)
        boxes = (
            geometry.masks_to_boxes(visible, "xyxy")
            if visible.numel()
            else torch.zeros(*shape[:2], 4, device=masks.device)
        )
        execution.params = {
            "donors": donors,
            "selected": selected,  # of the donor's instances
            "pasted": pasted,
            "kept": is_left | (before == 0),  # of those of the image; what has no pixels stays
            "is_cut": after < before,
            "boxes": boxes,  # around what is left
            "batch_prob": torch.full((shape[0],), float(applied), device="cpu")
            if columns is None or columns.chosen is None
            else columns.chosen,
            "forward_input_shape": torch.tensor(shape, device="cpu"),
        }
        return execution

    def _pasted(self, key: DataKey, x: Tensor, execution: Execution) -> Tensor:
        assert execution.params is not None
        indices, selected, pasted, kept, is_cut, boxes = (
            execution.params[name].to(x.device) for name in ("donors", "selected", "pasted", "kept", "is_cut", "boxes")
        )
        if key == DataKey.INPUT:
            shape = pasted.shape[0], x.shape[1] if x.dim() > 1 else 0, *pasted.shape[2:]
        else:
            shape = *selected.shape, *(pasted.shape[2:] if key == DataKey.MASK else x.shape[2:])
        self._check_shape(key, x, shape)
        donors = x[indices]
        if key == DataKey.INPUT:
            return self._blended(x, donors, pasted)
        axes = (..., *[None] * (x.dim() - 2))
        if key == DataKey.MASK:
            own = x.masked_fill(~kept[axes] | pasted, 0)
            return torch.cat([own, donors.masked_fill(~selected[axes], 0)], 1)
        if key in BOX_FORMATS:
            self._check_xyxy({"mode": key})
            own = torch.where(is_cut[..., None], boxes.to(x.dtype), x)
            return torch.cat([torch.where(kept[..., None], own, 0), torch.where(selected[..., None], donors, 0)], 1)
        if key == DataKey.CLASS:
            check_signed("RandomCopyPaste", x)
            return torch.cat([torch.where(kept[axes], x, -1), torch.where(selected[axes], donors, -1)], 1)
        raise self._refuse("key points")

    def _check_shape(self, key: DataKey, x: Tensor, shape: tuple[int, ...]) -> None:
        if tuple(x.shape) != tuple(shape):
            name = key.name.lower()
            raise ShapeError(
                f"RandomCopyPaste: expected {name} of shape {tuple(shape)}, as there are masks, got {tuple(x.shape)}"
            )

    def _blended(self, x: Tensor, donors: Tensor, pasted: Tensor) -> Tensor:
        if not self.blend_sigma:
            return torch.where(pasted, donors, x)
        side = 2 * int(4 * self.blend_sigma + 0.5) + 1
        alpha = gaussian_blur2d(pasted.to(compute_dtype(x)), (side, side), (self.blend_sigma,) * 2, "replicate")
        y = torch.lerp(x.to(alpha), donors.to(alpha), alpha)
        return y.round_().to(x.dtype) if x.dtype == torch.uint8 else y.to(x.dtype)

    def _mixed_labels(self, key: DataKey, labels: Any, execution: Execution, boxes: int | None) -> Any:
        self._check_labels(key, labels, execution.shape[0])
        return self._pasted(key, labels, execution)
