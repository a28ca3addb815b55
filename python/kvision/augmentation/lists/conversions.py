"""Images of lists in another type, each by one launch."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from kvision.augmentation.warp_and_color import (
    ColorPart,
    ColorStep,
    Output,
    Pass,
    as_plane,
    make_pass,
)
from kvision.augmentation.warp_and_color_list import warp_and_color_to_list
from kvision.geometry.transform.lists.arguments import like_batch


def _conversion(dtype: torch.dtype) -> Pass:
    copied = ColorStep("scale_shift", 1.0, 0.0, float(dtype == torch.uint8))
    return make_pass(None, parts=[ColorPart([copied])], output=Output(dtype))


_TO = {dtype: _conversion(dtype) for dtype in (torch.float16, torch.bfloat16, torch.float32, torch.uint8)}


def in_type(dtype: torch.dtype, images: Sequence[Tensor]) -> list[Tensor]:
    """Images (C, H, W) in a type of floats of at most 32 bits; bytes are in [0, 1] then."""
    return run_on_list(_TO[dtype], images)


def bytes_of_float_images(images: Sequence[Tensor]) -> list[Tensor]:
    """Images (C, H, W) in [0, 1], which they are clamped to, in bytes, without a gradient."""
    return run_on_list(_TO[torch.uint8], [x.detach() for x in images])


def run_on_list(colors: Pass, images: Sequence[Tensor], columns: Tensor | None = None) -> list[Tensor]:
    """What a pass without a warp makes of images (C, H, W), by the columns of each."""
    columns, fill, _, *program = colors.arguments(like_batch(images), columns)
    takes_planes = colors.takes_planes(images[0])
    planes = [as_plane(x) for x in images] if takes_planes else list(images)
    results = list(warp_and_color_to_list(planes, columns, fill, False, [], *program)[: len(images)])
    return [y.view(x.shape) for x, y in zip(images, results)] if takes_planes else results
