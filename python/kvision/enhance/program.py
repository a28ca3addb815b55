"""A chain of color steps as one module and one pass over the image."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from kvision import _check
from kvision._leading import apply_on_batch
from kvision._torch_compat import ConstantModule
from kvision.color.frames import PLAINLY, Frames, affine_of
from kvision.color.program import LAYOUTS, MAX_STEPS, arguments, run
from kvision.color.steps import STEPS
from kvision.core.exceptions import ImageError, ShapeError, TypeCheckError, ValueCheckError

Value = float | Sequence[float] | Tensor


class _Kind(NamedTuple):
    step: str
    parameters: dict[str, int] = {}  # names and sizes
    arguments: Callable[..., tuple[Any, ...]] = lambda *values: values  # from parameters to the arguments of the step


_KINDS = {
    "brightness": _Kind("scale_shift", {"factor": 1}, lambda f: (f, 0.0, 1.0)),
    "shift": _Kind("scale_shift", {"shift": 1}, lambda s: (1.0, s, 1.0)),
    "contrast": _Kind("contrast", {"factor": 1}, lambda f: (f, 0.0)),
    "saturation": _Kind("saturation_gray", {"factor": 1}),
    "hue": _Kind("hue", {"angle": 1}),
    "gamma": _Kind("gamma", {"gamma": 1}, lambda g: (g, 1.0)),
    "solarize": _Kind("solarize", {"threshold": 1}, lambda t: (t, 0.0, 0.0)),
    "posterize": _Kind("posterize", {"bits": 1}, lambda b: (b, 1.0)),
    "invert": _Kind("scale_shift", {}, lambda: (-1.0, 1.0, 0.0)),
    "normalize": _Kind("standardize_rgb", {"mean": 3, "std": 3}),
    "denormalize": _Kind("scale_shift_rgb", {"mean": 3, "std": 3}, lambda mean, std: (std, mean, 0.0)),
}


_NAMES = tuple(_KINDS)


class ColorProgram(ConstantModule):
    """A chain of color steps on RGB images, computed in one pass over memory (two with contrast), with its gradient.

    Every step is a name and its parameters:

        ("brightness", factor)      factor * x, clamped: adjust_brightness_accumulative
        ("shift", shift)            x + shift, clamped: adjust_brightness
        ("contrast", factor)        away from the mean gray: adjust_contrast_with_mean_subtraction
        ("saturation", factor)      away from the gray: adjust_saturation_with_gray_subtraction
        ("hue", angle)              rotated by an angle in radians: adjust_hue
        ("gamma", gamma)            x ** gamma: adjust_gamma
        ("solarize", threshold)     1 - x from the threshold on: solarize
        ("posterize", bits)         the high bits of the levels: posterize
        ("invert",)                 1 - x: invert
        ("normalize", mean, std)    (x - mean) / std, three numbers each: normalize
        ("denormalize", mean, std)  x * std + mean, three numbers each: denormalize

    The first four with normalize are torchvision's ColorJitter, but for the hue, which has turns there. The result is that
    of the functions named, one after the other in float32.

    Args:
        steps: tuples as above, at most 16. A parameter is a number, or three in a tuple; or a tensor () or (B,), (3,) or
            (B, 3), of one a sample. An nn.Parameter is learned.
        dtype: type of the result, floating point or uint8; default: that of the image.
        memory_format: torch.contiguous_format or torch.channels_last, of the result; default: that of the image.

    Attributes:
        steps: the steps as they were given.

    Raises:
        TypeCheckError, ValueCheckError: an unknown step, wrong parameters, more than 16 steps.

    Example:
        >>> import torch, kvision as K
        >>> jitter = K.enhance.ColorProgram(("brightness", 1.2), ("saturation", 0.5), dtype=torch.float16)
        >>> jitter
        ColorProgram(brightness(1.2), saturation(0.5), dtype=torch.float16)
        >>> image = torch.full((2, 3, 4, 5), 100, dtype=torch.uint8)
        >>> jitter(image)[0, 0, 0, 0]
        tensor(0.4707, dtype=torch.float16)
        >>> jitter(image, {"brightness": torch.tensor([1.0, 0.0])}).amax((1, 2, 3))
        tensor([0.3921, 0.0000], dtype=torch.float16)
    """

    def __init__(
        self,
        *steps: Sequence[Any],
        dtype: torch.dtype | None = None,
        memory_format: torch.memory_format | None = None,
    ) -> None:
        super().__init__()
        if len(steps) > MAX_STEPS:
            raise ValueCheckError(f"ColorProgram: expected at most {MAX_STEPS} steps, got {len(steps)}")
        if (
            dtype is not None
            and dtype != torch.uint8
            and not (isinstance(dtype, torch.dtype) and dtype.is_floating_point)
        ):
            raise TypeCheckError(f"ColorProgram: expected dtype to be floating point or uint8, got {dtype!r}")
        if memory_format not in tuple(LAYOUTS):
            raise ValueCheckError(
                f"ColorProgram: memory_format must be torch.contiguous_format or torch.channels_last; got {memory_format!r}"
            )
        self.dtype, self.memory_format = dtype, memory_format
        self._layout = LAYOUTS[memory_format]
        self._steps: list[tuple[str, list[Any]]] = []  # a tensor is represented by its attribute's name
        for i, args in enumerate(steps):
            name, values = _checked(args)
            for k, parameter in enumerate(_KINDS[name].parameters):
                value, attribute = values[k], f"{parameter}_{i}"
                if not isinstance(value, Tensor):
                    continue
                values[k] = attribute
                if isinstance(value, nn.Parameter):
                    self.register_parameter(attribute, value)
                else:
                    self.register_buffer(attribute, value, persistent=False)
            self._steps.append((name, values))
        self._names = [name for name, _ in self._steps]
        self._program = [STEPS[_KINDS[name].step].number for name, _ in self._steps]
        # Cached for parameters that are constant: the slots of each step, and the arguments of the whole program.
        self._numbers = [
            None if any(isinstance(value, str) for value in values) else _slots(name, values, None)
            for name, values in self._steps
        ]
        plain = [slots for slots in self._numbers if slots is not None]
        self._arguments = arguments([n for slots in plain for n in slots]) if len(plain) == len(self._numbers) else None

    @property
    def steps(self) -> tuple[tuple[Any, ...], ...]:
        return tuple((name, *values) for name, values in map(self._values, range(len(self._steps))))

    def forward(
        self,
        image: Tensor | Frames,
        parameters: Mapping[str | int, Value | Sequence[Value]] | None = None,
        order: Tensor | None = None,
        enabled: Tensor | None = None,
    ) -> Tensor:
        """Run the program.

        Args:
            image: RGB images (*, 3, H, W), floating point in [0, 1], or uint8, whose levels are 255ths. Of
                :class:`kvision.color.Frames` the steps get colors that are not rounded; a program that normalizes, and does
                nothing else, is part of the launch that reads the planes.
            parameters: other parameters for this call, by the name of a step or its position: a value, or for steps of
                several a tuple of them.
            order: (S,) or (B, S), int64: which step comes at each position, -1 for none; default: as they were given.
            enabled: (S,) or (B, S), bool: which steps are done.

        Returns:
            The images, differentiable in image and parameters.

        Raises:
            TypeCheckError, ValueCheckError: arguments of the wrong type.
            ImageError: image is not (*, 3, H, W).
            ShapeError: no pixels; parameters, order or enabled that do not fit the image or the steps.
            DeviceError: the tensors are on different devices; parameters in CPU memory are moved.
        """
        dtype, args = self.dtype, self._arguments
        if isinstance(image, Frames):
            dtype = dtype or image.dtype
            plain = args is not None and not parameters and order is None and enabled is None and self._layout < 0
            affine = affine_of(self._program, args.columns, args.numbers) if plain and args is not None else None
            rgb = (
                image._read(None, None, PLAINLY, *affine, dtype)
                if affine
                else image._read(None, None, dtype=image.computed)
            )
            rgb = rgb[0] if image.is_single else rgb
            if affine is not None:
                return rgb
            image = rgb
        _check.channels("ColorProgram", "image", image, 3, ImageError)
        if not image.is_floating_point() and image.dtype != torch.uint8:
            raise TypeCheckError(f"ColorProgram: expected image to be floating point or uint8, got {image.dtype}")
        if 0 in image.shape[-2:]:
            raise ShapeError(f"ColorProgram: expected image with H, W of at least 1, got {tuple(image.shape)}")
        if parameters or args is None:
            args = arguments(self._all_slots(parameters or {}, image))
        if order is not None or enabled is not None:
            order = _order(order, enabled, len(self._program), image)
        return apply_on_batch(run, image, self._program, args, order, dtype, self._layout)

    def _all_slots(self, parameters: Mapping[str | int, Any], image: Tensor) -> list[float | Tensor]:
        """The parameters of the program: numbers, or tensors (B or 1, 1, P) that fit the image."""
        if not isinstance(parameters, Mapping):
            raise TypeCheckError(f"ColorProgram: expected parameters by the names of steps, got {parameters!r}")
        slots_by_step = list(self._numbers)
        for key, value in parameters.items():
            i = self._index(key)
            name, _ = self._steps[i]
            values = (value,) if len(_KINDS[name].parameters) == 1 else value
            _check_values(name, values)
            slots_by_step[i] = _slots(name, values, image)
        slots: list[float | Tensor] = []
        for i, step_slots in enumerate(slots_by_step):
            slots += _slots(*self._values(i), image) if step_slots is None else step_slots
        return slots

    def _index(self, key: str | int) -> int:
        """The index of a step from its name or index."""
        names = self._names
        if isinstance(key, int) and -len(names) <= key < len(names):
            return key
        if not isinstance(key, str) or names.count(key) != 1:
            raise ValueCheckError(f"ColorProgram: there is not one step {key!r} among {', '.join(names)}")
        return names.index(key)

    def _values(self, i: int) -> tuple[str, list[Any]]:
        """The i-th step's name and parameters."""
        name, values = self._steps[i]
        return name, [getattr(self, v) if isinstance(v, str) else v for v in values]

    def extra_repr(self) -> str:
        steps = [f"{name}({', '.join(map(_short, values))})" for name, *values in self.steps]
        steps += [
            f"{k}={v}" for k, v in (("dtype", self.dtype), ("memory_format", self.memory_format)) if v is not None
        ]
        return ", ".join(steps)


