"""Channels of the images of a list in another order."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from torch import Tensor

from kvision._list_ops import ListOperator
from kvision.augmentation.erase import erase_rectangles
from kvision.geometry.transform.lists.arguments import fake_results, row, sizes

# Arguments: images (C, H, W); for each channel of a result, which one of the image it is, (B or 1, C) int64.


def _reference(images: Sequence[Tensor], orders: Tensor) -> list[Tensor]:
    return [x[row(orders, b)[0]] for b, x in enumerate(images)]


def _gradients(needs: Sequence[bool], grads: Sequence[Tensor], images: Sequence[Tensor], orders: Tensor) -> list[Any]:
    return [shuffle_channels_list(grads, orders.argsort(1)), None]


shuffle_channels_list = ListOperator(
    "shuffle_channels_list",
    erase_rectangles,  # which has kernels for the same types
    _reference,
    fake=lambda images, orders: fake_results(images, sizes(images)),
    backward=_gradients,
)
