"""Masks, boxes, key points and class labels that follow the images they belong to."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from kvision import _check
from kvision.constants import DataKey
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError

BOX_FORMATS = {
    DataKey.BBOX: "vertices",
    DataKey.BBOX_XYXY: "xyxy",
    DataKey.BBOX_XYXY_PLUS: "xyxy_plus",
    DataKey.BBOX_XYWH: "xywh",
}

# Boxes and points become points (B, M, 2) in coordinates of pixel centers, move with the image, and become boxes again.
Mover = Callable[[Tensor], Tensor]
CURVED = 16  # points on each side of a box that moves by a map, which bends its sides

# How far the edges of a box are from its numbers, in coordinates of pixel centers. xyxy and xywh, as COCO has them, end at the
# edges of pixels: the first pixel's center, 0, is half a pixel from its left edge, 0. xyxy_plus names the first and the last
# pixel, which both belong to the box.
_OFFSETS = {"xyxy": (-0.5, -0.5), "xywh": (-0.5, -0.5), "xyxy_plus": (-0.5, 0.5)}


def parse_data_keys(op: str, keys: Any) -> list[DataKey]:
    """The members of DataKey that the argument `data_keys` names."""
    if isinstance(keys, str) or not isinstance(keys, Sequence) or not keys:
        raise ValueCheckError(f"{op}: expected data_keys to be a sequence of keys, got {keys!r}")
    try:
        return [DataKey.get(key) for key in keys]
    except (ValueCheckError, TypeCheckError) as error:
        listed = ", ".join(repr(name.lower()) for name in DataKey._member_map_)
        raise type(error)(f"{op}: expected data_keys to be of {listed}; got {keys!r}") from None


def move_points(points: Any, move: Mover, numbers: int = 2) -> Any:
    """Key points (B, N, 2), (N, 2) or a list of (N, 2), of any floating-point type; those of volumes have 3 numbers."""
    if isinstance(points, (list, tuple)):
        if not points:
            return points
        padded, sizes = pad(points)
        moved = move_points(padded, move, numbers)
        return type(points)(m[:n] for m, n in zip(moved, sizes))
    if hasattr(points, "transform_keypoints"):  # kvision.geometry.keypoints.Keypoints
        moved = points.clone()
        moved._data = move_points(points._data, move, numbers)
        return moved
    _floating("keypoints", points)
    if points.shape[-1] != numbers or points.dim() not in (2, 3):
        raise ShapeError(
            f"AugmentationSequential: expected keypoints of shape (B, N, {numbers}), got {tuple(points.shape)}"
        )
    batch = points if points.dim() == 3 else points[None]
    return _keeping_type(batch, move).reshape(points.shape)


def visible_points(before: Any, after: Any, back: Mover, size: tuple[int, ...]) -> Any:
    """Which moved points are inside images of a size (H, W) or (D, H, W), as they were before the move.

    bool (B, N), or a list of (N,). A map that folds may show what was at a point nowhere; the point found for it is moved
    back to another position.
    """
    if isinstance(after, (list, tuple)):
        if not after:
            return after
        (padded, sizes), (start, _) = pad(after), pad(before)
        return type(after)(row[:n] for row, n in zip(visible_points(start, padded, back, size), sizes))
    if hasattr(after, "transform_keypoints"):
        return visible_points(before._data, after._data, back, size)
    points = after if after.dim() == 3 else after[None]
    of_axes = [(x >= -0.5) & (x <= n - 0.5) for x, n in zip(points.unbind(-1), reversed(size))]
    inside = torch.stack(of_axes).all(0)
    miss = (_keeping_type(points, back) - before.reshape(points.shape)).abs().amax(-1)
    return (inside & (miss < 0.5)).reshape(after.shape[:-1])


def move_boxes(boxes: Any, mode: str, move: Mover, points_of_side: int = 1) -> Any:
    """Boxes of a mode: vertices (B, N, 4, 2), or (B, N, 4); without the batch, or a list of those.

    Upright boxes are the smallest around so many points on each side, of which the first is a corner. The sides of vertices
    move outward until these points are inside.
    """
    if isinstance(boxes, (list, tuple)):
        if not boxes:
            return boxes
        padded, sizes = pad(boxes)
        moved = move_boxes(padded, mode, move, points_of_side)
        return type(boxes)(m[:n] for m, n in zip(moved, sizes))
    if hasattr(boxes, "transform_boxes"):  # kvision.geometry.boxes.Boxes
        if getattr(boxes, "normalized", False):
            raise ValueCheckError("AugmentationSequential: expected boxes in pixels, got normalized ones")
        moved = boxes.clone()
        moved._data = move_boxes(boxes._data, "vertices", move, points_of_side)
        return moved
    _check.is_tensor("AugmentationSequential", "boxes", boxes)
    trailing = (4, 2) if mode == "vertices" else (4,)
    if boxes.shape[-len(trailing) :] != trailing or boxes.dim() not in (1 + len(trailing), 2 + len(trailing)):
        raise ShapeError(
            f"AugmentationSequential: expected boxes of shape (B, N, {', '.join(map(str, trailing))}), "
            f"got {tuple(boxes.shape)}"
        )
    batch = boxes if boxes.dim() == 2 + len(trailing) else boxes[None]
    values = batch if batch.is_floating_point() else batch.double()
    corners = box_corners(values, mode)
    along = torch.arange(points_of_side, dtype=corners.dtype, device=corners.device)[:, None] / points_of_side
    sides = corners.roll(-1, -2) - corners
    outline = corners[..., None, :] + along * sides[..., None, :] if points_of_side > 1 else corners[..., None, :]
    b, n = batch.shape[:2]
    moved = _keeping_type(outline.reshape(b, n * 4 * points_of_side, 2), move).reshape(b, n, 4, points_of_side, 2)
    if mode == "vertices":
        corners = moved[..., 0, :] if points_of_side == 1 else _quadrangles_around(moved)
        return _as_type(_upright(corners), boxes)
    return _as_type(_boxes_around(moved.flatten(-3, -2), mode), boxes)


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


def _quadrangles_around(outline: Tensor) -> Tensor:
    """The corners (..., 4, 2) of quadrangles around points on their bent sides (..., 4, M, 2), the first a corner each.

    The sides are parallel to the lines between the corners, and as far outward as the points are.
    """
    corners = outline[..., 0, :]
    along = corners.roll(-1, -2) - corners
    after = along.roll(-1, -2)
    area = (along[..., 0] * after[..., 1] - along[..., 1] * after[..., 0]).sum(-1, keepdim=True)
    # A unit vector to the outside of each side: to the left of it, where the corners go clockwise on the screen.
    normal = torch.stack([along[..., 1], -along[..., 0]], -1) * torch.where(area < 0, -1.0, 1.0)[..., None]
    normal = normal / along.norm(dim=-1, keepdim=True).clamp(min=1e-6)
    excess = ((outline - corners[..., None, :]) * normal[..., None, :]).sum(-1).amax(-1).clamp(min=0)
    # A corner moves to where the lines of its two sides meet.
    before, distance = normal.roll(1, -2), excess.roll(1, -1)
    determinant = before[..., 0] * normal[..., 1] - before[..., 1] * normal[..., 0]
    x = distance * normal[..., 1] - excess * before[..., 1]
    y = excess * before[..., 0] - distance * normal[..., 0]
    is_flat = determinant.abs() < 1e-3
    step = torch.stack([x, y], -1) / torch.where(is_flat, 1.0, determinant)[..., None]
    return corners + torch.where(is_flat[..., None], 0.0, step)


class BoxFilter(NamedTuple):
    """Which boxes stay after they have moved, and whether they end at the edges of the image."""

    clip: bool = False
    min_area: float = 0.0  # in pixels, of the part inside the image
    min_visibility: float = 0.0  # the fraction of the area that is inside

    @property
    def does_nothing(self) -> bool:
        return not (self.clip or self.min_area > 0 or self.min_visibility > 0)


def filter_boxes(boxes: Any, mode: str, size: tuple[int, ...], rule: BoxFilter) -> tuple[Any, Any]:
    """Boxes in images of a size (H, W) by a rule, and which of them stay: bool (B, N), or a list of (N,).

    Lists become shorter; in tensors the boxes that do not stay are 0.
    """
    if isinstance(boxes, (list, tuple)):
        pairs = [_filtered(part, mode, size, rule) for part in boxes]
        return type(boxes)(part[kept] for part, kept in pairs), [kept for _, kept in pairs]
    if hasattr(boxes, "transform_boxes"):  # kvision.geometry.boxes.Boxes
        filtered = boxes.clone()
        filtered._data, kept = _filtered(boxes._data, "vertices", size, rule)
        return filtered, kept
    return _filtered(boxes, mode, size, rule)


def _filtered(boxes: Tensor, mode: str, size: tuple[int, ...], rule: BoxFilter) -> tuple[Tensor, Tensor]:
    values = boxes if boxes.dtype == torch.float64 else boxes.float() if boxes.is_floating_point() else boxes.double()
    corners = box_corners(values, mode)
    margin = 0.5 if mode == "vertices" else 0.0  # from the centers of the outermost pixels to their edges
    first, last = corners.amin(-2) - margin, corners.amax(-2) + margin
    first_inside, last_inside = _inside(first, size), _inside(last, size)
    area, whole = (last_inside - first_inside).prod(-1), (last - first).prod(-1)
    kept = (area > 0) & (area >= rule.min_area) & (area >= rule.min_visibility * whole)
    if rule.clip:
        center = (first_inside + last_inside) / 2
        x, y = (first_inside + margin).minimum(center).unbind(-1)
        right, bottom = (last_inside - margin).maximum(center).unbind(-1)
        inside = torch.stack([x, y, right, y, right, bottom, x, bottom], -1).reshape(corners.shape)
        values = inside if mode == "vertices" else _boxes_around(inside, mode)
    axes = (..., *[None] * (boxes.dim() - kept.dim()))
    return _as_type(torch.where(kept[axes], values, 0).to(values), boxes).to(boxes.dtype), kept


def _inside(points: Tensor, size: tuple[int, ...]) -> Tensor:
    """Points moved to the nearest position inside an image, in coordinates of pixel centers."""
    x, y = points.unbind(-1)
    return torch.stack([x.clamp(-0.5, size[1] - 0.5), y.clamp(-0.5, size[0] - 0.5)], -1)


def filter_labels(classes: Any, kept: Any) -> Any:
    """The class labels of boxes that stay; in tensors, whose shape stays, -1 for the others.

    Labels that do not begin with the shape of the boxes are those of images, and stay.
    """
    if isinstance(classes, (list, tuple)):
        rows = kept if isinstance(kept, list) else list(kept)
        if len(classes) != len(rows) or not all(isinstance(part, Tensor) for part in classes):
            return classes
        return type(classes)(
            part[row.to(part.device)] if len(part) == len(row) else part for part, row in zip(classes, rows)
        )
    if isinstance(kept, list) or not isinstance(classes, Tensor) or classes.shape[: kept.dim()] != kept.shape:
        return classes
    if classes.dtype in (torch.uint8, torch.uint16, torch.uint32, torch.uint64, torch.bool):
        raise TypeCheckError(
            f"AugmentationSequential: expected class of a signed type, as -1 marks removed boxes, got {classes.dtype}"
        )
    axes = (..., *[None] * (classes.dim() - kept.dim()))
    return torch.where(kept[axes].to(classes.device), classes, -1).to(classes.dtype)


def _as_type(moved: Tensor, boxes: Tensor) -> Tensor:
    moved = moved.reshape(boxes.shape)
    return moved if boxes.is_floating_point() else moved.round().to(boxes.dtype)


def _upright(vertices: Tensor) -> Tensor:
    """The corners of boxes that a flip has mirrored, beginning top left again and going clockwise."""
    first, second, _, last = vertices.unbind(-2)
    along, down = second - first, last - first
    is_mirrored = along[..., 0] * down[..., 1] - along[..., 1] * down[..., 0] < 0
    vertices = torch.where(is_mirrored[..., None, None], vertices.flip(-2), vertices)
    start = vertices.sum(-1).argmin(-1)
    index = (start[..., None] + torch.arange(4, device=vertices.device)) % 4
    return vertices.gather(-2, index[..., None].expand(*index.shape, 2))


def pad(parts: Sequence[Tensor]) -> tuple[Tensor, list[int]]:
    """Boxes, points or instances of each image, padded to the same number."""
    check_tensors("the labels of an image", parts)
    sizes = [len(part) for part in parts]
    padded = parts[0].new_zeros(len(parts), max(sizes, default=0), *parts[0].shape[1:])
    for row, part in zip(padded, parts):
        row[: len(part)] = part
    return padded, sizes


def check_tensors(name: str, parts: Sequence[Any]) -> None:
    """Raise TypeCheckError unless all parts are tensors."""
    for part in parts:
        _check.is_tensor("AugmentationSequential", name, part)


def _floating(name: str, x: Any) -> None:
    _check.is_tensor("AugmentationSequential", name, x)
    if not x.is_floating_point():
        raise TypeCheckError(f"AugmentationSequential: expected {name} of a floating-point type, got {x.dtype}")


def _keeping_type(points: Tensor, move: Mover) -> Tensor:
    """Move points in float32 or float64, which the formulas take."""
    if 0 in points.shape:
        return points
    return move(points if points.dtype == torch.float64 else points.float()).to(points.dtype)
