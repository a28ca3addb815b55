"""Resizes, crops and warps of frames of video, which read the planes where the call is what their kernel computes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from torch import Tensor

from kvision._constants import constant
from kvision.color.frames import PLAINLY, Frames, Reading
from kvision.core.exceptions import ShapeError


def check_frames(op: str, name: str, frames: Frames) -> None:
    """Raise unless frames have a batch, as functions of (B, C, H, W) say."""
    if frames.is_single:
        raise ShapeError(f"{op}: expected {name} of shape (B, 3, H, W), got {frames}", actual_shape=frames.shape)


def resized_frames(frames: Frames, size: tuple[int, int], align_corners: bool, antialias: bool) -> Tensor:
    """The frames at another size, bilinear."""
    matrix, reading = None, Reading(int(antialias))
    if align_corners:
        scales = [(n - 1) / (whole - 1) if n > 1 < whole else 1.0 for n, whole in zip(size, frames.shape[-2:])]
        if not antialias:
            scales = [(whole - 1) / (n - 1) if n > 1 else 1.0 for n, whole in zip(size, frames.shape[-2:])]
        matrix = constant(
            (((scales[1], 0.0, 0.0), (0.0, scales[0], 0.0), (0.0, 0.0, 1.0)),), frames._y, frames.computed
        )
        reading = Reading(2) if antialias else Reading(from_result=True, border=True)
    rgb = frames._read(matrix, size, reading)
    return rgb[0] if frames.is_single else rgb


def cropped_frames(frames: Frames, first: tuple[int, int], size: tuple[int, int]) -> Tensor:
    """Whole pixels from the first (y, x) on."""
    (y, x), (h, w) = first, size
    box = constant(((float(x), float(y), float(x + w), float(y + h)),), frames._y, frames.computed)
    return frames._read(box, size)


def warped_frames(
    op: str, frames: Frames, name: str, M: Tensor, size: Sequence[int], reading: Reading = PLAINLY
) -> Tensor:
    """The frames warped by matrices (B, 2, 3) or (B, 3, 3)."""
    return frames._read(frames._map_of(op, name, M), (size[0], size[1]), reading)


def reading_of(mode: str, padding_mode: str, fill_value: Any, antialias: bool, from_result: bool) -> Reading | None:
    """How a warp reads planes; None where it cannot."""
    is_plain = fill_value is None and not antialias
    if not is_plain or mode not in ("bilinear", "nearest") or padding_mode not in ("zeros", "fill", "border"):
        return None
    return Reading(0, from_result, mode == "nearest", padding_mode == "border")
