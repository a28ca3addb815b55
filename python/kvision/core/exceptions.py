"""The exceptions kvision raises. Each also is the built-in a caller would expect, so `except ValueError` works too.

Exception.__new__ keeps the message. Calls of Exception.__init__ are left out: dynamo cannot trace them, and would report
that instead of the message where torch.compile(fullgraph=True) meets a wrong argument.
"""

from __future__ import annotations

from typing import Any

__all__ = ["BaseError", "DeviceError", "ImageError", "ShapeError", "TypeCheckError", "ValueCheckError"]


class BaseError(Exception):
    """Root of the library's exceptions.

    Example:
        >>> from kvision.core.exceptions import BaseError, ShapeError
        >>> issubclass(ShapeError, BaseError) and issubclass(ShapeError, ValueError)
        True
    """


class ShapeError(BaseError, ValueError):
    """A tensor has the wrong number of axes or the wrong sizes.

    Example:
        >>> ShapeError("sobel: expected input of shape (B, C, H, W), got (3, 4)", actual_shape=(3, 4)).actual_shape
        (3, 4)
    """

    def __init__(self, message: str, *, actual_shape: Any = None, expected_shape: Any = None) -> None:
        self.actual_shape = actual_shape
        self.expected_shape = expected_shape


class TypeCheckError(BaseError, TypeError):
    """An argument is of the wrong type: a list instead of a tensor, an integer image where floats are needed.

    Example:
        >>> TypeCheckError("sobel: expected input to be a Tensor, got list", actual_type=list).actual_type
        <class 'list'>
    """

    def __init__(self, message: str, *, actual_type: Any = None, expected_type: Any = None) -> None:
        self.actual_type = actual_type
        self.expected_type = expected_type


class ValueCheckError(BaseError, ValueError):
    """An argument has a value outside its range or its list of choices.

    Example:
        >>> ValueCheckError("median_blur: expected kernel_size to be odd", actual_value=4).actual_value
        4
    """

    def __init__(self, message: str, *, actual_value: Any = None, expected_range: Any = None) -> None:
        self.actual_value = actual_value
        self.expected_range = expected_range


class DeviceError(BaseError, ValueError):
    """Tensors that must be on one device are on different ones.

    Example:
        >>> DeviceError("filter2d: kernel is elsewhere", actual_devices=["cpu", "cuda:0"]).actual_devices
        ['cpu', 'cuda:0']
    """

    def __init__(self, message: str, *, actual_devices: Any = None, expected_device: Any = None) -> None:
        self.actual_devices = actual_devices
        self.expected_device = expected_device


class ImageError(BaseError, ValueError):
    """A tensor is not the kind of image an operator needs, say a wrong number of channels.

    Example:
        >>> issubclass(ImageError, ValueError)
        True
    """
