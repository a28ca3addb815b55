"""What callers hand to augmentations, and what they get back: tensors, pairs with matrices, images of NumPy and PIL, dictionaries.

Nothing here knows how an augmentation is executed.
"""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, get_args

import torch
from torch import Tensor
from torch.compiler import is_compiling

from kvision import _check
from kvision._choices import OutputType
from kvision._tv_tensors import TV_TENSORS, kind_of, plain
from kvision.augmentation.labels import BOX_FORMATS
from kvision.augmentation.lists.pixels import PixelRow
from kvision.constants import DataKey
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError
from kvision.geometry.transform.lists.arguments import ImageList, check_list, unchecked_list

WIDE_INTEGERS = (torch.int16, torch.uint16)  # whose values float32 holds
OUTPUT_TYPES = get_args(OutputType)

# --- images and pairs -----------------------------------------------------------------------------------------------


def image_and_matrix(module: Any, input: Any) -> tuple[Any, Tensor | None]:
    """An image for a module, and the matrices that came with it, as chains with `return_transform` pass them on.

    Only a tuple of two tensors is such a pair.
    """
    if isinstance(input, Tensor):
        return input, None
    if isinstance(input, tuple) and len(input) == 2 and all(isinstance(x, Tensor) for x in input):
        return input[0], input[1]
    if _may_be_image_list(module, input):
        return unchecked_list(type(module).__name__, "input", input), None
    if isinstance(input, (list, tuple)):
        described = _check.described(input)
        got = described if " of " in described else f"a {described} of {len(input)}"
        op = type(module).__name__
        lists = " a list of images (C, H, W)," if getattr(module, "takes_lists", False) else ""
        raise TypeCheckError(
            f"{op}: expected input to be a Tensor,{lists} or a tuple of one and of matrices, got {got}"
        )
    return input, None


def plain_image(module: Any, x: Any) -> Any:
    """An image of torchvision's class, or a video of a module that takes these, as a plain tensor, alone or in a list; others as
    they are.
    """
    if type(x) is Tensor:
        return x
    if isinstance(x, list):
        if "torchvision.tv_tensors" not in sys.modules:
            return x
        own = [plain_image(module, item) for item in x] if {*map(type, x)} != {Tensor} else x
        return own
    if (kind := kind_of(x)) not in TV_TENSORS:
        return x
    op, name = type(module).__name__, type(x).__name__
    if kind == "video" and not any(hasattr(m, "data_format") for m in module.modules()):
        raise TypeCheckError(
            f"{op}: expected an image, got tv_tensors.{name}, whose frames would draw by themselves; use VideoSequential"
        )
    if kind in ("mask", "boxes", "points"):
        raise TypeCheckError(
            f"{op}: expected an image, got tv_tensors.{name}; AugmentationSequential moves it with its image"
        )
    return plain(x)


def is_image_list(module: Any, input: Any) -> bool:
    """Whether an input is a list of images (C, H, W), for a container that takes them."""
    if type(input) is ImageList or not _may_be_image_list(module, input):
        return type(input) is ImageList
    return all(isinstance(x, Tensor) and x.ndim == 3 for x in input)


def _may_be_image_list(module: Any, input: Any) -> bool:
    """The same by the first image alone; `check_list` says then which of the others is none."""
    if not isinstance(input, list) or not input or not getattr(module, "takes_lists", False):
        return False
    return isinstance(input[0], Tensor) and input[0].ndim == 3


def check_image(module: Any, x: Any) -> None:
    """Raise unless a module takes images of this type."""
    if not isinstance(x, Tensor) or x.layout is not torch.strided or x.is_nested:
        _check.is_tensor(type(module).__name__, "input", x)
    if x.dtype in _check.FLOATING or x.dtype == torch.uint8:
        return
    if x.dtype not in WIDE_INTEGERS or not getattr(module, "accepts_wide_integers", False):
        more = ", or of int16 or uint16 for geometric classes" if x.dtype in WIDE_INTEGERS else ""
        raise TypeCheckError(
            f"{type(module).__name__}: expected input of a floating-point type or uint8{more}, got {x.dtype}"
        )


_LAYOUTS = ("(H, W), (C, H, W) or (B, C, H, W)", "(D, H, W), (C, D, H, W) or (B, C, D, H, W)")


