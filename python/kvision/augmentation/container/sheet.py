"""Sheets of the draws of an augmentation, with masks, boxes and key points drawn on the images."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor, nn

from kvision import _check
from kvision.augmentation.container import AugmentationSequential, ImageSequentialBase
from kvision.augmentation.labels import BOX_FORMATS, box_corners, parse_data_keys
from kvision.augmentation.normalize import Denormalize, Normalize
from kvision.constants import DataKey, DataKeys
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError
from kvision.core.pixels import to_unit
from kvision.image import drawing
from kvision.io import write_image

__all__ = ["preview"]


def preview(
    augment: nn.Module,
    *inputs: Any,
    data_keys: DataKeys | None = None,
    count: int = 8,
    columns: int = 3,
    size: int = 256,
    seed: int | None = None,
    file: str | os.PathLike[str] | None = None,
) -> Tensor:
    """Draw a sheet of an image and of `count` draws of its augmentation, with masks, boxes and key points on them.

    Objects have the same color in all cells: boxes and key points by their position, masks by their value. The first cell, in
    a frame, is the image before the augmentation. A `Normalize` at the end of a pipeline is undone; other values outside
    [0, 1] are clamped.

    Args:
        augment: an augmentation, a container or any module of images.
        *inputs: what a call of the pipeline gets: an image (C, H, W) and its labels without the axis of the batch, or
            batches, whose samples take turns.
        data_keys: what the inputs are, as in `AugmentationSequential`; default: the keys of the pipeline, or one image.
        count: how many draws.
        columns: cells in a row.
        size: the longer side of a cell, in pixels.
        seed: an int from which all draws follow; default: torch's generator draws a key.
        file: an image file to write the sheet to as well.

    Returns:
        The sheet, RGB (3, h, w), float32 in [0, 1], on the device of the image.

    Raises:
        TypeError: `augment` is not a module, an input is of another type than its key says.
        ValueError: the number of inputs is not that of the keys; `count`, `columns` or `size` is not positive.

    Example:
        >>> import torch, kvision as K
        >>> augment = K.augmentation.RandomAffine(30.0, p=1.0)
        >>> box = torch.tensor([[2.0, 2.0, 9.0, 7.0]])
        >>> K.augmentation.preview(augment, torch.rand(3, 12, 16), box, data_keys=["image", "bbox_xyxy"], size=64).shape
        torch.Size([3, 160, 208])
    """
    count = _check.scalar("preview", "count", count)
    columns = _check.scalar("preview", "columns", columns)
    size = _check.scalar("preview", "size", size)
    for name, value in (("count", count), ("columns", columns), ("size", size)):
        if not isinstance(value, int) or value < 1:
            raise ValueCheckError(f"preview: expected {name} to be a positive int, got {value!r}")
    cells = draw_samples(augment, inputs, data_keys, count, size, seed)
    sheet = drawing.sheet_of(cells, columns, gap=max(4, size // 32))
    if file is not None:
        write_image(file, sheet)
    return sheet


def draw_samples(
    augment: nn.Module,
    inputs: Sequence[Any],
    data_keys: DataKeys | None = None,
    count: int = 8,
    size: int = 256,
    seed: int | None = None,
) -> list[Tensor]:
    """The image before the augmentation and `count` draws, RGB (3, h, w) with the labels drawn on them."""
    if not isinstance(augment, nn.Module):
        raise TypeCheckError(f"preview: expected augment to be a module, got {type(augment).__name__}")
    if data_keys is None:
        data_keys = getattr(augment, "data_keys", None) or [DataKey.INPUT]
    keys = parse_data_keys("preview", data_keys)
    if len(keys) != len(inputs) or DataKey.INPUT not in keys:
        raise ValueCheckError(
            f"preview: expected an image and its labels for the keys {[key.name.lower() for key in keys]}, "
            f"got {len(inputs)} inputs"
        )
    image = inputs[keys.index(DataKey.INPUT)]
    _check.is_tensor("preview", "the image", image)
    if image.dim() not in (3, 4) or 0 in image.shape:
        raise ShapeError(f"preview: expected an image of shape (C, H, W) or (B, C, H, W), got {tuple(image.shape)}")
    batch = 1 if image.dim() == 3 else len(image)
    batches = [_as_batch(key, value, image.dim() == 3) for key, value in zip(keys, inputs)]
    pipeline = augment
    if not hasattr(augment, "data_keys"):
        children = augment if isinstance(augment, nn.Sequential) and not _is_container(augment) else [augment]
        pipeline = AugmentationSequential(*children, data_keys=keys)
    with torch.no_grad():
        results = pipeline(*(_repeated(value, batch, count) for value in batches), data_keys=keys, seed=seed)
    results = [results] if len(keys) == 1 else results
    image_at = keys.index(DataKey.INPUT)
    if isinstance(results[image_at], tuple):  # with its matrix
        results[image_at], _ = results[image_at]
    undo = _undo(augment)
    before = drawing.framed(_drawn(keys, batches, 0, size, lambda x: x), max(2, size // 64))
    return [before] + [_drawn(keys, results, i, size, undo) for i in range(count)]


def _is_container(module: nn.Module) -> bool:
    return isinstance(module, ImageSequentialBase)


def _undo(augment: nn.Module) -> Callable[[Tensor], Tensor]:
    """What brings the results of a pipeline back to [0, 1]: the inverse of a Normalize at its end."""
    modules = list(augment.modules())
    last = modules[-1] if modules else augment
    if not isinstance(last, Normalize):
        return lambda x: x
    return Denormalize(last.flags["mean"], last.flags["std"], keepdim=True)


# --- inputs ---------------------------------------------------------------------------------------------------------


def _as_batch(key: DataKey, value: Any, alone: bool) -> Any:
    """An input with the axis of the batch, which those of one image may lack."""
    if not isinstance(value, Tensor):
        if not isinstance(value, (list, tuple)) and key in (DataKey.MASK, DataKey.KEYPOINTS, *BOX_FORMATS):
            _check.is_tensor("preview", key.name.lower(), value)
        return value
    if key == DataKey.MASK:
        if value.dim() == 2:
            return value[None, None]
        if value.dim() == 3:
            return value[None] if alone else value[:, None]
        return value
    axes = {DataKey.INPUT: 4, DataKey.KEYPOINTS: 3, **dict.fromkeys(BOX_FORMATS, 3), DataKey.BBOX: 4}
    return value[None] if value.dim() == axes.get(key, 0) - 1 else value


def _repeated(value: Any, batch: int, count: int) -> Any:
    """Sample i % batch for each draw i."""
    turns = [i % batch for i in range(count)]
    if isinstance(value, (list, tuple)):
        return [value[i] for i in turns]
    if isinstance(value, Tensor) and value.dim() and len(value) == batch:
        return value[torch.tensor(turns, device=value.device)]
    return value


def _drawn(
    keys: Sequence[DataKey], values: Sequence[Any], i: int, size: int, undo: Callable[[Tensor], Tensor]
) -> Tensor:
    """Sample i with its labels, its longer side `size` pixels."""
    pairs = [
        (key, value[i]) for key, value in zip(keys, values) if key in (DataKey.MASK, DataKey.KEYPOINTS, *BOX_FORMATS)
    ]
    return drawing.with_labels(
        drawing.rgb(undo(to_unit(values[keys.index(DataKey.INPUT)][i]).float())),
        size,
        [value for key, value in pairs if key == DataKey.MASK],
        [box_corners(value.float(), BOX_FORMATS[key]) for key, value in pairs if key in BOX_FORMATS],
        [value for key, value in pairs if key == DataKey.KEYPOINTS],
    )
