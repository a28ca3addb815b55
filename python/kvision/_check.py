"""Argument checks. Every message says operator, argument, expected, got; see CONTRIBUTING.md.

Every call pays for them. Valid arguments therefore pass by plain loops and few attributes: generators, sets and slices of
shapes cost as much as the call of a kernel.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Sequence
from numbers import Integral, Real
from typing import Any, get_args

import torch
from torch import Tensor

from kvision._choices import Border, Reduction
from kvision._limits import LARGEST_WINDOW as LARGEST_WINDOW  # so that its area is an int, too
from kvision._torch_compat import in_function_transform
from kvision.core.exceptions import DeviceError, ShapeError, TypeCheckError, ValueCheckError

BORDERS = get_args(Border)
# What the kernels compute with: an axis is counted in int, a parameter of float32 images is a float.
LARGEST_INT = 2**31 - 1
LARGEST_FLOAT = torch.finfo(torch.float32).max
FLOATING = frozenset((torch.float16, torch.bfloat16, torch.float32, torch.float64))
NOT_SUBTRACTED = frozenset((torch.bool, torch.uint16, torch.uint32, torch.uint64))
COMPUTED = FLOATING.union(
    (torch.bool, torch.uint8, torch.uint16, torch.uint32, torch.uint64),
    (torch.int8, torch.int16, torch.int32, torch.int64),
)


def is_tensor(op: str, name: str, x: Any) -> None:
    """Raise TypeCheckError unless `x` is a dense tensor of real numbers."""
    if not isinstance(x, Tensor):
        raise TypeCheckError(f"{op}: expected {name} to be a Tensor, got {described(x)}", actual_type=type(x))
    if x.dtype.is_complex:
        raise TypeCheckError(f"{op}: expected {name} to be real, got {x.dtype}", actual_type=x.dtype)
    if x.layout is not torch.strided or x.is_nested:
        got = "a nested tensor" if x.is_nested else x.layout
        raise TypeCheckError(f"{op}: expected {name} to be dense, got {got}", actual_type=x.layout)


def described(x: Any) -> str:
    """The type of what is no tensor, and the call that makes one of it."""
    kind = type(x).__name__
    if isinstance(x, (list, tuple)) and x and (isinstance(x[0], Tensor) or is_pil(x[0]) or is_array(x[0])):
        other = "" if isinstance(x, list) else ", or pass a list where images may have different sizes"
        return f"a {kind} of {len(x)} images; stack them, as kvision.to_tensor does{other}"
    if is_pil(x):
        return f"{kind}; kvision.to_tensor converts PIL images"
    if isinstance(x, os.PathLike) or (isinstance(x, str) and os.path.splitext(x)[1]):
        return f"{kind}; kvision.to_tensor reads files"
    return f"{kind}; kvision.to_tensor converts images, torch.from_numpy other arrays" if is_array(x) else kind


def is_pil(x: Any) -> bool:
    """Whether `x` is a PIL image, without importing PIL, which is optional."""
    # Graphs have no module of a class.
    return not isinstance(x, (Tensor, list, tuple)) and type(x).__module__.startswith("PIL.")


def is_array(x: Any) -> bool:
    """Whether `x` is a NumPy array."""
    return type(x).__module__ == "numpy" and type(x).__name__ == "ndarray"


def numbers(op: str, name: str, x: Any) -> None:
    """Raise TypeCheckError unless `x` is a tensor of numbers that torch computes with: no float8, nothing quantized."""
    if not isinstance(x, Tensor) or x.dtype not in COMPUTED or x.layout is not torch.strided or x.is_nested:
        is_tensor(op, name, x)
        raise TypeCheckError(f"{op}: expected {name} of a type that torch computes with, got {x.dtype}")


def shape(op: str, name: str, x: Any, *expected: str | int) -> None:
    """Raise unless `x` is a tensor with one axis per entry of `expected`; an int entry fixes the size of its axis."""
    numbers(op, name, x)
    if not _fits(x.shape, expected, 0):
        listed = ", ".join(map(str, expected)) + ("," if len(expected) == 1 else "")
        raise ShapeError(
            f"{op}: expected {name} of shape ({listed}), got {tuple(x.shape)}{_advice_on_axes(expected, x)}",
            actual_shape=x.shape,
            expected_shape=expected,
        )


def trailing_shape(op: str, name: str, x: Any, *expected: str | int) -> None:
    """Raise unless `x` is a tensor whose last axes are `expected`, after any others; an int fixes the size of its axis."""
    numbers(op, name, x)
    if not _fits(x.shape, expected, x.dim() - len(expected)):
        raise ShapeError(
            f"{op}: expected {name} of shape (*, {', '.join(map(str, expected))}), got {tuple(x.shape)}"
            f"{_advice_on_axes(expected, x)}",
            actual_shape=x.shape,
        )


def _fits(sizes: Sequence[int], expected: Sequence[str | int], first: int) -> bool:
    """Whether the axes from `first` on are `expected`, which are all of them where `first` is 0."""
    if len(sizes) - first != len(expected) or first < 0:
        return False
    for e in expected:
        if isinstance(e, int) and e != sizes[first]:
            return False
        first += 1
    return True


def broadcastable(op: str, **shapes: Sequence[int]) -> None:
    """Raise ShapeError unless the named leading shapes can be broadcast together."""
    first, *others = shapes.values()
    for sizes in others:
        if sizes != first:
            break
    else:
        return
    common: list[int] = []  # of the shapes so far, the last axis first
    for sizes in shapes.values():
        for axis, n in enumerate(reversed(sizes)):
            if axis == len(common):
                common.append(n)
            elif common[axis] == 1:
                common[axis] = n
            elif n != 1 and n != common[axis]:
                got = ", ".join(f"{tuple(shape)} of {name}" for name, shape in shapes.items())
                raise ShapeError(f"{op}: expected leading axes that broadcast, got {got}")


def leading_axes(op: str, axes: int, **tensors: Tensor) -> None:
    """Raise ShapeError unless the axes in front of the last `axes` of the named tensors can be broadcast together."""
    batch = None
    for x in tensors.values():
        if x.dim() != axes + 1:
            break
        size = x.shape[0]
        if batch is None:
            batch = size
        elif size != batch:
            break
    else:
        return
    broadcastable(op, **{name: x.shape[: x.dim() - axes] for name, x in tensors.items()})


def images(op: str, name: str, x: Any) -> None:
    """Raise unless `x` is a (B, C, H, W) tensor with at least one pixel an image."""
    numbers(op, name, x)
    if x.dim() != 4:
        raise ShapeError(
            f"{op}: expected {name} of shape (B, C, H, W), got {tuple(x.shape)}{channels_advice(x.shape)}",
            actual_shape=x.shape,
        )
    sizes = x.shape
    if sizes[2] == 0 or sizes[3] == 0:
        raise ShapeError(f"{op}: expected {name} with H, W of at least 1, got {tuple(sizes)}", actual_shape=sizes)


def channels(op: str, name: str, x: Any, count: int, error: type[Exception] = ShapeError) -> None:
    """Raise unless `x` is a (*, C, H, W) tensor with `count` channels; `error` is the class for another shape."""
    numbers(op, name, x)
    if x.dim() < 3 or x.shape[-3] != count:
        raise error(
            f"{op}: expected {name} of shape (*, {count}, H, W), got {tuple(x.shape)}{channels_advice(x.shape)}"
        )


def rgb(op: str, shape: Sequence[int]) -> None:
    """Raise unless images (*, C, H, W) of a shape have three channels."""
    if shape[-3] != 3:
        raise ShapeError(f"{op}: expected images with 3 channels, got {shape[-3]}{channels_advice(shape)}")


def channels_advice(shape: Sequence[int]) -> str:
    """The end of an error about channels, for images whose last axis seems to have them, as in NumPy; else nothing."""
    axes = len(shape)
    if axes < 3 or shape[-1] not in (3, 4) or shape[-3] in (1, 3, 4):
        return ""
    order = (*range(axes - 3), axes - 1, axes - 3, axes - 2)
    return f"; permute({', '.join(map(str, order))}) puts channels first"


def _advice_on_axes(expected: Sequence[str | int], x: Tensor) -> str:
    return channels_advice(x.shape) if tuple(expected[-2:]) == ("H", "W") else ""


def volumes(op: str, name: str, x: Any) -> None:
    """Raise unless `x` is a (B, C, D, H, W) tensor with at least one voxel a volume."""
    numbers(op, name, x)
    if x.dim() != 5:
        raise ShapeError(f"{op}: expected {name} of shape (B, C, D, H, W), got {tuple(x.shape)}", actual_shape=x.shape)
    if 0 in x.shape[2:]:
        raise ShapeError(
            f"{op}: expected {name} with D, H, W of at least 1, got {tuple(x.shape)}", actual_shape=x.shape
        )


def sizes_as_numbers(x: Tensor) -> Sequence[int]:
    """`x.shape` for arithmetic: under torch.jit.trace, whose sizes are tensors, as the numbers that it records."""
    return tuple(map(int, x.shape)) if torch.jit.is_tracing() else x.shape


def is_symbolic(*sizes: int) -> bool:
    """Whether sizes may be symbols of a graph that serves several of them. Dynamo's types do not show it."""
    return torch.compiler.is_compiling() or not all(type(n) is int for n in sizes)