def check_batch(module: Any, x: Any, axes: int) -> None:
    """Raise unless a module takes an input: images with pixels, of `axes` with their channels, alone or in a batch."""
    check_image(module, x)
    op = type(module).__name__
    if not axes - 1 <= x.dim() <= axes + 1:
        raise ShapeError(f"{op}: expected input of shape {_LAYOUTS[axes - 3]}, got {tuple(x.shape)}")
    if not x.numel() and 0 in x.shape[1 - axes :]:
        raise ShapeError(f"{op}: expected input with pixels, got {tuple(x.shape)}")


def as_batch(x: Tensor, axes: int) -> Tensor:
    """An input that was checked as a batch; integers of 16 bits become float32."""
    while x.dim() < axes + 1:
        x = x[None]
    return x.float() if x.dtype in WIDE_INTEGERS else x


def checked_images(module: Any, images: Any) -> list[Tensor]:
    """A list of images, an ImageList but in graphs; raises unless a module takes images of the type of the first one.

    Integers of 16 bits become float32.
    """
    op = type(module).__name__
    images = unchecked_list(op, "input", images)
    check_image(module, images[0])
    if images[0].dtype in WIDE_INTEGERS:
        row = PixelRow(check_list(op, "input", images))
        floats = row.split(row.of(images).float())
        return floats if is_compiling() else ImageList(op, "input", floats)
    return images


def in_type_of(y: Tensor, input: Tensor) -> Tensor:
    """A result in the type of integers of 16 bits that it was computed for; others as they are."""
    if input.dtype not in WIDE_INTEGERS:
        return y
    bounds = torch.iinfo(input.dtype)
    return y.round().clamp(bounds.min, bounds.max).to(input.dtype)


def list_in_type_of(y: Any, images: Sequence[Tensor]) -> Any:
    """The results of a list, which may be a batch, in the type of the images, as :func:`in_type_of` has it."""
    if images[0].dtype not in WIDE_INTEGERS:
        return y
    if isinstance(y, Tensor):
        return in_type_of(y, images[0])
    row = PixelRow(y)
    return row.split(in_type_of(row.of(y), images[0]))


def check_matrix(module: Any, matrix: Tensor, x: Tensor) -> None:
    """Raise unless the matrices of a pair are those of a batch of images or volumes, or one for all."""
    batch, n, op = x.shape[0], x.dim() - 1, type(module).__name__
    if matrix.shape not in ((n, n), (batch, n, n)):
        advice = "" if matrix.shape[-2:] == (n, n) else "; stack images, or pass them as a list"
        raise ShapeError(
            f"{op}: expected a pair to be images and their matrices of shape ({batch}, {n}, {n}) or ({n}, {n}), got "
            f"{tuple(matrix.shape)}{advice}"
        )
    if not matrix.is_floating_point():
        raise TypeCheckError(f"{op}: expected the matrices of a pair to be floating point, got {matrix.dtype}")


def image_of(module: Any, value: Any) -> Any:
    """An image of NumPy or PIL, or a file, as a tensor for a container of images; others as they are."""
    if isinstance(value, (Tensor, list, tuple)):
        return value
    if not (_is_foreign(value) or isinstance(value, (str, os.PathLike))):
        return value
    if any(getattr(m, "axes", 3) > 3 or hasattr(m, "data_format") for m in module.modules()):
        return value  # whose axes are those of a volume or of a video
    from kvision.image.adapter import module_image

    return module_image(module, value)


def label_of(key: DataKey, value: Any, image: Any, keepdim: bool = False) -> Any:
    """A label of NumPy or PIL as a tensor with its values; classes and others as they are. With `keepdim` masks get no batch."""
    if isinstance(value, Tensor) or not _is_foreign(value):
        return value
    if key == DataKey.MASK:
        return _mask_of(value, image, keepdim)
    return torch.as_tensor(value, device="cpu") if key in BOX_FORMATS or key == DataKey.KEYPOINTS else value


def _mask_of(value: Any, image: Any, keepdim: bool) -> Tensor:
    """Masks with the axes of images: those of a batch of images may lack their channel."""
    from kvision.image.adapter import label_image

    if _check.is_array(value) and isinstance(image, Tensor):
        if image.dim() > 4:
            return torch.as_tensor(value, device="cpu")
        if image.dim() == 4 and value.shape == (len(image), *image.shape[2:]):
            return torch.as_tensor(value, device="cpu")[:, None]
    mask = label_image(value)
    return mask[None] if mask.dim() == 3 and not keepdim else mask


def _is_foreign(value: Any) -> bool:
    return _check.is_array(value) or _check.is_pil(value)


# --- results --------------------------------------------------------------------------------------------------------


def check_output_type(module: Any, output_type: Any) -> None:
    """Raise unless results of a module may have this type."""
    if output_type != "pt":
        _check.choice(type(module).__name__, "output_type", output_type, OUTPUT_TYPES)


