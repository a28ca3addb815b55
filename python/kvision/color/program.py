"""Colour programs: a chain of per-pixel steps as one operator, one pass over the image. A conversion is a program of one.

A step is its reference, written beside the public function it serves, and a formula in csrc/color/steps.h. `step` ties
them together by name.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor

from kvision._ops import as_stored, laid_out, register, saturate_to_byte

# The enum Step of csrc/color/program.h, and how many numbers each step takes.
_PARAMETERS = {
    # Of three channels.
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
    "byte_luma": 3,
    # With parameters that may be tensors.
    "weighted_sum": 3,
    "line_rgb": 6,
    "standardize_rgb": 6,
    "saturation": 1,
    "saturation_raw": 1,
    "saturation_grey": 1,
    "hue": 1,
    "hue_raw": 1,
    # Of any channels.
    "contrast": 2,
    "line": 3,
    "standardize": 2,
    "gamma": 2,
    "log": 3,
    "sigmoid": 3,
    "solarize": 3,
    "posterize": 2,
}
_NAMES = tuple(_PARAMETERS)
MOST_STEPS, MOST_NUMBERS = 16, 64  # of a program: kMostSteps and kMostParameters
_AROUND_MEAN = _NAMES.index("contrast")
_OF_VALUES = _NAMES[_AROUND_MEAN + 1 :]
_ONE_CHANNEL = ("byte_luma", "weighted_sum")
STEPS = {name: i for i, name in enumerate(_PARAMETERS)}
_references: dict[str, Callable[..., Tensor]] = {}
_findings: dict[str, Callable[[Tensor], Tensor]] = {}  # what a step's last parameter is, of the image as it is then

# --- the operators --------------------------------------------------------------------------------------------------
#
# Tensors: the image (B, C, H, W), parameters (B or 1, C or 1, P), order (B or 1, S). Then the program: `numbers` has all
# parameters of all steps, `columns` where in the tensor those stand that are not numbers, or -1, and is empty where there
# are none. Then dtype, as torch names it, and layout, "NCHW" or "NHWC"; "same" for those of the image.


def _sequential(
    x: Tensor,
    parameters: Tensor | None,
    order: Tensor | None,
    steps: Sequence[int],
    numbers: Sequence[float],
    columns: Sequence[int],
) -> tuple[Tensor, Tensor]:
    """The steps one after the other, or as `order` has them, and the mean around which there was contrast."""
    tensors = () if parameters is None else parameters[..., None, None].unbind(2)
    calls, first = [], 0
    for name in (_NAMES[i] for i in steps):
        slots = range(first, first := first + _PARAMETERS[name])
        calls.append((name, [numbers[i] if not columns or columns[i] < 0 else tensors[columns[i]] for i in slots]))
    mean = x.new_zeros(x.shape[0], 1)
    for k in range(len(calls) if order is None else order.shape[1]):
        for i, (name, of_step) in enumerate(calls) if order is not None else [(k, calls[k])]:
            here = None if order is None else (order[:, k] == i)[:, None, None, None]
            if name in _findings:
                found = _findings[name](x)
                of_step = [*of_step[:-1], found]
                mean = _where(here, found, mean[..., None, None])[..., 0, 0]
            x = _where(here, _references[name](x, *of_step), x)
    return x, mean


def _where(here: Tensor | None, new: Tensor, old: Tensor) -> Tensor:
    return new if here is None else torch.where(here, new, old)


_computed = as_stored(_sequential)


def _reference_around_mean(
    x: Tensor,
    parameters: Tensor | None,
    order: Tensor | None,
    steps: Sequence[int],
    numbers: Sequence[float],
    columns: Sequence[int],
    dtype: str,
    layout: str,
) -> tuple[Tensor, Tensor]:
    stored = _stored(x, dtype)
    y, mean = _computed(_widened(x, stored), parameters, order, steps, numbers, columns)
    y = saturate_to_byte(255 * y) if stored == torch.uint8 else y.to(stored)
    return _arranged(y, x, layout), mean


def _reference(x: Tensor, *arguments: Any) -> Tensor:
    return _reference_around_mean(x, *arguments)[0]


def _pulled_back(
    grad: Tensor,
    x: Tensor,
    parameters: Tensor | None,
    order: Tensor | None,
    mean: Tensor | None,
    steps: Sequence[int],
    numbers: Sequence[float],
    columns: Sequence[int],
    of_image: bool,
    of_parameters: bool,
) -> tuple[Tensor, Tensor]:
    wide = _widened(x, grad.dtype)

    def result(x: Tensor, rows: Tensor | None = None) -> Tensor:
        return _computed(x, rows, order, steps, numbers, columns)[0]

    rows = () if parameters is None else (parameters.expand(x.shape[0], -1, -1),)  # a gradient for each sample
    pullback = torch.func.vjp(result, wide, *rows)[1]
    of_x, *of_rows = pullback(grad.to(wide.dtype))
    none = wide[:, :0, 0, 0]
    return laid_out(of_x.to(x.dtype), x) if of_image else none.to(x.dtype), of_rows[0] if of_parameters else none


def _widened(x: Tensor, other: torch.dtype) -> Tensor:
    """`x` in the type that is computed in; bytes are 255ths."""
    wide = torch.float64 if torch.float64 in (x.dtype, other) else torch.float32
    return x.to(wide) / 255 if x.dtype == torch.uint8 else x.to(wide)


def _stored(x: Tensor, dtype: str) -> torch.dtype:
    return x.dtype if dtype == "same" else getattr(torch, dtype)


def _arranged(y: Tensor, x: Tensor, layout: str) -> Tensor:
    if layout == "same":
        return laid_out(y, x)
    return y.contiguous() if layout == "NCHW" else y.movedim(1, -1).contiguous().movedim(-1, 1)


def _result(x, parameters, order, steps, numbers, columns, dtype, layout):
    channels = 1 if steps and _NAMES[steps[-1]] in _ONE_CHANNEL else x.shape[1]
    sizes = (x.shape[0], channels, *x.shape[2:])
    return _arranged(x.new_empty(sizes, dtype=_stored(x, dtype)), x, layout)


def _result_and_mean(x, parameters, order, steps, numbers, columns, dtype, layout):
    y = _result(x, parameters, order, steps, numbers, columns, dtype, layout)
    return [y, x.new_empty((x.shape[0], 1), dtype=_computing(x.dtype, y.dtype))]


def _gradients(grad, x, parameters, order, mean, steps, numbers, columns, of_image, of_parameters):
    of_x = laid_out(torch.empty_like(x), x) if of_image else x.new_empty((x.shape[0], 0))
    sizes = (x.shape[0], *parameters.shape[1:]) if of_parameters else (x.shape[0], 0)
    return [of_x, x.new_empty(sizes, dtype=_computing(x.dtype, grad.dtype))]


def _computing(*types: torch.dtype) -> torch.dtype:
    return torch.float64 if torch.float64 in types else torch.float32


def _backward(needs, grad, x, parameters, order, steps, numbers, columns, dtype, layout, mean=None):
    of_x, of_rows = _program_backward(grad, x, parameters, order, mean, steps, numbers, columns, *needs[:2])
    if needs[1] and parameters.shape[0] == 1:
        of_rows = of_rows.sum(0, keepdim=True)
    return [of_x if needs[0] else None, of_rows if needs[1] else None, None]


def _backward_around_mean(needs, grad, _, y, mean, *arguments):
    return _backward(needs, grad, *arguments, mean=mean)


_program = register("color_program", _reference, fake=_result, backward=_backward, bytes=True, stores=True)
_program_around_mean = register(
    "color_program_around_mean",
    _reference_around_mean,
    fake=_result_and_mean,
    backward=_backward_around_mean,
    saves_results=True,
    constant=(1,),
    bytes=True,
    stores=True,
)
_program_backward = register("color_program_backward", _pulled_back, fake=_gradients, stores=True)

# --- calls ----------------------------------------------------------------------------------------------------------


def run(
    x: Tensor,
    steps: Sequence[int],
    parameters: Sequence[float | Tensor],
    order: Tensor | None = None,
    dtype: str = "same",
    layout: str = "same",
) -> Tensor:
    """A program on images (B, C, H, W), whose parameters are numbers or tensors (B or 1, C or 1, 1, 1)."""
    table, columns, numbers = None, [], parameters
    tensors = [p for p in parameters if isinstance(p, Tensor)]
    if tensors:
        places = iter(range(len(tensors)))
        table = _table(tensors, _computing(x.dtype))
        columns = [next(places) if isinstance(p, Tensor) else -1 for p in parameters]
        numbers = [0.0 if isinstance(p, Tensor) else p for p in parameters]
    operator = _program_around_mean if _AROUND_MEAN in steps else _program
    stored = _stored(x, dtype)
    # Kernels take one mean, and compute in one type.
    fits = steps.count(_AROUND_MEAN) < 2 and (x.dtype == torch.float64) == (stored == torch.float64)
    y = (operator if fits else operator.reference)(x, table, order, steps, numbers, columns, dtype, layout)
    return y[0] if _AROUND_MEAN in steps else y


def _table(tensors: Sequence[Tensor], dtype: torch.dtype) -> Tensor:
    """(B or 1, C or 1, P)"""
    if len(tensors) == 1:
        return tensors[0][..., 0].to(dtype)
    return torch.cat(torch.broadcast_tensors(*(t.to(dtype) for t in tensors)), -1)[:, :, 0]


def step(
    name: str, reference: Callable[..., Tensor], found: Callable[[Tensor], Tensor] | None = None
) -> Callable[..., Tensor]:
    """The step `name`, defined by `reference(x, *parameters)` on images (B, C, H, W), as a function of the same arguments.

    Parameters are numbers or tensors that broadcast to the image; the last one is `found(x)` where that is given.
    """
    _references[name] = reference
    composed = as_stored(reference)
    if found is not None:
        _findings[name] = found
        composed = as_stored(lambda x, *parameters: reference(x, *parameters, found(x)))
    steps, of_values, rest = [_NAMES.index(name)], name in _OF_VALUES, [0.0] * (name in _findings)

    def of_one_step(x: Tensor, *parameters: float | Tensor) -> Tensor:
        fits = 0 not in x.shape[2:]  # the kernels take no images without pixels
        for p in parameters:
            if isinstance(p, Tensor):
                fits = fits and p.shape[2:].numel() == 1 and (of_values or p.shape[1] == 1)
        return run(x, steps, [*parameters, *rest]) if fits else composed(x, *parameters)

    return of_one_step
