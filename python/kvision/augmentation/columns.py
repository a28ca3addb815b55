"""Columns of parameters: those of all augmentations of a call, drawn by as few launches as the operator allows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from kvision.augmentation.draws import MAX_DRAWS, MAX_NUMBERS, Draw, Request, draw_parameters, make_plan
from kvision.augmentation.keys import Keys
from kvision.augmentation.ranges import LearnedPair, LearnedUniform

Learned = LearnedUniform | LearnedPair


class Columns(NamedTuple):
    """The columns of one augmentation among those that a launch has drawn for all."""

    drawn: Tensor  # (B, all columns)
    first: int  # of this augmentation
    width: int
    has_chosen: bool  # the first of its columns says which samples are chosen

    @property
    def chosen(self) -> Tensor | None:
        """(B,): 1 for samples that are chosen, else 0; None for all."""
        return self.drawn[:, self.first] if self.has_chosen else None

    @property
    def first_value(self) -> int:
        """The first column of a parameter."""
        return self.first + self.has_chosen

    @property
    def values(self) -> Tensor:
        """(B, P), the parameters."""
        return self.drawn[:, self.first_value : self.first + self.width]


def draw_columns(images: Tensor, keys: Keys, requests: Sequence[Request], first: int = 0) -> list[Columns]:
    """The columns of each request, whose keys or positions in the chain begin with number `first`."""
    columns: list[Columns] = []
    begin, draws, numbers = 0, 0, 0
    for end, request in enumerate(requests):
        more, more_numbers = len(request.draws), 2 + sum(len(draw.numbers) for draw in request.draws)
        if end > begin and (draws + more > MAX_DRAWS or numbers + more_numbers > MAX_NUMBERS):
            columns += _draw(images, keys, requests[begin:end], first + begin)
            begin, draws, numbers = end, 0, 0
        draws, numbers = draws + more, numbers + more_numbers
    return columns + _draw(images, keys, requests[begin:], first + begin)


def _draw(images: Tensor, keys: Keys, requests: Sequence[Request], first: int) -> list[Columns]:
    plan = make_plan(requests, keys.one_key, first)
    own = keys.keys if keys.one_key else keys.keys[first : first + len(requests)]
    seeds = None if keys.seeds is None else keys.seeds.to(images.device, non_blocking=True)
    drawn = draw_parameters(images.detach(), own, seeds, plan.plan, plan.numbers)
    drawn = _with_learned(drawn, [draw for request in requests for draw in request.draws])
    ends = [*plan.first_columns[1:], drawn.shape[1]]
    return [
        Columns(drawn, begin, end - begin, request.draws[:1] == [_CHOSEN])
        for begin, end, request in zip(plan.first_columns, ends, requests)
    ]


_CHOSEN = Draw("chosen")


def _with_learned(drawn: Tensor, draws: Sequence[Draw | Learned]) -> Tensor:
    """The columns, with those drawn from ranges that get gradients."""
    if not any(isinstance(draw, Learned) for draw in draws):
        return drawn
    parts, first = [], 0
    for draw in draws:
        part = drawn[:, first : first + draw.columns]
        parts.append(draw.value(part) if isinstance(draw, Learned) else part)
        first += draw.columns
    return torch.cat(parts, 1)


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
        elif draw.kind == "rectangle":
            values += [0.0] * 4
        else:
            values.append(draw.numbers[-1])
    return values