def as_output_type(output: Any, output_type: OutputType, key: DataKey = DataKey.INPUT) -> Any:
    """A result as a tensor, as an array, or as PIL images, which images and masks become; pairs keep their matrix."""
    if output_type == "pt":
        return output
    if isinstance(output, (list, tuple)):
        if key == DataKey.INPUT and isinstance(output, tuple):
            return (as_output_type(output[0], output_type), output[1])
        return type(output)(as_output_type(part, output_type, key) for part in output)
    if not isinstance(output, Tensor):
        return output
    from kvision.image.adapter import channels_last, to_pil

    if key in (DataKey.INPUT, DataKey.MASK):
        return channels_last(output) if output_type == "numpy" else to_pil(output)
    return output.detach().cpu().numpy() if output_type == "numpy" else output


# --- dictionaries ---------------------------------------------------------------------------------------------------


class Entries(NamedTuple):
    """The entries of a dict that follow the images, the image that decides first; the others pass through."""

    names: list[str]
    keys: list[DataKey]
    values: list[Any]
    data: Mapping[Any, Any]

    def merged(self, outputs: Sequence[Any]) -> dict[Any, Any]:
        """A new dict of what was given, in its order, with the results in place of what followed the images."""
        results = dict(zip(self.names, outputs))
        return {name: results.get(name, value) for name, value in self.data.items()}


# Names of data, in lower case.
_DATA_NAMES = {**{name.lower(): key for name, key in DataKey.__members__.items()}, "masks": DataKey.MASK}
_LONGEST_FIRST = sorted(_DATA_NAMES, key=len, reverse=True)
_NO_DATA = frozenset(("id", "ids", "name", "names", "path", "paths", "size", "sizes"))  # last words of suffixes
_OFTEN_DATA = (*_DATA_NAMES, "boxes", "bboxes", "images", "labels", "points")


def parse_names(op: str, names: Any) -> dict[str, DataKey]:
    """The data keys of further names of entries, as the argument `keys` gives them."""
    if names is None:
        return {}
    if not isinstance(names, Mapping) or not all(isinstance(name, str) for name in names):
        raise TypeCheckError(f"{op}: expected keys to be a dict from names of entries to data keys, got {names!r}")
    try:
        return {name: DataKey.get(key) for name, key in names.items()}
    except (ValueCheckError, TypeCheckError) as error:
        listed = ", ".join(repr(name.lower()) for name in DataKey.__members__)
        raise type(error)(f"{op}: expected the values of keys to be of {listed}; got {names!r}") from None


def parse_entries(
    op: str, data: Mapping[Any, Any], further: Mapping[str, DataKey], module: Any, warned: set[str]
) -> Entries:
    """Split a dict by the names of its entries.

    The name of a data key, of `further` or "masks" is data, whatever its value is. One with a suffix is data if its value is of
    that kind. Tensors that pass through although they look like data are warned about, once for each name in `warned`.
    """
    exact: dict[str, DataKey] = {}
    suffixed: dict[str, DataKey] = {}
    for name in data:
        key = further.get(name) or _exact_key(name)
        if key is not None:
            exact[name] = key
        elif (key := _key_of_suffixed(name)) is not None:
            suffixed[name] = key
    first = next((name for name, key in exact.items() if key == DataKey.INPUT), None)
    if first is None:
        images = (name for name, key in suffixed.items() if key == DataKey.INPUT)
        first = next((name for name in images if _is_image(data[name], None, module)), None)
    image = None if first is None else image_of(module, data[first])
    like = image[0] if isinstance(image, tuple) and image else image
    entries = Entries([], [], [], data)
    for name in data if first is None else (first, *(name for name in data if name != first)):
        value, key = data[name], exact.get(name)
        if key is None and name in suffixed and (name == first or _fits(suffixed[name], value, like, module)):
            key = suffixed[name]
        if key is None:
            _warn(op, name, value, like, warned)
            continue
        entries.names.append(name)
        entries.keys.append(key)
        entries.values.append(image if name == first else value)
    return entries


def _exact_key(name: Any) -> DataKey | None:
    return _DATA_NAMES.get(name.lower()) if isinstance(name, str) else None


def _key_of_suffixed(name: Any) -> DataKey | None:
    """The longest data key that a name begins with, if a suffix follows that may be one of data."""
    if not isinstance(name, str):
        return None
    name = name.lower().replace("-", "_")
    key = next((key for key in _LONGEST_FIRST if name.startswith(key + "_")), None)
    return None if key is None or name.rpartition("_")[2] in _NO_DATA else _DATA_NAMES[key]