def _short(value: Any) -> str:
    return f"{type(value).__name__}{tuple(value.shape)}" if isinstance(value, Tensor) else repr(value)


def _checked(step: Any) -> tuple[str, list[Any]]:
    """The name of a step and its parameters."""
    if not isinstance(step, (tuple, list)) or not step or not isinstance(step[0], str):
        raise TypeCheckError(f"ColorProgram: expected steps to be tuples of a name and parameters, got {step!r}")
    name, *values = step
    _check.choice("ColorProgram", "step", name, _NAMES)
    _check_values(name, values)
    return name, values


def _check_values(name: str, values: Sequence[Any]) -> None:
    expected_sizes = _KINDS[name].parameters
    if len(values) != len(expected_sizes):
        raise ValueCheckError(
            f"ColorProgram: {name} takes {', '.join(expected_sizes) or 'no parameters'}; got {len(values)} of them"
        )
    for (parameter, size), value in zip(expected_sizes.items(), values):
        if isinstance(value, Tensor):
            _check.numbers("ColorProgram", f"{parameter} of {name}", value)
            continue
        several = isinstance(value, (tuple, list))
        if several and (size == 1 or len(value) != size):
            raise ValueCheckError(f"ColorProgram: expected {parameter} of {name} to be {size} numbers, got {value!r}")
        for number in value if several else [value]:
            _check.number("ColorProgram", f"{parameter} of {name}", number)


