"""Colour programs: a chain of per-pixel steps as one operator, one pass over the image. A conversion is a program of one.

A step is its reference, written beside the public function it serves, and a formula in csrc/color/steps.h. `step` ties
them together by name.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from kvision._ops import match_layout, register, saturate_to_byte, with_kernel_casts

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
    "byte_hsv": 0,
    # With parameters that may be tensors.
    "weighted_sum": 3,
    "byte_sum": 3,
    "line_rgb": 7,
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
    "threshold": 5,
}
_NAMES = tuple(_PARAMETERS)
MOST_STEPS, MOST_NUMBERS, MOST_TENSORS = 16, 64, 6  # of a program: kMostSteps, kMostParameters and kMostTensors
_AROUND_MEAN = _NAMES.index("contrast")
_OF_VALUES = _NAMES[_AROUND_MEAN + 1 :]
_ONE_CHANNEL = ("byte_luma", "weighted_sum", "byte_sum")
STEPS = {name: i for i, name in enumerate(_PARAMETERS)}
_references: dict[str, Callable[..., Tensor]] = {}
_findings: dict[str, Callable[[Tensor], Tensor]] = {}  # what a step's last parameter is, of the image as it is then

# --- the operators --------------------------------------------------------------------------------------------------
#
# Tensors: the image (B, C, H, W), six for parameters (B or 1, C or 1, P) or None, order (B or 1, S). Then the plan, a list
# of integers because each argument of an operator costs a call: the result's type (in _TYPES) and layout, -1 for those of
# the image, the number of steps, the steps, and their columns: where parameters stand that are not numbers, counted along
# the last axes of all tensors, or -1; none where all are. Then `numbers`, all parameters of all steps.

_SAME = -1
_TYPES = (torch.uint8, torch.float16, torch.bfloat16, torch.float32, torch.float64)  # the enum Storage of program.h
LAYOUTS = {None: _SAME, torch.contiguous_format: 0, torch.channels_last: 1}


class _Plan(NamedTuple):
    dtype: torch.dtype | None
    layout: int
    steps: Sequence[int]
    columns: Sequence[int]


def _read(plan: Sequence[int]) -> _Plan:
    dtype, layout, count, *rest = plan
    return _Plan(None if dtype == _SAME else _TYPES[dtype], layout, rest[:count], rest[count:])


def _plan(dtype: torch.dtype | None, layout: int, steps: Sequence[int], columns: Sequence[int]) -> list[int]:
    return [_SAME if dtype is None else _TYPES.index(dtype), layout, len(steps), *steps, *columns]


def _sequential(x: Tensor, *arguments: Any) -> tuple[Tensor, Tensor]:
    """The steps one after the other, or as `order` has them, and the mean around which there was contrast."""
    *parameters, order, plan, numbers = arguments
    _, _, steps, columns = _read(plan)
    tensors = _slots([p for p in parameters if p is not None])
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


def _slots(parameters: Sequence[float | Tensor]) -> list[float | Tensor]:
    """Parameters with every column of a tensor by itself, as (B or 1, C or 1, 1, 1)."""
    slots: list[float | Tensor] = []
    for p in parameters:
        slots += p[..., None, None].unbind(2) if isinstance(p, Tensor) and p.dim() == 3 else [p]
    return slots


def _where(here: Tensor | None, new: Tensor, old: Tensor) -> Tensor:
    return new if here is None else torch.where(here, new, old)


_computed = with_kernel_casts(_sequential)


def _reference_around_mean(x: Tensor, *arguments: Any) -> tuple[Tensor, Tensor]:
    *_, plan, _ = arguments
    dtype, layout, *_ = _read(plan)
    stored = dtype or x.dtype
    y, mean = _computed(_widened(x, stored), *arguments)
    y = saturate_to_byte(255 * y) if stored == torch.uint8 else y.to(stored)
    return _arranged(y, x, layout), mean


def _reference(x: Tensor, *arguments: Any) -> Tensor:
    return _reference_around_mean(x, *arguments)[0]


def _pulled_back(grad: Tensor, x: Tensor, *arguments: Any) -> tuple[Tensor, Tensor]:
    *parameters, order, _, plan, numbers, of_image, of_parameters = arguments
    given = [p for p in parameters if p is not None]
    wide = _widened(x, grad.dtype)

    def result(x: Tensor, *rows: Tensor) -> Tensor:
        return _computed(x, *rows, order, plan, numbers)[0]

    channels = max((p.shape[1] for p in given), default=1)
    rows = [p.to(wide.dtype).expand(x.shape[0], channels, -1) for p in given]  # a gradient for each sample
    vjp_fn = torch.func.vjp(result, wide, *rows)[1]
    of_x, *of_rows = vjp_fn(grad.to(wide.dtype))
    none = wide[:, :0, 0, 0]
    return (
        match_layout(of_x.to(x.dtype), x) if of_image else none.to(x.dtype),
        torch.cat(of_rows, 2) if of_parameters else none,
    )


def _widened(x: Tensor, other: torch.dtype) -> Tensor:
    """`x` in the type that is computed in; bytes are 255ths."""
    wide = torch.float64 if torch.float64 in (x.dtype, other) else torch.float32
    return x.to(wide) / 255 if x.dtype == torch.uint8 else x.to(wide)


def _arranged(y: Tensor, x: Tensor, layout: int) -> Tensor:
    if layout == _SAME:
        return match_layout(y, x)
    return y.contiguous() if layout == 0 else y.movedim(1, -1).contiguous().movedim(-1, 1)


def _result(x: Tensor, *arguments: Any) -> Tensor:
    *_, plan, _ = arguments
    dtype, layout, steps, _ = _read(plan)
    channels = 1 if steps and _NAMES[steps[-1]] in _ONE_CHANNEL else x.shape[1]
    sizes = (x.shape[0], channels, *x.shape[2:])
    return _arranged(x.new_empty(sizes, dtype=dtype or x.dtype), x, layout)


def _result_and_mean(x: Tensor, *arguments: Any) -> list[Tensor]:
    y = _result(x, *arguments)
    return [y, x.new_empty((x.shape[0], 1), dtype=_computing(x.dtype, y.dtype))]


def _gradients(grad: Tensor, x: Tensor, *arguments: Any) -> list[Tensor]:
    *parameters, _, _, _, _, of_image, of_parameters = arguments
    given = [p for p in parameters if p is not None]
    of_x = match_layout(torch.empty_like(x), x) if of_image else x.new_empty((x.shape[0], 0))
    sizes: tuple[int, ...] = (0,)
    if of_parameters:
        sizes = (max(p.shape[1] for p in given), sum(p.shape[2] for p in given))
    return [of_x, x.new_empty((x.shape[0], *sizes), dtype=_computing(x.dtype, grad.dtype))]


def _computing(*types: torch.dtype) -> torch.dtype:
    return torch.float64 if torch.float64 in types else torch.float32


def _backward(
    needs: Sequence[bool], grad: Tensor, x: Tensor, *arguments: Any, mean: Tensor | None = None
) -> list[Tensor | None]:
    *parameters, order, plan, numbers = arguments
    wanted = needs[1 : 1 + MOST_TENSORS]
    of_x, of_rows = _program_backward(grad, x, *parameters, order, mean, plan, numbers, needs[0], any(wanted))
    found: list[Tensor | None] = [of_x if needs[0] else None]
    first = 0
    for p, wants in zip(parameters, wanted):
        own = of_rows.narrow(2, first, p.shape[2]) if wants else None
        found.append(None if own is None else own.sum_to_size(p.shape).to(p.dtype))
        first += 0 if p is None else p.shape[2]
    return found


def _backward_around_mean(needs, grad, _, y, mean, *arguments):
    return _backward(needs, grad, *arguments, mean=mean)


_program = register("color_program", _reference, fake=_result, backward=_backward, bytes=True, casts_outputs=True)
_program_around_mean = register(
    "color_program_around_mean",
    _reference_around_mean,
    fake=_result_and_mean,
    backward=_backward_around_mean,
    saves_results=True,
    non_differentiable=(1,),
    bytes=True,
    casts_outputs=True,
)
_program_backward = register("color_program_backward", _pulled_back, fake=_gradients, casts_outputs=True)

# --- calls ----------------------------------------------------------------------------------------------------------


class Arguments(NamedTuple):
    """Parameters as the operators take them."""

    tensors: tuple[Tensor | None, ...]
    numbers: Sequence[float]
    columns: Sequence[int]


def arguments(parameters: Sequence[float | Tensor]) -> Arguments:
    """Parameters that are numbers, or tensors (B or 1, C or 1, P) for P of them."""
    numbers: list[float] = []
    columns: list[int] = []
    tensors: list[Tensor | None] = []
    first = 0
    for p in parameters:
        if isinstance(p, Tensor):
            tensors.append(p if p.is_floating_point() else p.float())
            for _ in range(p.shape[2]):
                columns.append(first)
                numbers.append(0.0)
                first += 1
        else:
            columns.append(-1)
            numbers.append(p)
    if not tensors:
        return Arguments(_NO_TENSORS, numbers, _NO_COLUMNS)
    if len(tensors) > MOST_TENSORS:
        tensors[MOST_TENSORS - 1 :] = [_joined(tensors[MOST_TENSORS - 1 :])]
    return Arguments((*tensors, *_NO_TENSORS[len(tensors) :]), numbers, columns)


_NO_TENSORS, _NO_COLUMNS = (None,) * MOST_TENSORS, ()


def _joined(tensors: Sequence[Any]) -> Tensor:
    """Their columns side by side."""
    sizes = torch.broadcast_shapes(*(t.shape[:2] for t in tensors))
    return torch.cat([t.expand(*sizes, -1) for t in tensors], 2)


def run(
    x: Tensor,
    steps: Sequence[int],
    given: Arguments,
    order: Tensor | None = None,
    dtype: torch.dtype | None = None,
    layout: int = _SAME,
) -> Tensor:
    """A program on images (B, C, H, W), whose result has a dtype and one of LAYOUTS."""
    means = steps.count(_AROUND_MEAN)
    if means < 2:
        return _run(x, steps, given, order, dtype, layout)
    if order is None:
        return _in_two(x, steps, given, dtype, layout)
    return _in_turns(means, x, steps, given, order, dtype, layout)


def _run(
    x: Tensor,
    steps: Sequence[int],
    given: Arguments,
    order: Tensor | None,
    dtype: torch.dtype | None = None,
    layout: int = _SAME,
) -> Tensor:
    means = _AROUND_MEAN in steps
    operator = _program_around_mean if means else _program
    of_one_type = dtype is None or (x.dtype == torch.float64) == (dtype == torch.float64)  # which kernels compute in
    call = operator if of_one_type else operator.reference
    y = call(x, *given.tensors, order, _plan(dtype, layout, steps, given.columns), given.numbers)
    return y[0] if means else y


def _in_turns(
    turns: int, x: Tensor, steps: Sequence[int], given: Arguments, order: Tensor, dtype: torch.dtype | None, layout: int
) -> Tensor:
    """A program with several means, in an order that is known to the samples: in each turn up to the next mean."""
    stored = dtype or x.dtype
    computed = _computing(x.dtype, stored)
    around = [order == i for i, step in enumerate(steps) if step == _AROUND_MEAN]
    turn = torch.stack(around).any(0).long().cumsum(1)  # means up to each position
    for k in range(1, turns):
        here = turn <= 1 if k == 1 else turn == k
        x = _run(x, steps, given, torch.where(here, order, -1), computed)
    return _run(x, steps, given, torch.where(turn >= turns, order, -1), stored, layout)


def _in_two(x: Tensor, steps: Sequence[int], given: Arguments, dtype: torch.dtype | None, layout: int) -> Tensor:
    """A program with several means as two, of which the first one stores what it computes in."""
    second = steps.index(_AROUND_MEAN, steps.index(_AROUND_MEAN) + 1)
    slots = sum(_PARAMETERS[_NAMES[i]] for i in steps[:second])
    stored = dtype or x.dtype
    tensors, numbers, columns = given
    first = Arguments(tensors, numbers[:slots], columns[:slots])
    x = run(x, steps[:second], first, dtype=_computing(x.dtype, stored))
    rest = Arguments(tensors, numbers[slots:], columns[slots:])
    return run(x, steps[second:], rest, dtype=stored, layout=layout)


def step(
    name: str, reference: Callable[..., Tensor], found: Callable[[Tensor], Tensor] | None = None
) -> Callable[..., Tensor]:
    """The step `name`, defined by `reference(x, *parameters)` on images (B, C, H, W), as a function of the same arguments.

    Parameters are numbers, or tensors that broadcast to the image; or tensors (B or 1, C or 1, P) for P parameters. The
    last one is `found(x)` where that is given.
    """
    _references[name] = reference
    composed = with_kernel_casts(reference)
    if found is not None:
        _findings[name] = found
        composed = with_kernel_casts(lambda x, *parameters: reference(x, *parameters, found(x)))
    steps, of_values, rest = [_NAMES.index(name)], name in _OF_VALUES, [0.0] * (name in _findings)
    plan = _plan(None, _SAME, steps, _NO_COLUMNS)

    def of_one_step(x: Tensor, *parameters: float | Tensor) -> Tensor:
        fits = x.numel() > 0 or 0 not in x.shape[2:]  # the kernels take no images without pixels
        plain = True
        for p in parameters:
            if isinstance(p, Tensor):
                plain = False
                fits = fits and p.dim() == 3 and (of_values or p.shape[1] == 1)
        if not fits:
            return composed(x, *_slots(parameters))
        if plain:  # most calls: straight to the operator
            if rest:
                return _program_around_mean(x, *_NO_TENSORS, None, plan, [*parameters, *rest])[0]
            return _program(x, *_NO_TENSORS, None, plan, parameters)
        return _run(x, steps, arguments([*parameters, *rest]), None)

    return of_one_step
