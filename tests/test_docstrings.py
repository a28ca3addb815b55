"""Docstrings of public functions and classes: the sections Args, Returns, Raises and Example where they apply, with every
argument described.

    python tests/test_docstrings.py    # lists what is missing, by file
"""

from __future__ import annotations

import ast
import inspect
import re
from collections import defaultdict
from collections.abc import Iterator
from enum import Enum
from functools import lru_cache
from pathlib import Path
from typing import Any

import pytest

from test_public_api import public_modules, public_names

pytestmark = pytest.mark.interface

ROOT = Path(__file__).parents[1]
SECTIONS = ("Args", "Returns", "Raises", "Example")


def public_objects() -> dict[str, Any]:
    """Public functions and classes by the names of their module and themselves, each once."""
    objects = {}
    for module in public_modules():
        for name in public_names(module):
            value = getattr(module, name)
            if inspect.isfunction(value) or (inspect.isclass(value) and not issubclass(value, (Enum, Exception))):
                objects[f"{value.__module__.removeprefix('kvision.')}.{value.__qualname__}"] = value
    return objects


@lru_cache
def checking_functions(module: str) -> set[str]:
    """Functions of a file that raise or check arguments, directly or through other functions of the file."""
    functions = {node.name: node for node in parse(module).body if isinstance(node, ast.FunctionDef)}
    checking = {name for name, node in functions.items() if any(map(is_check, ast.walk(node)))}
    while callers := {name for name, node in functions.items() if name not in checking and calls(node) & checking}:
        checking |= callers
    return checking


@lru_cache
def parse(module: str) -> ast.Module:
    path = ROOT / "python" / Path(*module.split("."))
    return ast.parse((path / "__init__.py" if path.is_dir() else path.with_suffix(".py")).read_text())


def is_check(node: ast.AST) -> bool:
    if isinstance(node, ast.Attribute):
        return isinstance(node.value, ast.Name) and node.value.id == "_check"
    return isinstance(node, ast.Raise)


def calls(node: ast.AST) -> set[str]:
    return {n.func.id for n in ast.walk(node) if isinstance(n, ast.Call) and isinstance(n.func, ast.Name)}


def sections(text: str) -> dict[str, str]:
    """The sections of a docstring by their titles."""
    parts = re.split(r"^([A-Z][a-z]+):[ \t]*$", inspect.cleandoc(text), flags=re.MULTILINE)
    return {title: body for title, body in zip(parts[1::2], parts[2::2]) if title in SECTIONS}


def missing(value: Any) -> Iterator[str]:
    """Required sections that a docstring lacks, and arguments that its Args do not describe.

    A class that is the module form of a function may refer to that function for its arguments.
    """
    text = value.__doc__ or ""
    present = sections(text)
    is_class = inspect.isclass(value)
    signature = inspect.signature(value.__init__ if is_class else value)
    arguments = [
        p.name
        for p in signature.parameters.values()
        if p.name != "self" and p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD)
    ]
    if arguments and not (is_class and ":func:" in text.partition("\n\n")[0]):
        described = set(
            re.findall(r"\w+", " ".join(re.findall(r"^ {4}(\w[^:]*):", present.get("Args", ""), re.MULTILINE)))
        )
        if "Args" not in present:
            yield "Args"
        elif unknown := [name for name in arguments if name not in described]:
            yield "Args of " + ", ".join(unknown)
    if not is_class and signature.return_annotation not in (None, "None") and "Returns" not in present:
        yield "Returns"
    if not is_class and value.__name__ in checking_functions(value.__module__) and "Raises" not in present:
        yield "Raises"
    if "Example" not in present:
        yield "Example"


OBJECTS = public_objects()


def test_docstrings_have_their_sections() -> None:
    gaps = {name: list(missing(value)) for name, value in OBJECTS.items()}
    assert not {name: sections for name, sections in gaps.items() if sections}


if __name__ == "__main__":
    by_file = defaultdict(list)
    for _, value in sorted(OBJECTS.items()):
        if gaps := list(missing(value)):
            by_file[value.__module__].append(f"    {value.__qualname__}: {'; '.join(gaps)}")
    for module, lines in by_file.items():
        print(module, *lines, sep="\n")
