"""Pipelines as text, and in files of torch.save: only classes of this package are ever made from either."""

from __future__ import annotations

import inspect
import json
import math
import re
import sys
from collections.abc import Callable, Iterator
from enum import Enum
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from kvision import _check, constants
from kvision._version import __version__
from kvision.augmentation.engine import KeepsArguments, restored_format
from kvision.augmentation.keys import restored_generator
from kvision.core.exceptions import BaseError, TypeCheckError, ValueCheckError

__all__ = ["from_json", "to_json"]

_PACKAGE = "kvision.augmentation"
_DTYPES = {str(x).removeprefix("torch."): x for x in vars(torch).values() if isinstance(x, torch.dtype)}
_ENUMS = {x.__name__: x for x in vars(constants).values() if isinstance(x, type) and issubclass(x, Enum)}
# What a module has that is no setting: torch's own attributes, plans, and what the last call did.
_NO_SETTINGS = {*vars(nn.Module()), "_arguments", "_plans", "_execution", "_record"}


def to_json(pipeline: nn.Module, indent: int | None = None) -> str:
    """An augmentation or a container as JSON: names of classes, and the arguments they were constructed with.

    :func:`from_json` makes the pipeline again, with the same results for the same `seed`. State that calls or training leave
    is no part of the text, nor is :meth:`~torch.nn.Module.eval`; torch.save keeps both.

    Args:
        pipeline: an augmentation, a policy, or a container of those, of any depth.
        indent: columns by which each level is indented; default: all in one line.

    Returns:
        The text.

    Raises:
        TypeError: a part is of a class that is not kvision's, or one of the operations with learned values; an argument is a
            function, a generator, a learned range or another object that JSON does not have.
        ValueError: a setting was changed after construction, so that the arguments do not give it.

    Example:
        >>> import kvision.augmentation as A
        >>> A.to_json(A.RandomHorizontalFlip(p=0.25))  # doctest: +ELLIPSIS
        '{"kvision": ..., "pipeline": {"class": "RandomHorizontalFlip", "arguments": {"p": 0.25}}}'
    """
    if indent is not None:
        (indent,) = _check.ints("to_json", "indent", indent, 1, minimum=0)
    described = _described(pipeline)
    _check_unchanged(pipeline, _made(described))
    return json.dumps({"kvision": __version__, "pipeline": described}, indent=indent, allow_nan=False)


def from_json(text: str | bytes) -> nn.Module:
    """The pipeline that :func:`to_json` described. The text chooses classes of `kvision.augmentation`, and runs nothing else.

    Args:
        text: what :func:`to_json` gave.

    Returns:
        The augmentation or container, on the CPU, in training mode.

    Raises:
        TypeError: `text` is no text; a class does not have an argument, or lacks one.
        ValueError: `text` is no JSON, does not describe a pipeline, is of a later version of kvision, or names a class that
            kvision does not have; an argument has a value that the class refuses.

    Example:
        >>> import kvision.augmentation as A
        >>> A.from_json(A.to_json(A.RandomRotation(30.0, p=0.5))).p
        0.5
    """
    if not isinstance(text, (str, bytes)):
        raise TypeCheckError(f"from_json: expected text to be a str, got {type(text).__name__}", actual_type=type(text))
    try:
        content = json.loads(text)
        if not isinstance(content, dict) or set(content) != {"kvision", "pipeline"}:
            raise ValueCheckError(
                "from_json: expected text to be what to_json gave: an object of 'kvision' and 'pipeline'"
            )
        _check_version(content["kvision"])
        return _made(content["pipeline"])
    except json.JSONDecodeError as error:
        raise ValueCheckError(f"from_json: expected text to be JSON: {error}") from error
    except UnicodeDecodeError as error:
        raise ValueCheckError(f"from_json: expected text to be UTF-8: {error}") from error
    except RecursionError as error:
        raise ValueCheckError("from_json: expected containers of fewer levels") from error


def allow_loading() -> None:
    """Let torch.load with weights_only=True make the classes of this package, whose constructors open no files."""
    modules = [module for name, module in sys.modules.items() if f"{name}.".startswith(f"{_PACKAGE}.")]
    own = {x for module in modules for x in vars(module).values() if isinstance(x, type) and _is_own(x)}
    torch.serialization.add_safe_globals([*own, *_ENUMS.values(), nn.ModuleList, restored_format, restored_generator])


def _is_own(cls: type) -> bool:
    return f"{cls.__module__}.".startswith(f"{_PACKAGE}.")


def _classes() -> dict[str, type]:
    """The classes that a text may name."""

    def below(cls: type) -> Iterator[type]:
        children: list[type] = cls.__subclasses__()
        for child in children:
            yield child
            yield from below(child)

    return {cls.__name__: cls for cls in below(KeepsArguments) if _is_own(cls) and not cls.__name__.startswith("_")}


# --- to text --------------------------------------------------------------------------------------------------------


def _described(module: Any) -> dict[str, Any]:
    cls = type(module)
    if _classes().get(cls.__name__) is not cls:
        raise TypeCheckError(
            f"to_json: expected augmentations and containers of kvision, got {cls.__name__}: torch.save keeps other modules",
            actual_type=cls,
        )
    args, kwargs = module._arguments
    bound = inspect.signature(cls.__init__).bind_partial(module, *args, **kwargs)
    kinds = {name: parameter.kind for name, parameter in bound.signature.parameters.items()}
    arguments: dict[str, Any] = {}
    for name, value in list(bound.arguments.items())[1:]:  # the first one is self
        if kinds[name] is not inspect.Parameter.VAR_POSITIONAL:
            arguments.update(value if kinds[name] is inspect.Parameter.VAR_KEYWORD else {name: value})
    described: dict[str, Any] = {"class": cls.__name__}
    if arguments:
        described["arguments"] = {
            name: _encoded(value, f"{cls.__name__}({name}=)") for name, value in arguments.items()
        }
    if inspect.Parameter.VAR_POSITIONAL in kinds.values():
        described["children"] = [_described(child) for child in module.children()]  # as they are, also after append
    return described


