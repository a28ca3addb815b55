"""Columns of parameters: those of all augmentations of a call, drawn by as few launches as the operator allows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from kvision._torch_compat import in_function_transform
from kvision.augmentation.draws import (
    MAX_DRAWS,
    MAX_NUMBERS,
    Draw,
    Request,
    draw_list_parameters,
    draw_parameters,
    make_plan,
)
from kvision.augmentation.keys import Keys, refuse_transformed_graphs
from kvision.augmentation.ranges import LearnedPair, LearnedUniform
from kvision.core.exceptions import ValueCheckError

Learned = LearnedUniform | LearnedPair


class Column(NamedTuple):
    """A column of drawn parameters, which is another number for each sample."""

    position: int  # among the columns of a launch


Input = float | str | Column  # of a formula: a number, the name of columns (`name_columns`), or a column
Names = Mapping[str, Sequence[Column]]


def name_columns(fields: Sequence[tuple[str, int]], first: int = 0) -> Names:
    """The columns by name of fields, pairs of a name and a width, of which the first begins at column `first`.

    A field of width 0 is one column. One of width n is n of them, each of which is `name[i]` besides.
    """
    names: dict[str, list[Column]] = {}
    for name, width in fields:
        own = names[name] = [Column(first + i) for i in range(width or 1)]
        names.update({f"{name}[{i}]": [own[i]] for i in range(width)})
        first += len(own)
    return names


def bind(inputs: Sequence[Input], names: Names) -> tuple[float | Column, ...]:
    """Inputs of a formula with columns in place of their names."""
    bound: list[float | Column] = []
    for value in inputs:
        if isinstance(value, str):
            if value not in names:
                raise ValueCheckError(
                    f"expected the name of a field, {' or '.join(names) or 'of which there are none'}, got {value!r}"
                )
            bound += names[value]
        else:
            bound.append(value)
    return tuple(bound)


def split_inputs(inputs: Sequence[Input]) -> tuple[list[float], list[int]]:
    """Bound inputs as plans have them: numbers, 0 for a column, and the indices of columns, -1 for a number."""
    numbers: list[float] = []
    columns: list[int] = []
    for x in inputs:
        assert not isinstance(x, str)
        numbers.append(0.0 if isinstance(x, Column) else x)
        columns.append(x.position if isinstance(x, Column) else -1)
    return numbers, columns


class Span(NamedTuple):
    """Where the columns of one augmentation are among those of a launch."""

    first: int
    width: int
    has_chosen: bool  # the first of its columns says which samples are chosen

    @property
    def first_value(self) -> int:
        """The first column of a parameter."""
        return self.first + self.has_chosen

    def moved(self, first: int) -> Span:
        """The same columns behind `first` others."""
        return self._replace(first=self.first + first) if first else self


class Columns(NamedTuple):
    """The columns of one augmentation among those that a launch has drawn for all."""

    drawn: Tensor  # (B, all columns)
    span: Span

    @property
    def chosen(self) -> Tensor | None:
        """(B,): 1 for samples that are chosen, else 0; None for all."""
        return self.drawn[:, self.span.first] if self.span.has_chosen else None

    @property
    def values(self) -> Tensor:
        """(B, P), the parameters."""
        first, end = self.span.first_value, self.span.first + self.span.width
        return self.drawn if end - first == self.drawn.shape[1] else self.drawn[:, first:end]


class DrawPlan(NamedTuple):
    """The arguments of one launch that draws the columns of requests `begin` to `end`."""

    begin: int
    end: int
    plan: list[int]
    numbers: list[float]
    spans: list[Span]  # of the requests
    learned: Sequence[Draw | Learned] | None  # all draws, where some are from ranges that get gradients

    def draw(self, images: Tensor, keys: Keys) -> Tensor:
        """The columns (B, P)."""
        own = self.keys_of(keys)
        seeds = keys.seeds_on(images.device)
        if in_function_transform():  # the elements of a vmap share what is drawn, unless their keys differ
            refuse_transformed_graphs()
            images = torch.empty(images.shape[0], device=images.device)
        elif images.requires_grad:
            images = images.detach()
        drawn: Tensor = draw_parameters(images, own, seeds, self.plan, self.numbers)
        return drawn if self.learned is None else _with_learned(drawn, self.learned)

    def draw_list(self, images: Tensor, keys: Keys, draws: Sequence[int], listed: Sequence[float]) -> Tensor:
        """The same with other numbers of some draws, by their positions among all: those of the first image, of the second, ..."""
        if not draws:
            return self.draw(images, keys)
        own, seeds = self.keys_of(keys), keys.seeds_on(images.device)
        drawn: Tensor = draw_list_parameters(images, own, seeds, self.plan, self.numbers, listed, list(draws))
        return drawn

    def keys_of(self, keys: Keys) -> Tensor:
        """Those of the keys of a call that belong to the requests of this plan."""
        own = keys.keys
        if not keys.has_seed and (self.begin > 0 or self.end < own.shape[0]):
            own = own[self.begin : self.end]
        return own


def plan_draws(requests: Sequence[Request], has_seed: bool, first: int = 0) -> list[DrawPlan]:
    """As few launches as the operator allows, of requests whose keys or positions in the chain begin with number `first`."""
    plans: list[DrawPlan] = []
    begin, draws, numbers = 0, 0, 0
    for end, request in enumerate(requests):
        more, more_numbers = len(request.draws), 2 + sum(len(draw.numbers) for draw in request.draws)
        if end > begin and (draws + more > MAX_DRAWS or numbers + more_numbers > MAX_NUMBERS):
            plans.append(_plan_launch(requests, begin, end, has_seed, first))
            begin, draws, numbers = end, 0, 0
        draws, numbers = draws + more, numbers + more_numbers
    return [*plans, _plan_launch(requests, begin, len(requests), has_seed, first)]


def fits_one_launch(request: Request) -> bool:
    """Whether the operator takes all draws of a request at once, as it must."""
    return len(request.draws) <= MAX_DRAWS and 2 + sum(len(draw.numbers) for draw in request.draws) <= MAX_NUMBERS


def _plan_launch(requests: Sequence[Request], begin: int, end: int, has_seed: bool, first: int) -> DrawPlan:
    own = requests[begin:end]
    plan, numbers, firsts = make_plan(own, has_seed, first + begin)
    ends = [*firsts[1:], plan[0]]
    spans = [Span(a, b - a, request.draws[:1] == [_CHOSEN]) for a, b, request in zip(firsts, ends, own)]
    draws = [draw for request in own for draw in request.draws]
    learned = draws if any(isinstance(draw, Learned) for draw in draws) else None
    return DrawPlan(first + begin, first + end, plan, numbers, spans, learned)


def draw_columns(images: Tensor, keys: Keys, requests: Sequence[Request], first: int = 0) -> list[Columns]:
    """The columns of each request, whose keys or positions in the chain begin with number `first`."""
    columns: list[Columns] = []
    for plan in plan_draws(requests, keys.has_seed, first):
        drawn = plan.draw(images, keys)
        columns += [Columns(drawn, span) for span in plan.spans]
    return columns


_CHOSEN = Draw("chosen")


def _with_learned(drawn: Tensor, draws: Sequence[Draw | Learned]) -> Tensor:
    """The columns, with those drawn from ranges that get gradients."""
    parts, first = [], 0
    for draw in draws:
        part = drawn[:, first : first + draw.columns]
        parts.append(draw.value(part) if isinstance(draw, Learned) else part)
        first += draw.columns
    return torch.cat(parts, 1)


def constant_values(draws: Sequence[Draw | Learned]) -> list[float | None]:
    """What the columns of draws hold for all samples that are chosen; None for those that differ."""
    values: list[float | None] = []
    for draw in draws:
        constants: list[float] = []
        if (
            isinstance(draw, Draw)
            and draw.kind in ("uniform", "uniform_and_affine")
            and draw.numbers[0] == draw.numbers[1]
        ):
            low, _, *rest = draw.numbers
            constants = [low] if draw.kind == "uniform" else [low, rest[0] * low + rest[1]]
        values += constants or [None] * draw.columns
    return values


def identity_values(draws: Sequence[Draw | Learned]) -> list[float]:
    """What the columns of draws hold for samples that are not chosen."""
    values: list[float] = []
    for draw in draws:
        if isinstance(draw, LearnedPair):
            values += [draw.identity, draw.scale * draw.identity + draw.offset]
        elif isinstance(draw, LearnedUniform):
            values.append(draw.identity)
        elif draw.kind == "uniform_and_affine":
            _, _, scale, offset, identity = draw.numbers
            values += [identity, scale * identity + offset]
        elif draw.kind == "permutation":
            n, first, step = draw.numbers
            values += [first + step * i for i in range(int(n))]
        elif draw.kind == "resized_crop":
            values += [0.0, 0.0, draw.numbers[5], draw.numbers[4]]
        elif draw.kind in ("rectangle", "rectangles"):
            values += [0.0] * draw.columns
        else:
            values.append(draw.numbers[-1])
    return values


def identity_of(requests: Sequence[Request]) -> list[float]:
    """The same of the columns of requests, each of which begins with the one that says who is chosen."""
    return [value for request in requests for value in (0.0, *identity_values(request.draws[1:]))]