def _slots(name: str, values: Sequence[Any], image: Tensor | None) -> list[float | Tensor]:
    """The parameters of a step in the slots of the program."""
    kind = _KINDS[name]
    slots: list[float | Tensor] = []
    fitting = []
    for (parameter, size), value in zip(kind.parameters.items(), values):
        fitting.append(_fitting(name, parameter, size, value, image))
    for argument in kind.arguments(*fitting):
        if isinstance(argument, tuple):
            slots += argument
        else:
            slots.append(argument)
    return slots


def _fitting(name: str, parameter: str, size: int, value: Value, image: Any) -> float | tuple[float, ...] | Tensor:
    """A parameter as a number or `size` of them, or as a tensor (B or 1, 1, size)."""
    if not isinstance(value, Tensor):
        if isinstance(value, Sequence):
            return tuple(map(float, value))
        return float(value) if size == 1 else (float(value),) * size
    value = _check.to_device_of("ColorProgram", image, parameter, value, of="image")
    axes, count = value.dim(), value.numel()
    batch = image.shape[0] if image.dim() == 4 else math.prod(image.shape[:-3])
    if size == 1 and axes <= 1 and (count == 1 or count == batch):
        return value.reshape(-1, 1, 1)
    rows = value if size > 1 and axes > 0 else value[..., None]
    if rows.dim() > 2 or rows.shape[-1] not in (1, size) or not _check.is_one_or(math.prod(rows.shape[:-1]), batch):
        expected = f"() or ({batch},)" if size == 1 else f"({size},) or ({batch}, {size})"
        raise ShapeError(f"ColorProgram: expected {parameter} of {name} of shape {expected}, got {tuple(value.shape)}")
    return rows.expand(*rows.shape[:-1], size).reshape(-1, 1, size)


def _order(order: Tensor | None, enabled: Tensor | None, steps: int, image: Tensor) -> Tensor | None:
    """The step at each position, (B or 1, S), -1 for none; None for all steps in order."""
    batch = math.prod(image.shape[:-3])
    for name, x, kind in (("order", order, torch.int64), ("enabled", enabled, torch.bool)):
        if x is None:
            continue
        if not isinstance(x, Tensor) or x.dtype != kind:
            raise TypeCheckError(f"ColorProgram: expected {name} to be a Tensor of {kind}, got {x!r}")
        _check.same_device("ColorProgram", image=image, **{name: x})
        if x.dim() not in (1, 2) or x.shape[-1] != steps or not _check.is_one_or(math.prod(x.shape[:-1]), batch):
            raise ShapeError(
                f"ColorProgram: expected {name} of shape ({steps},) or ({batch}, {steps}), got {tuple(x.shape)}"
            )
    if enabled is not None:
        enabled = enabled.reshape(-1, steps)
        order = torch.arange(steps, device=image.device) if order is None else order
        rows = order.reshape(-1, steps).expand(max(enabled.shape[0], math.prod(order.shape[:-1])), -1)
        done = enabled.expand(rows.shape[0], -1).gather(1, rows.clamp(min=0))
        order = torch.where(done, rows, -1)
    return None if order is None else order.reshape(-1, steps)
