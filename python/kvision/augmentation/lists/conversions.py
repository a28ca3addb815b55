"""Images of lists in floats and in bytes, each by one launch."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from kvision.augmentation.warp_and_color import ColorPart, ColorStep, Output, Pass, make_pass
from kvision.augmentation.warp_and_color_list import warp_and_color_to_list
from kvision.geometry.transform.lists.arguments import like_batch


def _conversion(dtype: torch.dtype) -> Pass:
    copied = ColorStep("scale_shift", 1.0, 0.0, float(dtype == torch.uint8))
    return make_pass(None, parts=[ColorPart([copied])], output=Output(dtype))


_TO_FLOATS, _TO_BYTES = _conversion(torch.float32), _conversion(torch.uint8)


def floats_of_byte_images(images: Sequence[Tensor]) -> list[Tensor]:
    """Images (C, H, W) of bytes in [0, 1], float32."""
    return run_on_list(_TO_FLOATS, images)


def bytes_of_float_images(images: Sequence[Tensor]) -> list[Tensor]:
    """Images (C, H, W) in [0, 1], which they are clamped to, in bytes, without a gradient."""
    return run_on_list(_TO_BYTES, [x.detach() for x in images])


def run_on_list(colors: Pass, images: Sequence[Tensor]) -> list[Tensor]:
    """What a pass without a warp and without columns makes of images (C, H, W)."""
    columns, fill, _, *program = colors.arguments(like_batch(images), None)
    return list(warp_and_color_to_list(list(images), columns, fill, False, [], *program)[: len(images)])
