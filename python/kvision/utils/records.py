"""Dataclasses to dictionaries and back, for configurations kept in files."""

from __future__ import annotations

import dataclasses
from types import UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

from kvision.core.exceptions import TypeCheckError

__all__ = ["dataclass_to_dict", "dict_to_dataclass"]

_Record = TypeVar("_Record")


def dataclass_to_dict(obj: Any) -> Any:
    """Convert a dataclass to a dict of its fields.

    Args:
        obj: a dataclass; or a list, tuple, dict or dataclass that contains some, at any depth.

    Returns:
        The same structure with a dict for every dataclass. Values of fields are not copied.

    Example:
        >>> import kvision as K
        >>> K.utils.dataclass_to_dict([K.image.ImageSize(3, 4)])
        [{'height': 3, 'width': 4}]
    """
    if dataclasses.is_dataclass(obj) and not isinstance(obj, type):
        return {field.name: dataclass_to_dict(getattr(obj, field.name)) for field in dataclasses.fields(obj)}
    if isinstance(obj, dict):
        return {key: dataclass_to_dict(value) for key, value in obj.items()}
    if isinstance(obj, (list, tuple)):
        items = [dataclass_to_dict(item) for item in obj]
        return type(obj)(*items) if hasattr(obj, "_fields") else type(obj)(items)
    return obj


def dict_to_dataclass(dict_obj: dict[str, Any], dataclass_type: type[_Record]) -> _Record:
    """Make a dataclass from a dict of its fields.

    Args:
        dict_obj: the fields by name. Where a field is annotated as a dataclass, or as a list, tuple or dict of them, its
            dicts are converted as well.
        dataclass_type: the class to make.

    Returns:
        An instance of `dataclass_type`.

    Raises:
        TypeCheckError: `dict_obj` is not a dict, or `dataclass_type` no dataclass.
        TypeError: a field is missing or unknown.

    Example:
        >>> import kvision as K
        >>> K.utils.dict_to_dataclass({"height": 3, "width": 4}, K.image.ImageSize)
        ImageSize(height=3, width=4)
    """
    if not isinstance(dict_obj, dict):
        raise TypeCheckError(f"dict_to_dataclass: expected dict_obj to be a dict, got {type(dict_obj).__name__}")
    if not (isinstance(dataclass_type, type) and dataclasses.is_dataclass(dataclass_type)):
        raise TypeCheckError(f"dict_to_dataclass: expected dataclass_type to be a dataclass, got {dataclass_type!r}")
    hints = get_type_hints(dataclass_type)
    values = {name: _value(value, hints.get(name)) for name, value in dict_obj.items()}
    return dataclass_type(**values)


def _value(value: Any, hint: Any) -> Any:
    """`value` for a field annotated `hint`, with the dicts that stand for dataclasses converted."""
    if isinstance(value, dict) and dataclasses.is_dataclass(hint):
        return dict_to_dataclass(value, hint)  # type: ignore[arg-type]  # an annotation is a class
    inner = [arg for arg in get_args(hint) if arg not in (type(None), Ellipsis)]
    if get_origin(hint) in (Union, UnionType):
        return _value(value, inner[0]) if len(inner) == 1 else value  # of several the dict could be any
    if type(value) in (list, tuple) and len(inner) == 1:
        return type(value)(_value(item, inner[0]) for item in value)
    if type(value) is dict and len(inner) == 2:
        return {key: _value(item, inner[1]) for key, item in value.items()}
    return value