def _fits(key: DataKey, value: Any, image: Any, module: Any) -> bool:
    """Whether the value of a suffixed name is what its data key says, next to an image."""
    if key == DataKey.INPUT:
        return _is_image(value, image, module)
    if key == DataKey.MASK:
        return _is_mask(value, image)
    batched = isinstance(image, Tensor) and image.dim() > 3
    if key == DataKey.LABEL:
        return not batched or (_has_length(value) and len(value) == len(image))
    if hasattr(value, "transform_boxes") or hasattr(value, "transform_keypoints"):
        return True
    if isinstance(value, (list, tuple)):
        return bool(value) and all(_is_label(key, part, 0) for part in value)
    return _is_label(key, value, int(batched))


def _is_label(key: DataKey, value: Any, axes: int) -> bool:
    """Whether a value has the trailing axes of boxes or points, behind `axes` and that of their number."""
    if not isinstance(value, Tensor) and not _check.is_array(value):
        return False
    value = value if isinstance(value, Tensor) else torch.as_tensor(value, device="cpu")
    if key == DataKey.KEYPOINTS:
        return value.is_floating_point() and value.dim() > 1 + axes and value.shape[-1] in (2, 3)
    trailing = (4, 2) if key == DataKey.BBOX else (4,)
    return value.dim() > len(trailing) + axes and value.shape[-len(trailing) :] == trailing


def _is_image(value: Any, image: Any, module: Any) -> bool:
    """Whether a value is an image that a container takes, with as many axes as another one, if there is one.

    A list of images is one next to another.
    """
    if isinstance(image, list):
        return is_image_list(module, value) and len(value) == len(image)
    if _is_foreign(value):
        shape = value.shape if _check.is_array(value) else (*reversed(value.size), len(value.getbands()))
        if not isinstance(image, Tensor):
            return len(shape) in (2, 3, 4)
        return shape == image.shape[-2:] if len(shape) == 2 else len(shape) == image.dim()
    if not isinstance(value, Tensor):
        return False
    if not (value.dtype.is_floating_point or value.dtype == torch.uint8):
        if value.dtype not in WIDE_INTEGERS or not module.accepts_wide_integers:
            return False
    return value.dim() == image.dim() if isinstance(image, Tensor) else value.dim() >= 2


def _is_mask(value: Any, image: Any) -> bool:
    """Whether a value has the axes of an image, or fewer of them with its size; or is a list of such tensors."""
    if isinstance(value, (list, tuple)):
        return bool(value) and all(isinstance(part, Tensor) and _has_size_of(part, image) for part in value)
    if _is_foreign(value):
        shape = value.shape if _check.is_array(value) else tuple(reversed(value.size))
        return not isinstance(image, Tensor) or image.shape[-2:] in (shape[:2], shape[-2:], shape[1:3])
    if not isinstance(value, Tensor):
        return False
    return (isinstance(image, Tensor) and value.dim() == image.dim()) or _has_size_of(value, image)


def _has_size_of(value: Tensor, image: Any) -> bool:
    return value.dim() >= 2 and (not isinstance(image, Tensor) or value.shape[-2:] == image.shape[-2:])


def _has_length(value: Any) -> bool:
    return hasattr(value, "__len__") and not (isinstance(value, Tensor) and value.dim() == 0)


def _warn(op: str, name: Any, value: Any, image: Any, warned: set[str]) -> None:
    """Warn once about a tensor that passes through although its size or its name is like that of data."""
    parts = value if isinstance(value, (list, tuple)) else [value]
    if name in warned or not parts or not all(isinstance(part, Tensor) for part in parts):
        return
    like = next((key for key in _OFTEN_DATA if isinstance(name, str) and _are_near(name.lower(), key)), None)
    has_size = isinstance(image, Tensor) and all(_has_size_of(part, image) for part in parts)
    if like is None and not has_size:
        return
    warned.add(name)
    reason = "it has the size of the image" if like is None else f"its name is like {like!r}"
    warnings.warn(
        f"{op}: {name!r} passes through unchanged, although {reason}; give its data key by keys={{{name!r}: ...}} if it "
        "follows the images",
        stacklevel=7,  # the call of the container
    )


