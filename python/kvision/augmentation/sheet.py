"""Sheets of the draws of an augmentation, with masks, boxes and key points drawn on the images."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from kvision import _check
from kvision.augmentation.container import AugmentationSequential, ImageSequentialBase
from kvision.augmentation.labels import BOX_FORMATS, box_corners, parse_data_keys
from kvision.augmentation.normalize import Denormalize, Normalize
from kvision.constants import DataKey
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError
from kvision.geometry.transform import resize
from kvision.io import write_image

__all__ = ["preview"]

# Colors of objects in their order: orange, blue, green, pink, yellow, purple, red, cyan.
_PALETTE = (0xFF8C00, 0x2E86FF, 0x00C853, 0xFF4FA3, 0xFFD600, 0x9C4DFF, 0xF4343C, 0x00C2D8)
_PAPER, _ACCENT = 1.0, 0xC2410C


def preview(
    augment: nn.Module,
    *inputs: Any,
    data_keys: Sequence[str | int | DataKey] | None = None,
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
    sheet = _sheet(cells, columns, gap=max(4, size // 32))
    if file is not None:
        write_image(file, sheet)
    return sheet


def draw_samples(
    augment: nn.Module,
    inputs: Sequence[Any],
    data_keys: Sequence[str | int | DataKey] | None = None,
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
    cells = [_drawn(keys, batches, 0, size, lambda x: x)]
    _frame(cells[0], max(2, size // 64))
    return cells + [_drawn(keys, results, i, size, undo) for i in range(count)]


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


# --- drawing --------------------------------------------------------------------------------------------------------


def _drawn(
    keys: Sequence[DataKey], values: Sequence[Any], i: int, size: int, undo: Callable[[Tensor], Tensor]
) -> Tensor:
    """Sample i with its labels, its longer side `size` pixels."""
    image = _rgb(undo(_unit(values[keys.index(DataKey.INPUT)][i])))
    scale = size / max(image.shape[1:])
    h, w = (max(1, round(n * scale)) for n in image.shape[1:])
    image = resize(image[None], (h, w), antialias=True)[0].clamp(0, 1)
    stroke = max(1.0, size / 110)
    for key, value in zip(keys, values):  # masks below the rest
        if key == DataKey.MASK:
            image = _with_mask(image, value[i])
    for key, value in zip(keys, values):
        if key in BOX_FORMATS:
            image = _with_boxes(image, box_corners(value[i].float(), BOX_FORMATS[key]), scale, stroke)
    for key, value in zip(keys, values):
        if key == DataKey.KEYPOINTS:
            image = _with_points(image, value[i], scale, 1.5 * stroke)
    return image


def _unit(image: Tensor) -> Tensor:
    return image.float() / 255 if image.dtype == torch.uint8 else image.float()


def _rgb(image: Tensor) -> Tensor:
    """The first three channels, or the first one three times."""
    return image[:3] if len(image) >= 3 else image[:1].expand(3, -1, -1)


def _color(i: int, like: Tensor) -> Tensor:
    return _rgb_of(_PALETTE[i % len(_PALETTE)], like)


def _rgb_of(code: int, like: Tensor) -> Tensor:
    return torch.tensor([code >> 16 & 255, code >> 8 & 255, code & 255], device=like.device)[:, None, None] / 255


def _blend(image: Tensor, color: Tensor | float, opacity: Tensor) -> Tensor:
    return image + opacity * (color - image)


def _with_mask(image: Tensor, mask: Tensor) -> Tensor:
    """The regions of a mask (C, H, W) in colors under a contour: labels, or a channel for each region."""
    labels = (mask[0] > 0.5 if mask.is_floating_point() else mask[0]).long()
    if len(mask) > 1:
        covers = mask > 0.5 if mask.is_floating_point() else mask != 0
        labels = torch.where(covers.any(0), 1 + covers.int().argmax(0), 0)
    rows, columns = (
        ((torch.arange(n, device=mask.device) + 0.5) * (m / n)).long().clamp_max(m - 1)
        for n, m in zip(image.shape[1:], labels.shape)
    )
    labels = labels[rows[:, None], columns]
    around = F.pad(labels[None, None].double(), (1, 1, 1, 1), mode="replicate")
    contour = F.max_pool2d(around, 3, 1) != -F.max_pool2d(-around, 3, 1)
    palette = torch.cat([_color(i, image) for i in range(len(_PALETTE))], 2)[:, 0]
    color = palette[:, (labels - 1) % len(_PALETTE)]
    image = _blend(image, color, 0.35 * (labels != 0))
    return _blend(image, color, 0.6 * (contour[0, 0] & (labels != 0)))


def _with_boxes(image: Tensor, corners: Tensor, scale: float, stroke: float) -> Tensor:
    """Quadrangles (N, 4, 2) of the unscaled image, as lines on a dark halo."""
    corners = _scaled(corners, scale)
    for i, box in enumerate(corners):
        extent = box.amax(0) - box.amin(0)
        if bool((extent > 0).all()):
            distance = _distance_to_sides(image, box)
            image = _blend(image, 0.0, 0.45 * _coverage(distance, 0.5 * stroke + 1))
            image = _blend(image, _color(i, image), _coverage(distance, 0.5 * stroke))
    return image


def _with_points(image: Tensor, points: Tensor, scale: float, radius: float) -> Tensor:
    """Discs with a white border at points (N, 2) of the unscaled image."""
    y, x = _pixels(image)
    for i, point in enumerate(_scaled(points, scale)):
        distance = torch.hypot(x - point[0], y - point[1])
        image = _blend(image, 0.0, 0.45 * _coverage(distance, 1.5 * radius + 1))
        image = _blend(image, 1.0, _coverage(distance, 1.5 * radius))
        image = _blend(image, _color(i, image), _coverage(distance, radius))
    return image


def _scaled(points: Tensor, scale: float) -> Tensor:
    """Points of an image on the image scaled about the edges of its pixels."""
    return (points.float() + 0.5) * scale - 0.5


def _pixels(image: Tensor) -> tuple[Tensor, Tensor]:
    y, x = (torch.arange(n, device=image.device, dtype=torch.float32) for n in image.shape[1:])
    return y[:, None], x


def _coverage(distance: Tensor, radius: float) -> Tensor:
    """How much of a pixel is nearer than a radius."""
    return (radius + 0.5 - distance).clamp(0, 1).nan_to_num(0)


def _distance_to_sides(image: Tensor, corners: Tensor) -> Tensor:
    """(H, W): the distance of each pixel to the nearest side of a quadrangle (4, 2)."""
    y, x = _pixels(image)
    nearest = torch.full((), math.inf, device=image.device)
    for start, end in zip(corners, corners.roll(-1, 0)):
        along = end - start
        dx, dy = x - start[0], y - start[1]
        t = ((dx * along[0] + dy * along[1]) / (along.square().sum() + 1e-12)).clamp(0, 1)
        nearest = torch.minimum(nearest, torch.hypot(dx - t * along[0], dy - t * along[1]))
    return nearest


# --- the sheet ------------------------------------------------------------------------------------------------------


def _frame(image: Tensor, width: int) -> None:
    accent = _rgb_of(_ACCENT, image)
    image[:, :width], image[:, -width:] = accent, accent
    image[:, :, :width], image[:, :, -width:] = accent, accent


def _sheet(cells: Sequence[Tensor], columns: int, gap: int) -> Tensor:
    """Cells row by row, each in the middle of its grid cell."""
    columns = min(columns, len(cells))
    h, w = (max(cell.shape[axis] for cell in cells) for axis in (1, 2))
    rows = -(-len(cells) // columns)
    sheet = cells[0].new_full((3, rows * (h + gap) + gap, columns * (w + gap) + gap), _PAPER)
    for i, cell in enumerate(cells):
        top = gap + i // columns * (h + gap) + (h - cell.shape[1]) // 2
        left = gap + i % columns * (w + gap) + (w - cell.shape[2]) // 2
        sheet[:, top : top + cell.shape[1], left : left + cell.shape[2]] = cell
    return sheet