def is_one_or(count: int, samples: int) -> bool:
    """Whether there is one for all samples or one for each. Dynamo gives False for a number in (1, its symbolic equal)."""
    return count == 1 or count == samples


def values_are_readable(x: Tensor, may_wait: bool = False) -> bool:
    """Whether values of `x` can be read without breaking a trace, a transform or the capture of a CUDA graph.

    Reading values on a GPU waits for it, which the caller must allow by `may_wait`.
    """
    if torch.compiler.is_compiling() or in_function_transform():
        return False
    if x.device.type == "cuda":
        return may_wait and not torch.cuda.is_current_stream_capturing()
    return x.device.type == "cpu"


def floating(op: str, name: str, x: Tensor) -> None:
    """Raise TypeCheckError unless `x` holds floating-point numbers."""
    if not x.is_floating_point():
        raise TypeCheckError(f"{op}: expected {name} to be floating point, got {x.dtype}", actual_type=x.dtype)


def floating_or_bytes(op: str, name: str, x: Tensor) -> None:
    """Raise TypeCheckError unless `x` holds floating-point numbers or uint8."""
    if not x.is_floating_point() and x.dtype != torch.uint8:
        raise TypeCheckError(f"{op}: expected {name} to be floating point or uint8, got {x.dtype}", actual_type=x.dtype)


