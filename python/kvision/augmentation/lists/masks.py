"""Masks of the images of a list, changed by the launches of a batch: of calls that do not move them image by image."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import reduce
from itertools import accumulate
from typing import Any

import torch
from torch import Tensor

from kvision._dtype import as_dtype, compute_dtype
from kvision.augmentation import labels
from kvision.augmentation.maps import (
    as_type_of_each,
    exact_each,
    read_labels_composed_list,
    read_labels_displaced_list,
    warp_to_sizes,
)
from kvision.augmentation.sample_rows import index_of
from kvision.core.exceptions import ShapeError
from kvision.geometry.transform.lists.arguments import sizes

# What a kernel that copies values takes masks of other types for; those of uint8 and of floating point are themselves.
_SAME_BITS = {torch.bool: torch.uint8, torch.int8: torch.uint8, torch.int32: torch.float32, torch.int64: torch.float64}


def checked_masks(masks: Any, sides: Sequence[int]) -> list[Tensor] | None:
    """Masks (N, H, W) or (H, W) of images of these sizes as (N, H, W); None if they are not of one type and device."""
    if not isinstance(masks, (list, tuple)) or 2 * len(masks) != len(sides) or {*map(type, masks)} != {Tensor}:
        return None
    if len({(m.dtype, m.device, m.dim()) for m in masks}) > 1 or masks[0].dim() not in (2, 3):
        return None
    if sizes(masks) != list(sides):
        return None
    return [m if m.dim() == 3 else m[None] for m in masks]


def masks_of_one_type(masks: Any, sides: Sequence[int]) -> list[Tensor]:
    """Masks of images of these sizes as (N, H, W), of the type that the types of all promote to."""
    labels.check_tensors("the masks of an image", masks)
    dtypes = {m.dtype for m in masks}
    if len(dtypes) > 1:
        masks = [m.to(reduce(torch.promote_types, dtypes)) for m in masks]
    checked = checked_masks([m if m.dim() == 3 else m[None] for m in masks], sides)
    if checked is None:
        raise ShapeError(
            f"AugmentationSequential: expected masks (N, H, W) of the sizes of their images, on one device, "
            f"got {[tuple(m.shape) for m in masks]}"
        )
    return checked


def filled_masks(
    masks: list[Tensor], value: float, erase: Callable[[list[Tensor], Tensor], Sequence[Tensor]]
) -> list[Tensor] | None:
    """Masks (N, H, W) with a value where `erase` sets images to values (1, 1); None if no kernel copies their type."""
    first = masks[0]
    kind = first.dtype if first.is_floating_point() else _SAME_BITS.get(first.dtype, torch.uint8)
    if kind.itemsize != first.dtype.itemsize:
        return None
    fill = torch.full((1, 1), value, dtype=first.dtype, device=first.device).view(kind)
    values = masks if kind == first.dtype else [m.view(kind) for m in masks]
    filled = erase(values, as_dtype(fill, compute_dtype(values[0])))
    return [m.view(first.dtype) for m in filled] if kind != first.dtype else list(filled)


def warped_masks(masks: list[Tensor], matrix: Tensor, size: Sequence[int], resampling: Any) -> list[Tensor]:
    """Masks (N, H, W) warped by matrices (B, 3, 3), to the height and width of each."""
    first = masks[0]
    is_bits = first.dtype == torch.bool and resampling.mode == "nearest" and resampling.fill is None
    values = [m.view(torch.uint8) for m in masks] if is_bits else exact_each(masks)
    moved = warp_to_sizes(values, matrix, size, resampling)
    return [m.view(torch.bool) for m in moved] if is_bits else as_type_of_each(moved, first.dtype)


def move_masks(masks: list[Tensor], run: Any, reading: Any) -> list[Tensor] | None:
    """Masks (N, H, W) after a run on a list, as containers read them; None where the calls of parts move them."""
    steps = [step for step in run.label_steps if not step.numbers or run.modules[step.numbers[0]]._moves_labels]
    if not steps:
        return masks
    counts = [len(m) for m in masks]
    if len({*counts}) == 1 and counts[0]:
        return _moved(masks, None, run, steps, reading)
    # Each instance is an image by itself, and one of zeros stands for none.
    none, taken = masks[0].new_zeros(1, 1, 1), [max(n, 1) for n in counts]
    planes = [plane for m in masks for plane in (m[:, None] if len(m) else [none.expand(1, *m.shape[1:])])]
    moved = _moved(planes, [b for b, n in enumerate(taken) for _ in range(n)], run, steps, reading)
    if moved is None:
        return None
    sides = [moved[end - n].shape[1:] for n, end in zip(taken, accumulate(taken))]
    values = torch.cat([plane.flatten() for plane in moved]).split([n * h * w for n, (h, w) in zip(taken, sides)])
    return [own.view(-1, *size)[:n] for own, n, size in zip(values, counts, sides)]


def _moved(
    masks: list[Tensor], owners: Sequence[int] | None, run: Any, steps: Sequence[Any], reading: Any
) -> list[Tensor] | None:
    """The same of masks of one N: those of all images, or of the images whose numbers are `owners`."""
    if any(m._is_overridden("apply_transform_mask") for m in run.modules):
        return None
    for numbers, links, resampling, _, size in steps:
        module: Any = run.modules[numbers[0]] if numbers else None
        if not links:
            moved = module._move_mask_list(masks, run.execution(numbers[0], owners), reading.fill)
            if moved is None:
                return None
            masks = moved
            continue
        if resampling is None:  # of one augmentation, which reads them by its own rule
            if not (module.moves_by_map or getattr(module, "_warps_masks", False)):
                return None
            resampling = module.resampling(module.flags)
        if owners is not None:
            size = [n for b in owners for n in size[2 * b : 2 * b + 2]]
        masks = _read(masks, links, owners, size, resampling.for_labels(reading.mode, reading.fill))
    return masks


def _read(
    masks: list[Tensor], links: Sequence[Any], owners: Sequence[int] | None, size: Sequence[int], resampling: Any
) -> list[Tensor]:
    """Masks (N, H, W) read by links of their images, or of the `owners` of each."""
    first, values = links[0], exact_each([masks[0][:0]])[0]
    is_one_map = len(links) == 1 and not isinstance(first, Tensor)
    # Coordinates of masks that are no numbers are those of images of 32 bits.
    computes = compute_dtype(values) if is_one_map or masks[0].is_floating_point() else torch.float32
    each: list[tuple[Tensor, Sequence[int]]] = []
    for link in links:
        if isinstance(link, Tensor):
            each.append((link if owners is None else link.index_select(0, index_of(owners, link)), ()))
        else:
            own = link if owners is None else link.of_rows(owners)
            each.append((own.make(values.new_empty(0, dtype=computes)), own.sides))
    if len(each) > 1:
        in_type = [(link.to(values.device, computes), sides) for link, sides in each]
        return read_labels_composed_list(masks, in_type, size, resampling)
    if is_one_map:
        return read_labels_displaced_list(masks, each[0][0], resampling)
    return warped_masks(masks, each[0][0], size, resampling)
