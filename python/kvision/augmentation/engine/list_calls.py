"""Calls on lists of images of different sizes, image by image: those of one size are a batch, each with a seed of its own.

A call is one of batches, whose images, labels and parameters are joined in the order of the list. So whatever runs on a batch
runs on a list, and an image of a list becomes what it becomes alone with its seed. A list of one size is one batch, with the draws
of that batch. What a list becomes follows from the augmentations: a batch if all images have one size in the end, whatever
they had before, and a list otherwise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import chain
from typing import Any, NamedTuple, TypeVar

import torch
from torch import Generator, Tensor
from torch.compiler import is_compiling

from kvision.augmentation.draws import philox
from kvision.augmentation.engine.execution import Execution
from kvision.augmentation.engine.record import Record, SomeParamItem
from kvision.augmentation.keys import Seed, check_seeds, draw_keys
from kvision.constants import DataKey
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError

_SEEDS = 1 << 24  # the position in the chain of draws of seeds, behind those of all augmentations and choices
_SHAPE = "forward_input_shape"
Sizes = tuple[tuple[int, ...], tuple[int, ...]]
SIZES: Sizes = ((40037, 53003), (91009, 67003))  # of images that show what depends on their size; larger than any crop
Module = TypeVar("Module")


class Part(NamedTuple):
    """The images of a list that were one batch, by their numbers, and what that batch's call drew and did."""

    rows: Sequence[int]
    call: Any  # an Execution, or a Record of a container


def _largest(parts: Sequence[Part], count: int) -> tuple[int, ...]:
    """(B, C, H, W) with the largest sides of a list."""
    return (count, *(max(sides) for sides in zip(*(part.call.shape[1:] for part in parts))))


class ListRecord(Record):
    """The call of a container on a list, in parts."""

    def __init__(self, parts: Sequence[Part], count: int) -> None:
        super().__init__(_largest(parts, count))
        self.parts, self.count = parts, count


class PartedExecution(Execution):
    """The call of an augmentation on a list, in parts."""

    is_of_list = True

    def __init__(self, parts: Sequence[Part], count: int, module: Any) -> None:
        self.parts, self.count, self._module = parts, count, module
        self._matrices: Tensor | None = None
        self._named: dict[str, Any] | None = None
        super().__init__(_largest(parts, count))

    @property
    def matrix(self) -> Tensor:  # type: ignore[override]  # made when it is read
        if self._matrices is None:
            matrices = [self._module._matrix(part.call) for part in self.parts]
            self._matrices = join(self.parts, matrices, self.count)
        return self._matrices

    @property
    def params(self) -> Any:
        if self._named is None:
            each = [self._module._read_params(part.call) for part in self.parts]
            self._named = join_params(self.parts, each, self.count)
        return self._named

    @params.setter
    def params(self, params: Any) -> None:
        self._named = params


def with_call(module: Module, name: str, call: Any) -> Module:
    """The module, as it is when a part of its call is its last one; calls of other threads do not see it."""
    view = object.__new__(type(module))
    view.__dict__.update(module.__dict__)
    view.__dict__[name] = call
    return view


# --- the parts of a call --------------------------------------------------------------------------------------------


def refuse_list(op: str, modules: Any) -> None:
    """Raise where a list cannot be augmented image by image."""
    for module in modules:
        if getattr(module, "mixes_samples", False):
            raise TypeCheckError(
                f"{op}: expected a batch for {type(module).__name__}, which mixes samples, got a list of images; begin "
                "with a crop or resize to a fixed size, or mix the batch that another container makes of the list"
            )
    if is_compiling():
        raise RuntimeError(
            f"{op}: a list of images that no crop or resize to a fixed size makes a batch has no graph; call it outside of "
            "torch.compile, or without fullgraph=True"
        )


