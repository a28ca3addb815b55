"""What an input is by torchvision's classes.

torchvision is not imported: objects of its classes exist only where it is loaded.
"""

from __future__ import annotations

import sys
from typing import Any

from torch import Tensor

TV_TENSORS = frozenset({"image", "video", "mask", "boxes", "points", "tv_tensor"})

_TV_CLASSES = {
    "Image": "image",
    "Video": "video",
    "Mask": "mask",
    "BoundingBoxes": "boxes",
    "KeyPoints": "points",
    "TVTensor": "tv_tensor",
}
_kinds: dict[type, str] = {Tensor: "tensor"}


def kind_of(x: Any) -> str:
    """One of "tensor" (a plain one), "pil", "array", "other" and the kinds of tv_tensors."""
    kind = _kinds.get(type(x))
    if kind is None:
        kind = _kinds[type(x)] = _classify(type(x))
    return kind


def _classify(cls: type) -> str:
    if issubclass(cls, Tensor):
        for name, kind in _TV_CLASSES.items():
            tv_class = getattr(sys.modules.get("torchvision.tv_tensors"), name, None)
            if tv_class is not None and issubclass(cls, tv_class):
                return kind
        return "tensor"
    for module, name, kind in (("PIL.Image", "Image", "pil"), ("numpy", "ndarray", "array")):
        if module in sys.modules and issubclass(cls, getattr(sys.modules[module], name)):
            return kind
    return "other"


def wrap(output: Any, like: Any, **changed: Any) -> Any:
    """A plain tensor as a tv_tensor of the class of `like`, with its format and canvas but for what is `changed`.

    Of a list each; a batch that a list became is of the class of its first image.
    """
    if isinstance(like, list):
        return [wrap(*pair) for pair in zip(output, like)] if isinstance(output, list) else wrap(output, like[0])
    kind = kind_of(like)
    if kind not in TV_TENSORS:
        return output
    if isinstance(output, (tuple, list)):
        return type(output)(wrap(x, like) for x in output)
    if kind in ("image", "video", "mask"):
        return output.as_subclass(type(like))
    return sys.modules["torchvision.tv_tensors"].wrap(output, like=like, **changed)


def plain(x: Tensor) -> Tensor:
    return x if type(x) is Tensor else x.as_subclass(Tensor)
