"""What augmentations draw, and the inputs of their matrices, that depend on the size of an image: numbers of each image of a list.

They are found by asking the augmentations for images of a few sizes: linear functions of height and width, or numbers that are
read for each size.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, lru_cache, partial
from itertools import chain
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.compiler import is_compiling

from kvision._constants import on_device
from kvision.augmentation.columns import Column, Span, identity_of
from kvision.augmentation.draws import Draw, Request
from kvision.augmentation.engine.call_context import CallContext
from kvision.augmentation.engine.drawing import may_apply
from kvision.augmentation.engine.execution import Shape
from kvision.augmentation.transforms import Transform
from kvision.geometry.transform.lists.arguments import sizes as sides_of

Size = tuple[int, ...]
Sizes = tuple[Size, Size]
SIZES: Sizes = ((40037, 53003), (91009, 23003))  # of images that show what depends on their size; larger than any crop
CORNERS = ((64, 64), (128, 64), (64, 128))  # sizes from which linear functions follow; at the others they are compared
_ANY = 2  # images of a batch, on which nothing here depends
_SQUARE = (SIZES[0][0], SIZES[0][0])  # may be drawn for in another way
_KNOWN = 4096  # sizes of which numbers are kept
_PROBES = (*SIZES, *CORNERS, _SQUARE, (1, 1), (3, 1000), (641, 427))


class SizedNumbers(NamedTuple):
    """Numbers that are linear functions of the size of an image."""

    constant: Sequence[float]
    of_height: Sequence[float]
    of_width: Sequence[float]

    @classmethod
    def of(cls, read: Callable[[Size], Sequence[float]]) -> SizedNumbers | None:
        """Those that `read` gives for a size; None if they are no linear functions."""
        try:
            rows = [read(size) for size in _PROBES]
        except ValueError:  # of images that are too small
            return None
        side, numbers, corners = CORNERS[0][0], [], len(SIZES)
        for first, higher, wider in zip(*rows[corners : corners + 3]):
            of_height, of_width = (higher - first) / side, (wider - first) / side
            numbers.append((first - side * of_height - side * of_width, of_height, of_width))
        found = cls(*(tuple(column) for column in zip(*numbers)))
        is_linear = all(
            math.isclose(a, b, rel_tol=1e-14, abs_tol=1e-12)
            for size, row in zip(_PROBES, rows)
            for a, b in zip(found.at(*size), row)
        )
        return found if is_linear else None

    def at(self, height: int, width: int) -> list[float]:
        """The numbers for a size."""
        return [a + height * b + width * c for a, b, c in zip(self.constant, self.of_height, self.of_width)]

    def of_sides(self, sides: Sequence[int]) -> Tensor:
        """The numbers (B, N) for height and width of each image, float64 on the CPU."""
        own = torch.tensor(sides, dtype=torch.float64, device="cpu").view(-1, 2, 1)
        a, b, c = self.linear()
        return a + own[:, 0] * b + own[:, 1] * c

    def linear(self) -> Tensor:
        """The three rows (3, N), float64 on the CPU."""
        return torch.tensor(self, dtype=torch.float64, device="cpu")


class NumbersOfEach:
    """Numbers that are read for the size of each image, once for those of many images.

    Args:
        sized: what reads them.
        what: the arguments of :meth:`Sized.numbers_at` before the size.
    """

    def __init__(self, sized: Sized, what: tuple[bool, bool, Sequence[int]]) -> None:
        self._sized, self._what = sized, what  # and no function of both, which a graph cannot keep

    @cached_property
    def _at_size(self) -> Callable[[Size], Sequence[float]]:  # made in calls, as a graph cannot make it
        return lru_cache(_KNOWN)(partial(self._sized.numbers_at, *self._what))

    def at(self, height: int, width: int) -> Sequence[float]:
        """The numbers for a size."""
        return self._sized.numbers_at(*self._what, (height, width))

    def of_each(self, images: Sequence[Tensor]) -> Tensor:
        """The numbers (B, N) for the size of each image, float64 on the CPU."""
        return self.of_sides(sides_of(images))

    def of_sides(self, sides: Sequence[int]) -> Tensor:
        """The same for height and width of each image."""
        sizes = zip(sides[::2], sides[1::2])
        if is_compiling():  # a graph has no memory of numbers
            return torch.tensor([[*self.at(*size)] for size in sizes], dtype=torch.float64, device="cpu")
        rows = list(map(self._at_size, sizes))
        if not rows[0]:
            return torch.empty(len(rows), 0, dtype=torch.float64, device="cpu")
        # The tensor is one of memory, as torch converts the entries of lists one by one.
        return torch.frombuffer(array("d", chain.from_iterable(rows)), dtype=torch.float64).view(len(rows), -1)


class Reading:
    """What augmentations draw, and the formulas of their matrices, for a size of images, of those that are `applied`."""

    def __init__(
        self, modules: Sequence[Any], applied: Sequence[bool], batch: int, channels: int, context: CallContext
    ) -> None:
        self.modules, self.applied, self.shape = modules, applied, (batch, channels)
        self.is_certain, self.has_owners = context.is_certain, context.owners is not None

    def shapes(self, size: Size) -> list[Shape]:
        """The shapes of the images before each augmentation, and behind the last one."""
        shapes: list[Shape] = [(*self.shape, *size)]
        for module, is_applied in zip(self.modules, self.applied):
            shapes.append(module.output_shape(shapes[-1], module.flags) if is_applied else shapes[-1])
        return shapes

    def draws(self, size: Size) -> list[Any]:
        """Those of all augmentations, as `plan_run` asks for them."""
        return [draw for request in self._requests(size) for draw in request.draws]

    def identity(self, size: Size) -> list[float]:
        """What the columns hold for samples that get none of the augmentations."""
        return identity_of(self._requests(size))

    def _requests(self, size: Size) -> list[Request]:
        requests = [
            m._request(shape, self.is_certain, self.has_owners)
            for m, shape in zip(self.modules, self.shapes(size))
            if may_apply(m, self.is_certain)
        ]
        return [request for request in requests if request is not None]

    def chains(self, size: Size) -> list[Sequence[Transform]]:
        """The formulas of each augmentation; none of one without a matrix."""
        chains = [
            m.matrix_transforms(shape, m.flags) if is_applied and hasattr(m, "matrix_transforms") else ()
            for m, is_applied, shape in zip(self.modules, self.applied, self.shapes(size))
        ]
        return [() if chain is None else chain for chain in chains]


class Sized:
    """The draws and the inputs of matrices that depend on the size of an image, among those of augmentations.

    `own` of these give images sizes of their own, those in `sizing` others than the images have, and the next one all the same.
    """

    def __init__(self, reading: Reading, own: int, sizing: Sequence[int]) -> None:
        self.reading, self.own, self.sizing = reading, own, sizing
        probes = _valid(reading.draws)
        self.may_be_too_small = len(probes) < len(_PROBES)  # images, which reading says
        draws = [own for _, own in probes]
        self.has_same_draws = all([_kind(a) for a in own] == [_kind(a) for a in draws[0]] for own in draws)
        # By their numbers: tensors of learned ranges are the same for all sizes.
        numbers = [[a.numbers for a in own] for own in draws]
        self.draws = [i for i, (first, *others) in enumerate(zip(*numbers)) if any(n != first for n in others)]
        chains = [reading.chains(size) for size, _ in probes]
        forms = [[[(t.kind, len(t.inputs)) for t in chain] for chain in of_size] for of_size in chains]
        self.has_same_forms = all(form == forms[0] for form in forms)
        # Of each augmentation pairs of a transform and an input, by their numbers.
        self.inputs = [
            [
                (i, k)
                for i, transforms in enumerate(zip(*of_sizes))
                for k, (first, *others) in enumerate(zip(*[t.inputs for t in transforms]))
                if any(x != first for x in others)
            ]
            for of_sizes in zip(*chains)
        ]
        self.count = sum(map(len, self.inputs))
        self._sizes_after: dict[Size, Callable[[Size], Size]] = {}

    def numbers(
        self, has_draws: bool = True, has_inputs: bool = True, then: Sequence[int] = ()
    ) -> SizedNumbers | NumbersOfEach | None:
        """What depends on the size, as numbers of each image: those of the draws, then the inputs, and height and width behind
        augmentations by their numbers; None for none.
        """
        count = self.count if has_inputs else 0
        if not count and not then and not (has_draws and (self.draws or self.may_be_too_small)):
            return None
        what = (has_draws, has_inputs, then)
        return SizedNumbers.of(partial(self.numbers_at, *what)) or NumbersOfEach(self, what)

    def numbers_at(self, has_draws: bool, has_inputs: bool, then: Sequence[int], size: Size) -> list[float]:
        """Those for a size."""
        draws = self.reading.draws(size) if has_draws else []
        numbers = [n for i in self.draws for n in draws[i].numbers] if has_draws else []
        for formulas, inputs in zip(self.reading.chains(size), self.inputs if has_inputs else ()):
            numbers += [formulas[i].inputs[k] for i, k in inputs]
        return [*numbers, *self._size_after(then, size)] if then else numbers

    def changes(self, numbers: Sequence[int]) -> bool:
        """Whether augmentations by their numbers give images sizes of their own, which are others than they have."""
        return any(number in self.sizing for number in numbers)

    def sizes_after(self, numbers: Sequence[int], images: Sequence[Tensor]) -> list[int]:
        """Height and width of each image behind augmentations by their numbers."""
        return self.sides_after(numbers, [n for x in images for n in x.shape[-2:]])

    def sides_after(self, numbers: Sequence[int], sides: Sequence[int]) -> list[int]:
        """The same for height and width of each image."""
        sizes = zip(sides[::2], sides[1::2])
        if is_compiling():
            return [n for size in sizes for n in self._size_after(numbers, size)]
        known = self._sizes_after.setdefault(tuple(numbers), lru_cache(_KNOWN)(partial(self._size_after, numbers)))
        return [n for size in sizes for n in known(size)]

    def _size_after(self, numbers: Sequence[int], size: Size) -> Size:
        shape: Shape = (*self.reading.shape, *size)
        for number in numbers:
            module = self.reading.modules[number]
            shape = module.output_shape(shape, module.flags) if self.reading.applied[number] else shape
        return shape[2:]

    def bound(
        self, modules: Sequence[Any], spans: Sequence[Span | None], columns: int
    ) -> Mapping[int, Sequence[Transform]]:
        """The chains, by the numbers of augmentations, with columns behind `columns` others in place of their inputs."""
        bound: dict[int, Sequence[Transform]] = {}
        for number, (formulas, inputs) in enumerate(zip(self.reading.chains(SIZES[0]), self.inputs)):
            own = {place: Column(columns + i) for i, place in enumerate(inputs)}
            columns += len(own)
            if own:
                with_columns = [
                    Transform(t.kind, *[own.get((i, k), x) for k, x in enumerate(t.inputs)])
                    for i, t in enumerate(formulas)
                ]
                bound[number] = modules[number]._bound(with_columns, spans[number])
        return bound


class ImagesOfList:
    """The images of a list in a run: what depends on their sizes, and height and width of each, or a tensor of them."""

    def __init__(self, sized: Sized, sides: Sequence[int] | Tensor) -> None:
        self.sized, self._sides = sized, sides

    @property
    def sides(self) -> Sequence[int]:
        """Height and width of each image."""
        if isinstance(self._sides, Tensor):
            self._sides = self._sides.flatten().tolist()
        return self._sides

    def sides_before(self, number: int, shape: Shape) -> Sequence[int]:
        """Height and width of each image before an augmentation, which gets images of a shape where all have one size."""
        if number > self.sized.own:
            return [*shape[2:]] * (len(self.sides) // 2)
        return self.sized.sides_after(range(number), self.sides)


def listed(numbers: SizedNumbers | NumbersOfEach, sides: Sequence[int]) -> list[float]:
    """The numbers for height and width of the first image, the second, ..."""
    if is_compiling():  # a graph has no numbers of tensors
        return [n for size in zip(sides[::2], sides[1::2]) for n in numbers.at(*size)]
    return numbers.of_sides(sides).flatten().tolist()


def columns_of_sides(corners: Sequence[Tensor], probes: Mapping[Size, Tensor], sides: Sequence[int]) -> Tensor | None:
    """Columns (B, P) of images by height and width of each, of those at `CORNERS`; None if others tell that they are not linear."""
    side, (first, higher, wider) = CORNERS[0][0], [x.double() for x in corners]
    of_height, of_width = (higher - first) / side, (wider - first) / side
    constant = first - side * of_height - side * of_width

    def at(height: Any, width: Any) -> Tensor:
        return (constant + height * of_height + width * of_width).to(corners[0].dtype)

    if not all(torch.equal(at(*size), columns) for size, columns in probes.items()):
        return None
    own = on_device(torch.tensor(sides, dtype=torch.float64, device="cpu").view(-1, 2, 1), corners[0].device)
    return at(*own.unbind(1))


def _valid(read: Callable[[Size], Any]) -> list[tuple[Size, Any]]:
    """What `read` gives for those sizes of images that are not too small."""
    known = []
    for size in _PROBES:
        try:
            known.append((size, read(size)))
        except ValueError:
            pass
    return known


def _kind(draw: Any) -> Any:
    return (draw.kind, draw.columns) if isinstance(draw, Draw) else None


def find_sized(modules: Sequence[Any], applied: Sequence[bool], channels: int, context: CallContext) -> Sized | None:
    """What depends on the sizes of images; None for what is no run on a list."""
    if any(m.mixes_samples or not m.takes_lists for m in modules):
        return None
    if not all(_follows(m.reads_labels, before) for number, m in enumerate(modules) for before in modules[:number]):
        return None
    of_sizes = [own for _, own in _valid(Reading(modules, applied, _ANY, channels, context).shapes)]
    if any(shape[:2] != (_ANY, channels) for shapes in of_sizes for shape in shapes):
        return None
    own, sizing = len(modules), []
    for number in range(len(modules)):
        before, after = zip(*[(shapes[number], shapes[number + 1]) for shapes in of_sizes])
        if all(shape == after[0] for shape in after):
            own = number
            break
        if after != before:
            sizing.append(number)
    sized = Sized(Reading(modules[: own + 1], applied, _ANY, channels, context), own, sizing)
    return sized if sized.has_same_forms else None


def _follows(kind: str | None, module: Any) -> bool:
    """Whether labels of a kind that an augmentation reads follow one before it by what is known of all images together."""
    if kind is None or module._leaves_labels or (kind == "boxes" and module.keeps_positions):
        return True
    if module.moves_by_map:
        return bool(module._knows_maps_of_lists) and not module._is_overridden("apply_transform_mask")
    chain = getattr(module, "matrix_transforms", None)
    if chain is None or chain((1, 3, *SIZES[0]), module.flags) is None or module._is_overridden("apply_transform_mask"):
        return False
    return bool(module._warps_points if kind == "boxes" else module._warps_masks)


# --- sizes of results -----------------------------------------------------------------------------------------------


def sizes_after(module: Any, sizes: Sizes) -> Sizes | None:
    """What a module makes of two sizes; None where it depends on more than these."""
    if hasattr(module, "_sizes_after"):
        own: Sizes | None = module._sizes_after(sizes)
        return own
    if not hasattr(module, "output_shape") or not module.has_known_size or module._is_customized():
        return None
    after = tuple(tuple(module.output_shape((1, 3, *size), module.flags)[2:]) for size in sizes)
    if after != sizes and module.whole_batch and module.p_batch < 1:
        return None
    if after == SIZES and _changes_small_images(module):
        return None
    return after[0], after[1]


def _changes_small_images(module: Any) -> bool:
    """Whether what keeps the size of large images pads small ones."""
    try:
        return bool(module.output_shape((1, 3, 1, 1), module.flags)[2:] != (1, 1))
    except ValueError:  # too small
        return False


def gives_one_size(module: Any) -> bool:
    """Whether images of any sizes have one in the end, in every call."""
    sizes: Sizes | None = module._plans.made("sizes", lambda: sizes_after(module, SIZES))
    return sizes is not None and sizes[0] == sizes[1]


def makes_batch(module: Any) -> bool:
    """Whether one launch of an augmentation makes images of any sizes a batch, in every call."""
    if not hasattr(module, "matrix_transforms") or not module.takes_lists or not gives_one_size(module):
        return False
    sized = find_sized([module], [True], 3, CallContext.of_module("", None, None))
    has_matrix = module.matrix_transforms((1, 3, *SIZES[0]), module.flags) is not None
    return module.whole_batch and has_matrix and sized is not None and sized.own == 0 and sized.has_same_draws
