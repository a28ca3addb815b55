"""Objects that are dropped from images by their masks."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any, Literal

import torch
from torch import Generator, Tensor
from torch.compiler import is_compiling

from kvision._ops import FLOATS, FastPath, register
from kvision.augmentation import ranges
from kvision.augmentation.draws import mixed_words
from kvision.augmentation.engine import Execution, Params, check_images
from kvision.augmentation.erase import erase_marked_list, fill_with_maps, fill_with_noise
from kvision.augmentation.keys import Seed
from kvision.augmentation.labels import masks_as_batch
from kvision.augmentation.lists.masks import filled_masks
from kvision.augmentation.lists.sides import rows_on_device
from kvision.augmentation.occlusion.dropout_base import DropoutBase
from kvision.augmentation.random_generator.mapped import MappedGenerator
from kvision.augmentation.random_generator.occlusion import fill_maps
from kvision.augmentation.ranges import Numbers
from kvision.contrib.connected_components import connected_components
from kvision.geometry.transform.lists.arguments import largest_shape, like_batch


def _reference(
    masks: Tensor, components: Tensor | None, words: Tensor, counts: Tensor, widths: Tensor | None, most: int
) -> Tensor:
    """1 where an object of masks (B, N, H, W) int64 is dropped, bytes (B, 1, H, W).

    An object is what a mask has that is not 0; with `components` (B, 1, H, W) int64, the numbers of regions of one mask a sample,
    it is what a region has of one value. Every object has a random rank, by the words (B,); those of the highest `counts` (B,)
    ranks, at most `most`, are dropped. `widths` (B,) int64 are those of images that are padded on the right: their regions have the
    numbers that they have without padding.
    """
    is_inside = masks != 0
    if components is not None and widths is not None:
        padding = masks.shape[-1] - widths[:, None, None, None]
        components = components - (components - 1).div(masks.shape[-1], rounding_mode="trunc") * padding
    if components is None:
        objects = torch.arange(masks.shape[1], device=masks.device)[:, None, None]
    else:
        objects = components + mixed_words(masks)
    rank = torch.where(is_inside, mixed_words(objects ^ mixed_words(words.long()[:, None, None, None])), -1)
    dropped = torch.zeros_like(is_inside[:, :1])
    for i in range(most if 0 not in masks.shape else 0):
        best = rank.amax((1, 2, 3), keepdim=True)
        is_hit = (rank == best) & (best >= 0) & (i < counts[:, None, None, None])
        dropped = dropped | is_hit.any(1, keepdim=True)
        rank = torch.where(is_hit, -1, rank)
    return dropped.to(torch.uint8)


drop_objects = register(
    "drop_objects",
    _reference,
    fake=lambda masks, *_: masks.new_empty((masks.shape[0], 1, *masks.shape[2:]), dtype=torch.uint8),
    non_differentiable=(0,),
    labels=True,
    casts_outputs=True,
)
# Masks (N, h, w) or (h, w) as int64 (B, most N, height, width), and their widths (B,).
_number_masks = FastPath(
    "number_masks",
    (torch.bool, torch.uint8, torch.int8, torch.int16, torch.int32, torch.int64, *FLOATS),
)


class MaskDropout(DropoutBase, keeps_contract=True):
    """Fill random objects of the masks of images with a value, in the images and in the masks, as Albumentations' `MaskDropout`.

    An object is what one value has of a connected region of pixels that are not 0, in a mask of one channel, and a channel in a
    mask of several: parts of an instance that another one separates, and touches, are one object. Masks are those of an
    :class:`AugmentationSequential` at this step, the first ones if there are several, or `masks` of a call, (B, C, H, W) or
    (B, H, W). Boxes and key points stay. In videos each frame has objects of its own.

    Args:
        max_objects: pair of the lowest and the highest number of objects, of at least 1.
        fill: the fill value, within 0 and 1: a number, one of each channel, or 'random' for uniform noise.
        fill_mask: the value of masks where objects were; None leaves masks as they are.
        same_on_batch: all samples get the same random numbers; their objects differ.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: an argument does not have the form in Args, or is out of bounds.

    Example:
        >>> import torch, kvision as K
        >>> masks = torch.tensor([[0, 2, 0, 0, 1]]).reshape(1, 1, 1, 5)
        >>> drop = K.augmentation.MaskDropout((2, 2), p=1.0)
        >>> drop(torch.ones(1, 1, 1, 5), masks=masks)
        tensor([[[[1., 0., 1., 1., 0.]]]])
    """

    reads_labels = "masks"
    needs_masks = True

    def __init__(
        self,
        max_objects: tuple[int, int] = (1, 1),
        fill: Numbers | Literal["random"] = 0.0,
        fill_mask: float | None = 0.0,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(fill, fill_mask, p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        op = "MaskDropout"
        self.max_objects = ranges.parse_integers(op, "max_objects", max_objects, 1)
        integers = {"word": (0, 2**24 - 1), "objects": self.max_objects}  # exact in float32
        self._param_generator = MappedGenerator(integers=integers, maps=fill_maps(self.fill), op=op)

    def is_dropped(self, params: Params, shape: tuple[int, ...], device: torch.device) -> Tensor:
        dropped: Tensor = params["dropped"].to(device)
        return dropped

    def _draw_and_run(
        self,
        x: Tensor,
        seed: Seed,
        generator: Generator | None,
        flags: dict[str, Any],
        labels: Any = None,
        is_certain: bool = False,
    ) -> tuple[Tensor, Execution]:
        check_images("MaskDropout", x.shape)
        execution = self.__dict__["_execution"] = self._draw(x, seed, generator, is_certain=is_certain)
        if execution.applied:
            execution.found = self._found(self._dropped(execution, labels, x))
        return self._run(x, execution, flags), execution

    def _find_params(self, execution: Execution) -> Params:
        batch, _, height, width = execution.shape
        found = execution.found or {"dropped": torch.zeros(batch, 1, height, width, dtype=torch.bool, device="cpu")}
        params = super()._find_params(execution)
        return {**params, **self._on_device(found, params["batch_prob"].device)}

    def _params_on_device(self, x: Tensor, execution: Execution, for_users: bool = True) -> Params:
        params = super()._params_on_device(x, execution, for_users)
        return params if "dropped" in params else {**params, **(execution.found or {})}

    def _run_with_masks(
        self,
        x: Tensor,
        masks: Any,
        params: Params | None,
        seed: Seed,
        generator: Generator | None,
        is_certain: bool = False,
    ) -> tuple[Tensor, Execution]:
        if params is None:
            return self._draw_and_run(x, seed, generator, self.flags, masks, is_certain)
        execution = self.__dict__["_execution"] = self._from_params(params, x)
        return self._run(x, execution, self.flags), execution

    def _labels_of_call(self, kwargs: dict[str, Any], x: Tensor) -> Any:
        return kwargs.pop("masks", None)  # as they are: how many an image has says what an object is

    def _dropped(self, execution: Execution, masks: Any, x: Tensor) -> Tensor:
        """The pixels (B, 1, H, W) of the objects that are dropped, by masks in any form."""
        _warn_without(masks)
        batch = None if masks is None or execution.columns is None else masks_as_batch(masks, tuple(x.shape))
        if batch is None or 0 in batch.shape:
            return torch.zeros((len(x), 1, *x.shape[-2:]), dtype=torch.bool, device=x.device)
        counts = [len(m) for m in masks] if isinstance(masks, (list, tuple)) else []
        return self._dropped_among(_as_integers(batch.to(x.device)), counts, execution)

    def _dropped_among(
        self, masks: Tensor, counts: Sequence[int], execution: Execution, widths: Tensor | None = None
    ) -> Tensor:
        """The same by masks (B, N, H, W) int64, whose first ones are those of each image, as many as `counts`."""
        if masks.shape[1] == 1 or 1 not in counts:
            return self._dropped_of(masks, _regions(masks), execution, widths)
        # Images with a mask of one channel are among others with more.
        first, has_one = masks[:, :1].contiguous(), torch.tensor([n == 1 for n in counts], device="cpu")
        has_one = rows_on_device(has_one[:, None], masks, torch.bool)[:, :, None, None]
        of_regions = self._dropped_of(first, _regions(first), execution, widths)
        return torch.where(has_one, of_regions, self._dropped_of(masks, None, execution, widths))

    def _dropped_of(
        self, masks: Tensor, components: Tensor | None, execution: Execution, widths: Tensor | None = None
    ) -> Tensor:
        assert execution.columns is not None
        params = self._named(execution.columns.values, execution)
        words, counts = (params[name].to(masks.device, torch.float32) for name in ("word", "objects"))
        hit: Tensor = drop_objects(masks, components, words, counts, widths, self.max_objects[1])
        return hit.view(torch.bool)

    @staticmethod
    def _found(dropped: Tensor) -> Params:
        return {"dropped": dropped}

    # --- lists ---

    def _takes_masks(self, images: Sequence[Tensor], context: Any) -> bool:
        """Whether the masks of a call on a list are one of each image, on one device, or none."""
        masks = _masks_of(context)
        if masks is None:
            return True
        if not isinstance(masks, (list, tuple)) or len(masks) != len(images) or {*map(type, masks)} != {Tensor}:
            return False
        fit = all(m.dim() in (2, 3) and m.shape[-2:] == x.shape[-2:] for m, x in zip(masks, images))
        return fit and len({m.device for m in masks}) == 1

    def _find_in_list(self, images: Sequence[Tensor], execution: Execution, context: Any) -> Tensor:
        """The pixels (B, 1, H, W) of the objects that are dropped from a list, of the largest sides."""
        masks, (_, _, height, width) = _masks_of(context), largest_shape(images)
        _warn_without(masks)
        dropped = torch.zeros(len(images), 1, height, width, dtype=torch.bool, device=images[0].device)
        counts = [] if masks is None else _channels_of(masks)
        if any(counts) and execution.columns is not None:
            padded, widths = _padded(masks, height, width, images[0].device)
            dropped = self._dropped_among(padded, counts, execution, widths)
            if execution.chosen is not None:
                dropped = dropped & execution.chosen[:, None, None, None]
        execution.found = self._found(dropped)
        return dropped

    def _move_mask_list(self, masks: list[Tensor], execution: Execution, fill: Any) -> list[Tensor] | None:
        if self.fill_mask is None:
            return masks
        marks = self._marks(masks, execution)
        if marks.device != masks[0].device:
            return None
        return filled_masks(
            masks, self.fill_mask if fill is None else fill, lambda x, value: erase_marked_list(x, marks, value)
        )

    def _marks(self, images: Sequence[Tensor], execution: Execution) -> Tensor:
        """1 at the pixels that are dropped from images or masks of a list, (B, 1, H, W) uint8 of the largest sides."""
        if execution.found is not None:
            dropped: Tensor = execution.found["dropped"]
            return dropped.view(torch.uint8)
        given, device, (_, _, height, width) = (
            (execution.params or {})["dropped"],
            images[0].device,
            largest_shape(images),
        )
        pixels = torch.cat([x.flatten() for x in given]).to(device)  # in one copy
        each = [own.view(1, *x.shape[-2:]) for own, x in zip(pixels.split([x.numel() for x in given]), given)]
        marks = _padded(each, height, width, device)[0] != 0
        if execution.chosen is not None:
            marks = marks & execution.chosen.to(device)[:, None, None, None]
        return marks.view(torch.uint8)

    def _operates_on(self, dtype: torch.dtype) -> bool:
        return not self._is_customized()

    def _run_list(self, images: Sequence[Tensor], execution: Execution) -> list[Tensor]:
        marks = self._marks(images, execution).to(images[0].device)
        if isinstance(self.fill, str) and execution.params is not None:
            return fill_with_maps(images, lambda x, own: erase_marked_list(x, marks, own), execution.params["fill"])
        if isinstance(self.fill, str):
            return fill_with_noise(images, marks, self._pixel_noise(execution, execution.redraw, marks.device))
        return list(erase_marked_list(images, marks, self._values(like_batch(images), {})[:, :, 0, 0]))


def _masks_of(context: Any) -> Any:
    """The first masks of the images of a list, as they are by then."""
    return None if context.labels is None else context.labels.first_masks()


def _warn_without(masks: Any) -> None:
    if masks is None and not is_compiling():
        warnings.warn(
            "MaskDropout: this call has no masks, so that nothing is dropped: pass `masks=`, or in an "
            "AugmentationSequential the data key 'mask'",
            stacklevel=3,
        )


def _channels_of(masks: Sequence[Tensor]) -> list[int]:
    return [mask.shape[0] if mask.dim() == 3 else 1 for mask in masks]


def _regions(masks: Tensor) -> Tensor | None:
    """The numbers (B, 1, H, W) of the regions of masks (B, N, H, W) of one channel; None for those of several."""
    return connected_components((masks != 0).view(torch.uint8)) if masks.shape[1] == 1 else None


def _as_integers(masks: Tensor) -> Tensor:
    """Masks as int64, those of floating point by their bits: -0 is 0."""
    if masks.is_floating_point():
        masks = torch.where(masks == 0, 0, masks.float().view(torch.int32))
    return masks.long()


def _padded(masks: Sequence[Tensor], height: int, width: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """Masks (N, h, w) or (h, w) of any types as (B, most N, H, W) int64, 0 beyond each, and the widths (B,)."""
    shown = [mask for mask in masks if mask.numel()]
    has_kernel = all(map(_number_masks.serves, shown)) and {m.dtype for m in masks} <= {m.dtype for m in shown}
    if has_kernel and masks[0].device == device:
        numbers: tuple[Tensor, Tensor] = _number_masks.kernel(list(masks), height, width)
        return numbers
    # They are joined, and then each pixel reads its number.
    counts, begins, rows = _channels_of(masks), 0, []
    for mask, channels in zip(masks, counts):
        rows.append((*mask.shape[-2:], begins, channels))
        begins += mask.numel()
    joined = torch.cat([_as_integers(mask.flatten().to(device)) for mask in masks])
    of_each = rows_on_device(torch.tensor(rows, device="cpu"), joined, torch.int64)
    h, w, begin, count = (n[:, None, None, None] for n in of_each.unbind(1))
    channel, y, x = (torch.arange(n, device=device) for n in (max(counts), height, width))
    y, channel = y[:, None], channel[:, None, None]
    is_inside = (y < h) & (x < w) & (channel < count)
    at = torch.where(is_inside, begin + (channel * h + y) * w + x, 0)
    return torch.where(is_inside, joined[at], 0), of_each[:, 1]
