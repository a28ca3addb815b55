"""Warps of lists of images by a matrix each: the operator `warp` for one image after the other, in one launch."""

from __future__ import annotations

from typing import Any

from torch import Tensor

from kvision._choices import Interpolation, PaddingOrFill
from kvision._modes import INTERPOLATION, PADDING
from kvision.geometry.transform import sampling
from kvision.geometry.transform.lists import arguments as lists
from kvision.geometry.transform.lists.register_warp import register_warp
from kvision.geometry.transform.lists.warp_antialiased_list import warp_antialiased_list


def _adds_by_atomics(grads, matrix, size, interpolation, padding, *options):
    return grads[0].is_cuda and padding != PADDING["fill"]


# Options: those of `warp`.
warp_list, warp_list_backward, warp_list_matrix_backward = register_warp(
    "warp_list", sampling.warp, sampling.warp_image_backward, sampling._warp_matrix_backward, _adds_by_atomics
)


def warped(
    op: str,
    images: list[Tensor],
    name: str,
    matrix: Tensor,
    size: list[int],
    mode: Interpolation,
    padding_mode: PaddingOrFill,
    align_corners: bool,
    fill_value: Any = None,
    inverse: bool = False,
    is_list: bool = False,
    antialias: bool = False,
) -> Any:
    """Images warped by matrices `name`, from pixels of the result unless `inverse`; `size` has that of all or of each."""
    like, values = lists.like_batch(images), lists.as_value_list(images, mode)
    matrix = sampling.cast_to_image(op, values[0][None], name, matrix, len(images))
    padding, fill = sampling.padding_and_fill(op, like, padding_mode, fill_value, None, mode)
    options = (padding, align_corners, inverse, False)
    if antialias:
        results = warp_antialiased_list(values, matrix, fill, size, *options)
    else:
        results = warp_list(values, matrix, fill, size, INTERPOLATION[mode], *options)
    return lists.of_value_list(results, like, mode, is_list)