def rows_of_parts(images: Sequence[Tensor], modules: Sequence[Any], has_seeds: bool) -> list[list[int]]:
    """The numbers of the images of each part: those of one size, or one image where samples of a batch would not be alone.

    A chance may decide for a batch, and what is chosen for samples may give them sizes of their own.
    """
    by_size: dict[tuple[int, ...], list[int]] = {}
    for i, x in enumerate(images):
        by_size.setdefault(tuple(x.shape), []).append(i)
    has_chance = len(by_size) > 1 and any(getattr(m, "whole_batch", False) and 0 < m.p_batch < 1 for m in modules)
    if has_chance or any(_gives_samples_sizes(m, has_seeds or len(by_size) > 1) for m in modules):
        return [[i] for i in range(len(images))]
    return list(by_size.values())


def _gives_samples_sizes(module: Any, has_seeds: bool) -> bool:
    """Whether a container chooses children for samples which give these different sizes."""
    chooses = getattr(module, "chooses_for_samples", False) or (has_seeds and getattr(module, "random_apply", None))
    return bool(chooses) and module._sizes_after(SIZES) is None


def seeds_of_list(op: str, modules: Sequence[Any], count: int, seed: Seed, generator: Generator | None) -> Tensor:
    """A seed of each image (B,): those that are given, or what follows from one seed or from the key of a generator.

    They are one for all where all that draws has `same_on_batch`.
    """
    if seed is None and torch.cuda.is_initialized() and torch.cuda.is_current_stream_capturing():
        raise RuntimeError(
            f"{op}: a CUDA graph would repeat the draws of a list of images of several sizes; give a seed, or begin with a crop or "
            "resize to a fixed size"
        )
    keys = draw_keys(op, 1, torch.device("cpu"), seed, generator)
    if keys.seeds is not None:
        check_seeds(op, keys, count)
        return keys.seeds
    samples = torch.arange(count, device=keys.keys.device)
    same = {is_same for is_same in map(_draws_same, modules) if is_same is not None}
    if len(same) > 1:
        raise ValueCheckError(
            f"{op}: expected one same_on_batch of all that draws for images of several sizes, got True and False; give a seed of "
            "each image"
        )
    samples = torch.zeros_like(samples) if same == {True} else samples
    zero = torch.zeros_like(samples)
    high, low, _, _ = philox(keys.keys[0], (zero, 0, samples, _SEEDS))
    return (high << 32) | low


def _draws_same(module: Any) -> bool | None:
    """Whether a module draws the same for all samples; None if it draws nothing."""
    if hasattr(module, "output_shape"):
        draws = module._draws_by_name or (module.p > 0 and module._request((1, 3, *SIZES[0])) is not None)
    else:
        draws = getattr(module, "_draws_choices", False)
    return bool(module.same_on_batch) if draws else None


def part_seed(
    seed: Seed, generator: Generator | None, rows: Sequence[int], count: int
) -> tuple[Seed, Generator | None]:
    """The seed and the generator of a part: those of the call for all of it, or the seeds of its images."""
    if len(rows) == count or seed is None:
        return seed, generator
    assert isinstance(seed, Tensor)
    return seed[list(rows)], None


def belongs_to_images(value: Any, count: int) -> bool:
    """Whether a value has an entry of each image."""
    if isinstance(value, Tensor):
        return value.dim() > 0 and len(value) == count
    return isinstance(value, (list, tuple)) and len(value) == count


def of_rows(op: str, key: DataKey, value: Any, rows: Sequence[int], count: int) -> Any:
    """What belongs to some of `count` images, as those of a batch."""
    name = key.name.lower()
    if not belongs_to_images(value, count):
        got = len(value) if isinstance(value, (Tensor, list, tuple)) else type(value).__name__
        raise ShapeError(f"{op}: expected {name} of {count} images, one of each in a list or a tensor, got {got}")
    if isinstance(value, Tensor):
        return value if len(rows) == count else value[torch.tensor(rows, device="cpu").to(value.device)]
    own = [value[i] for i in rows]
    if key == DataKey.INPUT:
        sizes = {x.shape for x in own}
        if len(sizes) > 1:
            raise ShapeError(f"{op}: expected further images of one size for images of one size, got {sorted(sizes)}")
        return own[0][None] if len(own) == 1 else torch.stack(own)
    if key == DataKey.MASK:
        return [x[None] if isinstance(x, Tensor) and x.dim() == 2 else x for x in own]
    return own


