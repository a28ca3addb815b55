"""Color programs: a chain of per-pixel steps as one operator and one pass over the image.

A conversion is a program of one step. A step has a row in the table of steps.py, a reference, which is defined next to the
public function that uses it, and a formula in csrc/color/steps.h. `step` connects them by name.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from kvision._hints import look_at_range
from kvision._limits import MAX_COLOR_NUMBERS as MAX_NUMBERS  # noqa: F401
from kvision._limits import MAX_COLOR_STEPS as MAX_STEPS  # noqa: F401
from kvision._limits import MAX_COLOR_TENSORS as MAX_TENSORS
from kvision._modes import DTYPE
from kvision._ops import FLOATS, FastPath, match_layout, register, saturate_to_byte, with_kernel_casts
from kvision.color.steps import CONTRAST, NAMES, STEPS

_references: dict[str, Callable[..., Tensor]] = {}
_measurements: dict[str, Callable[[Tensor], Tensor]] = {}  # computes the last parameter of a step
_CLAMPING = ("contrast", "gamma", "posterize", "saturation", "saturation_gray")
_CLIPPING = ("affine", "log", "scale_shift", "scale_shift_rgb", "solarize")
_PER_VALUE = [name for name, step in STEPS.items() if step.domain == "any" and name != "contrast"]

# --- the operators --------------------------------------------------------------------------------------------------
#
# Arguments: the image (B, C, H, W); six tensors of parameters (B or 1, C or 1, P) or None; order (B or 1, S); the plan;
# and `numbers`, all parameters of all steps. The plan is one list of integers, because every argument of an operator costs
# time: the dtype of the result (an index into _DTYPES) and its layout, -1 for those of the image; the number of steps; the
# steps; and for every parameter its column among the last axes of all tensors, or -1 for a number. The columns are missing
# if all parameters are numbers.

_SAME = -1
_DTYPES = tuple(getattr(torch, name) for name in DTYPE)
LAYOUTS = {None: _SAME, torch.contiguous_format: 0, torch.channels_last: 1}


class _Plan(NamedTuple):
    dtype: torch.dtype | None
    layout: int
    steps: Sequence[int]
    columns: Sequence[int]


def _parse_plan(plan: Sequence[int]) -> _Plan:
    dtype, layout, count, *rest = plan
    return _Plan(None if dtype == _SAME else _DTYPES[dtype], layout, rest[:count], rest[count:])


def _plan(dtype: torch.dtype | None, layout: int, steps: Sequence[int], columns: Sequence[int]) -> list[int]:
    return [_SAME if dtype is None else _DTYPES.index(dtype), layout, len(steps), *steps, *columns]


def _sequential(x: Tensor, *arguments: Any) -> tuple[Tensor, Tensor]:
    """Apply the steps in order, or in the order of `order`. Also returns the mean that contrast used."""
    *parameters, order, plan, numbers = arguments
    _, _, steps, columns = _parse_plan(plan)
    tensors = _split_columns([p for p in parameters if p is not None])
    calls, first = [], 0
    for name in (NAMES[i] for i in steps):
        slots = range(first, first := first + STEPS[name].parameters)
        calls.append((name, [numbers[i] if not columns or columns[i] < 0 else tensors[columns[i]] for i in slots]))
    mean = x.new_zeros(x.shape[0], 1)
    for k in range(len(calls) if order is None else order.shape[1]):
        for i, (name, values) in enumerate(calls) if order is not None else [(k, calls[k])]:
            here = None if order is None else (order[:, k] == i)[:, None, None, None]
            if name in _measurements:
                measured = _measurements[name](x)
                values = [*values[:-1], measured]
                mean = _where(here, measured, mean[..., None, None])[..., 0, 0]
            x = _where(here, _references[name](x, *values), x)
    return x, mean


def _split_columns(parameters: Sequence[float | Tensor]) -> list[float | Tensor]:
    """Split tensors of parameters into their columns, each (B or 1, C or 1, 1, 1)."""
    slots: list[float | Tensor] = []
    for p in parameters:
        slots += p[..., None, None].unbind(2) if isinstance(p, Tensor) and p.dim() == 3 else [p]
    return slots


def _where(here: Tensor | None, new: Tensor, old: Tensor) -> Tensor:
    return new if here is None else torch.where(here, new, old)


_apply_steps = with_kernel_casts(_sequential)


def _reference_around_mean(x: Tensor, *arguments: Any) -> tuple[Tensor, Tensor]:
    *_, plan, _ = arguments
    dtype, layout, *_ = _parse_plan(plan)
    stored = dtype or x.dtype
    y, mean = _apply_steps(_to_compute_dtype(x, stored), *arguments)
    y = saturate_to_byte(255 * y) if stored == torch.uint8 else y.to(stored)
    return _with_layout(y, x, layout), mean


def _reference(x: Tensor, *arguments: Any) -> Tensor:
    return _reference_around_mean(x, *arguments)[0]


def _reference_backward(grad: Tensor, x: Tensor, *arguments: Any) -> tuple[Tensor, Tensor]:
    *parameters, order, _, plan, numbers, of_image, of_parameters = arguments
    tensors = [p for p in parameters if p is not None]
    promoted = _to_compute_dtype(x, grad.dtype)

    def result(x: Tensor, *rows: Tensor) -> Tensor:
        return _apply_steps(x, *rows, order, plan, numbers)[0]

    channels = max((p.shape[1] for p in tensors), default=1)
    rows = [p.to(promoted.dtype).expand(x.shape[0], channels, -1) for p in tensors]  # a gradient for each sample
    vjp_fn = torch.func.vjp(result, promoted, *rows)[1]
    grad_x, *grad_rows = vjp_fn(grad.to(promoted.dtype))
    empty = promoted[:, :0, 0, 0]
    return (
        match_layout(grad_x.to(x.dtype), x) if of_image else empty.to(x.dtype),
        torch.cat(grad_rows, 2) if of_parameters else empty,
    )


def _to_compute_dtype(x: Tensor, other: torch.dtype) -> Tensor:
    """`x` in the compute dtype; bytes become 255ths."""
    promoted = torch.float64 if torch.float64 in (x.dtype, other) else torch.float32
    return x.to(promoted) / 255 if x.dtype == torch.uint8 else x.to(promoted)


def _with_layout(y: Tensor, x: Tensor, layout: int) -> Tensor:
    if layout == _SAME:
        return match_layout(y, x)
    return y.contiguous() if layout == 0 else y.movedim(1, -1).contiguous().movedim(-1, 1)


def _result(x: Tensor, *arguments: Any) -> Tensor:
    *_, plan, _ = arguments
    dtype, layout, steps, _ = _parse_plan(plan)
    channels = 1 if steps and STEPS[NAMES[steps[-1]]].channels == "one" else x.shape[1]
    sizes = (x.shape[0], channels, *x.shape[2:])
    return _with_layout(x.new_empty(sizes, dtype=dtype or x.dtype), x, layout)


def _result_and_mean(x: Tensor, *arguments: Any) -> list[Tensor]:
    y = _result(x, *arguments)
    return [y, x.new_empty((x.shape[0], 1), dtype=_promoted_dtype(x.dtype, y.dtype))]


def _gradients(grad: Tensor, x: Tensor, *arguments: Any) -> list[Tensor]:
    *parameters, _, _, _, _, of_image, of_parameters = arguments
    tensors = [p for p in parameters if p is not None]
    grad_x = match_layout(torch.empty_like(x), x) if of_image else x.new_empty((x.shape[0], 0))
    sizes: tuple[int, ...] = (0,)
    if of_parameters:
        sizes = (max(p.shape[1] for p in tensors), sum(p.shape[2] for p in tensors))
    return [grad_x, x.new_empty((x.shape[0], *sizes), dtype=_promoted_dtype(x.dtype, grad.dtype))]


def _promoted_dtype(*types: torch.dtype) -> torch.dtype:
    return torch.float64 if torch.float64 in types else torch.float32


def _backward(
    needs: Sequence[bool], grad: Tensor, x: Tensor, *arguments: Any, mean: Tensor | None = None
) -> list[Tensor | None]:
    *parameters, order, plan, numbers = arguments
    needs_tensors = needs[1 : 1 + MAX_TENSORS]
    grad_x, grad_parameters = _program_backward(
        grad, x, *parameters, order, mean, plan, numbers, needs[0], any(needs_tensors)
    )
    grads: list[Tensor | None] = [grad_x if needs[0] else None]
    first = 0
    for p, needs_grad in zip(parameters, needs_tensors):
        grad_p = grad_parameters.narrow(2, first, p.shape[2]) if needs_grad else None
        grads.append(None if grad_p is None else grad_p.sum_to_size(p.shape).to(p.dtype))
        first += 0 if p is None else p.shape[2]
    return grads


def _backward_around_mean(needs, grad, _, y, mean, *arguments):
    return _backward(needs, grad, *arguments, mean=mean)


def clamps(steps: Sequence[int], numbers: Sequence[Any]) -> bool:
    """Whether one of the steps clamps to [0, 1]; the last parameter of some says whether they do."""
    end = 0
    for step in (STEPS[NAMES[i]] for i in steps):
        end += step.parameters
        if NAMES[step.number] in _CLAMPING or (NAMES[step.number] in _CLIPPING and numbers[end - 1]):
            return True
    return False


def _plan_clamps(x: Tensor, *arguments: Any) -> bool:
    *_, plan, numbers = arguments
    return clamps(_parse_plan(plan).steps, numbers)


def _supports(x: Tensor, *arguments: Any) -> str | None:
    """The kernels compute in one type: image and result are both float64, or neither is."""
    dtype = arguments[-2][0]
    if dtype == _SAME or (x.dtype == torch.float64) == (_DTYPES[dtype] == torch.float64):
        return None
    return f"there is no kernel from {x.dtype} to {_DTYPES[dtype]}"


_program = register(
    "color_program",
    _reference,
    fake=_result,
    backward=_backward,
    bytes=True,
    casts_outputs=True,
    supports=_supports,
    clamps=_plan_clamps,
)
_program_around_mean = register(
    "color_program_around_mean",
    _reference_around_mean,
    fake=_result_and_mean,
    backward=_backward_around_mean,
    saves_results=True,
    non_differentiable=(1,),
    bytes=True,
    casts_outputs=True,
    supports=_supports,
    clamps=_plan_clamps,
)
_program_of_numbers = FastPath("color_program_of_numbers", (*FLOATS, torch.uint8))
_program_backward = register("color_program_backward", _reference_backward, fake=_gradients, casts_outputs=True)

# --- calls ----------------------------------------------------------------------------------------------------------


class Arguments(NamedTuple):
    """Parameters in the form of the operators' arguments."""

    tensors: tuple[Tensor | None, ...]
    numbers: Sequence[float]
    columns: Sequence[int]