def floating_trailing_shape(op: str, name: str, x: Any, *expected: str | int) -> None:
    """Raise unless `x` is a floating-point tensor that ends in the axes `expected`."""
    if isinstance(x, Tensor) and x.dtype in FLOATING and x.layout is torch.strided and not x.is_nested:
        if _fits(x.shape, expected, x.dim() - len(expected)):
            return
    trailing_shape(op, name, x, *expected)
    floating(op, name, x)


def same_device(op: str, **tensors: Tensor) -> None:
    """Raise DeviceError unless all the named tensors are on one device."""
    first = None
    for x in tensors.values():
        if first is None:
            first = x.device
        elif x.device != first:
            devices = [x.device for x in tensors.values()]
            got = ", ".join(f"{name} on {device}" for name, device in zip(tensors, devices))
            raise DeviceError(f"{op}: expected all tensors on one device, got {got}", actual_devices=devices)


def to_device_of(op: str, x: Tensor, name: str, value: Tensor, of: str = "input") -> Tensor:
    """The parameter `value` on the device of `x`: copied there from the CPU, without waiting for either.

    Parameters are what a few numbers say for a whole image: factors, sigmas, angles, weights, kernels, means, matrices.
    Images, maps, points and labels are not moved: `same_device` refuses them, as this refuses a parameter on another GPU.
    """
    if value.device == x.device:
        return value
    if value.device.type != "cpu":
        same_device(op, **{of: x, name: value})
    # Pageable memory is read before the call returns. Pinned memory is read later, when its owner may have changed it.
    pinned = values_are_readable(value) and value.is_pinned()
    return value.to(x.device, non_blocking=not pinned)


def nearest_name(name: str, known: Iterable[str]) -> str | None:
    """The known name that is most like a misspelt one, upper and lower case alike; None where none is."""
    import difflib  # a name is seldom misspelt

    by_lowered = {other.lower(): other for other in known}
    nearest = difflib.get_close_matches(name.lower(), by_lowered, n=1)
    return by_lowered[nearest[0]] if nearest else None


class UnknownChoiceError(ValueCheckError, NotImplementedError):
    """A value that is not one of the options, where Kornia raises NotImplementedError."""


def choice(
    op: str, name: str, value: Any, options: Sequence[Any], error: type[ValueCheckError] = ValueCheckError
) -> None:
    """Raise `error` unless `value` is one of `options`."""
    if not isinstance(value, type(options[0])) or value not in options:
        listed = ", ".join(map(str, options))
        raise error(f"{op}: {name} must be one of {listed}; got {value!r}", actual_value=value)


def reduction(op: str, value: Any, options: Sequence[str] = get_args(Reduction)) -> None:
    """Raise UnknownChoiceError unless `value` names a reduction."""
    choice(op, "reduction", value, options, UnknownChoiceError)