def each_row(values: Sequence[Any], parts: Sequence[Part], count: int) -> list[Any]:
    """What the parts gave, as a list with an entry of each image."""
    rows: list[Any] = [None] * count
    for part, value in zip(parts, values):
        for i, own in zip(part.rows, value):
            rows[i] = own
    return rows


def join(parts: Sequence[Part], values: Sequence[Any], count: int) -> Any:
    """Tensors (b, ...) of the parts as one (B, ...) in the order of the list; others as a list."""
    if len(parts) == 1:
        return values[0]
    if not all(isinstance(value, Tensor) for value in values):
        return each_row(values, parts, count)
    order = torch.tensor([i for part in parts for i in part.rows], device="cpu").argsort()
    y = torch.cat(list(values))
    if y.dim() == 4 and values[0].shape[1] > 1 and values[0].is_contiguous(memory_format=torch.channels_last):
        return y.permute(0, 2, 3, 1).index_select(0, order.to(y.device)).permute(0, 3, 1, 2)
    return y.index_select(0, order.to(y.device))


def join_images(parts: Sequence[Part], values: Sequence[Tensor], count: int, has_one_size: bool) -> Any:
    """Images (b, C, h, w) of the parts: a batch, or a list of (C, h, w)."""
    return join(parts, values, count) if has_one_size else each_row(values, parts, count)


# --- parameters by name ---------------------------------------------------------------------------------------------
#
# Of a list they have the form that they have of a batch: a tensor has a row of each image, or k B rows of the cells of grids.
# The shape of the images is (B, 4), a row of each. What is as large as the images is a list, an entry (k, ...) of each.


