"""Modules that also take and return NumPy arrays, PIL images and file names, and remember their last image."""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable, Sequence
from functools import wraps
from typing import Any, get_args

import numpy as np
from torch import Tensor, nn

from kvision import _check
from kvision._choices import OutputType
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError
from kvision.core.pixels import to_uint8

__all__ = ["ImageModule", "ImageModuleMixIn", "ImageSequential"]

_OUTPUT_TYPES = get_args(OutputType)


class ImageModuleMixIn:
    """Conversions between tensors, arrays, PIL images and files, and the display of the last result.

    Arrays and PIL images are (H, W), (H, W, C) or (B, H, W, C); integers among them become floating point in [0, 1].
    In a module with parameters or buffers the tensors made of them go to their device and dtype.

    Example:
        >>> import numpy as np, kvision as K
        >>> K.core.ImageModuleMixIn().to_tensor(np.full((4, 5), 255, np.uint8)).max()
        tensor(1.)
    """

    _output_image: Any = None

    def convert_input_output(
        self,
        input_names_to_handle: Sequence[str] | None = None,
        output_type: OutputType = "pt",
        *,
        cache_output: bool = False,
    ) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
        """A decorator for functions of tensors.

        Args:
            input_names_to_handle: the parameters to convert; by default every array and PIL image, and a string where
                it is the first argument.
            output_type: what results become: "pt" (tensor), "numpy" or "pil".
            cache_output: keep the result for `show` and `save`.

        Raises:
            ValueCheckError: another `output_type`.
        """
        _check.choice("convert_input_output", "output_type", output_type, _OUTPUT_TYPES)

        def decorate(func: Callable[..., Any]) -> Callable[..., Any]:
            @wraps(func)
            def wrapper(*args: Any, **kwargs: Any) -> Any:
                args, kwargs = self._admit_all(func, args, kwargs, input_names_to_handle)
                return self._release(func(*args, **kwargs), output_type, cache_output)

            return wrapper

        return decorate

    def to_tensor(self, x: Any) -> Tensor:
        """A file name, array or PIL image as (C, H, W) or (B, C, H, W); a tensor as it is.

        Raises:
            TypeCheckError: `x` is none of these.
            OSError, ImageError: the file cannot be read.
        """
        from kvision.image.adapter import module_image

        return x if isinstance(x, Tensor) else module_image(self, x)

    def to_numpy(self, x: Any) -> np.ndarray[Any, Any]:
        """A tensor as an array with the channels last (where it has three or four axes); an array as it is.

        Raises:
            TypeCheckError: `x` is neither of these, nor a PIL image.
        """
        from kvision.image.adapter import channels_last

        if isinstance(x, Tensor):
            return channels_last(x)
        if isinstance(x, np.ndarray) or _check.is_pil(x):
            return np.asarray(x)
        raise TypeCheckError(
            f"to_numpy: expected x to be a Tensor, an array or a PIL image, got {type(x).__name__}", actual_type=type(x)
        )

    def to_pil(self, x: Any) -> Any:
        """Images as :func:`kvision.to_pil` gives them.

        Raises:
            TypeCheckError, ShapeError, ValueCheckError: as there.
        """
        from kvision.image import to_pil

        return to_pil(x)

    def show(self, n_row: int | None = None, backend: str = "pil", display: bool = True) -> Any:
        """The last result as a PIL image, a batch as a grid; displayed, or returned where `display` is False.

        Raises:
            ValueCheckError: there is no result yet, or another `backend` than "pil".
            ShapeError: the result is no image.
        """
        _check.choice("show", "backend", backend, ("pil",))
        picture = self.to_pil(self._last_image("show", n_row))
        return picture.show() if display else picture

    def save(self, name: str | os.PathLike[str] | None = None, n_row: int | None = None) -> None:
        """Write the last result, a batch as a grid, to the file `name`, by default "kvision.jpg".

        Raises:
            ValueCheckError: there is no result yet.
            ShapeError: the result is no image.
        """
        from kvision.io import write_image

        write_image("kvision.jpg" if name is None else name, to_uint8(self._last_image("save", n_row)))

    def _last_image(self, op: str, n_row: int | None) -> Tensor:
        from kvision.image import make_grid

        output = self._output_image
        if isinstance(output, tuple) and len(output) == 1:
            (output,) = output
        if output is None:
            raise ValueCheckError(f"{op}: expected a result to show, got none: call the module first")
        if not isinstance(output, Tensor) or output.dim() not in (3, 4):
            raise ShapeError(f"{op}: expected the last result to be (C, H, W) or (B, C, H, W)")
        return make_grid(output, n_row) if output.dim() == 4 else output

    def _admit_all(
        self, func: Callable[..., Any], args: tuple[Any, ...], kwargs: dict[str, Any], names: Sequence[str] | None
    ) -> tuple[tuple[Any, ...], dict[str, Any]]:
        """The arguments of `func` with those called `names` as tensors, or by default those that look like images."""
        if names is None:
            args = tuple(self._admit(arg, i == 0) for i, arg in enumerate(args))
            return args, {name: self._admit(arg, False) for name, arg in kwargs.items()}
        bound = inspect.signature(func).bind(*args, **kwargs)
        for name in bound.arguments.keys() & set(names):
            bound.arguments[name] = self.to_tensor(bound.arguments[name])
        return bound.args, bound.kwargs

    def _admit(self, arg: Any, first: bool) -> Any:
        """`arg` as a tensor if it looks like an image; only the first argument may be the name of a file."""
        is_image = isinstance(arg, np.ndarray) or _check.is_pil(arg) or (first and isinstance(arg, (str, os.PathLike)))
        return self.to_tensor(arg) if is_image else arg

    def _release(self, output: Any, output_type: OutputType, cache_output: bool) -> Any:
        if cache_output:
            self._output_image = _map_tensors(Tensor.detach, output)
        if output_type == "pt":
            return output
        return _map_tensors(self.to_numpy if output_type == "numpy" else self.to_pil, output)