def same_shape(op: str, **tensors: Tensor) -> None:
    """Raise ShapeError unless all the named tensors have the same shape."""
    shapes = [x.shape for x in tensors.values()]
    first = shapes[0]
    fits = True
    for sizes in shapes:
        fits = fits and sizes == first
    if not fits:
        got = ", ".join(f"{name} {tuple(shape)}" for name, shape in zip(tensors, shapes))
        raise ShapeError(f"{op}: expected tensors of one shape, got {got}", actual_shape=shapes)


def border(op: str, border_type: Any) -> None:
    """Raise ValueCheckError unless `border_type` names a border rule."""
    if not isinstance(border_type, str) or border_type not in BORDERS:
        choice(op, "border_type", border_type, BORDERS)


def flag(op: str, name: str, value: Any) -> None:
    """Raise TypeCheckError unless `value` is a bool."""
    if not isinstance(value, bool):
        raise TypeCheckError(f"{op}: expected {name} to be a bool, got {value!r}", actual_type=type(value))


def switch(op: str, name: str, value: Any) -> bool:
    """`value` as a bool where truth is what counts, so that 0, 1 and None serve as well; raise TypeCheckError for others."""
    if isinstance(value, bool):
        return value
    number = bool(value) if type(value).__name__ in ("bool_", "bool") else scalar(op, name, value)  # NumPy's
    if number is not None and not isinstance(number, (int, float)):
        raise TypeCheckError(f"{op}: expected {name} to be a bool, got {described(value)}", actual_type=type(value))
    return bool(number)


def device(op: str, value: Any) -> torch.device | None:
    """`value` as a device; raise unless torch has it. None is the default one."""
    if value is None or isinstance(value, torch.device):
        return value
    try:
        return torch.device(value)
    except (RuntimeError, TypeError) as error:
        kind = TypeCheckError if isinstance(error, TypeError) else ValueCheckError
        raise kind(f"{op}: expected device to be one that torch has here, got {value!r}: {error}") from error


def as_tensor(op: str, name: str, value: Any) -> Tensor:
    """Numbers as a tensor; raise TypeCheckError for what torch makes none of."""
    try:
        return value if isinstance(value, Tensor) else torch.as_tensor(value, device="cpu")
    except (RuntimeError, TypeError, ValueError, OverflowError) as error:
        raise TypeCheckError(f"{op}: expected {name} to be numbers, got {value!r}", actual_type=type(value)) from error


def subtractable(op: str, **tensors: Tensor) -> None:
    """Raise TypeCheckError for tensors of bools and unsigned integers, which torch does not subtract."""
    for name, x in tensors.items():
        if x.dtype in NOT_SUBTRACTED:
            raise TypeCheckError(f"{op}: expected {name} of a type with negative numbers, got {x.dtype}")


def representable(op: str, name: str, value: float, dtype: torch.dtype) -> None:
    """Raise ValueCheckError for a finite number that `dtype` would have as infinite."""
    if abs(value) > torch.finfo(dtype).max and abs(value) != math.inf:
        raise ValueCheckError(f"{op}: expected {name} to be a {dtype} number, got {value!r}", actual_value=value)


def function(op: str, name: str, value: Any) -> None:
    """Raise TypeCheckError unless `value` can be called, as modules and functions can; a class has yet to be made a module."""
    if not callable(value) or isinstance(value, type):
        raise TypeCheckError(
            f"{op}: expected {name} to be a module or function, got {value!r}", actual_type=type(value)
        )


def scalar(op: str, name: str, value: Any) -> Any:
    """A NumPy scalar or a tensor of no axes as Python's number; everything else as it is.

    A tensor on a GPU is waited for. One that requires a gradient is refused, since it would get none.
    """
    if isinstance(value, Tensor) and value.dim() == 0 and not value.dtype.is_complex:
        if value.requires_grad and torch.is_grad_enabled():
            raise TypeCheckError(
                f"{op}: expected {name} to be a number, got a Tensor that requires a gradient, which it would not get; "
                f"pass {name}.detach()",
                actual_type=type(value),
            )
        return value.item()
    if isinstance(value, (int, float, torch.SymInt, torch.SymFloat)) or not isinstance(value, Real):
        return value
    return int(value) if isinstance(value, Integral) else float(value)


def scalars(op: str, name: str, value: Any) -> Any:
    """`scalar`, also of the entries of a tuple or list."""
    if isinstance(value, (tuple, list)):
        return type(value)(scalar(op, name, v) for v in value) if type(value) in (tuple, list, torch.Size) else value
    return scalar(op, name, value)


