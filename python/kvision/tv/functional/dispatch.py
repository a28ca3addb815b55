"""From a kernel of tensors to v2's function: the same for images, videos, masks, PIL images, boxes and key points."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np
import torch
from torch import Tensor

from kvision import _constants
from kvision._tv_tensors import TV_TENSORS, kind_of, plain, wrap
from kvision.core.exceptions import TypeCheckError
from kvision.tv.inputs import IMAGES, LABELS, pil_to_tensor, to_pil_image

Function = TypeVar("Function", bound=Callable[..., Any])  # whose arguments editors show
# Modes of PIL images: bits and indices of a palette, which cannot be interpolated, and those with alpha.
_UNMIXED, _WITH_ALPHA = ("1", "P"), ("LA", "RGBA")
_registered: dict[str, dict[type, Callable[..., Any]]] = {}


def functional(
    *,
    moves: bool = False,
    keeps_alpha: bool = False,
    pil: Callable[..., Any] | None = None,
    mask: Callable[..., Any] | str | None = None,
    each: Callable[[Any, list[dict[str, Any]]], Any] | None = None,
    steps: Callable[..., Sequence[Any]] | None = None,
) -> Callable[[Function], Function]:
    """Make a public function of a kernel, which takes a tensor (*, C, H, W) and v2's arguments.

    `moves` says that masks, boxes and key points follow; `mask` is the kernel of masks where it is another, or "nearest" for that
    interpolation. `keeps_alpha` says that alpha of PIL images stays. `pil` is a function of PIL images with the same values;
    NotImplemented says that they differ for some arguments.
    `each` is the kernel of images (B, C, H, W) with arguments of each; NotImplemented says that it has none for some. `steps` are
    those of a color program that a function of bytes is: names with their parameters, by arrays (B,) of the arguments.
    Boxes and key points are torchvision's: their classes exist only where it is loaded, and its functions are public.
    """

    def decorate(kernel: Function) -> Function:
        name = kernel.__name__
        parameters = tuple(inspect.signature(kernel).parameters.values())[1:]
        names = tuple(p.name for p in parameters)
        moves_pixels = moves or name in ("five_crop", "ten_crop")

        @functools.wraps(kernel)
        def call(inpt: Any, *args: Any, **kwargs: Any) -> Any:
            args, kwargs = args and _as_numbers(args), {key: _as_numbers(value) for key, value in kwargs.items()}
            kind = kind_of(inpt)
            if kind == "tensor":
                return kernel(inpt, *args, **kwargs)
            if kind in ("image", "video"):
                return wrap(kernel(plain(inpt), *args, **kwargs), inpt)
            if kind == "pil":
                output = pil(inpt, *args, **kwargs) if pil is not None else NotImplemented
                if output is not NotImplemented:
                    return output
                if not moves_pixels and inpt.mode in (*_UNMIXED, "I;16"):
                    raise TypeCheckError(f"{name}: expected a PIL image of 8-bit or float levels, got mode {inpt.mode}")
                if inpt.mode in _UNMIXED and "interpolation" in names:
                    args, kwargs = (), {**kwargs, **dict(zip(names, args)), "interpolation": "nearest"}
                return _on_pil(kernel, keeps_alpha, inpt, *args, **kwargs)
            if kind == "mask" and moves:
                kwargs.update(zip(names, args))
                if mask == "nearest":
                    kwargs["interpolation"] = mask
                return wrap(_on_mask(mask if callable(mask) else kernel, plain(inpt), kwargs), inpt)
            if kind in LABELS and moves:
                from torchvision.transforms.v2 import functional as v2

                return getattr(v2, name)(inpt, *args, **kwargs)
            if own := _own_kernel(name, inpt):
                return own(inpt, *args, **kwargs)
            raise TypeCheckError(
                f"{name}: expected inpt to be a Tensor, tv_tensor or PIL image, got {type(inpt).__name__}"
            )

        call.kinds = IMAGES | {"mask"} | LABELS if moves else IMAGES  # type: ignore[attr-defined]
        call.steps = steps  # type: ignore[attr-defined]
        call.of_each = functools.partial(_of_each, call, each, mask, parameters)  # type: ignore[attr-defined]
        return call  # type: ignore[return-value]  # takes what the kernel takes

    return decorate


def _as_numbers(value: Any) -> Any:
    """Numbers of NumPy or torch, and lists of them, as Python's, which v2's arguments are."""
    if type(value) in (int, float, str):
        return value
    if type(value) in (list, tuple):
        return type(value)([_as_numbers(v) for v in value])
    is_number = isinstance(value, np.generic) or (
        isinstance(value, Tensor) and value.dim() == 0 and not value.requires_grad
    )
    return value.item() if is_number else value


def _of_each(call: Any, each: Any, mask: Any, parameters: Any, x: Any, arguments: list[dict[str, Any]]) -> Any:
    """A function of a batch of images, or of their masks, by arguments of each."""
    first = arguments[0]
    if not any(isinstance(value, Tensor) for value in first.values()) and all(own == first for own in arguments):
        return call(x, **first)
    kind = kind_of(x)
    is_image = kind in ("tensor", "image") and plain(x).dim() == 4
    if each is not None and (is_image or (kind == "mask" and not callable(mask))):
        rows = [
            {**{p.name: p.default for p in parameters}, **first},
            *arguments[1:],
        ]  # what all share is read from the first
        if kind == "mask" and mask is not None:
            rows[0]["interpolation"] = mask
        batch = plain(x)
        output = each(batch if batch.dim() == 4 else batch[:, None], rows)
        if output is not NotImplemented:
            return wrap(output if batch.dim() == 4 else output[:, 0], x)
    outputs = [call(wrap(part, x), **own) for part, own in zip(plain(x), arguments)]
    return wrap(torch.stack([plain(y) for y in outputs]), x)


def on_device(values: Any, device: torch.device) -> Tensor:
    """Numbers on a device, without waiting for it."""
    return _constants.on_device(torch.as_tensor(values, device="cpu"), device)


def takes(function: Callable[..., Any], x: Any) -> bool:
    """Whether `function` changes inputs such as `x`; transforms pass others on."""
    if (kind := kind_of(x)) == "tensor":
        return True
    kinds = getattr(function, "kinds", None)
    if kinds is None or kind in kinds:
        return True
    return kind in TV_TENSORS and _own_kernel(function.__name__, x) is not None


def register_kernel(functional: Callable[..., Any] | str, tv_tensor_cls: type) -> Callable[[Any], Any]:
    """Register what a function does to a tv_tensor class of your own, as v2's.

    Args:
        functional: a function of this module, or its name.
        tv_tensor_cls: a subclass of torchvision.tv_tensors.TVTensor.

    Returns:
        A decorator of a function of an input and the arguments of `functional`.

    Example:
        >>> import torch, kvision.tv.functional as F
        >>> class Points(torch.Tensor): pass
        >>> @F.register_kernel("horizontal_flip", Points)
        ... def flip_points(points):
        ...     return -points
    """
    name = functional if isinstance(functional, str) else functional.__name__

    def decorate(kernel: Any) -> Any:
        _registered.setdefault(name, {})[tv_tensor_cls] = kernel
        return kernel

    return decorate


def _own_kernel(name: str, x: Any) -> Callable[..., Any] | None:
    kernels = _registered.get(name, {})
    return next((kernels[cls] for cls in type(x).__mro__ if cls in kernels), None)


def _on_mask(kernel: Callable[..., Any], x: Any, kwargs: dict[str, Any]) -> Any:
    if x.dim() > 2:
        return kernel(x, **kwargs)
    return kernel(x[None], **kwargs)[0]


def _on_pil(kernel: Callable[..., Any], keeps_alpha: bool, image: Any, *args: Any, **kwargs: Any) -> Any:
    x = pil_to_tensor(image)
    if x.dtype == torch.uint16:
        x = x.int()  # torch flips no uint16 before 2.14
    if keeps_alpha and image.mode in _WITH_ALPHA:
        return _as_pil(torch.cat([kernel(x[:-1], *args, **kwargs), x[-1:]]), image)
    output = kernel(x, *args, **kwargs)
    return tuple(_as_pil(x, image) for x in output) if isinstance(output, tuple) else _as_pil(output, image)


def _as_pil(x: Tensor, source: Any) -> Any:
    """A PIL image of the mode of another one, unless the number of channels has changed."""
    x = x.to(torch.uint16) if source.mode == "I;16" else x
    if source.mode != "P":
        return to_pil_image(x, source.mode if x.shape[-3] == len(source.getbands()) else None)
    image, colors = to_pil_image(x), source.palette.mode
    image.putpalette(source.getpalette(colors), colors)
    image.info = dict(source.info)
    return image
