"""Enumerations that name the choices of several modules, and pi as a tensor."""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from typing import Any, Literal, TypeAlias

import torch
from typing_extensions import Self

from kvision.core.exceptions import TypeCheckError, ValueCheckError

__all__ = ["BorderType", "DType", "DataKey", "Resample", "SamplePadding", "pi"]

pi = torch.tensor(3.14159265358979323846)


class _UnknownNameError(ValueCheckError, KeyError):
    """A name that no member has: a ValueError as for an unknown value, a KeyError as for a failed `Enum[name]`."""

    __str__ = Exception.__str__  # KeyError's would put the message in quotes


class _NamedEnum(Enum):
    """An Enum whose members are also found by name in any case, and by value."""

    @classmethod
    def get(cls, value: Any) -> Self:
        """The member with this name (in any case) or this value; a member is returned as it is.

        Raises:
            TypeCheckError: `value` is not a str, int or member.
            ValueCheckError: no member has that name or value; for a name it is also a KeyError.
        """
        if isinstance(value, cls):
            return value
        if isinstance(value, str):
            # Not in __members__: torch.compile of torch 2.11 cannot read a property of a class.
            if value.upper() in cls._member_map_:
                return cls[value.upper()]
            error: type[ValueCheckError] = _UnknownNameError
        elif isinstance(value, int) and not isinstance(value, bool):
            if value in cls._value2member_map_:
                return cls(value)
            error = ValueCheckError
        else:
            raise TypeCheckError(
                f"{cls.__name__}.get: expected value to be a str, an int or a {cls.__name__}, "
                f"got {type(value).__name__}",
                actual_type=type(value),
            )
        listed = ", ".join(f"{name.lower()} ({member.value})" for name, member in cls.__members__.items())
        raise error(f"{cls.__name__}.get: value must be one of {listed}; got {value!r}", actual_value=value)


class Resample(_NamedEnum):
    """How an image is interpolated.

    Example:
        >>> import kvision as K
        >>> K.constants.Resample.get("bilinear").name
        'BILINEAR'
        >>> K.constants.Resample.get(2).name
        'BICUBIC'
    """

    NEAREST = 0
    BILINEAR = 1
    BICUBIC = 2


# What `get` takes, for type checkers and editors: names in lower and upper case, numbers and members.
ResampleName: TypeAlias = Literal["nearest", "bilinear", "bicubic", "NEAREST", "BILINEAR", "BICUBIC"]
AnyResample: TypeAlias = ResampleName | int | Resample


class BorderType(_NamedEnum):
    """Where a filter takes the pixels outside the image from.

    Example:
        >>> import kvision as K
        >>> K.constants.BorderType.get("Reflect").value
        1
    """

    CONSTANT = 0
    REFLECT = 1
    REPLICATE = 2
    CIRCULAR = 3


BorderTypeName: TypeAlias = Literal[
    "constant", "reflect", "replicate", "circular", "CONSTANT", "REFLECT", "REPLICATE", "CIRCULAR"
]
AnyBorderType: TypeAlias = BorderTypeName | int | BorderType


class SamplePadding(_NamedEnum):
    """What a warp reads outside the image; FILL is a constant color.

    Example:
        >>> import kvision as K
        >>> [padding.name for padding in K.constants.SamplePadding]
        ['ZEROS', 'BORDER', 'REFLECTION', 'FILL']
    """

    ZEROS = 0
    BORDER = 1
    REFLECTION = 2
    FILL = 3


SamplePaddingName: TypeAlias = Literal["zeros", "border", "reflection", "fill", "ZEROS", "BORDER", "REFLECTION", "FILL"]
AnySamplePadding: TypeAlias = SamplePaddingName | int | SamplePadding


class DType(_NamedEnum):
    """Element types by number, for code that keeps a type in a tensor.

    Example:
        >>> import torch, kvision as K
        >>> K.constants.DType.get(torch.float16).value
        1
        >>> K.constants.DType.to_torch("bfloat16")
        torch.bfloat16
    """

    INT64 = 0
    FLOAT16 = 1
    FLOAT32 = 2
    FLOAT64 = 3
    BFLOAT16 = 4

    @classmethod
    def get(cls, value: Any) -> Self:
        """The member for a name, a number, a `torch.dtype`, or a tensor that holds the number."""
        if isinstance(value, torch.dtype):
            value = str(value).removeprefix("torch.")
        elif isinstance(value, torch.Tensor):
            value = int(value)
        return super().get(value)

    @classmethod
    def to_torch(cls, value: Any) -> torch.dtype:
        """The `torch.dtype` that `get(value)` stands for."""
        dtype = getattr(torch, cls.get(value).name.lower())
        assert isinstance(dtype, torch.dtype)
        return dtype


class DataKey(_NamedEnum):
    """What an input of an augmentation pipeline holds. INPUT is IMAGE, CLASS is LABEL.

    Example:
        >>> import kvision as K
        >>> K.constants.DataKey.get("input") is K.constants.DataKey.IMAGE
        True
    """

    IMAGE = 0
    INPUT = 0
    MASK = 1
    BBOX = 2
    BBOX_XYXY = 3
    BBOX_XYWH = 4
    KEYPOINTS = 5
    LABEL = 6
    CLASS = 6
    BBOX_XYXY_PLUS = 7


DataKeyName: TypeAlias = Literal[
    "image", "input", "mask", "bbox", "bbox_xyxy", "bbox_xywh", "bbox_xyxy_plus", "keypoints", "label", "class",
    "IMAGE", "INPUT", "MASK", "BBOX", "BBOX_XYXY", "BBOX_XYWH", "BBOX_XYXY_PLUS", "KEYPOINTS", "LABEL", "CLASS",
]  # fmt: skip
AnyDataKey: TypeAlias = DataKeyName | int | DataKey
# A list that is a variable of its own has the type list[str], whatever its words are.
DataKeys: TypeAlias = Sequence[AnyDataKey] | Sequence[str]
