"""Sizes whose rows and planes are not aligned, and what they cost next to aligned ones."""

from __future__ import annotations

import random
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from benchmarks.case import Size
from benchmarks.measure import KVISION, Row, size_name

SHAPES = ((336, 514), (335, 513), (375, 500), (427, 640), (321, 481), (299, 299))
RANDOM_SHAPES = 3
ALIGNMENT = 16  # pixels: rows of aligned sizes are multiples of vectors in every type


@dataclass(frozen=True)
class Ratio:
    """Time over floor at an awkward size, over that at the aligned size next to it."""

    case: str
    dtype: str
    stage: str
    size: str
    factor: float


def sizes(round_size: Size, seed: int = 0) -> list[Size]:
    """The awkward sizes with about as many pixels as `round_size`: those of photographs, and random ones."""
    draw = random.Random(seed)
    shapes = [*SHAPES, *((draw.randint(200, 700), draw.randint(200, 700)) for _ in range(RANDOM_SHAPES))]
    batch, channels, height, width = round_size
    return [(max(1, round(batch * height * width / (h * w))), channels, h, w) for h, w in shapes]


def aligned(size: Size) -> Size:
    """The same size with the next width that is a multiple of 16 pixels."""
    return (*size[:-1], -(-size[-1] // ALIGNMENT) * ALIGNMENT)


def worst_ratios(rows: Iterable[Row], awkward: Sequence[Size]) -> list[Ratio]:
    """The worst ratio of each case, type and stage, the worst case first."""
    ours = {
        (row.case, row.dtype, row.stage, row.size): row.value / row.floor
        for row in rows
        if row.library == KVISION and row.value is not None and row.floor
    }
    neighbor = {size_name(size): size_name(aligned(size)) for size in awkward}
    worst: dict[tuple[str, str, str], Ratio] = {}
    for (case, dtype, stage, size), cost in ours.items():
        neighboring = ours.get((case, dtype, stage, neighbor.get(size, size)))
        if size not in neighbor or neighbor[size] == size or neighboring is None:
            continue
        ratio = Ratio(case, dtype, stage, size, cost / neighboring)
        key = (case, dtype, stage)
        if key not in worst or worst[key].factor < ratio.factor:
            worst[key] = ratio
    return sorted(worst.values(), key=lambda ratio: -ratio.factor)
