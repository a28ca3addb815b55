"""Colour programs: a chain of per-pixel steps as one operator, one pass over the image. A conversion is a program of one.

A step is its reference, written beside the public function it serves, and a formula in csrc/color/steps.h. `step` ties
them together by name.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from torch import Tensor

from kvision._ops import register, vjp

# The enum Step of csrc/color/program.h, and how many numbers each step takes.
_PARAMETERS = {
    "affine": 13,
    "rgb_to_hsv": 1,
    "hsv_to_rgb": 0,
    "rgb_to_hls": 1,
    "hls_to_rgb": 0,
    "rgb_to_linear_rgb": 0,
    "linear_rgb_to_rgb": 0,
    "rgb_to_lab": 0,
    "lab_to_rgb": 1,
    "rgb_to_luv": 1,
    "luv_to_rgb": 1,
    "weighted_sum": 3,
}
_NAMES = tuple(_PARAMETERS)
_references: dict[str, Callable[..., Tensor]] = {}


def _reference(x: Tensor, steps: Sequence[int], parameters: Sequence[float]) -> Tensor:
    for name in (_NAMES[i] for i in steps):
        count = _PARAMETERS[name]
        x = _references[name](x, *parameters[:count])
        parameters = parameters[count:]
    return x


def _sizes(x: Tensor, steps: Sequence[int], parameters: Sequence[float]) -> tuple[int, ...]:
    channels = 1 if steps and _NAMES[steps[-1]] == "weighted_sum" else x.shape[1]
    return (x.shape[0], channels, *x.shape[2:])


def _backward(needs, grad, x, steps, parameters):
    return [_program_backward(grad, x, steps, parameters)]


_program = register("color_program", _reference, fake=_sizes, backward=_backward)
_program_backward = register("color_program_backward", vjp(_reference), fake=lambda grad, x, steps, parameters: x.shape)


def step(name: str, reference: Callable[..., Tensor]) -> Callable[..., Tensor]:
    """The step `name`, defined by `reference(x, *numbers)` on images (B, 3, H, W), as a function of the same arguments."""
    _references[name] = reference
    steps = [_NAMES.index(name)]

    def of_one_step(x: Tensor, *numbers: float) -> Tensor:
        run = _program.reference if 0 in x.shape[2:] else _program  # the kernels take no images without pixels
        return run(x, steps, list(numbers))

    return of_one_step