def _encoded(value: Any, where: str) -> Any:
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, Enum) and _ENUMS.get(type(value).__name__) is type(value):
        return {"enum": [type(value).__name__, value.name]}
    if isinstance(value, float) and not math.isfinite(value):
        return {"float": str(value)}
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, (list, tuple, range)):
        return [_encoded(item, where) for item in value]
    if isinstance(value, dict):
        return {"dict": [[_encoded(key, where), _encoded(item, where)] for key, item in value.items()]}
    if isinstance(value, torch.dtype):
        return {"dtype": str(value).removeprefix("torch.")}
    if isinstance(value, torch.memory_format):
        return {"memory_format": str(value).removeprefix("torch.")}
    if isinstance(value, Tensor) and not value.requires_grad:
        return {"tensor": [_encoded(value.tolist(), where), str(value.dtype).removeprefix("torch.")]}
    learned = "learned " if isinstance(value, Tensor) else ""
    raise TypeCheckError(
        f"to_json: expected {where} to be a number, text, tensor, type or container of those, got {learned}"
        f"{type(value).__name__}: torch.save keeps other arguments",
        actual_type=type(value),
    )


def _check_unchanged(pipeline: nn.Module, again: nn.Module) -> None:
    """Raise unless the arguments give the settings that the pipeline has."""
    parts, others = dict(pipeline.named_modules()), dict(again.named_modules())
    if list(parts) != list(others):
        raise ValueCheckError(f"to_json: expected the parts that the arguments give, {list(others)}, got {list(parts)}")
    for path, part in parts.items():
        now, given = _settings(part), _settings(others[path])
        changed = sorted(name for name in now.keys() | given.keys() if now.get(name) != given.get(name))
        if changed:
            raise ValueCheckError(
                f"to_json: expected the settings that {type(part).__name__} was constructed with, but {changed[0]} was changed: "
                "pass it to the constructor"
            )


def _settings(module: nn.Module) -> dict[str, str]:
    """The attributes of a module as text, where they have one."""
    settings: dict[str, str] = {}
    tensors = [*module.named_parameters(recurse=False), *module.named_buffers(recurse=False)]
    for name, value in [*vars(module).items(), *tensors]:
        if name in _NO_SETTINGS:
            continue
        try:
            settings[name] = repr(_encoded(value.detach() if isinstance(value, Tensor) else value, name))
        except TypeCheckError:
            settings[name] = type(value).__name__
    return settings


# --- from text ------------------------------------------------------------------------------------------------------


def _check_version(version: Any) -> None:
    """Raise unless this version of kvision knows what a text of `version` means: up to its own minor one."""
    numbers = re.match(r"(\d+)\.(\d+)", version) if isinstance(version, str) else None
    if numbers is None:
        raise ValueCheckError(f"from_json: expected 'kvision' to be the version that wrote the text, got {version!r}")
    if [int(n) for n in numbers.groups()] > [int(n) for n in __version__.split(".")[:2]]:
        raise ValueCheckError(f"from_json: expected a text of kvision {__version__} or older, got one of {version}")


def _made(described: Any) -> nn.Module:
    if not isinstance(described, dict) or not {"class"} <= set(described) <= {"class", "arguments", "children"}:
        raise ValueCheckError("from_json: expected an object of 'class', 'arguments' and 'children' for each part")
    arguments, children = described.get("arguments", {}), described.get("children", [])
    if not isinstance(arguments, dict) or not isinstance(children, list):
        raise ValueCheckError("from_json: expected 'arguments' to be an object and 'children' a list")
    name = described["class"]
    cls = _classes().get(name) if isinstance(name, str) else None
    if cls is None:
        raise ValueCheckError(
            f"from_json: expected class to be an augmentation or a container of kvision, got {name!r}"
        )
    if children and not issubclass(cls, nn.Sequential):
        raise ValueCheckError(f"from_json: expected no children of {name}, which is no container")
    parts, settings = [*map(_made, children)], {key: _decoded(value) for key, value in arguments.items()}
    try:
        made: nn.Module = cls(*parts, **settings)
    except TypeError as error:
        if isinstance(error, BaseError):
            raise
        raise TypeCheckError(f"from_json: expected arguments of {name}: {error}") from error
    return made


def _decoded(value: Any) -> Any:
    """The value; lists are read as tuples."""
    if isinstance(value, list):
        return tuple(_decoded(item) for item in value)
    if not isinstance(value, dict):
        return value
    try:
        ((kind, content),) = value.items()
        return _KINDS[kind](content)
    except (LookupError, TypeError, ValueError) as error:
        raise ValueCheckError(
            f"from_json: expected one of {', '.join(_KINDS)} with its value, got {value!r}"
        ) from error


_KINDS: dict[str, Callable[[Any], Any]] = {
    "enum": lambda x: _ENUMS[x[0]][x[1]],
    "float": float,
    "dict": lambda x: {_decoded(key): _decoded(item) for key, item in x},
    "dtype": lambda x: _DTYPES[x],
    "memory_format": restored_format,
    "tensor": lambda x: torch.tensor(_decoded(x[0]), dtype=_DTYPES[x[1]], device="cpu"),
}