def arguments(parameters: Sequence[float | Tensor]) -> Arguments:
    """Convert parameters: each is a number, or a tensor (B or 1, C or 1, P) for P parameters."""
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
    if len(tensors) > MAX_TENSORS:
        tensors[MAX_TENSORS - 1 :] = [_concatenate(tensors[MAX_TENSORS - 1 :])]
    return Arguments((*tensors, *_NO_TENSORS[len(tensors) :]), numbers, columns)


_NO_TENSORS, _NO_COLUMNS = (None,) * MAX_TENSORS, ()


def _concatenate(tensors: Sequence[Any]) -> Tensor:
    """Concatenate the columns of all tensors."""
    sizes = torch.broadcast_shapes(*(t.shape[:2] for t in tensors))
    return torch.cat([t.expand(*sizes, -1) for t in tensors], 2)


def run(
    x: Tensor,
    steps: Sequence[int],
    parameters: Arguments,
    order: Tensor | None = None,
    dtype: torch.dtype | None = None,
    layout: int = _SAME,
) -> Tensor:
    """Run a program on images (B, C, H, W). The result has `dtype` and one of LAYOUTS."""
    contrasts = steps.count(CONTRAST)
    if contrasts < 2:
        return _run(x, steps, parameters, order, dtype, layout)
    if order is None:
        return _run_in_two(x, steps, parameters, dtype, layout)
    return _run_by_order(contrasts, x, steps, parameters, order, dtype, layout)


