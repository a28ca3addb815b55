"""Masks, boxes, key points and class labels that follow the images they belong to."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import accumulate, chain, islice
from typing import Any, NamedTuple

import torch
from torch import Tensor

from kvision import _check
from kvision.augmentation.sample_rows import index_of, numbers_by
from kvision.constants import DataKey
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError

BOX_FORMATS = {
    DataKey.BBOX: "vertices",
    DataKey.BBOX_XYXY: "xyxy",
    DataKey.BBOX_XYXY_PLUS: "xyxy_plus",
    DataKey.BBOX_XYWH: "xywh",
}

# Points (B, N, 2), (B, N, 3) of volumes, in coordinates of pixel centers, after a move.
PointMover = Callable[[Tensor], Tensor]
# The corners (B, N, 4, 2) of boxes after a move, and the visible fractions (B, N) of their areas or None. The second argument
# says that they are to be upright; then any points (B, N, M, 2) will do that have the box around them.
BoxMover = Callable[[Tensor, bool], tuple[Tensor, Tensor | None]]

# How far the edges of a box are from its numbers, in coordinates of pixel centers. xyxy and xywh, as COCO has them, end at the
# edges of pixels: the first pixel's center, 0, is half a pixel from its left edge, 0. xyxy_plus names the first and the last
# pixel, which both belong to the box.
_OFFSETS = {"xyxy": (-0.5, -0.5), "xywh": (-0.5, -0.5), "xyxy_plus": (-0.5, 0.5)}


_UNSIGNED = (torch.uint8, torch.uint16, torch.uint32, torch.uint64, torch.bool)


def parse_data_keys(op: str, keys: Any) -> list[DataKey]:
    """The members of DataKey that the argument `data_keys` names."""
    if isinstance(keys, str) or not isinstance(keys, Sequence) or not keys:
        raise ValueCheckError(f"{op}: expected data_keys to be a sequence of keys, got {keys!r}")
    try:
        return [DataKey.get(key) for key in keys]
    except (ValueCheckError, TypeCheckError) as error:
        listed = ", ".join(repr(name.lower()) for name in DataKey._member_map_)
        raise type(error)(f"{op}: expected data_keys to be of {listed}; got {keys!r}") from None


def move_points(points: Any, move: PointMover, numbers: int = 2) -> Any:
    """Key points (B, N, 2), (N, 2) or a list of (N, 2), of any floating-point type; those of volumes have 3 numbers.

    A further number, which says whether a point is visible, stays.
    """
    if isinstance(points, (list, tuple)):
        if not points:
            return points
        padded, _ = pad(points)
        return _rows_of(points, move_points(padded, move, numbers))
    if hasattr(points, "transform_keypoints"):  # kvision.geometry.keypoints.Keypoints
        moved = points.clone()
        moved._data = move_points(points._data, move, numbers)
        return moved
    _floating("keypoints", points)
    if points.dim() not in (2, 3) or points.shape[-1] not in (numbers, numbers + 1):
        raise ShapeError(
            f"AugmentationSequential: expected keypoints of shape (B, N, {numbers}), or (B, N, {numbers + 1}) with visibility, "
            f"got {tuple(points.shape)}"
        )
    batch = points if points.dim() == 3 else points[None]
    if points.shape[-1] == numbers:
        return _keeping_type(batch, move).reshape(points.shape)
    moved = _keeping_type(batch[..., :numbers], move)
    return torch.cat([moved, batch[..., numbers:]], -1).reshape(points.shape)


def has_visibility(points: Any, numbers: int) -> bool:
    """Whether key points have a number behind their coordinates that says whether they are visible."""
    first = points[0] if isinstance(points, (list, tuple)) and points else points
    return isinstance(first, Tensor) and first.shape[-1] == numbers + 1


def hide_points(points: Any, visible: Any, numbers: int) -> Any:
    """Key points with visibility, which is 0 where they are not visible."""
    if isinstance(points, (list, tuple)):
        return type(points)(hide_points(part, row, numbers) for part, row in zip(points, visible))
    return torch.cat([points[..., :numbers], torch.where(visible[..., None], points[..., numbers:], 0)], -1)


def visible_points(points: Any, are_visible: Callable[[Tensor], Tensor], numbers: int = 2) -> Any:
    """Which points are visible, as a function of points (B, N, 2) tells: bool (B, N), or a list of (N,)."""
    if isinstance(points, (list, tuple)):
        if not points:
            return points
        padded, sizes = pad(points)
        return type(points)(row[:n] for row, n in zip(visible_points(padded, are_visible, numbers), sizes))
    if hasattr(points, "transform_keypoints"):
        return visible_points(points._data, are_visible, numbers)
    return are_visible((points if points.dim() == 3 else points[None])[..., :numbers]).reshape(points.shape[:-1])


def move_boxes(boxes: Any, mode: str, move: BoxMover) -> tuple[Any, Tensor | None]:
    """Boxes of a mode, and the visible fractions (B, N) of their areas, with a list padded to the longest; None for all.

    Vertices are (B, N, 4, 2), other boxes (B, N, 4); without the batch, or a list of those.
    """
    if isinstance(boxes, (list, tuple)):
        if not boxes:
            return boxes, None
        padded, _ = pad(boxes)
        moved, fraction = move_boxes(padded, mode, move)
        return _rows_of(boxes, moved), fraction
    if hasattr(boxes, "transform_boxes"):  # kvision.geometry.boxes.Boxes
        if getattr(boxes, "normalized", False):
            raise ValueCheckError("AugmentationSequential: expected boxes in pixels, got normalized ones")
        moved = boxes.clone()
        moved._data, fraction = move_boxes(boxes._data, "vertices", move)
        return moved, fraction
    _check.is_tensor("AugmentationSequential", "boxes", boxes)
    trailing = (4, 2) if mode == "vertices" else (4,)
    if boxes.shape[-len(trailing) :] != trailing or boxes.dim() not in (1 + len(trailing), 2 + len(trailing)):
        raise ShapeError(
            f"AugmentationSequential: expected boxes of shape (B, N, {', '.join(map(str, trailing))}), "
            f"got {tuple(boxes.shape)}"
        )
    if 0 in boxes.shape:
        return boxes, None
    batch = boxes if boxes.dim() == 2 + len(trailing) else boxes[None]
    corners, fraction = move(box_corners(_computed(batch), mode), mode != "vertices")
    return _as_type(_upright(corners) if mode == "vertices" else _boxes_around(corners, mode), boxes), fraction


def box_edges(boxes: Any, mode: str, batch: int, given: Any = None) -> Tensor:
    """The upright boxes (B, N, 4) around boxes of a mode: left, top, right and bottom edges, in pixels; all of an image is (0, 0,
    W, H). Entries that stand for no box, all numbers of which are 0 in `boxes` or in `given`, are 0.
    """
    corners = _batch_of_corners(boxes, mode)
    if corners is None:
        return torch.zeros(batch, 0, 4, device="cpu")
    is_box = _is_given(corners, mode)
    before = None if given is None or given is boxes else _batch_of_corners(given, mode)
    if before is not None and before.shape == corners.shape:
        is_box = is_box & _is_given(before, mode).to(is_box.device)
    near, far = (
        (0.0, 1.0) if mode == "vertices" else (0.5, 0.5)
    )  # from positions that have the first pixel's center at 0
    edges = torch.cat([corners.amin(-2) + near, corners.amax(-2) + far], -1)
    return torch.where(is_box[..., None], edges, 0.0)


def _batch_of_corners(boxes: Any, mode: str) -> Tensor | None:
    """The corners (B, N, 4, 2) of boxes in any form, lists padded with those of zeros; None if there are none."""
    batch: list[Tensor] = []

    def keep(corners: Tensor, is_upright: bool) -> tuple[Tensor, None]:
        batch.append(corners)
        return corners, None

    move_boxes(boxes, mode, keep)
    return batch[0] if batch else None


def _is_given(corners: Tensor, mode: str) -> Tensor:
    """Which boxes (B, N) have a number that is not 0: others are padding, or were removed."""
    zeros = box_corners(corners.new_zeros((4, 2) if mode == "vertices" else (4,)), mode)
    return (corners != zeros).flatten(-2).any(-1)


def masks_as_batch(masks: Any, images: tuple[int, ...] | None = None) -> Tensor:
    """Masks in any form as (B, C, H, W), those of a list padded with 0 to the same number."""
    batch: list[Tensor] = []

    def keep(masks: Tensor) -> Tensor:
        batch.append(masks)
        return masks

    move_masks(masks, keep, images)
    return batch[0]


def box_corners(boxes: Tensor, mode: str) -> Tensor:
    """The corners (..., 4, 2) of boxes (..., 4), in coordinates of pixel centers; those of "vertices" as they are."""
    if mode == "vertices":
        return boxes
    near, far = _OFFSETS[mode]
    x, y, right, bottom = boxes.unbind(-1)
    if mode == "xywh":
        right, bottom = x + right, y + bottom
    x, y, right, bottom = x + near, y + near, right + far, bottom + far
    return torch.stack([x, y, right, y, right, bottom, x, bottom], -1).reshape(*boxes.shape[:-1], 4, 2)


def _boxes_around(corners: Tensor, mode: str) -> Tensor:
    """The smallest upright boxes (..., 4) around points of each, (..., M, 2)."""
    near, far = _OFFSETS[mode]
    first, last = corners.amin(-2) - near, corners.amax(-2) - far
    return torch.cat([first, last - first if mode == "xywh" else last], -1)


class BoxFilter(NamedTuple):
    """Which boxes stay after they have moved, and whether they end at the edges of the image."""

    clip: bool = False
    min_area: float = 0.0  # in pixels, of the part inside the image
    min_visibility: float = 0.0  # the fraction of the area that is inside

    @property
    def does_nothing(self) -> bool:
        return not (self.clip or self.min_area > 0 or self.min_visibility > 0)


def filter_boxes(
    boxes: Any,
    mode: str,
    size: Sequence[Any],
    rule: BoxFilter,
    fraction: Tensor | None = None,
    samples: Sequence[int] | None = None,
) -> tuple[Any, Any]:
    """Boxes in images of a size (H, W), or of two (B, 1), by a rule, and which of them stay: bool (B, N), or a list of (N,).

    `fraction` (B, N) is the visible fraction of areas before these boxes were cut off, None for 1. Lists become shorter; in
    tensors the boxes that do not stay are 0. Of others than some `samples`, if there are such, all stay as they are.
    """
    if isinstance(boxes, (list, tuple)):
        if not boxes:
            return boxes, []
        padded, sizes = pad(boxes)
        filtered, is_kept = _filtered(padded, mode, size, rule, fraction, samples)
        rows = [row[:n] for row, n in zip(is_kept, sizes)]
        return leave_boxes(_rows_of(boxes, filtered), rows), rows
    if hasattr(boxes, "transform_boxes"):  # kvision.geometry.boxes.Boxes
        filtered = boxes.clone()
        filtered._data, kept = _filtered(boxes._data, "vertices", size, rule, fraction, samples)
        return filtered, kept
    return _filtered(boxes, mode, size, rule, fraction, samples)


def leave_boxes(boxes: Any, kept: Any) -> Any:
    """Boxes that are kept: lists become shorter; in tensors the others are 0."""
    if isinstance(boxes, (list, tuple)):
        return type(boxes)(_that_stay(boxes, kept))
    return clear_boxes(boxes, kept)


def all_kept(boxes: Any, mode: str) -> Any:
    """That all boxes stay, in the shape of `filter_boxes`."""
    if isinstance(boxes, (list, tuple)):
        counts = [len(part) for part in boxes]
        device = boxes[0].device if boxes else "cpu"
        return list(torch.ones(sum(counts), dtype=torch.bool, device=device).split(counts))
    values, is_corners = (boxes, mode == "vertices") if isinstance(boxes, Tensor) else (boxes._data, True)
    return torch.ones(values.shape[: -2 if is_corners else -1], dtype=torch.bool, device=values.device)


def leave_fractions(fraction: Tensor, kept: Any, samples: Sequence[int] | None = None) -> Tensor:
    """Visible fractions (B, N) of the areas of boxes that are kept, which are 1 again of some samples."""
    if isinstance(kept, (list, tuple)):
        fraction, _ = pad(_that_stay([row[: len(own)] for row, own in zip(fraction, kept)], kept))
    return fraction if samples is None else fraction.index_fill(0, index_of(samples, fraction), 1.0)


def kept_boxes(boxes: Any, mode: str, keeps: Callable[[Tensor], Tensor | None]) -> Any:
    """Which boxes stay by their centers (B, N, 2), in the shape of `filter_boxes`; None for all."""
    edges = box_edges(boxes, mode, 0)
    kept = keeps((edges[..., :2] + edges[..., 2:]) / 2 - 0.5) if edges.shape[1] else None
    if kept is None:
        return None
    if isinstance(boxes, (list, tuple)):
        return [row[: len(part)] for row, part in zip(kept, boxes)]
    if isinstance(boxes, Tensor):
        return kept.reshape(boxes.shape[: -2 if mode == "vertices" else -1])
    return kept.reshape(boxes._data.shape[:-2])  # kvision.geometry.boxes.Boxes


def clear_boxes(boxes: Any, kept: Any) -> Any:
    """Boxes with 0 for those that do not stay, in tensors, whose shape stays; lists have none of these."""
    if isinstance(boxes, (list, tuple)):
        return boxes
    if hasattr(boxes, "transform_boxes"):  # kvision.geometry.boxes.Boxes
        cleared = boxes.clone()
        cleared._data = clear_boxes(boxes._data, kept)
        return cleared
    if kept.shape != boxes.shape[: kept.dim()]:  # boxes were mixed since
        return boxes
    axes = (..., *[None] * (boxes.dim() - kept.dim()))
    return torch.where(kept[axes], boxes, 0)


def _filtered(
    boxes: Tensor,
    mode: str,
    size: Sequence[Any],
    rule: BoxFilter,
    fraction: Tensor | None,
    samples: Sequence[int] | None,
) -> tuple[Tensor, Tensor]:
    values = _computed(boxes)
    corners = box_corners(values, mode)
    margin = 0.5 if mode == "vertices" else 0.0  # from the centers of the outermost pixels to their edges
    first, last = corners.amin(-2) - margin, corners.amax(-2) + margin
    first_inside, last_inside = _inside(first, size), _inside(last, size)
    area, whole = (last_inside - first_inside).prod(-1), (last - first).prod(-1)
    kept = (area > 0) & (area >= rule.min_area)
    if fraction is None:
        kept = kept & (area >= rule.min_visibility * whole)
    else:
        before = fraction.reshape(area.shape).to(area)
        kept = kept & (before > 0) & (area * before >= rule.min_visibility * whole)
    if rule.clip:
        center = (first_inside + last_inside) / 2
        x, y = (first_inside + margin).minimum(center).unbind(-1)
        right, bottom = (last_inside - margin).maximum(center).unbind(-1)
        inside = torch.stack([x, y, right, y, right, bottom, x, bottom], -1).reshape(corners.shape)
        values = inside if mode == "vertices" else _boxes_around(inside, mode)
    axes = (..., *[None] * (boxes.dim() - kept.dim()))
    filtered = _as_type(torch.where(kept[axes], values, 0), boxes)
    if samples is None:
        return filtered, kept
    index = index_of(samples, kept)
    kept = torch.ones_like(kept).index_copy(0, index, kept.index_select(0, index))
    return boxes.index_copy(0, index, filtered.index_select(0, index)), kept


def _inside(points: Tensor, size: Sequence[Any]) -> Tensor:
    """Points moved to the nearest position inside an image, in coordinates of pixel centers."""
    along = [x.clamp(min=-0.5).clamp(max=size[axis] - 0.5) for x, axis in zip(points.unbind(-1), (1, 0))]
    return torch.stack(along, -1)


def filter_labels(classes: Any, kept: Any) -> Any:
    """The class labels of boxes that stay; in tensors and arrays, whose shape stays, -1, "" or None for the others.

    Labels of images stay: scalars in a list, tensors of one axis or of fractions that do not begin with the shape of the boxes.

    Args:
        classes: a tensor or an array (B, N, ...), a list of sequences, arrays or tensors of the labels of each image; of one
            image without the batch a sequence, an array or a tensor of N labels.
        kept: which boxes stay, bool (B, N) or (N,), or a list of (N,).

    Raises:
        ValueError: there are more or fewer labels than boxes.
    """
    is_single = isinstance(kept, Tensor) and kept.dim() == 1
    rows: list[Tensor] = [kept] if is_single else list(kept)
    if isinstance(classes, (list, tuple)):
        of_images = [_is_sequence(part) for part in classes]
        if len(rows) == 1 and not any(of_images) and (is_single or len(classes) == len(rows[0]) > 1):
            return _filtered_labels(classes, rows[0])
        if len(classes) != len(rows):
            raise _wrong_count(f"{len(rows)} images", f"those of {len(classes)}")
        if not any(of_images):
            return classes
        if all(isinstance(part, Tensor) and len(part) == len(row) for part, row in zip(classes, rows)):
            return type(classes)(_that_stay(classes, rows))
        flags = torch.cat(rows).cpu().split([len(row) for row in rows])  # which waits for their device once
        return type(classes)(_filtered_labels(part, row) for part, row in zip(classes, flags))
    if not _is_array(classes) or classes.ndim == 0:
        return classes
    of_boxes = kept if isinstance(kept, Tensor) else _padded_rows(rows)
    if is_single and (classes.ndim > 1 and tuple(classes.shape[:2]) == (1, len(kept))):
        of_boxes = of_boxes[None]
    shape = tuple(of_boxes.shape)
    if tuple(classes.shape[: len(shape)]) == shape:
        return _marked(classes, of_boxes)
    if classes.ndim < len(shape) or _is_fraction(classes):
        return classes
    raise _wrong_count(f"shape {shape}", str(tuple(classes.shape)))


class MaskCounts(NamedTuple):
    """How many masks and how many boxes each image of a call has, before any are removed."""

    masks: list[int]
    boxes: list[int]


def count_masks(keys: Sequence[DataKey], values: Sequence[Any]) -> dict[int, MaskCounts]:
    """The counts of each input of masks (N, H, W) in a list; none where masks are no such list, or without boxes."""
    known: dict[int, MaskCounts] = {}
    for i, (key, masks) in enumerate(zip(keys, values)):
        at = boxes_of(i, [j for j, other in enumerate(keys) if other in BOX_FORMATS])
        if key == DataKey.MASK and isinstance(masks, (list, tuple)) and at is not None:
            if all(isinstance(part, Tensor) and part.dim() > 2 for part in masks):
                known[i] = MaskCounts([len(part) for part in masks], _counts_of_boxes(values[at], keys[at]))
    return known


def boxes_of(i: int, of_boxes: Sequence[int]) -> int | None:
    """The number of the input of boxes that an input of classes or masks belongs to; None if there are none."""
    before = [at for at in of_boxes if at < i]
    return before[-1] if before else next(iter(of_boxes), None)


def _counts_of_boxes(boxes: Any, key: DataKey) -> list[int]:
    if isinstance(boxes, (list, tuple)):
        return [len(part) for part in boxes]
    shape = tuple((boxes if isinstance(boxes, Tensor) else boxes._data).shape)  # or kvision.geometry.boxes.Boxes
    *batch, count = shape[: -2 if key == DataKey.BBOX or not isinstance(boxes, Tensor) else -1]
    return [count] * (batch[0] if batch else 1)


def filter_masks(masks: Any, kept: Any, counts: MaskCounts | None) -> Any:
    """The masks (N, H, W) of instances whose boxes stay, in a list of those of each image.

    Masks of images stay: those of as many channels in all images of the call, which are not those of the boxes.
    """
    if counts is None:
        return masks
    rows = [kept] if isinstance(kept, Tensor) and kept.dim() == 1 else list(kept)
    if counts.masks == counts.boxes and [len(part) for part in masks] == [len(row) for row in rows]:
        return type(masks)(_masks_that_stay(masks, rows))
    if counts.masks != counts.boxes and len(set(counts.masks)) > 1:
        raise ShapeError(
            f"AugmentationSequential: expected masks of {counts.boxes} instances, as there are boxes, got {counts.masks}"
        )
    return masks


def _is_array(labels: Any) -> bool:
    """Whether labels are a tensor or a NumPy array."""
    return isinstance(labels, Tensor) or hasattr(labels, "__array_interface__")


def _is_sequence(labels: Any) -> bool:
    return isinstance(labels, (list, tuple)) or (_is_array(labels) and labels.ndim > 0)


def _is_fraction(labels: Any) -> bool:
    return labels.is_floating_point() if isinstance(labels, Tensor) else labels.dtype.kind == "f"


def _wrong_count(expected: str, got: str) -> ShapeError:
    return ShapeError(f"AugmentationSequential: expected class of {expected}, as there are boxes, got {got}")


def _filtered_labels(labels: Any, row: Tensor) -> Any:
    """Those of the labels of one image, or of its masks, whose boxes stay."""
    if not _is_sequence(labels):
        raise TypeCheckError(
            f"AugmentationSequential: expected class of sequences for all images, got {type(labels).__name__}"
        )
    if len(labels) != len(row):
        raise _wrong_count(f"{len(row)} labels", str(len(labels)))
    if isinstance(labels, Tensor):
        return labels[row.to(labels.device)]
    if _is_array(labels):
        return labels[row.cpu().numpy()]
    return type(labels)(label for label, stays in zip(labels, row.tolist()) if stays)


def _flags(kept: Sequence[Tensor]) -> list[list[bool]]:
    """Which of the boxes of each image stay, read from their device at once."""
    flags = iter(torch.cat(list(kept)).tolist() if kept else [])
    return [list(islice(flags, len(row))) for row in kept]


def _that_stay(parts: Sequence[Tensor], kept: Sequence[Tensor]) -> list[Tensor]:
    """The rows of the parts (N, ...) of images that stay: by one copy where all have one type and form."""
    stay, flags = list(parts), _flags(kept)
    changed = [i for i, row in enumerate(flags) if not all(row)]
    groups = numbers_by((parts[i].dtype, parts[i].device, parts[i].shape[1:]) for i in changed)
    for own in [[changed[n] for n in numbers] for numbers in groups.values()]:
        together = torch.cat([parts[i] for i in own])
        index = [n for n, stays in enumerate(chain.from_iterable(flags[i] for i in own)) if stays]
        rows = together.index_select(0, index_of(index, together)) if index else together[:0]
        for i, part in zip(own, rows.split([sum(flags[i]) for i in own])):
            stay[i] = part
    return stay


def _masks_that_stay(masks: Sequence[Tensor], kept: Sequence[Tensor]) -> list[Tensor]:
    """The masks (N, H, W) of instances that stay, of one type and of the size of each image, by one copy."""
    stay, changed = list(masks), list[tuple[int, list[Tensor]]]()
    for i, (mask, row) in enumerate(zip(masks, _flags(kept))):
        planes = [plane for plane, stays in zip(mask, row) if stays]
        if len(planes) < len(mask):
            stay[i] = mask[:0]
            if planes:
                changed.append((i, planes))
    if changed:
        counts = [sum(plane.numel() for plane in planes) for _, planes in changed]
        values = torch.cat([plane.flatten() for _, planes in changed for plane in planes]).split(counts)
        for (i, planes), own in zip(changed, values):
            stay[i] = own.view(len(planes), *masks[i].shape[1:])
    return stay


def _padded_rows(rows: Sequence[Tensor]) -> Tensor:
    """Rows in one tensor, filled up with True: what is not there is not removed."""
    longest = max((len(row) for row in rows), default=0)
    if all(len(row) == longest for row in rows):
        return torch.stack(list(rows)) if rows else torch.ones(0, 0, dtype=torch.bool, device="cpu")
    return torch.stack([torch.cat([row, row.new_ones(longest - len(row))]) for row in rows])


def _marked(classes: Any, kept: Tensor) -> Any:
    """Labels in a tensor or an array, with -1, "" or None in place of those whose boxes do not stay."""
    dtype = classes.dtype
    is_tensor = isinstance(classes, Tensor)
    if dtype in _UNSIGNED if is_tensor else dtype.kind in "ub":
        raise TypeCheckError(
            f"AugmentationSequential: expected class of a signed type, as -1 marks removed boxes, got {dtype}"
        )
    if is_tensor:
        axes = (..., *[None] * (classes.ndim - kept.dim()))
        return torch.where(kept[axes].to(classes.device), classes, -1).to(dtype)
    marked = classes.copy()
    marked[~kept.cpu().numpy()] = {"U": "", "S": b"", "O": None}.get(dtype.kind, -1)
    return marked


def _computed(boxes: Tensor) -> Tensor:
    """Boxes in float32 or float64, which the formulas take."""
    if not boxes.is_floating_point():
        return boxes.double()
    return boxes if boxes.dtype == torch.float64 else boxes.float()


def _as_type(moved: Tensor, boxes: Tensor) -> Tensor:
    moved = moved.reshape(boxes.shape)
    return (moved if boxes.is_floating_point() else moved.round()).to(boxes.dtype)


def _upright(vertices: Tensor) -> Tensor:
    """The corners of boxes that a flip has mirrored, beginning top left again and going clockwise."""
    first, second, _, last = vertices.unbind(-2)
    along, down = second - first, last - first
    is_mirrored = along[..., 0] * down[..., 1] - along[..., 1] * down[..., 0] < 0
    vertices = torch.where(is_mirrored[..., None, None], vertices.flip(-2), vertices)
    start = vertices.sum(-1).argmin(-1)
    index = (start[..., None] + torch.arange(4, device=vertices.device)) % 4
    return vertices.gather(-2, index[..., None].expand(*index.shape, 2))


def _rows_of(parts: Any, padded: Any) -> Any:
    """What became of parts that were padded."""
    return type(parts)(own[: len(part)] if len(part) else part for part, own in zip(parts, padded))


def pad(parts: Sequence[Tensor]) -> tuple[Tensor, list[int]]:
    """Boxes, points or instances of each image, padded with 0 to the same number."""
    check_tensors("the labels of an image", parts)
    sizes = [len(part) for part in parts]
    shapes = {tuple(part.shape[1:]): None for part in parts if len(part)}
    if len(shapes) > 1:
        first, other, *_ = shapes
        raise ShapeError(
            f"AugmentationSequential: expected labels of images of one size, got (N, *{first}) and (N, *{other})"
        )
    known = [part for part in parts if len(part)]  # an empty one may have another type
    if not known:
        return parts[0].new_zeros(len(parts), 0, *parts[0].shape[1:]), sizes
    most, values = max(sizes), torch.cat(known)
    if len(values) < len(parts) * most:
        firsts = accumulate(sizes, initial=0)
        rows = [first + i if i < n else len(values) for first, n in zip(firsts, sizes) for i in range(most)]
        values = torch.cat([values, values.new_zeros(1, *values.shape[1:])])
        values = values.index_select(0, index_of(rows, values))
    return values.unflatten(0, (len(parts), most)), sizes


def check_one_type(key: DataKey, value: Any) -> None:
    """Raise TypeCheckError where masks, boxes or points of a list have several types, those of no elements aside."""
    if isinstance(value, (list, tuple)) and (key == DataKey.MASK or key == DataKey.KEYPOINTS or key in BOX_FORMATS):
        types = {
            part.dtype: i for i, part in reversed(list(enumerate(value))) if isinstance(part, Tensor) and len(part)
        }
        if len(types) > 1:
            (first, _), (other, at) = sorted(types.items(), key=lambda item: item[1])[:2]
            name = key.name.lower()
            raise TypeCheckError(
                f"AugmentationSequential: expected {name} of one type, got {first} and, at {at}, {other}",
                actual_type=other,
            )


def check_tensors(name: str, parts: Sequence[Any]) -> None:
    """Raise TypeCheckError unless all parts are tensors."""
    for part in parts:
        _check.is_tensor("AugmentationSequential", name, part)


def _floating(name: str, x: Any) -> None:
    _check.is_tensor("AugmentationSequential", name, x)
    if not x.is_floating_point():
        raise TypeCheckError(f"AugmentationSequential: expected {name} of a floating-point type, got {x.dtype}")


def _keeping_type(points: Tensor, move: PointMover) -> Tensor:
    """Move points in float32 or float64, which the formulas take."""
    if 0 in points.shape:
        return points
    return move(points if points.dtype == torch.float64 else points.float()).to(points.dtype)


def move_masks(masks: Any, move: Callable[[Tensor], Tensor], images: tuple[int, ...] | None) -> Any:
    """Moved masks of images of a shape: a tensor, or a list of those of the instances of each image.

    `move` takes them as (B, C, H, W) or (B, C, D, H, W).
    """
    if isinstance(masks, (list, tuple)):
        check_tensors("the masks of an image", masks)
        if len({mask.shape for mask in masks}) <= 1:
            stacked = torch.stack(list(masks)) if masks else None
            return masks if stacked is None else type(masks)(move_masks(stacked, move, images).unbind(0))
        padded, sizes = pad(masks)  # as many instances for each image
        return type(masks)(row[:n] for row, n in zip(move_masks(padded, move, images), sizes))
    check_tensors("mask", [masks])
    shape = masks.shape
    axes = 4 if images is None else len(images)
    if masks.dim() == axes - 1 and images is not None:
        # (B, H, W) of a batch, or (C, H, W) of one image; of volumes (B, D, H, W) or (C, D, H, W)
        batched = masks[:, None] if shape[0] == images[0] and shape[0] > 1 else masks[None]
    else:
        batched = masks[None, None] if masks.dim() == axes - 2 else masks
    if batched.dim() != axes:
        layout = "(B, C, H, W)" if axes == 4 else "(B, C, D, H, W)"
        raise ShapeError(f"AugmentationSequential: expected mask of shape {layout}, got {tuple(shape)}")
    if images is not None and (batched.shape[0], *batched.shape[2:]) != (images[0], *images[2:]):
        raise ShapeError(
            f"AugmentationSequential: expected mask of {images[0]} images of {tuple(images[2:])}, got {tuple(shape)}"
        )
    moved = move(batched)
    if masks.dim() < axes and moved.shape[:2] == batched.shape[:2]:
        return moved.reshape(*shape[: 2 - axes], *moved.shape[2:])
    return moved


def kept_by_both(before: dict[int, Any], after: dict[int, Any]) -> dict[int, Any]:
    """Which of the boxes stay that a part of the call has kept, and then another; those of the latter where boxes were mixed."""
    both = dict(before)
    for i, own in after.items():
        first = before.get(i)
        if isinstance(own, (list, tuple)):
            both[i] = own if not first else type(own)(_of_kept(first, own))
        else:
            both[i] = own if first is None or first.shape != own.shape else first & own
    return both


def _of_kept(first: Sequence[Tensor], own: Sequence[Tensor]) -> Sequence[Tensor]:
    """Which of the boxes of each image stay, if those of the first have become a shorter list."""
    flat = torch.cat(list(first))
    return flat.masked_scatter(flat, torch.cat(list(own))).split([len(row) for row in first])


# --- rectangles and polygons ----------------------------------------------------------------------------------------


def is_within(points: Tensor, size: Sequence[Any], margin: float = 0.5) -> Tensor:
    """Whether points (..., 2 or 3) are in an image, or up to a margin away from the centers of its outermost pixels."""
    of_axes = [(x >= -margin) & (x <= n - 1 + margin) for x, n in zip(points.unbind(-1), reversed(size))]
    return torch.stack(of_axes).all(0)


def polygon_area(polygons: Tensor) -> Tensor:
    """The areas of polygons (..., V, 2)."""
    after = polygons.roll(-1, -2)
    return (polygons[..., 0] * after[..., 1] - polygons[..., 1] * after[..., 0]).sum(-1).abs() / 2


def rectangle_around(points: Tensor) -> Tensor:
    """The corners (..., 4, 2) of the smallest upright rectangles around points (..., M, 2)."""
    (left, top), (right, bottom) = points.amin(-2).unbind(-1), points.amax(-2).unbind(-1)
    return torch.stack([left, top, right, top, right, bottom, left, bottom], -1).unflatten(-1, (4, 2))


def outward_normals(corners: Tensor) -> tuple[Tensor, Tensor]:
    """Unit vectors (..., 4, 2) to the outside of the sides of quadrilaterals, and whether these are convex, (...,)."""
    along = corners.roll(-1, -2) - corners
    after = along.roll(-1, -2)
    turn = along[..., 0] * after[..., 1] - along[..., 1] * after[..., 0]
    is_convex = (turn > 0).all(-1) | (turn < 0).all(-1)
    # To the left of each side, where the corners go clockwise on the screen.
    normals = (
        torch.stack([along[..., 1], -along[..., 0]], -1) * torch.where(turn.sum(-1) < 0, -1.0, 1.0)[..., None, None]
    )
    return normals / along.norm(dim=-1, keepdim=True).clamp(min=1e-6), is_convex


def line_corners(normals: Tensor, distances: Tensor, others: Tensor) -> Tensor:
    """The corners (..., 4, 2) at which neighboring lines meet, each at a distance along its normal; `others` if they do not."""
    before, distance = normals.roll(1, -2), distances.roll(1, -1)
    determinant = before[..., 0] * normals[..., 1] - before[..., 1] * normals[..., 0]
    x = distance * normals[..., 1] - distances * before[..., 1]
    y = distances * before[..., 0] - distance * normals[..., 0]
    meets = (determinant.abs() >= 1e-3) & x.isfinite() & y.isfinite()
    corners = torch.stack([x, y], -1) / torch.where(meets, determinant, 1.0)[..., None]
    return torch.where(meets[..., None], corners, others)


def around_outlines(corners: Tensor, is_upright: bool, count: int, move: Callable[[Tensor], Tensor]) -> Tensor:
    """Moved points of the outlines of boxes, so many on each side, of which the first is a corner.

    The box is the smallest one around them if it is upright. For others these are corners (B, N, 4, 2) around them, whose
    sides are parallel to the lines between the moved corners.
    """
    if count == 1:
        return move(corners.flatten(1, 2)).reshape(corners.shape)
    along = torch.arange(count, dtype=corners.dtype, device=corners.device)[:, None] / count
    sides = corners.roll(-1, -2) - corners
    outline = corners[..., None, :] + along * sides[..., None, :]
    moved = move(outline.flatten(1, 3)).reshape(outline.shape)
    if is_upright:
        return moved.flatten(-3, -2)
    corners = moved[..., 0, :]
    normals, _ = outward_normals(corners)
    return line_corners(normals, (moved @ normals[..., None])[..., 0].amax(-1), corners)


def clip_polygons(polygons: Tensor, size: Sequence[Any]) -> tuple[Tensor, Tensor]:
    """The parts (..., V + 4, 2) of convex polygons (..., V, 2) inside images of a size (H, W), and where there is one.

    Sizes (B, 1) are those of polygons (B, N, V, 2).

    Of V vertices and the line of an edge V + 1 vertices remain at most; the first one is repeated in place of those that do not.
    """
    is_inside = torch.ones_like(polygons[..., 0, 0], dtype=torch.bool)
    bottom, right = (n[..., None] - 0.5 if isinstance(n, Tensor) else n - 0.5 for n in size)
    for axis, edge, sign in ((0, -0.5, 1.0), (1, -0.5, 1.0), (0, right, -1.0), (1, bottom, -1.0)):
        depth = sign * (polygons[..., axis] - edge)
        other, after = depth.roll(-1, -1), polygons.roll(-1, -2)
        crosses = (depth >= 0) != (other >= 0)
        at = depth / torch.where(crosses, depth - other, 1.0)
        points = torch.stack([polygons, polygons + at[..., None] * (after - polygons)], -2).flatten(-3, -2)
        stays = torch.stack([depth >= 0, crosses], -1).flatten(-2)
        order = (~stays).to(torch.uint8).sort(dim=-1, stable=True)[1][..., : polygons.shape[-2] + 1]
        order = torch.where(stays.gather(-1, order), order, order[..., :1])
        polygons = points.gather(-2, order[..., None].expand(*order.shape, 2))
        is_inside = is_inside & stays.any(-1)
    return polygons, is_inside