def number(op: str, name: str, value: Any, minimum: float = -math.inf) -> float:
    """`value` as a float; raise unless it is a number of at least `minimum`. NumPy's and torch's scalars are numbers."""
    if not isinstance(value, (int, float)):
        value = scalar(op, name, value)
        if not isinstance(value, (int, float)):
            raise TypeCheckError(f"{op}: expected {name} to be a number, got {value!r}", actual_type=type(value))
    if not value >= minimum or not fits_float(value):  # also refuses NaN
        bound = f" of at least {minimum:g}" if minimum > -math.inf else ""
        raise ValueCheckError(f"{op}: expected {name} to be a float32 number{bound}, got {value!r}", actual_value=value)
    return float(value)


def fraction(op: str, name: str, value: Any) -> float:
    """`value` as a float; raise unless it is a number within 0 and 1, as probabilities and opacities are."""
    result = number(op, name, value)
    if not 0 <= result <= 1:
        raise ValueCheckError(f"{op}: expected {name} within 0 and 1, got {value}", actual_value=value)
    return result


def fits_float(value: float) -> bool:
    """Whether float32 has the number, up to rounding, or it is infinite."""
    return -LARGEST_FLOAT <= value <= LARGEST_FLOAT or value in (math.inf, -math.inf)


def reflectable(
    op: str, x: Tensor, pads: Sequence[int], border_type: str, advice: str = "use border_type='replicate'"
) -> None:
    """Raise ShapeError where a border of `pads` pixels along the trailing axes of `x` would reach past the opposite edge.

    'reflect' needs more pixels than it mirrors, 'circular' as many as it repeats; torch's padding has the same limits.
    `advice` is for functions whose border cannot be chosen.
    """
    if border_type not in ("reflect", "circular"):
        return
    spare = 0 if border_type == "circular" else 1
    for pad, size in zip(reversed(pads), reversed(x.shape)):
        if pad > size - spare:
            raise ShapeError(
                f"{op}: expected input larger than its '{border_type}' border of {pad} pixels, got {tuple(x.shape)}; "
                f"{advice} for images this small",
                actual_shape=x.shape,
            )


def pair(op: str, name: str, value: Any, minimum: int = 1, maximum: int = LARGEST_WINDOW) -> tuple[int, int]:
    """`value`, an int or two of them in (y, x) order, as (y, x): the window of a filter, unless `maximum` says otherwise."""
    return ints(op, name, value, 2, minimum, maximum)  # type: ignore[return-value]  # two entries by construction


def ints(op: str, name: str, value: Any, count: int, minimum: int = 1, maximum: int = LARGEST_INT) -> tuple[int, ...]:
    """`value`, an int or `count` of them, as a tuple of `count` ints of at least `minimum`.

    The maximum is LARGEST_WINDOW for the windows of filters. Scalars of NumPy and torch become ints. A symbolic size of
    torch.export and torch.compile stays symbolic; the kernels check its maximum when the graph runs.
    """
    if type(value) is int and minimum <= value <= maximum:
        return (value,) * count
    if isinstance(value, (tuple, list)) and len(value) == count > 1:
        for n in value:
            if type(n) is not int or n < minimum or n > maximum:
                break
        else:
            return tuple(value)
    values = scalars(op, name, value)
    if is_int(values):
        values = (values,) * count
    elif count == 1 or not isinstance(values, (tuple, list)) or not values or not all(map(is_int, values)):
        raise TypeCheckError(f"{op}: expected {name} to be {_ints(count)}, got {value!r}", actual_type=type(value))
    values = tuple(n if isinstance(n, torch.SymInt) else int(n) for n in values)
    if len(values) != count or any(n < minimum for n in values):
        raise ValueCheckError(
            f"{op}: expected {name} to be {_ints(count)} of at least {minimum}, got {value!r}", actual_value=value
        )
    if all(isinstance(n, torch.SymInt) or n <= maximum for n in values):
        return values
    raise ValueCheckError(
        f"{op}: expected {name} to be {_ints(count)} of at most {maximum}, got {value!r}", actual_value=value
    )


def is_int(value: Any) -> bool:
    """Whether `value` is an integer: Python's, NumPy's or a symbolic one, but no bool."""
    return type(value) is int or (isinstance(value, (Integral, torch.SymInt)) and not isinstance(value, bool))


def _ints(count: int) -> str:
    return "an int" if count == 1 else f"an int or {count} ints"


def odd(op: str, name: str, sizes: Sequence[int]) -> None:
    """Raise ValueCheckError unless all `sizes` are odd."""
    for n in sizes:
        if n % 2 == 0:
            raise ValueCheckError(f"{op}: expected {name} to be odd, got {tuple(sizes)}", actual_value=tuple(sizes))