def _run(
    x: Tensor,
    steps: Sequence[int],
    parameters: Arguments,
    order: Tensor | None,
    dtype: torch.dtype | None = None,
    layout: int = _SAME,
) -> Tensor:
    has_mean = CONTRAST in steps
    operator = _program_around_mean if has_mean else _program
    y = operator(x, *parameters.tensors, order, _plan(dtype, layout, steps, parameters.columns), parameters.numbers)
    return y[0] if has_mean else y


def _run_by_order(
    contrasts: int,
    x: Tensor,
    steps: Sequence[int],
    parameters: Arguments,
    order: Tensor,
    dtype: torch.dtype | None,
    layout: int,
) -> Tensor:
    """Run a program with several means and an order per sample: each pass runs the steps up to the next mean."""
    stored = dtype or x.dtype
    computed = _promoted_dtype(x.dtype, stored)
    around = [order == i for i, step in enumerate(steps) if step == CONTRAST]
    means_so_far = torch.stack(around).any(0).long().cumsum(1)  # number of means up to each position
    for k in range(1, contrasts):
        here = means_so_far <= 1 if k == 1 else means_so_far == k
        x = _run(x, steps, parameters, torch.where(here, order, -1), computed)
    return _run(x, steps, parameters, torch.where(means_so_far >= contrasts, order, -1), stored, layout)


