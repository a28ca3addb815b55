"""Statistics of channels and blocks of lists of images of different sizes: the operators on batches that have kernels for lists."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from torch import Tensor

from kvision.enhance.channels.channel_contrast import backward as _of_contrast
from kvision.enhance.channels.channel_contrast import channel_contrast
from kvision.enhance.clahe import _equalize_clahe as equalize_clahe
from kvision.enhance.equalize import _equalize as equalize
from kvision.enhance.equalize import equalize_backward
from kvision.enhance.jpeg import _backward as _of_jpeg
from kvision.enhance.jpeg import _jpeg as jpeg
from kvision.enhance.min_max import _backward as _normalize_min_max_backward
from kvision.enhance.min_max import _normalize_min_max as normalize_min_max
from kvision.geometry.transform.lists.arguments import row
from kvision.geometry.transform.lists.kept_sizes import register_filter


def _of_equalized(needs: Sequence[bool], grad: Tensor, x: Tensor, opencv: bool) -> list[Tensor | None]:
    return [equalize_backward(grad, *equalize(x, opencv))]


register_filter("equalize_list", equalize, lambda b, opencv: (opencv,), _of_equalized)


def _of_range(needs: Sequence[bool], grad: Tensor, x: Tensor, *settings: Any) -> list[Tensor | None]:
    return [_normalize_min_max_backward(grad, x, normalize_min_max(x, *settings)[1], *settings)]


register_filter("normalize_min_max_list", normalize_min_max, lambda b, *settings: settings, _of_range)


def _of_channels(needs: Sequence[bool], grad: Tensor, x: Tensor, factor: float) -> list[Tensor | None]:
    return [_of_contrast(grad, x, factor)]


register_filter("channel_contrast_list", channel_contrast, lambda b, factor: (factor,), _of_channels)


def _of_clahe_sample(b: int, clip_limits: Tensor | None, *rest: Any) -> tuple[Any, ...]:
    return row(clip_limits, b), *rest


def _of_tiles(needs: Sequence[bool], grad: Tensor, x: Tensor, *args: Any) -> list[Tensor | None]:
    return [equalize_backward(grad, equalize_clahe(x, *args), None), None]


register_filter("equalize_clahe_list", equalize_clahe, _of_clahe_sample, _of_tiles)
register_filter("jpeg_list", jpeg, lambda b, *args: (*(row(t, b) for t in args[:3]), args[3]), _of_jpeg)
