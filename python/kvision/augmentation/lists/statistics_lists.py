"""Statistics of channels and blocks of lists of images of different sizes: the operators on batches that have kernels for lists."""

from __future__ import annotations

from typing import Any

from torch import Tensor

from kvision.enhance.channels.channel_contrast import backward as channel_contrast_backward
from kvision.enhance.channels.channel_contrast import channel_contrast
from kvision.enhance.clahe import _equalize_clahe as equalize_clahe
from kvision.enhance.equalize import _equalize as equalize
from kvision.enhance.equalize import equalize_backward
from kvision.enhance.jpeg import _backward as _of_jpeg
from kvision.enhance.jpeg import _jpeg as jpeg
from kvision.enhance.jpeg import _jpeg_backward as jpeg_backward
from kvision.enhance.min_max import _backward as normalize_min_max_backward
from kvision.enhance.min_max import _normalize_min_max as normalize_min_max
from kvision.geometry.transform.lists.arguments import row
from kvision.geometry.transform.lists.kept_sizes import by_samples, register_filter, register_list_backward


def _of_equalized(b: int, grad: Tensor, x: Tensor, changed: Tensor | None) -> Tensor:
    """The image stands for its result, which has the same NaN."""
    of_image: Tensor = equalize_backward.reference(grad, x, row(changed, b))
    return of_image


_equalize_list_backward = register_list_backward("equalize_list_backward", equalize_backward, by_samples(_of_equalized))
register_filter(
    "equalize_list",
    equalize,
    lambda b, opencv: (opencv,),
    of_images=lambda grads, results, images, chosen, opencv: _equalize_list_backward(
        [*images, *grads], chosen, results[-1]
    ),
    saves_results=True,
    of_channels=(),
)


def _of_range(b: int, grad: Tensor, x: Tensor, ranges: Tensor, *settings: Any) -> Tensor:
    of_image: Tensor = normalize_min_max_backward.reference(grad, x, row(ranges, b), *settings)
    return of_image


_normalize_min_max_list_backward = register_list_backward(
    "normalize_min_max_list_backward", normalize_min_max_backward, by_samples(_of_range)
)
register_filter(
    "normalize_min_max_list",
    normalize_min_max,
    lambda b, *settings: settings,
    of_images=lambda grads, results, images, chosen, *settings: _normalize_min_max_list_backward(
        [*images, *grads], chosen, results[-1], *settings
    ),
    saves_results=True,
    of_channels=(2,),
)

_channel_contrast_list_backward = register_list_backward(
    "channel_contrast_list_backward",
    channel_contrast_backward,
    by_samples(lambda b, grad, x, factor: channel_contrast_backward.reference(grad, x, factor)),
)
register_filter(
    "channel_contrast_list",
    channel_contrast,
    lambda b, factor: (factor,),
    of_images=lambda grads, images, *args: _channel_contrast_list_backward([*images, *grads], *args),
)


def _of_clahe_sample(b: int, clip_limits: Tensor | None, *rest: Any) -> tuple[Any, ...]:
    return row(clip_limits, b), *rest


register_filter(
    "equalize_clahe_list",
    equalize_clahe,
    _of_clahe_sample,
    lambda needs, grad, x, *args: [equalize_backward(grad, x, None), None],
    of_images=lambda grads, images, chosen, *args: _equalize_list_backward([*images, *grads], chosen, None),
)


def _of_jpeg_sample(b: int, *args: Any) -> tuple[Any, ...]:
    return *(row(t, b) for t in args[:3]), args[3]


def _of_coded(b: int, grad: Tensor, x: Tensor, *args: Any) -> Tensor:
    of_image: Tensor = jpeg_backward.reference(grad, x, *_of_jpeg_sample(b, *args), True, False)[0]
    return of_image


_jpeg_list_backward = register_list_backward("jpeg_list_backward", jpeg_backward, by_samples(_of_coded))
register_filter(
    "jpeg_list",
    jpeg,
    _of_jpeg_sample,
    _of_jpeg,
    of_images=lambda grads, images, *args: _jpeg_list_backward([*images, *grads], *args),
)