def _run_in_two(
    x: Tensor, steps: Sequence[int], parameters: Arguments, dtype: torch.dtype | None, layout: int
) -> Tensor:
    """Run a program with several means as two programs. The first one stores its result in the compute dtype."""
    second = steps.index(CONTRAST, steps.index(CONTRAST) + 1)
    slots = sum(STEPS[NAMES[i]].parameters for i in steps[:second])
    stored = dtype or x.dtype
    tensors, numbers, columns = parameters
    first = Arguments(tensors, numbers[:slots], columns[:slots])
    x = run(x, steps[:second], first, dtype=_promoted_dtype(x.dtype, stored))
    rest = Arguments(tensors, numbers[slots:], columns[slots:])
    return run(x, steps[second:], rest, dtype=stored, layout=layout)


def step(
    name: str, reference: Callable[..., Tensor], measure: Callable[[Tensor], Tensor] | None = None
) -> Callable[..., Tensor]:
    """Define the step `name` by `reference(x, *parameters)` on images (B, C, H, W); returns a function of these arguments.

    Parameters are numbers, or tensors that broadcast to the image; or tensors (B or 1, C or 1, P) for P parameters. The
    last one is `measure(x)` if that is given. Bytes give bytes, or `dtype`.
    """
    _references[name] = reference
    composed = with_kernel_casts(reference, levels=255)
    if measure is not None:
        _measurements[name] = measure
        composed = with_kernel_casts(lambda x, *parameters: reference(x, *parameters, measure(x)), levels=255)
    steps, per_value, rest = [STEPS[name].number], name in _PER_VALUE, (0.0,) * (name in _measurements)
    plan = _plan(None, _SAME, steps, _NO_COLUMNS)
    plan_tensor: Tensor | None = None

    def run_one_step(x: Tensor, *parameters: float | Tensor, dtype: torch.dtype | None = None) -> Tensor:
        nonlocal plan_tensor
        fits = x.numel() > 0 or 0 not in x.shape[2:]  # kernels need at least one pixel
        plain = True
        for p in parameters:
            if isinstance(p, Tensor):
                plain = False
                fits = fits and p.dim() == 3 and (per_value or p.shape[1] == 1)
        if not fits:
            return composed(x if dtype is None else _to_compute_dtype(x, dtype), *_split_columns(parameters))
        if plain and dtype is None:  # the most common case needs no conversion of parameters
            numbers = parameters + rest
            if _program_of_numbers.serves(x):
                if plan_tensor is None:
                    plan_tensor = torch.tensor(plan, device="cpu")
                    if clamps(steps, numbers):
                        look_at_range(x)
                return _program_of_numbers.kernel(x, plan_tensor, numbers)
            if rest:
                return _program_around_mean(x, *_NO_TENSORS, None, plan, numbers)[0]
            return _program(x, *_NO_TENSORS, None, plan, numbers)
        return _run(x, steps, arguments([*parameters, *rest]), None, dtype)

    return run_one_step
