"""The parameters and results of one call of an augmentation: kept for `_params`, matrices, labels, the inverse and replay."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor
from torch.compiler import is_compiling

from kvision._dtype import compute_dtype
from kvision.augmentation.columns import Columns
from kvision.augmentation.keys import Keys
from kvision.augmentation.noise import PixelNoise
from kvision.augmentation.sample_rows import index_of
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError

Shape = tuple[int, ...]
Params = dict[str, Any]


def check_batch_of_params(op: str, count: int, batch: int) -> None:
    """Raise ShapeError unless parameters of `count` images replay on `batch` of them."""
    if count != batch:
        raise ShapeError(f"{op}: expected params of a batch of {batch}, got those of {count} images")


def check_maps_of_params(module: Any, params: Params, channels: int, sides: Sequence[int]) -> None:
    """Raise ShapeError where numbers of pixels or of channels replay on other images: of so many channels, with height and width of
    each image, or of all.
    """
    op, generator = type(module).__name__, module._param_generator
    drawn = params.get("forward_input_shape")
    maps = [x for x in params.values() if isinstance(x, list) or (isinstance(x, Tensor) and x.dim() > 3)]
    is_of_channels = generator is not None and generator.draws_channels
    if not (maps or is_of_channels) or drawn is None or getattr(drawn, "is_cuda", False) or is_compiling():
        return
    drawn_shapes = torch.as_tensor(drawn, device="cpu")
    shapes = drawn_shapes.reshape(-1, drawn_shapes.shape[-1]).tolist()
    # Shapes are (B, C, H, W), of volumes (B, C, D, H, W), of each image of a list (C, H, W).
    before_channels = shapes[0][min(len(shapes[0]) - 3, 1)]
    if before_channels != channels and generator is not None:
        planes = {own[0].shape[-3] if isinstance(own, list) else own.shape[1] for own in maps if len(own)}
        if is_of_channels or (generator.has_planes_of_images and before_channels in planes - {1}):
            raise ShapeError(f"{op}: expected params of images of {channels} channels, got those of {before_channels}")
    each = list(zip(sides[::2], sides[1::2]))
    before = [tuple(shape[-2:]) for shape in shapes]
    count = max(len(each), len(before))
    for own in maps:
        sizes = [tuple(x.shape[-2:]) for x in own] if isinstance(own, list) else [tuple(own.shape[-2:])] * count
        for size, old, new in zip(sizes, before * (count // len(before)), each * (count // len(each))):
            if size == old != new:  # others are not of pixels
                raise ShapeError(f"{op}: expected params of images of size {new}, got those of images of size {old}")


def check_images(op: str, shape: Shape, axes: int = 4) -> None:
    """Raise ShapeError unless a shape is that of a batch of images, which has so many axes."""
    if len(shape) != axes:
        raise ShapeError(f"{op}: expected images of shape (B, C, H, W), got {tuple(shape)}")


@contextlib.contextmanager
def replaying(op: str, params: Any) -> Iterator[None]:
    """Name in an error what is no dict of parameters, and the parameter that a replay does not find in it."""
    if not isinstance(params, Mapping):
        raise TypeCheckError(f"{op}: expected params to be a dict, got {type(params).__name__}")
    try:
        yield
    except KeyError as error:
        if error.args[0] in params:
            raise
        raise ValueCheckError(
            f"{op}: expected params with {error.args[0]!r}, got {', '.join(map(str, params))}"
        ) from None


def matrix_type(images: Tensor) -> tuple[torch.device, torch.dtype]:
    """The device and the type of matrices of images."""
    return images.device, compute_dtype(images)


class Execution:
    """One call of an augmentation: what was drawn, for `_params`, `transform_matrix`, labels, inverse and replay."""

    matrix: Tensor | None = None
    identity: tuple[torch.device, torch.dtype] | None = None  # `matrix_type` of matrices that are made when read
    of_list: Any = None  # of images of different sizes: what has `params` and `matrix` of them
    keeps_map = False  # for labels of the same call
    map: Tensor | None = None  # of a deformation, kept by `keeps_map`
    found: Params | None = None  # parameters by name that labels gave
    noise: PixelNoise | None = None  # the source of the numbers of pixels, of an image of a list
    whole: tuple[Execution, Sequence[int]] | None = None  # the call that had these samples, and their numbers in it

    def __init__(
        self,
        shape: Shape,
        columns: Columns | None = None,
        chosen: Tensor | None = None,
        applied: bool = True,
        params: Params | None = None,
        redraw: tuple[Keys, int] | None = None,
        frames: int = 1,
        is_certain: bool = False,
    ) -> None:
        self.shape = shape  # of the images, (B, C, H, W)
        self.columns = columns  # of the parameters, on their device
        self._chosen = chosen
        self.applied = applied  # False where the whole batch passes unchanged
        self.params = params  # by name, where they were given or have been read
        self.redraw = redraw  # the keys, and the index of this augmentation's
        self.frames = frames  # neighboring samples that share what was drawn
        self.is_certain = is_certain  # all samples are chosen, which is known without the columns

    def keep_matrix(self, matrix: Tensor) -> None:
        """Keep the matrices of an operator, which carry no gradients; where parameters do, they are computed when asked for."""
        if self.columns is None or not self.columns.drawn.requires_grad:
            self.matrix = matrix

    def of_rows(self, rows: Sequence[int]) -> Execution:
        """The same call of some of its samples, without parameters by name."""
        columns, chosen = self.columns, self._chosen
        if columns is not None:
            columns = columns._replace(drawn=columns.drawn.index_select(0, index_of(rows, columns.drawn)))
        if chosen is not None:
            chosen = chosen.index_select(0, index_of(rows, chosen))
        own = Execution((len(rows), *self.shape[1:]), columns, chosen, self.applied, is_certain=self.is_certain)
        own.whole = self, rows
        return own

    @property
    def chosen(self) -> Tensor | None:
        """(B,) bool, the samples that are augmented; None for all."""
        if self.is_certain:
            return None
        if self._chosen is None and self.columns is not None and self.columns.chosen is not None:
            self._chosen = self.columns.chosen > 0.5
        return self._chosen


class ListExecution(Execution):
    """A call on a list, whose shape is that of `of_list`, read where it is asked for."""

    def __init__(self, of_list: Any, columns: Columns | None = None, **options: Any) -> None:
        self.of_list = of_list
        super().__init__((), columns, **options)

    @property
    def shape(self) -> Shape:
        shape: Shape = self.of_list.shape
        return shape

    @shape.setter
    def shape(self, _: Any) -> None: ...