def _are_near(a: str, b: str) -> bool:
    """Whether at most two letters are inserted, deleted or replaced between two words."""
    if abs(len(a) - len(b)) > 2:
        return False
    row = list(range(len(b) + 1))
    for i, x in enumerate(a, 1):
        before, row[0] = row[0], i
        for j, y in enumerate(b, 1):
            before, row[j] = row[j], min(row[j] + 1, row[j - 1] + 1, before + (x != y))
    return row[-1] <= 2


def parse_size(op: str, size: Any) -> tuple[int, int]:
    """Height and width: two ints, or one for both."""
    size = _check.scalars(op, "size", size.tolist() if isinstance(size, Tensor) else size)
    sides = (size, size) if isinstance(size, int) else size
    if not isinstance(sides, (tuple, list)) or len(sides) != 2 or any(type(n) is not int for n in sides):
        raise TypeCheckError(f"{op}: expected size to be an int or (height, width), got {size!r}")
    if min(sides) < 1:
        raise ValueCheckError(f"{op}: expected size of at least one pixel, got {size!r}")
    if max(sides) > _check.LARGEST_INT:
        raise ValueCheckError(f"{op}: expected size of less than 2^31, got {size!r}")
    return sides[0], sides[1]


# --- videos ---------------------------------------------------------------------------------------------------------


class VideoRankError(ShapeError, AssertionError):
    """Kornia raises an AssertionError."""


class VideoLayout(NamedTuple):
    """How videos and what belongs to their frames are a batch of frames: (B, T, ...) as (B T, ...)."""

    op: str
    data_format: str  # of videos
    sizes: tuple[int, int]  # B, T

    @classmethod
    def of(cls, op: str, data_format: str, videos: Any) -> VideoLayout:
        _check.is_tensor(op, "input", videos)
        if videos.dim() != 5:
            raise VideoRankError(f"{op}: expected input of shape ({', '.join(data_format)}), got {tuple(videos.shape)}")
        t = data_format.index("T")
        return cls(op, data_format, (videos.shape[0], videos.shape[t]))

    def frames(self, videos: Tensor) -> Tensor:
        """Videos of this layout, or masks as they are, as images."""
        return (videos.transpose(1, 2) if self.data_format == "BCTHW" else videos).flatten(0, 1)

    def videos(self, frames: Tensor) -> Tensor:
        videos = frames.unflatten(0, self.sizes)
        return videos.transpose(1, 2) if self.data_format == "BCTHW" else videos

    def labels_of_frames(self, name: str, labels: Any) -> Any:
        """Boxes, points or classes (B, T, ...) as those of images; others as they are."""
        if not isinstance(labels, Tensor):
            return labels
        if labels.shape[:2] != self.sizes:
            raise ShapeError(f"{self.op}: expected {name} of shape {(*self.sizes, '...')}, got {tuple(labels.shape)}")
        return labels.flatten(0, 1)

    def labels_of_videos(self, labels: Any) -> Any:
        return labels.unflatten(0, self.sizes) if isinstance(labels, Tensor) else labels


def as_frames(
    videos: VideoLayout | None, keys: Sequence[DataKey], inputs: Sequence[Any]
) -> tuple[list[Any], list[Callable[[Any], Any]]]:
    """Videos and their labels as images and theirs, and for each of them what turns it back."""
    if videos is None:
        return list(inputs), []
    frames: list[Any] = []
    restore: list[Callable[[Any], Any]] = []
    for key, value in zip(keys, inputs):
        if key == DataKey.INPUT or (key == DataKey.MASK and isinstance(value, Tensor) and value.dim() == 5):
            own = VideoLayout.of(videos.op, videos.data_format, value)
            frames.append(own.frames(value))
            restore.append(own.videos)
        elif key == DataKey.MASK and isinstance(value, Tensor):  # (B, T, H, W)
            frames.append(videos.labels_of_frames("mask", value)[:, None])
            restore.append(lambda moved: videos.labels_of_videos(moved[:, 0]))
        elif key == DataKey.CLASS and (not isinstance(value, Tensor) or value.shape[:2] != videos.sizes):
            frames.append(value)  # of the videos
            restore.append(lambda moved: moved)
        else:
            frames.append(videos.labels_of_frames(key.name.lower(), value))
            restore.append(videos.labels_of_videos)
    return frames, restore


def as_videos(videos: VideoLayout | None, outputs: list[Any], restore: Sequence[Callable[[Any], Any]]) -> list[Any]:
    return outputs if videos is None else [back(moved) for back, moved in zip(restore, outputs)]


def labels_as_videos(videos: VideoLayout | None, of_frames: Sequence[Any]) -> list[Any]:
    return list(of_frames) if videos is None else [videos.labels_of_videos(values) for values in of_frames]
