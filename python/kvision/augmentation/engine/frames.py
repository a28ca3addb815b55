"""A pass over frames of video, by the launch that reads their planes."""

from __future__ import annotations

from torch import Tensor

from kvision._modes import INTERPOLATION, PADDING
from kvision.augmentation import transforms
from kvision.augmentation.warp_and_color import Pass, _columns_of, _parse, warp_and_color
from kvision.color.frames import PLAINLY, Frames, Reading, affine_of
from kvision.color.program import _DTYPES


def frames_pass(frames: Frames, image_pass: Pass, columns: Tensor | None) -> tuple[Tensor, Tensor] | None:
    """What `Pass.run` gives of the images that the frames are; None where no launch reads the planes for it."""
    like = frames._like()
    like = like[None] if frames.is_single else like
    columns, _, size, plan, numbers = image_pass.arguments(like, columns)
    parts = _parse(plan, numbers)
    interpolation, padding, align_corners = parts.sampling
    is_bilinear = interpolation == INTERPOLATION["bilinear"]
    affine = affine_of(parts.steps, parts.columns, parts.numbers)
    dtype = _DTYPES[parts.dtype] if parts.dtype >= 0 else frames.dtype
    # Steps get colors that are rounded to bytes, if frames are images of these.
    if parts.order or parts.layout >= 0 or (parts.steps and not frames.dtype.is_floating_point):
        affine = None
    if not image_pass.warps and affine is not None:
        return frames._read(None, None, PLAINLY, *affine, dtype), like.new_empty(len(like), 0, 3)
    if not image_pass.warps or image_pass.resampling is not None:
        return None
    if not (is_bilinear or (interpolation == INTERPOLATION["nearest"] and not parts.antialias)):
        return None
    if padding == PADDING["reflection"] and not parts.antialias:
        return None
    matrix = transforms._transform_matrix(_columns_of(like, columns), parts.transforms, parts.transform_numbers)
    windows = (2 if align_corners else 1) if parts.antialias else 0
    reading = Reading(windows, False, not is_bilinear, padding == PADDING["border"])
    if affine is not None:
        y = frames._read(matrix, (size[0], size[1]), reading, *affine, dtype)
    else:
        y = frames._read(matrix, (size[0], size[1]), reading)
        y, _, _ = warp_and_color(y, columns, None, [], parts.plan_of_steps, parts.numbers)
    return y, matrix.detach()
