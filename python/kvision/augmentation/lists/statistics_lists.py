"""Operators on lists of images of different sizes by statistics of channels: those on batches that have kernels for lists."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor

from kvision.enhance.equalize import _equalize as equalize
from kvision.enhance.equalize import equalize_backward
from kvision.geometry.transform.lists.kept_sizes import register_filter


def _of_equalized(needs: Sequence[bool], grad: Tensor, x: Tensor, opencv: bool) -> list[Tensor | None]:
    return [equalize_backward(grad, *equalize(x, opencv))]


register_filter("equalize_list", equalize, lambda b, opencv: (opencv,), _of_equalized)
