"""What an augmentation adds to the passes that it shares with its neighbors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from kvision.augmentation.transforms import Transform
from kvision.augmentation.warp_and_color import ColorStep, Resampling


class Motion(NamedTuple):
    """How pixels move: where a pixel of the result reads the image. Masks, boxes and points follow.

    Attributes:
        size: height and width of the results.
        resampling: how images are read.
        chain: the formulas of the matrix from image pixels to result pixels; None for a map, which `displacements` gives.
        reads_by_matrix: the images are read at the matrix and nowhere else. Otherwise, as with antialiasing of what becomes
            smaller, a chain stands for them only where neighbors are resampled once.
        moves_whole_pixels: every pixel of the result is one of the image, or the fill value.
        stays_inside: none is the fill value.
        permutes_pixels: every pixel of the image is in the result, as with flips and turns.
    """

    size: tuple[int, int]
    resampling: Resampling
    chain: Sequence[Transform] | None
    reads_by_matrix: bool = False
    moves_whole_pixels: bool = False
    stays_inside: bool = False
    permutes_pixels: bool = False

    @property
    def is_map(self) -> bool:
        return self.chain is None

    @property
    def is_antialiased(self) -> bool:
        return self.chain is not None and (self.resampling.antialias or not self.reads_by_matrix)

    @property
    def interpolates(self) -> bool:
        return not self.moves_whole_pixels


class Colors(NamedTuple):
    """How the values of pixels change, each by itself. Labels stay.

    Attributes:
        steps: of a color program.
        order: the field with the numbers of the steps in the order of each sample; None: as listed.
    """

    steps: Sequence[ColorStep]
    order: str | None = None


class Contribution(NamedTuple):
    """A motion of pixels or a change of colors; neither for what runs by itself and moves labels by its own methods.

    Attributes:
        takes_volumes: whether each slice of a volume is treated as an image.
    """

    motion: Motion | None = None
    colors: Colors | None = None
    takes_volumes: bool = False
