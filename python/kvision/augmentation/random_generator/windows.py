"""Generators of windows that follow from the size of an image and from its labels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from kvision.augmentation.draws import Draw, integer, mixed_words, unit
from kvision.augmentation.inputs import parse_size
from kvision.augmentation.random_generator.base import Shape
from kvision.augmentation.random_generator.crop import WindowGeneratorBase
from kvision.core.exceptions import ValueCheckError

_STEP = 0x9E3779B9  # 2^32 over the golden ratio


class WindowGenerator(WindowGeneratorBase):
    """Base of generators that draw a window of each image: a function of random numbers, sizes and labels.

    Two words of each sample are drawn, and as many random numbers follow from them as a subclass needs.

    Args:
        op: the augmentation, for errors.
        size: height and width of the results; None for those of the images.
    """

    derives = True
    must_fit = False  # windows have the size of the results
    count = 4  # of random numbers

    def __init__(self, op: str, size: Any = None) -> None:
        super().__init__()
        self.op, self.output_size = op, None if size is None else parse_size(op, size)

    def windows(self, numbers: Tensor, height: Tensor, width: Tensor, labels: Any) -> Tensor:
        """First column, first row, width and height in whole pixels, (B, 4), in float64.

        Args:
            numbers: random numbers (B, count), from 0 to below 1.
            height: of the images, (B,), in float64.
            width: of the images, (B,), in float64.
            labels: see `derive`.
        """
        raise NotImplementedError(f"{type(self).__name__}.windows")

    def draws(self, shape: Shape) -> Sequence[Draw]:
        if self.must_fit and self.output_size is not None:
            height, width = self.output_size
            if height > shape[-2] or width > shape[-1]:
                raise ValueCheckError(
                    f"{self.op}: expected images of at least {self.output_size}, got {tuple(shape[-2:])}"
                )
        return [integer(0, 2**24 - 1), integer(0, 2**24 - 1)]  # exact in float32

    def derive(self, drawn: Tensor, sizes: Tensor, labels: Any) -> Tensor:
        height, width = sizes.double().expand(drawn.shape[0], 2).unbind(1)
        return self.windows(random_numbers(drawn, self.count), height, width, labels)

    def identity(self, sizes: Tensor) -> Tensor:
        height, width = sizes.unbind(1)
        zero = torch.zeros_like(width)
        return torch.stack([zero, zero, width, height], 1)


def random_numbers(words: Tensor, count: int) -> Tensor:
    """Numbers (B, count) within 0 and 1, in float64, that follow from two words (B, 2) of 24 bits."""
    first, second = words.long().unbind(1)
    state = mixed_words(first ^ mixed_words(second + _STEP))
    index = torch.arange(count, device=words.device)
    numbers: Tensor = unit(mixed_words(state[:, None] + _STEP * index))
    return numbers


def pick(is_candidate: Tensor, number: Tensor) -> Tensor:
    """The index (B,) of one of the candidates (B, N) by a random number (B,), all equally likely; N where there is none."""
    before = is_candidate.cumsum(1, dtype=torch.int32)
    rank = (number * before[:, -1]).floor().to(torch.int32) + 1
    return torch.searchsorted(before, rank[:, None].contiguous())[:, 0]


def up_to(number: Tensor, most: Tensor) -> Tensor:
    """A whole number from 0 to `most` by a random number, all equally likely."""
    return (number * (most + 1)).floor().minimum(most).clamp(min=0)


def clipped_boxes(boxes: Tensor | None, height: Tensor, width: Tensor) -> tuple[Tensor, Tensor]:
    """The parts of boxes (B, N, 4) inside images of sizes (B,), in float64, and which of them have pixels, (B, N).

    Without boxes there is one of each image, which has none.
    """
    if boxes is None or boxes.shape[1] == 0:
        boxes = height.new_zeros(len(height), 1, 4)
    largest = torch.stack([width, height, width, height], -1)[:, None]
    boxes = boxes.to(height).clamp(min=0).minimum(largest)
    return boxes, (boxes[..., 2:] > boxes[..., :2]).all(-1)
