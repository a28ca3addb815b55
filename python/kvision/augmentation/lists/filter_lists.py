"""Filters of lists of images of different sizes: the operators on batches that have kernels for lists."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from torch import Tensor

from kvision._ops import Operator
from kvision.enhance.sharpness import _sharpness as sharpness
from kvision.filters.filter2d import _filter2d as filter2d
from kvision.filters.filter2d import _filter2d_backward, _kernel_backward, clamped_gradients, filter2d_clamped
from kvision.filters.smoothing import box, gaussian, median
from kvision.geometry.transform.lists.arguments import row
from kvision.geometry.transform.lists.kept_sizes import register_filter

box_blur, gaussian_blur2d, median_blur = box._box_blur, gaussian._gaussian_blur2d, median._median_blur


def _register_filter(
    name: str, of: Operator, transposed: Operator, gradients: Callable[..., Any] | None = None
) -> None:
    """A linear filter, whose first argument is a tensor or None where `gradients` has the gradient of it."""

    def of_sample(b: int, *args: Any) -> tuple[Any, ...]:
        return args if gradients is None else (row(args[0], b), *args[1:])

    def others(needs: Any, grad: Tensor, x: Tensor, *args: Any) -> Any:
        return [None] if gradients is None else [None, gradients(grad, x, *args)]

    register_filter(name, of, of_sample, others, transposed)


def _of_kernel(grad: Tensor, x: Tensor, kernel: Tensor, *rest: Any) -> Tensor:
    of: Tensor = _kernel_backward(kernel, grad, x, *rest)
    return of


def _of_median(needs: Any, grad: Tensor, x: Tensor, *window: Any) -> list[Tensor | None]:
    return [median._backward(grad, x, median_blur(x, *window), *window)]


_register_filter("box_blur_list", box_blur, box._transposed)
_register_filter("box_blur_backward_list", box._transposed, box_blur)
_register_filter("gaussian_blur2d_list", gaussian_blur2d, gaussian._transposed, gaussian.sigma_gradient)
_register_filter(
    "gaussian_blur2d_backward_list",
    gaussian._transposed,
    gaussian_blur2d,
    lambda grad, x, *blur: gaussian.sigma_gradient(x, grad, *blur),
)
_register_filter("filter2d_list", filter2d, _filter2d_backward, _of_kernel)
_register_filter(
    "filter2d_backward_list", _filter2d_backward, filter2d, lambda grad, x, *args: _of_kernel(x, grad, *args)
)
register_filter(
    "filter2d_clamped_list",
    filter2d_clamped,
    lambda b, kernel, border: (row(kernel, b), border),
    clamped_gradients,
)
register_filter("median_blur_list", median_blur, lambda b, *window: window, _of_median)
register_filter(
    "sharpness_list",
    sharpness,
    lambda b, factor, number: (row(factor, b), number),
    lambda needs, grad, x, *args: sharpness.backward((*needs, False), grad, x, *args)[:2],
)
