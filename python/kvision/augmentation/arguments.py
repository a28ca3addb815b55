"""The arguments of a call with labels: by data keys, in a dict, or among torchvision's tv_tensors; and results in their form."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from kvision._torch_compat import tree_flatten, tree_unflatten
from kvision._tv_tensors import TV_TENSORS, kind_of, plain, wrap
from kvision.augmentation import labels
from kvision.augmentation.inputs import Entries, image_and_matrix, image_of, label_of, parse_entries, plain_image
from kvision.constants import DataKey, DataKeys
from kvision.core.exceptions import TypeCheckError, ValueCheckError

_KEYS = {
    "image": DataKey.INPUT,
    "video": DataKey.INPUT,
    "mask": DataKey.MASK,
    "boxes": DataKey.BBOX_XYXY,
    "points": DataKey.KEYPOINTS,
}
_FORMATS = {"XYXY": DataKey.BBOX_XYXY, "XYWH": DataKey.BBOX_XYWH, "CXCYWH": DataKey.BBOX_XYXY}


class Sample(NamedTuple):
    """The inputs that follow the image among the leaves of nested arguments; the others pass through."""

    flat: list[Any]
    spec: Any
    where: list[int]
    keys: list[DataKey]

    @property
    def values(self) -> list[Any]:
        return [self.flat[i] for i in self.where]

    def merged(self, outputs: Sequence[Any]) -> Any:
        """The arguments with the results in their places: one, or a list of several."""
        results = dict(zip(self.where, outputs))
        nested = tree_unflatten([results.get(i, value) for i, value in enumerate(self.flat)], self.spec)
        return nested[0] if len(nested) == 1 else nested


class Arguments:
    """What the arguments of a container are: values by data keys, the image of a dict first.

    Args:
        module: the container, with the settings `data_keys` and `keys`.
        args: those of a call.
        data_keys: those of the call.
        is_inverse: some of the values may be missing.
    """

    def __init__(self, module: Any, args: Sequence[Any], data_keys: DataKeys | None, is_inverse: bool = False) -> None:
        sample = _sample(module, args, data_keys)
        if sample is not None:
            keys, values = sample.keys, sample.values
        else:
            keys, values = _keys_of(module, args, data_keys, is_inverse), list(args)
        self.sample = sample  # a dict, or nested arguments, that the values are in; None where these are the arguments
        self.given: list[Any] | None = None  # the values where some are tv_tensors
        if holds_tv_tensors(values):
            self.given, (keys, values) = values, as_tensors(module, keys, values, sample is not None)
        self.keys, self.values = keys, values

    def convert(self, module: Any, image: int | None) -> Tensor | None:
        """Put tensors in place of values of NumPy and PIL, and of the image; gives the matrices that came with it."""
        before = like = None
        if image is not None:
            like, before = image_and_matrix(module, image_of(module, self.values[image]))
            self.values[image] = like
        for i, (key, value) in enumerate(zip(self.keys, self.values)):
            is_image = key == DataKey.INPUT
            self.values[i] = image_of(module, value) if is_image else label_of(key, value, like, module._keeps_axes())
            labels.check_one_type(key, self.values[i])
        return before

    def merged(self, outputs: list[Any]) -> Any:
        """Results in the form in which the arguments were given."""
        if self.sample is not None:
            return self.sample.merged(outputs)
        return outputs[0] if len(outputs) == 1 else outputs


def _sample(module: Any, args: Sequence[Any], data_keys: DataKeys | None) -> Entries | Sample | None:
    """What follows the images among the entries of a dict, or among tv_tensors; None for arguments by their keys."""
    if len(args) == 1 and isinstance(args[0], Tensor):
        return None
    op, known = type(module).__name__, module.data_keys
    if data_keys is None and (known is None or len(known) != len(args) or len(args) == 1):
        sample = sample_of(op, args, lambda data: parse_entries(op, data, module._names, module, set(data)))
        if sample is not None:
            return sample
    if len(args) != 1 or not isinstance(args[0], Mapping):
        return None
    return parse_entries(op, args[0], module._names, module, module._warned)


def _keys_of(module: Any, args: Sequence[Any], data_keys: DataKeys | None, is_inverse: bool) -> list[DataKey]:
    """The keys of arguments: those of the call, or else of the container; the inverse may have some of its inputs."""
    op = type(module).__name__
    keys: list[DataKey] | None = module.data_keys if data_keys is None else labels.parse_data_keys(op, data_keys)
    if is_inverse:
        return keys or [DataKey.INPUT]
    if keys is None:
        raise ValueCheckError(f"{op}: without data_keys, expected one dict")
    if len(keys) != len(args):
        names = [key.name.lower() for key in keys]
        raise ValueCheckError(f"{op}: expected {len(keys)} inputs for {names}, got {len(args)}")
    return keys


def holds_tv_tensors(values: Sequence[Any]) -> bool:
    if "torchvision.tv_tensors" not in sys.modules:
        return False
    return any(
        type(x) is not Tensor and (holds_tv_tensors(x) if isinstance(x, list) else kind_of(x) in TV_TENSORS)
        for x in values
    )


def sample_of(op: str, args: Sequence[Any], named: Any) -> Sample | None:
    """The sample that arguments with tv_tensors are, by their classes; None without any.

    Further entries of a dict are data by their names, which `named` parses; other tensors pass through, as in torchvision. A plain
    tensor is the image if no other is there and it is the first one.
    """
    if "torchvision.tv_tensors" not in sys.modules:
        return None
    flat, spec = tree_flatten(list(args))
    keys = {i: _KEYS[kind] for i, x in enumerate(flat) if (kind := kind_of(x)) in _KEYS}
    if not keys:
        return None
    if len(args) == 1 and isinstance(args[0], Mapping):
        others = {
            k: v for k, v in args[0].items() if kind_of(v) not in _KEYS and not holds_tv_tensors(tree_flatten(v)[0])
        }
        if others:
            entries = named(others)
            for key, value in zip(entries.keys, entries.values):
                keys.update({i: key for i, x in enumerate(flat) if x is value})
    if DataKey.INPUT not in keys.values():
        first = next((i for i, x in enumerate(flat) if kind_of(x) in ("tensor", "pil") and i not in keys), None)
        if first is None:
            raise ValueCheckError(f"{op}: expected an image in the sample of tv_tensors")
        keys[first] = DataKey.INPUT
    where = sorted(keys)
    return Sample(flat, spec, where, [keys[i] for i in where])


def as_tensors(
    module: Any, keys: list[DataKey], values: Sequence[Any], by_class: bool
) -> tuple[list[DataKey], list[Any]]:
    """Plain tensors in place of tv_tensors, with the keys of boxes by their format."""
    op, images = type(module).__name__, _images(keys, values)
    new_keys, tensors = list(keys), list(values)
    for i, (key, value) in enumerate(zip(keys, values)):
        if key == DataKey.INPUT:
            tensors[i] = plain_image(module, value)
        elif not isinstance(value, list):
            new_keys[i], tensors[i] = _as_tensor(op, key, value, _size_of(images), by_class)
        elif holds_tv_tensors(value):
            each = [_as_tensor(op, key, x, _size_of(images, b), by_class) for b, x in enumerate(value)]
            tensors[i], formats = [x for _, x in each], {own for own, _ in each}
            if len(formats) > 1:
                names = sorted(own.name.lower() for own in formats)
                raise ValueCheckError(f"{op}: expected boxes of one format in a list, got {', '.join(names)}")
            (new_keys[i],) = formats
    return new_keys, tensors


def _as_tensor(op: str, key: DataKey, value: Any, size: Any, by_class: bool) -> tuple[DataKey, Any]:
    """A label of an image of this size as a plain tensor, and its key."""
    kind = kind_of(value)
    if kind not in TV_TENSORS:
        return key, value
    canvas = getattr(value, "canvas_size", None)
    if canvas is not None and size is not None and tuple(canvas) != size:
        raise ValueCheckError(f"{op}: expected a canvas_size of the image, {size}, got {tuple(canvas)}")
    return _boxes(op, key, value, by_class) if kind == "boxes" else (key, plain(value))


def _images(keys: Sequence[DataKey], values: Sequence[Any]) -> Any:
    return next((v for k, v in zip(keys, values) if k == DataKey.INPUT), None)


def _size_of(images: Any, b: int | None = None) -> tuple[int, ...] | None:
    """Height and width of the images of a batch, or of image b of a list; None where they are none of both."""
    one = images[b] if b is not None and isinstance(images, list) and b < len(images) else images
    return tuple(one.shape[-2:]) if isinstance(one, Tensor) else None


def _boxes(op: str, key: DataKey, boxes: Any, by_class: bool) -> tuple[DataKey, Tensor]:
    name = boxes.format.name
    own = _FORMATS.get(name)
    if own is None:
        raise TypeCheckError(f"{op}: expected boxes of format XYXY, XYWH or CXCYWH, got {name}; use kvision.tv")
    if not by_class and (own != key or name == "CXCYWH"):
        raise ValueCheckError(f"{op}: expected boxes of the format of the data key {key.name.lower()}, got {name}")
    numbers = plain(boxes)
    numbers = numbers if numbers.is_floating_point() else numbers.float()
    if name == "CXCYWH":
        center, half = numbers[..., :2], numbers[..., 2:] / 2
        numbers = torch.cat([center - half, center + half], -1)
    return own, numbers


def as_given(outputs: Sequence[Any], values: Sequence[Any], keys: Sequence[DataKey]) -> list[Any]:
    """Results as the classes of tv_tensors that the inputs had, with the format of boxes and the size of the results."""
    images, results = _images(keys, outputs), []
    for output, value in zip(outputs, values):
        if isinstance(value, list) and isinstance(output, (list, tuple)) and holds_tv_tensors(value):
            results.append([_as_given(y, x, _size_of(images, b)) for b, (y, x) in enumerate(zip(output, value))])
        else:
            results.append(_as_given(output, value, _size_of(images)))
    return results


def _as_given(output: Any, value: Any, size: tuple[int, ...] | None) -> Any:
    """A result as the class of the tv_tensor that the input was, beside a resulting image of this size."""
    if isinstance(value, list) and isinstance(output, Tensor) and holds_tv_tensors(value):
        value = value[0]  # of a list that became a batch
    kind = kind_of(value)
    if kind not in TV_TENSORS or not isinstance(output, Tensor):
        return output
    if kind == "boxes" and value.format.name == "CXCYWH":
        low, high = output[..., :2], output[..., 2:]
        output = torch.cat([(low + high) / 2, high - low], -1)
    if kind in ("boxes", "points") and not value.is_floating_point():
        output = output.round().to(value.dtype)
    changed = {"canvas_size": size} if kind in ("boxes", "points") and size is not None else {}
    return wrap(output, value, **changed)
