"""The public names, their modules and their arguments, on which users' code relies, are those of public_api.txt.

A deliberate change comes with a new list, a line in CHANGELOG.md, and one in docs/differences.md where it departs from
Kornia:

    python tests/test_public_api.py > tests/public_api.txt
"""

from __future__ import annotations

import importlib
import inspect
import re
from collections.abc import Iterator
from enum import Enum
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from torch import nn

import kvision as K

pytestmark = pytest.mark.interface

LIST = Path(__file__).with_name("public_api.txt")


def public_modules() -> Iterator[ModuleType]:
    yield K
    yield from (getattr(K, name) for name in K.__all__ if is_plain_module(getattr(K, name)))
    modules = (
        "core.exceptions",
        "core.ops",
        "augmentation.auto",
        "augmentation.auto.operations",
        "augmentation.presets.ada",
        "augmentation.random_generator",
        "sensors.camera",
        "tv.functional",
    )
    yield from (importlib.import_module(f"kvision.{module}") for module in modules)  # modules of Kornia and torchvision


def public_names(module: ModuleType) -> list[str]:
    """The names of `from module import *`, without modules and names imported from other packages."""
    names = getattr(module, "__all__", None) or [n for n, v in vars(module).items() if n[0] != "_" and is_ours(v)]
    return [name for name in names if not is_plain_module(getattr(module, name))]


def is_plain_module(value: Any) -> bool:
    """Whether the value is a module that is not callable; kvision.info is a callable one."""
    return inspect.ismodule(value) and not callable(value)


def is_ours(value: Any) -> bool:
    return getattr(value, "__module__", "").startswith("kvision")


def arguments(function: Any) -> str:
    signature = inspect.signature(function)
    plain = [p.replace(annotation=p.empty) for p in signature.parameters.values() if p.name != "self"]
    text = str(signature.replace(parameters=plain, return_annotation=signature.empty))
    return re.sub(r"<(?:function|class) '?([\w.]+)'?[^>]*>", r"\1", text)  # defaults by name, without addresses


def lines(name: str, value: Any) -> Iterator[str]:
    """A function or class with its arguments; a class with its members as well."""
    if not inspect.isclass(value):
        yield name + (arguments(value) if callable(value) else "")
        return
    if issubclass(value, Enum):
        yield from (f"{name}.{member.name} = {member.value!r}" for member in value)
    else:
        yield name + arguments(value.__init__)
    own = {attribute for base in value.__mro__ if is_ours(base) for attribute in vars(base)}
    for attribute in sorted(own):
        member = getattr(value, attribute)
        inherited = (attribute != "forward" and hasattr(nn.Module, attribute)) or hasattr(Exception, attribute)
        if attribute.startswith("_") or inherited:
            continue
        if isinstance(member, property):
            yield f"{name}.{attribute}"
        elif inspect.isroutine(member) and is_ours(member):
            yield f"{name}.{attribute}{arguments(member)}"


def surface() -> list[str]:
    return sorted(
        line
        for module in public_modules()
        for name in public_names(module)
        for line in lines(f"{module.__name__}.{name}", getattr(module, name))
    )


def test_the_public_api_is_the_listed_one() -> None:
    listed, result = LIST.read_text().splitlines(), surface()
    gone = sorted(set(listed) - set(result))
    new = sorted(set(result) - set(listed))
    assert not gone and not new, "\n".join(
        ["gone or changed:", *gone, "new or changed:", *new, "", "If that is meant, see the top of this file."]
    )


def test_top_level_names_are_those_of_their_modules() -> None:
    """A flat name is an alias of the same object and never behaves differently."""
    homes = [
        K.color,
        K.constants,
        K.contrib,
        K.core,
        K.enhance,
        K.feature,
        K.filters,
        K.geometry,
        K.image,
        K.losses,
        K.utils,
    ]
    for name in public_names(K):
        if name not in ("RangeWarning", "__version__", "backend", "info", "patch_kornia"):  # defined at the top level
            assert any(getattr(home, name, None) is getattr(K, name) for home in homes), name


if __name__ == "__main__":
    print(*surface(), sep="\n")
