"""Sets rectangles of images, the lines of grids or marked pixels to a value or to noise."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor

from kvision._constants import constant
from kvision._dtype import compute_dtype
from kvision._list_ops import ListOperator
from kvision._ops import Operator, match_layout, register, saturate_to_byte
from kvision.augmentation.lists.pixels import PixelRow
from kvision.augmentation.noise import UNIT, PixelNoise, of_sample_of_list, uniform_noise
from kvision.geometry.transform.lists.arguments import fake_results, like_batch, row, sizes
from kvision.geometry.transform.lists.kept_sizes import Operation, register_list


def is_erased(images: Tensor, boxes: Tensor) -> Tensor:
    """Which pixels (B, 1, H, W) lie in one of the boxes (B, N, 4) of their sample: x, y, width, height."""
    height, width = images.shape[-2:]
    x, y, w, h = boxes.double().unbind(2)

    def reaches(first: Tensor, side: Tensor, size: int) -> Tensor:
        at = torch.arange(size, device=images.device)
        return ((at >= first[..., None]) & (at < (first + side)[..., None])).float()

    # How many boxes there are at a pixel: one product of matrices for any number of boxes.
    return (reaches(y, h, height).mT @ reaches(x, w, width) > 0)[:, None]


def is_line(images: Tensor, grids: Tensor) -> Tensor:
    """Which pixels (B, 1, H, W) lie on the lines of a grid that is turned about the center.

    Grids (B, 5) have the width of lines as a fraction of a cell, the angle, the offsets along x and y in cells, and how many cells
    the shorter side has.
    """
    height, width = images.shape[-2:]
    of_line, angle, offset_x, offset_y, number = grids.double()[:, :, None, None].unbind(1)
    cell = (min(height, width) / number).floor().clamp(min=2)
    line = (cell * of_line).floor().clamp(min=1)
    center_y, center_x = (height - 1) / 2, (width - 1) / 2
    y = torch.arange(height, dtype=torch.float64, device=images.device)[:, None] - center_y
    x = torch.arange(width, dtype=torch.float64, device=images.device) - center_x
    cos, sin = angle.cos(), angle.sin()
    along_x = (cos * x - sin * y + center_x).round() - (offset_x * cell).floor()
    along_y = (sin * x + cos * y + center_y).round() - (offset_y * cell).floor()
    return ((along_x.remainder(cell) < line) | (along_y.remainder(cell) < line))[:, None]


def erased_where(erasing: Operation, chosen: Tensor | None) -> Operation:
    """The same, but for samples that are not chosen (B,), which stay as they are; None for all."""
    if chosen is None:
        return erasing
    parts, values = erasing.arguments
    own = torch.where(chosen[(...,) + (None,) * (parts.dim() - 1)], parts, torch.nan)  # which erases nothing
    return erasing._replace(arguments=(own, values))


def _gradients(
    erase: Operator, needs: Sequence[bool], grad: Tensor, parts: Tensor, values: Tensor
) -> list[Tensor | None]:
    kept = erase(grad, parts, torch.zeros_like(values))
    if not needs[2]:
        return [kept, None, None]
    return [kept, None, (grad - kept).to(values.dtype).sum((2, 3)).sum_to_size(values.shape)]


def _register_eraser(name: str, is_part: Callable[[Tensor, Tensor], Tensor]) -> Operator:
    """The operator that sets parts of images to values (B, C), or (B, 1) for all channels, in the units of the images."""

    def reference(images: Tensor, parts: Tensor, values: Tensor) -> Tensor:
        if images.dtype == torch.uint8:
            values = saturate_to_byte(values)
        filled = torch.where(is_part(images, parts), values.to(images.dtype)[:, :, None, None], images)
        return match_layout(filled, images)

    def backward(
        needs: Sequence[bool], grad: Tensor, images: Tensor, parts: Tensor, values: Tensor
    ) -> list[Tensor | None]:
        return _gradients(erase, needs, grad, parts, values)

    erase = register(name, reference, backward=backward, bytes=True, casts_outputs=True)
    return erase


erase_rectangles = _register_eraser("erase_rectangles", is_erased)
erase_grid = _register_eraser("erase_grid", is_line)


def _of_sample(b: int, parts: Tensor, values: Tensor) -> tuple[Tensor, Tensor]:
    return row(parts, b), row(values, b)


def _register_list(name: str, erase: Operator) -> ListOperator:
    def gradients(needs: Sequence[bool], grad: Tensor, images: Tensor, *args: Tensor) -> list[Tensor | None]:
        return _gradients(erase, needs, grad, *args)

    def of_images(grads: Sequence[Tensor], images: Sequence[Tensor], parts: Tensor, values: Tensor) -> Sequence[Tensor]:
        return of_list(grads, parts, torch.zeros_like(values))

    of_list = register_list(name, erase, _of_sample, gradients, of_images=of_images)
    return of_list


_rectangles_of_list = _register_list("erase_rectangles_list", erase_rectangles)
_grids_of_list = _register_list("erase_grid_list", erase_grid)


# Pixels that are marked, (B, 1, H, W) uint8 for the largest sides: of lists only.


def is_marked(images: Tensor, marks: Tensor) -> Tensor:
    """Which pixels (B, 1, H, W) marks of at least their sizes are not 0 at."""
    return marks[..., : images.shape[2], : images.shape[3]] != 0


def _marked_reference(images: Sequence[Tensor], marks: Tensor, values: Tensor) -> list[Tensor]:
    results = []
    for b, x in enumerate(images):
        own = saturate_to_byte(values) if x.dtype == torch.uint8 else values
        is_part = is_marked(x[None], row(marks, b))[0]
        results.append(torch.where(is_part, row(own, b)[0, :, None, None].to(x.dtype), x))
    return results


def _marked_gradients(
    needs: Sequence[bool], grads: Sequence[Tensor], images: Sequence[Tensor], marks: Tensor, values: Tensor
) -> list[Any]:
    kept = erase_marked_list(grads, marks, torch.zeros_like(values))
    if not needs[2]:
        return [kept, None, None]
    of_values = [(g - own).to(values.dtype).sum((1, 2)) for g, own in zip(grads, kept)]
    return [kept, None, torch.stack(of_values).sum_to_size(values.shape)]


erase_marked_list = ListOperator(
    "erase_marked_list",
    erase_rectangles,
    _marked_reference,
    fake=lambda images, *args: fake_results(images, sizes(images)),
    backward=_marked_gradients,
)


# Uniform noise in [0, 1] in place of a value. Arguments: images; parts: boxes, grids or marks; parameters, keys, seeds and plan of
# noise.py.


def _filled_reference(
    images: Sequence[Tensor],
    parts: Tensor,
    parameters: Tensor,
    keys: Tensor,
    seeds: Tensor | None,
    plan: Sequence[int],
) -> list[Tensor]:
    is_part = {3: is_erased, 2: is_line, 4: is_marked}[parts.dim()]
    results = []
    for b, x in enumerate(images):
        own = of_sample_of_list(b, parameters, keys, seeds, None, plan)
        noise = uniform_noise.reference(torch.zeros_like(x)[None], *own)
        results.append(torch.where(is_part(x[None], row(parts, b)), noise, x[None])[0])
    return results


def _eraser_of(parts: Tensor) -> Any:
    """The operator on lists that sets such parts to values."""
    return {3: _rectangles_of_list, 2: _grids_of_list, 4: erase_marked_list}[parts.dim()]


def _filled_gradients(
    needs: Sequence[bool], grads: Sequence[Tensor], images: Sequence[Tensor], parts: Tensor, *args: Any
) -> list[Any]:
    kept = _eraser_of(parts)(grads, parts, constant(((0.0,),), grads[0], compute_dtype(grads[0])))
    return [kept, *(None,) * (len(needs) - 1)]


fill_with_noise_list = ListOperator(
    "fill_with_noise_list",
    erase_rectangles,
    _filled_reference,
    fake=lambda images, *args: fake_results(images, sizes(images)),
    backward=_filled_gradients,
)


def fill_with_noise(images: Sequence[Tensor], parts: Tensor, noise: PixelNoise) -> list[Tensor]:
    """Images of a list whose parts are set to uniform noise, float32 as `_params` have it."""
    if images[0].dtype == torch.float64:
        maps = noise.uniform_list([tuple(x.shape) for x in images])
        return fill_with_maps(images, lambda x, value: _eraser_of(parts)(x, parts, value), maps)
    keys, seeds, _, plan = noise.arguments(form=UNIT)
    like = like_batch(images)
    parameters = constant(((0.0, 1.0),), like, compute_dtype(like))
    return list(fill_with_noise_list(images, parts, parameters, keys, seeds, plan))


def fill_with_maps(
    images: Sequence[Tensor], erase: Callable[[list[Tensor], Tensor], Sequence[Tensor]], maps: Any
) -> list[Tensor]:
    """Images of a list with maps in [0, 1] where `erase` sets images to values (1, 1)."""
    row = PixelRow(images)
    x = row.of(images)
    marks = row.of(erase(row.split(torch.zeros_like(x, dtype=torch.uint8)), constant(((1.0,),), x, torch.float32)))
    values = row.of_maps(maps).to(compute_dtype(x))
    values = (255 * values).round() if x.dtype == torch.uint8 else values
    return row.split(torch.where(marks != 0, values.to(x.dtype), x))