def join_params(parts: Sequence[Part], each: Sequence[Mapping[str, Any]], count: int) -> dict[str, Any]:
    """The parameters of the parts as those of the list."""
    joined: dict[str, Any] = {}
    for name in each[0]:
        values = [params[name] for params in each]
        if name == _SHAPE:
            shapes = [
                value.new_tensor([[int(value[0]) // len(part.rows), *value[1:].tolist()]]).expand(len(part.rows), -1)
                for part, value in zip(parts, values)
            ]
            joined[name] = join(parts, shapes, count)
        else:
            joined[name] = _joined_rows(parts, values, count)
    return joined


def _joined_rows(parts: Sequence[Part], values: Sequence[Any], count: int) -> Any:
    if not all(
        isinstance(x, Tensor) and x.dim() and len(x) and not len(x) % len(p.rows) for p, x in zip(parts, values)
    ):
        return values[0]
    by_image = [x.unflatten(0, (-1, len(part.rows))).transpose(0, 1) for part, x in zip(parts, values)]  # (b, k, ...)
    if len({x.shape[1:] for x in by_image}) > 1:
        return each_row(by_image, parts, count)
    return join(parts, by_image, count).transpose(0, 1).flatten(0, 1)


def params_of_rows(params: Mapping[str, Any], rows: Sequence[int], count: int) -> dict[str, Any]:
    """The parameters of some of `count` images, as those of a batch."""
    own: dict[str, Any] = {}
    for name, value in params.items():
        if isinstance(value, list) and len(value) == count:
            own[name] = torch.stack([value[i] for i in rows], 1).flatten(0, 1)
        elif not isinstance(value, Tensor) or not value.dim():
            own[name] = value
        elif name == _SHAPE:
            first = value[rows[0]] if value.dim() == 2 else torch.cat([value[:1] // count, value[1:]])
            own[name] = torch.cat([first[:1] * len(rows), first[1:]])
        elif len(value) and not len(value) % count:
            index = torch.tensor(rows, device="cpu").to(value.device)
            own[name] = value.unflatten(0, (-1, count)).index_select(1, index).flatten(0, 1)
        else:
            own[name] = value
    return own


def shapes_of_images(params: Any) -> list[tuple[int, ...] | None] | None:
    """The shapes (C, H, W) of the images of a list, in the parameters of a call, None where no child ran; None of a batch."""
    if isinstance(params, Mapping):
        of_images = params.get(_SHAPE)
        is_of_list = isinstance(of_images, Tensor) and of_images.dim() == 2
        return [tuple(row[1:]) for row in of_images.tolist()] if is_of_list and of_images is not None else None
    known: list[tuple[int, ...] | None] = []
    for item in params if isinstance(params, (list, tuple)) else ():
        shapes = shapes_of_images(getattr(item, "data", None))  # cells of a grid say nothing about the image
        samples = getattr(item, "samples", None)
        if shapes is None or samples is None:
            if shapes is not None:
                return shapes
            continue
        known = known or [None] * len(samples)
        for i, shape in zip(samples.nonzero()[:, 0].tolist(), shapes):
            known[i] = known[i] or shape
    return known or None


def join_items(parts: Sequence[Part], each: Sequence[Sequence[Any]], count: int) -> list[Any]:
    """The items of the children of a container for the parts, as those of the list."""
    kinds = [[_kind(item) for item in items] for items in each]
    if all(kind == kinds[0] for kind in kinds) and all(_samples(item) is None for item in chain(*each)):
        return [
            _replaced(items[0], _joined_data(parts, [_data(item) for item in items], count)) for items in zip(*each)
        ]
    joined = []
    for part, items in zip(parts, each):
        size = len(part.rows)
        for item in items:
            samples = _samples(item)
            inside = range(size) if samples is None else samples.nonzero()[:, 0].tolist()
            length = size if samples is None else len(samples)
            is_of_list = torch.zeros(length // size * count, dtype=torch.bool, device="cpu")
            is_of_list[[i // size * count + part.rows[i % size] for i in inside]] = True
            data = _joined_data([Part(range(len(inside)), None)], [_data(item)], len(inside))
            joined.append(_replaced(item, data, is_of_list))
    return joined


def items_of_rows(items: Any, rows: Sequence[int], count: int) -> list[Any]:
    """The items of the children for some of `count` images; without those of children that none of them got."""
    own = []
    for item in items:
        samples = _samples(item)
        if samples is None:
            own.append(_replaced(item, _data_of_rows(_data(item), rows, count)))
            continue
        wanted = [cell + row for cell in range(0, len(samples), count) for row in rows]
        is_own = samples[wanted]
        if is_own.any():
            places = (samples.cumsum(0) - 1)[wanted][is_own].tolist()
            own.append(_replaced(item, _data_of_rows(_data(item), places, int(samples.sum())), is_own))
    return own


def _kind(item: Any) -> Any:
    return (getattr(item, "indices", None), getattr(item, "param", item).name)


def _data(item: Any) -> Any:
    return getattr(item, "param", item).data


def _samples(item: Any) -> Any:
    return getattr(getattr(item, "param", item), "samples", None)


def _replaced(item: Any, data: Any, samples: Tensor | None = None) -> Any:
    """An item with other parameters, of some samples."""
    if hasattr(item, "param"):  # of cells
        return item._replace(param=_replaced(item.param, data, samples))
    return item._replace(data=data) if samples is None else SomeParamItem(item.name, data, samples)


def _joined_data(parts: Sequence[Part], each: Sequence[Any], count: int) -> Any:
    if isinstance(each[0], Mapping):
        return join_params(parts, each, count)
    return join_items(parts, each, count) if isinstance(each[0], list) else each[0]


def _data_of_rows(data: Any, rows: Sequence[int], count: int) -> Any:
    if isinstance(data, Mapping):
        return params_of_rows(data, rows, count)
    return items_of_rows(data, rows, count) if isinstance(data, list) else data


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
    return after[0], after[1]


def gives_one_size(module: Any) -> bool:
    """Whether images of any sizes have one in the end, in every call."""
    kept: bool | None = module._plans.get("one size")
    if kept is None:
        sizes = sizes_after(module, SIZES)
        kept = sizes is not None and sizes[0] == sizes[1]
        module._plans.keep("one size", kept)
    return kept
