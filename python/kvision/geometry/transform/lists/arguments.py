"""Lists of images of different sizes: arguments of public functions, and rules of operators."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Any

import torch
from torch import Tensor
from torch.compiler import is_compiling

from kvision import _check
from kvision._ops import match_layout
from kvision.core.exceptions import DeviceError, ShapeError, TypeCheckError
from kvision.geometry.transform.nearest import as_values, moves_values, of_values

# --- arguments ------------------------------------------------------------------------------------------------------


class ImageList(list[Tensor]):
    """A list of images (C, H, W), which is checked where its sizes are read, once: to ask each image takes the host longer than
    a launch. Kernels that read the sizes themselves check it, too, but say less of what is wrong.
    """

    def __init__(self, op: str, name: str, images: Sequence[Tensor]) -> None:
        super().__init__(images)
        self._op, self._name = op, name

    @cached_property
    def _sides(self) -> tuple[Sequence[int], Sequence[int]]:
        return _checked_sides(self._op, self._name, self)

    def some(self, samples: Sequence[int]) -> ImageList:
        """The images of these numbers, which are checked with all of them."""
        some, (heights, widths) = ImageList(self._op, self._name, [self[i] for i in samples]), self._sides
        some._sides = [heights[i] for i in samples], [widths[i] for i in samples]
        return some

    def check(self) -> ImageList:
        """The list; raises unless it has images of one type, device and number of channels."""
        _ = self._sides
        return self

    @cached_property
    def sides(self) -> list[int]:
        sides = [0] * (2 * len(self))
        sides[::2], sides[1::2] = self._sides
        return sides

    @cached_property
    def largest_shape(self) -> tuple[int, ...]:
        return (len(self), self[0].shape[0], *map(max, self._sides))


def have_one_size(images: Sequence[Tensor]) -> bool:
    """Whether all images of a list have one size."""
    if isinstance(images, ImageList):
        return all(len({*own}) == 1 for own in images._sides)
    return len({x.shape for x in images}) == 1


def some_of(images: list[Tensor], samples: Sequence[int]) -> list[Tensor]:
    """The images of these numbers, which ascend."""
    if len(samples) == len(images):
        return images
    return images.some(samples) if isinstance(images, ImageList) else [images[i] for i in samples]


def unchecked_list(op: str, name: str, images: Any) -> list[Tensor]:
    """An ImageList that is not checked yet but for its first image; in graphs the list, checked."""
    if type(images) is ImageList:
        return images
    if is_compiling() or not images or {*map(type, images)} != {Tensor}:
        return check_list(op, name, images)
    _check.shape(op, f"{name}[0]", images[0], "C", "H", "W")
    return ImageList(op, name, images)


def check_list(op: str, name: str, images: Any) -> list[Tensor]:
    """The list, an ImageList but in graphs; raises unless it has images (C, H, W) of one type, device and number of channels."""
    if type(images) is ImageList:
        return images.check()
    if not images:
        raise ShapeError(f"{op}: expected {name} with at least one image, got an empty list")
    _check.shape(op, f"{name}[0]", images[0], "C", "H", "W")
    if is_compiling():
        _checked_sides(op, name, images)
        return list(images)
    return ImageList(op, name, images).check()


def _checked_sides(op: str, name: str, images: Sequence[Tensor]) -> tuple[Sequence[int], Sequence[int]]:
    """The heights and widths of a list; raises what is wrong with it."""
    sides = _uniform_sides(images)
    if sides is not None:
        return sides
    first = images[0]
    for i, x in enumerate(images):
        if type(x) is not Tensor or x.dim() != 3 or 0 in x.shape[1:]:
            _check.shape(op, f"{name}[{i}]", x, "C", "H", "W")
            if 0 in x.shape[1:]:
                raise ShapeError(
                    f"{op}: expected {name}[{i}] with H, W of at least 1, got {tuple(x.shape)}", actual_shape=x.shape
                )
        if x.dtype is not first.dtype:
            raise TypeCheckError(f"{op}: expected {name} of one type, got {first.dtype} and, at {i}, {x.dtype}")
        if x.shape[0] != first.shape[0]:
            raise ShapeError(
                f"{op}: expected {name} with one number of channels, got {first.shape[0]} and, at {i}, {x.shape[0]}"
            )
        if x.device != first.device:
            raise DeviceError(f"{op}: expected {name} on one device, got {first.device} and, at {i}, {x.device}")
    _, heights, widths = zip(*(x.shape for x in images))
    return heights, widths


def _uniform_sides(images: Sequence[Any]) -> tuple[Sequence[int], Sequence[int]] | None:
    """The heights and widths of a list with which nothing is wrong; which image is wrong is looked for only then."""
    if {*map(type, images)} != {Tensor} or len({x.dtype for x in images}) > 1:
        return None
    numbers = {x.get_device() for x in images}  # in half of the time that devices take; those without a number have -1
    if len(numbers) > 1 or (-1 in numbers and len({x.device for x in images}) > 1):
        return None
    try:
        channels, heights, widths = zip(*[x.shape for x in images], strict=True)
    except ValueError:  # other axes
        return None
    return (heights, widths) if len({*channels}) == 1 and min(heights) > 0 and min(widths) > 0 else None


def as_value_list(images: Sequence[Tensor], mode: str) -> list[Tensor]:
    """The images as operators take them."""
    first = images[0]
    if first.is_floating_point() or first.dtype == torch.uint8:
        return images if isinstance(images, list) else list(images)
    return [as_values(x[None], mode)[0] for x in images]


def like_batch(images: Sequence[Tensor]) -> Tensor:
    """(B, C, 1, 1) of the type and device of a list, for checks that read nothing else of a batch."""
    return images[0][:, :1, :1].detach().expand(len(images), -1, -1, -1)


def smallest_batch(images: Sequence[Tensor]) -> Tensor:
    """(B, C, H, W) of the type, the device and the smallest sides of a list: what windows have to fit into."""
    sides = sizes(images)
    return like_batch(images).expand(-1, -1, min(sides[::2]), min(sides[1::2]))


def largest_shape(images: Sequence[Tensor]) -> tuple[int, ...]:
    """(B, C, H, W) with the largest sides of a list."""
    if isinstance(images, ImageList):
        return images.largest_shape
    _, heights, widths = zip(*[x.shape for x in images])
    return (len(images), images[0].shape[0], max(heights), max(widths))


def images_of(results: Sequence[Tensor]) -> list[Tensor]:
    """Results (C, h, w) for a size of each image, as operators return them: that of one image by itself is a batch of one."""
    return list(results[0] if results[0].dim() == 4 else results)


def of_value_list(results: Sequence[Tensor], like: Tensor, mode: str, is_list: bool) -> Any:
    """The results of an operator on :func:`as_value_list`: (B, C, h, w), or a list of (C, h, w)."""
    if not is_list:
        return of_values(results[0], like, mode)
    each = images_of(results)
    return each if not moves_values(like, mode) else [of_values(y[None], like, mode)[0] for y in each]


# --- rules of operators ---------------------------------------------------------------------------------------------


def sizes(images: Sequence[Tensor]) -> list[int]:
    """Height and width of each image."""
    return images.sides if isinstance(images, ImageList) else [n for x in images for n in x.shape[-2:]]


def row(x: Tensor | None, b: int) -> Any:
    """What parameters of all samples, or of each, say for sample b."""
    return x if x is None or x.shape[0] == 1 else x[b : b + 1]


def sizes_of(size: Sequence[int], count: int) -> Iterator[list[int]]:
    """Height and width of `count` results, of which `size` has one for all or one for each."""
    for b in range(count):
        yield list(size if len(size) == 2 else size[2 * b : 2 * b + 2])


def halves(both: Sequence[Tensor]) -> tuple[Sequence[Tensor], Sequence[Tensor]]:
    """The images of a list, and the gradients behind them: one of each image, or one tensor (B, C, h, w)."""
    if both[-1].dim() == 4:
        return both[:-1], both[-1:]
    return both[: len(both) // 2], both[len(both) // 2 :]


def samples(grads: Sequence[Tensor]) -> list[Tensor]:
    """Tensors (1, C, h, w) of a batch or of a list."""
    return list(grads[0].split(1)) if grads[0].dim() == 4 else [grad[None] for grad in grads]


def shape_of(grads: Sequence[Tensor]) -> list[int]:
    """The size of results that have these gradients: one for all of a batch, or one for each of a list."""
    return list(grads[0].shape[2:]) if grads[0].dim() == 4 else sizes(grads)


def collected(results: Sequence[Tensor], like: Tensor, size: Sequence[int]) -> list[Tensor]:
    """Results (1, C, h, w) as operators return them, for the one size of all or the size of each; in the layout of `like`."""
    return [match_layout(torch.cat(list(results)), like)] if len(size) == 2 else [y[0] for y in results]


def fake_results(images: Sequence[Tensor], size: Sequence[int]) -> list[Tensor]:
    """What the kernels allocate for results of images (C, H, W)."""
    first, count = images[0], len(images)
    if len(size) == 2:
        return [match_layout(first.new_empty(count, first.shape[0], *size), first[None])]
    return [match_layout(first.new_empty(1, first.shape[0], *s), first[None])[0] for s in sizes_of(size, count)]
