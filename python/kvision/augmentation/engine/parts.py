"""The parts of a call on a list of images: its inputs, outputs and parameters, split for the parts and joined again."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from itertools import chain
from typing import Any, TypeVar

import torch
from torch import Tensor

from kvision.augmentation.engine.execution import Execution
from kvision.augmentation.engine.record import SomeParamItem
from kvision.augmentation.sample_rows import read_rows
from kvision.constants import DataKey
from kvision.core.exceptions import ShapeError

_SHAPE = "forward_input_shape"
Module = TypeVar("Module")


class Parts:
    """A call on a list: its images in parts that were one batch each, by their numbers, with what each call drew and did.

    Args:
        op: of errors.
        rows: the numbers of the images of each part.
        calls: of each part an Execution, or the Record of a container; or what gives all of them when they are asked for.
        shape: (B, C, H, W) with the largest sides; default: that of the calls.
    """

    def __init__(
        self,
        op: str,
        rows: Sequence[Sequence[int]],
        calls: Sequence[Any] | Callable[[], list[Any]],
        shape: tuple[int, ...] | None = None,
    ) -> None:
        self.op, self.rows, self._calls, self._shape = op, rows, calls, shape
        self.count = sum(map(len, rows))

    @classmethod
    def of_params(
        cls, op: str, params: Any, shapes: Sequence[Any], outputs: Any, call: Callable[[Tensor, Any, Any], Any]
    ) -> Parts:
        """Each image of a list for itself, of a shape and with given parameters, for which `call` says what was done.

        Images that no child augmented have None for a shape: that of their results.
        """
        outputs, count = [torch.empty(1, 1, 1, device="cpu")] * len(shapes) if outputs is None else outputs, len(shapes)
        known = [tuple(output.shape if shape is None else shape) for shape, output in zip(shapes, outputs)]
        like = outputs[0].new_empty(1)  # and not the results, which would be kept

        def calls() -> list[Any]:
            return [call(like, (1, *own), params_of_rows(params, [b], count)) for b, own in enumerate(known)]

        return cls(op, [[b] for b in range(count)], calls, (count, *map(max, zip(*known))))

    @cached_property
    def calls(self) -> Sequence[Any]:
        """What each part drew and did."""
        return self._calls() if callable(self._calls) else self._calls

    @property
    def shape(self) -> tuple[int, ...]:
        """(B, C, H, W) with the largest sides."""
        return self._shape or (self.count, *map(max, zip(*(call.shape[1:] for call in self.calls))))

    def views(self, module: Module) -> list[Module]:
        """The module as it is when the call of a part is its last one; calls of other threads do not see it."""
        views = []
        for call in self.calls:
            view = object.__new__(type(module))
            view.__dict__.update(module.__dict__)
            view.__dict__["_execution" if isinstance(call, Execution) else "_record"] = call
            views.append(view)
        return views

    def inputs(self, rows: Sequence[int], keys: Sequence[DataKey], inputs: Sequence[Any]) -> list[Any]:
        """What the inputs of the call are for some of its images."""
        return [
            value if self._is_shared(key, value) else of_rows(self.op, key, value, rows, self.count)
            for key, value in zip(keys, inputs)
        ]

    def outputs(
        self, keys: Sequence[DataKey], inputs: Sequence[Any], each: Sequence[Any], has_one_size: bool = False
    ) -> list[Any]:
        """The outputs of the parts in the order of the list; images as a batch if they have one size, or a list of (C, h, w)."""
        outputs = []
        for key, value, *results in zip(keys, inputs, *each):
            if key == DataKey.INPUT and not has_one_size:
                outputs.append(self.each_row(results))
            else:
                outputs.append(value if self._is_shared(key, value) else self.join(results))
        return outputs

    def _is_shared(self, key: DataKey, value: Any) -> bool:
        return key == DataKey.CLASS and not belongs_to_images(value, self.count)

    def each_output(
        self,
        module: Module,
        keys: Sequence[DataKey],
        inputs: Sequence[Any],
        call: Callable[[Module, list[Any]], Any],
    ) -> list[Any]:
        """What a call of the module makes of the inputs of each part."""
        return [call(view, self.inputs(rows, keys, inputs)) for view, rows in zip(self.views(module), self.rows)]

    def each_result(self, module: Module, output: Any, call: Callable[[Module, Tensor], Any]) -> Any:
        """What a call of the module makes of the result of each image."""
        return self.each_row(self.each_output(module, [DataKey.INPUT], [output], lambda view, own: call(view, own[0])))

    def each_row(self, values: Sequence[Any]) -> list[Any]:
        """What the parts gave, as a list with an entry of each image."""
        each: list[Any] = [None] * self.count
        for rows, value in zip(self.rows, values):
            for i, own in zip(rows, value):
                each[i] = own
        return each

    def join(self, values: Sequence[Any]) -> Any:
        """Tensors (b, ...) of the parts as one (B, ...) in the order of the list; others as a list."""
        if len(values) == 1:
            return values[0]
        if not all(isinstance(value, Tensor) for value in values):
            return self.each_row(values)
        rows = list(chain(*self.rows))
        return read_rows(torch.cat(list(values)), sorted(range(len(rows)), key=rows.__getitem__))

    def params(self, read: Callable[[Any], Any]) -> Any:
        """The parameters of the list, of what `read` says are those of a part."""
        return joined(self, [read(call) for call in self.calls])

    def matrix(self, read: Callable[[Any], Tensor | None]) -> Any:
        """The matrices (B, 3, 3) of the list, of what `read` says are those of a part; None if there are none."""
        matrices = [read(call) for call in self.calls]
        return None if matrices[0] is None else self.join(matrices)


class PartsOfImages(Parts):
    """Parts that are an image each, whose record is made when it is asked for."""

    def __init__(self, op: str, images: Sequence[Tensor]) -> None:
        self.op, self.count = op, len(images)
        self._shapes = [(1, *x.shape) for x in images]  # and not the images, which would be kept

    @property
    def rows(self) -> list[list[int]]:  # type: ignore[override]
        return [[b] for b in range(self.count)]

    @cached_property
    def calls(self) -> list[Any]:
        return [self._record(b) for b in range(self.count)]

    @property
    def shape(self) -> tuple[int, ...]:
        return (self.count, *map(max, zip(*(shape[1:] for shape in self._shapes))))

    def _record(self, b: int) -> Any:
        """The call of an image."""
        raise NotImplementedError


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


# --- parameters by name ---------------------------------------------------------------------------------------------
#
# Of a list they have the form that they have of a batch: a tensor has a row of each image, or k B rows of the cells of grids.
# The shape of the images is (B, 4), a row of each. What is as large as the images is a list, an entry (k, ...) of each.


def joined(parts: Parts, each: Sequence[Any]) -> Any:
    """Parameters of the parts as those of the list: by name, items of children, or what has none."""
    if isinstance(each[0], list):
        return _joined_items(parts, each)
    if not isinstance(each[0], Mapping):
        return each[0]
    named: dict[str, Any] = {}
    for name in each[0]:
        values = [params[name] for params in each]
        if name == _SHAPE:
            counts = [len(rows) for rows in parts.rows]
            shapes = [value.new_tensor([[int(value[0]) // n, *value[1:].tolist()]]) for value, n in zip(values, counts)]
            named[name] = parts.join([shape.expand(n, -1) for shape, n in zip(shapes, counts)])
        else:
            named[name] = _joined_rows(parts, values)
    return named


def _joined_rows(parts: Parts, values: Sequence[Any]) -> Any:
    sized = list(zip(values, map(len, parts.rows)))
    if not all(isinstance(x, Tensor) and x.dim() and len(x) and not len(x) % n for x, n in sized):
        return values[0]
    by_image = [x.unflatten(0, (-1, n)).transpose(0, 1) for x, n in sized]  # (b, k, ...)
    if len({x.shape[1:] for x in by_image}) > 1:
        return parts.each_row(by_image)
    return parts.join(by_image).transpose(0, 1).flatten(0, 1)


def _joined_items(parts: Parts, each: Sequence[Sequence[Any]]) -> list[Any]:
    items_of_list = []
    for rows, items in _by_children(parts, each):
        numbers = sorted(chain(*rows))
        size, group = len(numbers), Parts(parts.op, [[numbers.index(i) for i in own] for own in rows], ())
        for of_child in zip(*items):
            samples, data = _samples(of_child[0]), list(map(_data, of_child))
            if samples is None and size == parts.count:
                items_of_list.append(_replaced(of_child[0], joined(group, data)))
                continue
            if len(rows) > 1 or samples is None:
                inside, length, own = range(size), size, group
            else:
                inside, length = samples.nonzero()[:, 0].tolist(), len(samples)
                own = Parts(parts.op, [range(len(inside))], ())
            is_of_list = torch.zeros(length // size * parts.count, dtype=torch.bool, device="cpu")
            is_of_list[[i // size * parts.count + numbers[i % size] for i in inside]] = True
            items_of_list.append(_replaced(of_child[0], joined(own, data), is_of_list))
    return items_of_list


def _by_children(parts: Parts, each: Sequence[Sequence[Any]]) -> list[tuple[list[Sequence[int]], list[Sequence[Any]]]]:
    """The rows and the items of parts: together those of parts whose samples all got the same children, so that a replay is one."""
    groups: dict[Any, tuple[list[Sequence[int]], list[Sequence[Any]]]] = {}
    for rows, items in zip(parts.rows, each):
        samples = [_samples(item) for item in items]
        is_of_all = all(own is None or len(own) == len(rows) == 1 for own in samples)
        key = [(_kind(item), own is None) for item, own in zip(items, samples)] if is_of_all else rows
        of_rows, of_items = groups.setdefault(tuple(key), ([], []))
        of_rows.append(rows)
        of_items.append(items)
    return list(groups.values())


def params_of_rows(params: Any, rows: Sequence[int], count: int) -> Any:
    """The parameters of some of `count` images, as those of a batch; items without those of children that none of them got."""
    if isinstance(params, list):
        items = (_item_of_rows(item, rows, count) for item in params)
        return [item for item in items if item is not None]
    if not isinstance(params, Mapping):
        return params
    own: dict[str, Any] = {}
    for name, value in params.items():
        if isinstance(value, list) and len(value) == count:
            each = [value[i] for i in rows]
            has_one_shape = all(x.shape == each[0].shape for x in each)
            own[name] = torch.stack(each, 1).flatten(0, 1) if has_one_shape else each
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


def _item_of_rows(item: Any, rows: Sequence[int], count: int) -> Any:
    samples = _samples(item)
    if samples is None:
        return _replaced(item, params_of_rows(_data(item), rows, count))
    wanted = [cell + row for cell in range(0, len(samples), count) for row in rows]
    is_own = samples[wanted]
    if not is_own.any():
        return None
    places = (samples.cumsum(0) - 1)[wanted][is_own].tolist()
    return _replaced(item, params_of_rows(_data(item), places, int(samples.sum())), is_own)


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


def are_of_samples(params: Any) -> bool:
    """Whether a container, or one in it, chose its children for each sample when it drew these parameters."""
    items = params if isinstance(params, list) else ()
    return any(_samples(item) is not None or are_of_samples(_data(item)) for item in items)


def _kind(item: Any) -> Any:
    indices = getattr(item, "indices", None)
    return (None if indices is None else tuple(indices), getattr(item, "param", item).name)


def _data(item: Any) -> Any:
    return getattr(item, "param", item).data


def _samples(item: Any) -> Any:
    return getattr(getattr(item, "param", item), "samples", None)


def _replaced(item: Any, data: Any, samples: Tensor | None = None) -> Any:
    """An item with other parameters, of some samples."""
    if hasattr(item, "param"):  # of cells
        return item._replace(param=_replaced(item.param, data, samples))
    return item._replace(data=data) if samples is None else SomeParamItem(item.name, data, samples)
