"""Filters of lists of images of different sizes: the operators on batches that have kernels for lists."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor

from kvision._dtype import compute_dtype
from kvision._list_ops import ListOperator
from kvision._ops import Operator
from kvision.augmentation.corruption.layer import clamp_gradients
from kvision.augmentation.lists.conversions import in_type
from kvision.enhance.sharpness import _sharpness as sharpness
from kvision.enhance.sharpness import _sharpness_backward
from kvision.filters.filter2d import _filter2d as filter2d
from kvision.filters.filter2d import _filter2d_backward, _kernel_backward, clamped_gradients, filter2d_clamped
from kvision.filters.smoothing import box, gaussian, median
from kvision.geometry.transform.lists.arguments import row, sizes
from kvision.geometry.transform.lists.kept_sizes import by_samples, register_filter, register_list_backward
from kvision.geometry.transform.lists.remap_list import packed, packed_size, unpacked

box_blur, gaussian_blur2d, median_blur = box._box_blur, gaussian._gaussian_blur2d, median._median_blur


def _register_filter(
    name: str, of: Operator, transposed: Operator, gradients: Callable[..., Any] | None = None
) -> ListOperator:
    """A linear filter, whose first argument is a tensor or None where `gradients` has the gradient of it."""

    def of_sample(b: int, *args: Any) -> tuple[Any, ...]:
        return args if gradients is None else (row(args[0], b), *args[1:])

    def others(needs: Any, grad: Tensor, x: Tensor, *args: Any) -> Any:
        return [None] if gradients is None else [None, gradients(grad, x, *args)]

    return register_filter(name, of, of_sample, others, transposed)


def _of_kernel(grad: Tensor, x: Tensor, kernel: Tensor, *rest: Any) -> Tensor:
    of: Tensor = _kernel_backward(kernel, grad, x, *rest)
    return of


_register_filter("box_blur_list", box_blur, box._transposed)
_register_filter("box_blur_backward_list", box._transposed, box_blur)
_register_filter("gaussian_blur2d_list", gaussian_blur2d, gaussian._transposed, gaussian.sigma_gradient)
_register_filter(
    "gaussian_blur2d_backward_list",
    gaussian._transposed,
    gaussian_blur2d,
    lambda grad, x, *blur: gaussian.sigma_gradient(x, grad, *blur),
)
_filter2d_list = _register_filter("filter2d_list", filter2d, _filter2d_backward, _of_kernel)
_filter2d_backward_list = _register_filter(
    "filter2d_backward_list", _filter2d_backward, filter2d, lambda grad, x, *args: _of_kernel(x, grad, *args)
)


def _of_clamped(
    grads: Sequence[Tensor], images: Sequence[Tensor], chosen: Tensor | None, kernel: Tensor, border: int
) -> Sequence[Tensor]:
    """Those of images: they are filtered again, in the type that is computed in, to see what was clamped."""
    dtype = images[0].dtype
    is_half = dtype != compute_dtype(images[0])
    if is_half:
        images, grads = in_type(torch.float32, images), in_type(torch.float32, grads)
    window = (chosen, kernel, border, True)
    of_results = clamp_gradients(_filter2d_list(images, *window), grads, chosen)
    of_images = _filter2d_backward_list(of_results, *window)
    return in_type(dtype, of_images) if is_half else of_images


register_filter(
    "filter2d_clamped_list",
    filter2d_clamped,
    lambda b, kernel, border: (row(kernel, b), border),
    clamped_gradients,
    of_images=_of_clamped,
)


def _of_median(b: int, grad: Tensor, x: Tensor, medians: Sequence[Tensor], *window: Any) -> Tensor:
    of_image: Tensor = median._backward.reference(grad, x, medians[b][None], *window)
    return of_image


_median_blur_list_backward = register_list_backward(
    "median_blur_list_backward", median._backward, by_samples(_of_median)
)
register_filter(
    "median_blur_list",
    median_blur,
    lambda b, *window: window,
    of_images=lambda grads, medians, images, chosen, *window: _median_blur_list_backward(
        [*images, *grads], chosen, list(medians), *window
    ),
    saves_results=True,
)


def _of_sharpness(b: int, grad: Tensor, x: Tensor, factor: Tensor | None, number: float) -> Tensor:
    of_image: Tensor = _sharpness_backward.reference(grad, x, row(factor, b), number, True, False)[0]
    return of_image


_sharpness_list_backward = register_list_backward(
    "sharpness_list_backward", _sharpness_backward, by_samples(_of_sharpness)
)
register_filter(
    "sharpness_list",
    sharpness,
    lambda b, factor, number: (row(factor, b), number),
    lambda needs, grad, x, *args: sharpness.backward((*needs, False), grad, x, *args)[:2],
    of_images=lambda grads, images, *args: _sharpness_list_backward([*images, *grads], *args),
)


# Blurs whose windows grow with the image: sigma in heights and widths of each, and the border. The results are one tensor, as maps
# of lists are.


def _windows(x: Tensor, sigma: float) -> tuple[int, int, float, float]:
    """Height and width of the window of an image (C, H, W), and the standard deviations."""
    sigma_y, sigma_x = (sigma * n for n in x.shape[-2:])
    return 2 * int(3 * sigma_y + 0.5) + 1, 2 * int(3 * sigma_x + 0.5) + 1, sigma_y, sigma_x


def _of_sides(images: Sequence[Tensor], sigma: float, border: int) -> list[Tensor]:
    return [packed([gaussian_blur2d.reference(x[None], None, *_windows(x, sigma), border)[0] for x in images])]


def _of_sides_backward(
    needs: Sequence[bool], grads: Sequence[Tensor], images: Sequence[Tensor], sigma: float, border: int
) -> list[Any]:
    each = zip(unpacked(grads[0], sizes(images), len(images[0])), images)
    return [[gaussian._transposed(g[None], None, *_windows(x, sigma), border)[0] for g, x in each]]


gaussian_blur2d_of_sides = ListOperator(
    "gaussian_blur2d_of_sides_list",
    gaussian_blur2d,
    _of_sides,
    fake=lambda images, *args: [images[0].new_empty(packed_size(sizes(images), images[0].shape[0]))],
    backward=_of_sides_backward,
)
