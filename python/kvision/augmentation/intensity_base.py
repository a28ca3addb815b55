"""Intensity augmentations: pixels keep their places, so masks, boxes and points stay as they are."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from kvision.augmentation.base import (
    Execution,
    Params,
    RigidAffineAugmentationBase2D,
    RigidAffineAugmentationBase3D,
    Shape,
)
from kvision.augmentation.draws import Draw, Request
from kvision.color.program import MAX_NUMBERS, MAX_STEPS, MAX_TENSORS, Arguments, run
from kvision.color.steps import CONTRAST, STEPS

__all__ = ["IntensityAugmentationBase2D", "IntensityAugmentationBase3D"]


class ColorStep(NamedTuple):
    """A step of a color program: its name (kvision.color.steps) and its parameters, a number or the index of a column each."""

    name: str
    parameters: Sequence[float] = ()
    columns: Sequence[int] = ()  # one of a parameter, -1 for a number; empty if all are numbers

    @property
    def number(self) -> int:
        return STEPS[self.name].number


class ColorSteps(NamedTuple):
    """The steps of an augmentation. Their order is that of the list, or of `order`, columns with positions in the list."""

    steps: Sequence[ColorStep]
    order: Sequence[int] | None = None


class IntensityAugmentationBase2D(RigidAffineAugmentationBase2D):
    """Base of augmentations that change values and no positions; the matrix is the identity.

    A subclass declares a part of a color program, `color_steps`, or overrides `apply_transform`.

    Args:
        p: probability that a sample is augmented.
        p_batch: probability that a batch is.
        same_on_batch: all samples get the same parameters.
        keepdim: an image (C, H, W) gives an image (C, h, w) instead of a batch of one.
        generator: draws the key of each call; default: torch's generator.
        return_transform: calls return the image and its matrix.

    Raises:
        TypeError: `p` or `p_batch` is no number.
        ValueError: `p` or `p_batch` is not within 0 and 1.

    Example:
        >>> import torch, kvision as K
        >>> class Negative(K.augmentation.IntensityAugmentationBase2D):
        ...     def apply_transform(self, input, params, flags, transform=None):
        ...         return 1 - input
        >>> Negative(p=1.0)(torch.zeros(1, 1, 1, 2))
        tensor([[[[1., 1.]]]])
    """

    def color_steps(self, shape: Shape, flags: dict[str, Any]) -> ColorSteps | None:
        """The steps of the drawn columns; None if `apply_transform` is overridden instead."""
        return None

    def _request(self, shape: Shape) -> Request | None:
        request = super()._request(shape)
        steps = self.color_steps(shape, self.flags)
        if request is None or steps is None or steps.order is not None or request.draws[0].kind != "chosen":
            return request
        # Samples that are not chosen have an order without steps.
        order = [Draw("integer", (i, 1, 1, -1)) for i in range(len(steps.steps))]
        return request._replace(draws=[*request.draws, *order])

    def _executes_columns(self, shape: Shape) -> bool:
        return self.color_steps(shape, self.flags) is not None

    def _further_columns(self, shape: Shape, values: Tensor, chosen: Tensor | None) -> list[Tensor]:
        steps = self.color_steps(shape, self.flags)
        if steps is None or steps.order is not None or chosen is None:
            return []
        order = torch.arange(len(steps.steps), device=values.device, dtype=values.dtype)
        return [torch.where(chosen[:, None], order, -1)]

    def _run(self, x: Tensor, execution: Execution, flags: dict[str, Any]) -> Tensor:
        if not execution.applied:
            return x
        part = None if self._is_customized() else color_part(self, execution, flags)
        return super()._run(x, execution, flags) if part is None else run_color(x, [part])

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        steps = self.color_steps(tuple(input.shape), flags)
        if steps is None:
            raise NotImplementedError(f"{type(self).__name__}.apply_transform")
        columns = None
        if self._param_generator is not None:
            columns = self._param_generator.to_columns(params, tuple(input.shape)).to(input.device)
        order = None if steps.order is None or columns is None else columns[:, steps.order[0] : steps.order[-1] + 1]
        return run_color(input, [ColorPart(steps, columns, 0, order)])


class IntensityAugmentationBase3D(RigidAffineAugmentationBase3D):
    """Base of augmentations of volumes that change values and no positions.

    Args:
        p: probability that a sample is augmented.
        p_batch: probability that a batch is.
        same_on_batch: all samples get the same parameters.
        keepdim: an image (C, H, W) gives an image (C, h, w) instead of a batch of one.
        generator: draws the key of each call; default: torch's generator.
        return_transform: calls return the image and its matrix.

    Example:
        >>> import torch, kvision as K
        >>> class Negative(K.augmentation.IntensityAugmentationBase3D):
        ...     def apply_transform(self, input, params, flags, transform=None):
        ...         return 1 - input
        >>> Negative(p=1.0)(torch.zeros(1, 1, 1, 1, 2))
        tensor([[[[[1., 1.]]]]])
    """


class ColorPart(NamedTuple):
    """What one augmentation contributes to a color program."""

    steps: ColorSteps
    columns: Tensor | None  # (B, all columns)
    first: int  # of its parameters among the columns
    order: Tensor | None  # (B, S) positions in its steps, -1 for none


def color_part(module: IntensityAugmentationBase2D, execution: Execution, flags: dict[str, Any]) -> ColorPart | None:
    """The part of an execution whose columns were drawn; None for one with parameters by name, or without steps."""
    steps = module.color_steps(execution.shape, flags)
    if steps is None or (execution.columns is None and execution.params is not None):
        return None
    columns = execution.columns
    if columns is None:
        return ColorPart(steps, None, 0, None)
    first = columns.first_value
    if steps.order is not None:
        order = columns.drawn[:, first + steps.order[0] : first + steps.order[-1] + 1]
    elif columns.has_chosen:
        order = columns.values[:, -len(steps.steps) :]
    else:
        order = None
    return ColorPart(steps, columns.drawn, first, order)


def fits_one_program(parts: Sequence[ColorPart]) -> bool:
    """Whether the kernels take the steps of all parts in one program."""
    steps = [step for part in parts for step in part.steps.steps]
    numbers = sum(STEPS[step.name].parameters for step in steps)
    return len(steps) <= MAX_STEPS and numbers <= MAX_NUMBERS and sum(step.number == CONTRAST for step in steps) <= 1


def run_color(x: Tensor, parts: Sequence[ColorPart], dtype: torch.dtype | None = None, layout: int = -1) -> Tensor:
    """Run the steps of neighboring augmentations as one color program."""
    steps: list[int] = []
    numbers: list[float] = []
    columns: list[int] = []
    tensors: list[Tensor] = []  # of parameters; augmentations drawn by one launch share one
    orders: list[Tensor | None] = []
    for part in parts:
        orders.append(part.order if part.order is None or not steps else _moved(part.order, len(steps)))
        first = part.first
        if part.columns is not None:
            index = next((i for i, t in enumerate(tensors) if t is part.columns), len(tensors))
            if index == len(tensors):
                tensors.append(part.columns)
            first += sum(t.shape[1] for t in tensors[:index])
        for step in part.steps.steps:
            count = STEPS[step.name].parameters
            steps.append(step.number)
            numbers += [*step.parameters, *[0.0] * (count - len(step.parameters))]
            columns += [first + c if c >= 0 else -1 for c in step.columns] + [-1] * (count - len(step.columns))
    order = _order(x, parts, orders) if any(o is not None for o in orders) else None
    if all(c < 0 for c in columns):
        return run(x, steps, Arguments((None,) * MAX_TENSORS, numbers, ()), order, dtype, layout)
    if len(tensors) > MAX_TENSORS:
        tensors = [torch.cat(tensors, 1)]
    rows = [t[:, None] for t in tensors]
    return run(
        x, steps, Arguments((*rows, *[None] * (MAX_TENSORS - len(rows))), numbers, columns), order, dtype, layout
    )


def _moved(order: Tensor, first: int) -> Tensor:
    return torch.where(order < 0, order, order + first)


def _order(x: Tensor, parts: Sequence[ColorPart], orders: Sequence[Tensor | None]) -> Tensor:
    """The order of all steps, (B, S)."""
    rows, first = [], 0
    for part, order in zip(parts, orders):
        count = len(part.steps.steps)
        if order is None:
            order = torch.arange(first, first + count, device=x.device, dtype=torch.float32)
            order = order.expand(x.shape[0], -1)
        rows.append(order)
        first += count
    return (torch.cat(rows, 1) if len(rows) > 1 else rows[0]).long()
