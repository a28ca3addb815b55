"""What a call of a policy drew, and what it did to the images of a list."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from kvision.augmentation.auto.operation_table import BILINEAR
from kvision.augmentation.engine import ByMatrix, Chain, LabelStep, Move, Moves, PartsOfImages, Record, Warp
from kvision.augmentation.lists.masks import checked_masks, move_masks


class Drawn(NamedTuple):
    """What was drawn for a call: the number of the operation and its value, of each sample in each step."""

    operation: Tensor  # (B, steps), int64; -1 for none
    value: Tensor  # (B, steps)
    weights: Tensor | None = None  # of a mixture (B, 1 + chains): that of the image, then those of its chains

    def of_sample(self, b: int) -> Drawn:
        """What was drawn for one sample."""
        return Drawn(*(None if t is None else t[b : b + 1] for t in self))  # type: ignore[arg-type]


class _Steps(NamedTuple):
    """Steps of a policy as those of a run."""

    label_steps: Sequence[LabelStep]
    modules: Sequence[Any] = ()


class PolicyParts(PartsOfImages):
    """A call of a policy on a list.

    Args:
        op: of errors.
        images: those of the call.
        drawn: of all of them.
        matrices: (B, 3, 3) of each step that moves pixels.
    """

    def __init__(self, op: str, images: Sequence[Tensor], drawn: Drawn, matrices: Sequence[Tensor]) -> None:
        super().__init__(op, images)
        self._drawn, self._matrices = drawn, matrices

    def _record(self, b: int) -> Record:
        """The call of one image."""
        size = self._shapes[b][2:]
        stages = [Warp(matrix[b : b + 1], size, size, BILINEAR) for matrix in self._matrices]
        return Record(self._shapes[b], (), Chain(stages), drawn=self._drawn.of_sample(b), size=size)

    def moves(self) -> Moves:
        """What boxes and points follow."""
        sides = self._sides
        return Moves([Move([matrix], sides, sides) for matrix in self._matrices], sides)

    def moved_masks(self, masks: Any, reading: Any) -> list[Tensor] | None:
        """Masks (N, h, w) of each image by the launches of a batch; None where they follow the calls of the images."""
        sides = self._sides
        given = checked_masks(masks, sides)
        steps = [LabelStep((), [matrix], BILINEAR, sides, sides) for matrix in self._matrices]
        return None if given is None else move_masks(given, _Steps(steps), reading)

    @property
    def _sides(self) -> list[int]:
        """Height and width of each image."""
        return [n for shape in self._shapes for n in shape[2:]]

    @property
    def _whole(self) -> Record:
        """The call, whose stages have no sizes."""
        return Record(self.shape, (), Chain([ByMatrix(matrix) for matrix in self._matrices]), drawn=self._drawn)

    def params(self, read: Callable[[Any], Any]) -> list[Any]:
        """The parameters of all images, which are read at once."""
        items: list[Any] = read(self._whole)
        for item in items:
            item.data["forward_input_shape"] = torch.tensor(self._shapes, device="cpu")
        return items

    def matrix(self, read: Callable[[Any], Tensor | None]) -> Tensor | None:
        return read(self._whole)