class _ImageCalls(ImageModuleMixIn):
    """The call of `ImageModule` and `ImageSequential`, which stands in front of the one of their torch class."""

    _disable_features = False
    _takes_batches = False  # an image that is converted is a batch of one on the way

    @property
    def disable_features(self) -> bool:
        """True makes a call the plain call of a torch module: nothing is converted, and no result is kept."""
        return self._disable_features

    @disable_features.setter
    def disable_features(self, value: bool = True) -> None:
        self._disable_features = value
        if value:
            self._output_image = None

    def __call__(
        self,
        *inputs: Any,
        input_names_to_handle: Sequence[str] | None = None,
        output_type: OutputType = "pt",
        **kwargs: Any,
    ) -> Any:
        call = super().__call__  # type: ignore[misc]  # nn.Module's
        if self._disable_features:
            return call(*inputs, **kwargs)
        _check.choice(type(self).__name__, "output_type", output_type, _OUTPUT_TYPES)
        forward = self.forward  # type: ignore[attr-defined]  # nn.Module's
        admitted, kwargs = self._admit_all(forward, inputs, kwargs, input_names_to_handle)
        if self._takes_batches and admitted and admitted[0] is not inputs[0] and admitted[0].dim() == 3:
            output = _map_tensors(lambda y: y[0], call(admitted[0][None], *admitted[1:], **kwargs))
        else:
            output = call(*admitted, **kwargs)
        return self._release(output, output_type, cache_output=True)

    def __getstate__(self) -> dict[str, Any]:
        return {k: v for k, v in self.__dict__.items() if k != "_output_image"}


class ImageModule(_ImageCalls, nn.Module):
    """An `nn.Module` from image to image that also takes arrays, PIL images and file names.

    A call takes two more keywords: `output_type`, "pt", "numpy" or "pil", and `input_names_to_handle`, the parameters
    of `forward` to convert (all that look like images by default). The last result stays for `show` and `save`.

    Example:
        >>> import numpy as np, kvision as K
        >>> class Invert(K.core.ImageModule):
        ...     def forward(self, x):
        ...         return 1 - x
        >>> Invert()(np.zeros((4, 5, 3), np.uint8), output_type="numpy").shape
        (4, 5, 3)
    """


class ImageSequential(_ImageCalls, nn.Sequential):
    """An `nn.Sequential` from image to image, with the conversions of `ImageModule`.

    An array, PIL image or file goes through the modules as a batch of one, as filters take it, and comes out without it.

    Example:
        >>> import torch, kvision as K
        >>> K.core.ImageSequential(torch.nn.ReLU())(torch.rand(3, 4, 5), output_type="pil").size
        (5, 4)
    """

    _takes_batches = True


def _map_tensors(f: Callable[[Tensor], Any], output: Any) -> Any:
    if isinstance(output, Tensor):
        return f(output)
    if type(output) in (list, tuple):
        return type(output)(_map_tensors(f, item) for item in output)
    return output
