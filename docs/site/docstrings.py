"""An extension of Griffe, which reads the docstrings for mkdocstrings: kvision's style and public names in terms of Griffe's."""

from __future__ import annotations

import inspect
import re
import sys
from typing import Any

import griffe


class Docstrings(griffe.Extension):
    """Doctests below "Example:" are code, and roles of Sphinx are code or formulas in plain text."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        _rewrite(obj)

    def on_package(self, *, pkg: griffe.Module, **_: Any) -> None:
        """Make public names what they are at run time: Griffe takes `filters.sobel` for the file sobel.py, which defines it."""
        found = []
        for path, module in list(sys.modules.items()):
            package = _member(pkg, path)
            for name in {*vars(module), *getattr(module, "__all__", ())} if package is not None else ():
                value = getattr(module, name, None)
                is_public = (inspect.isfunction(value) or inspect.isclass(value)) and not name.startswith("_")
                target = _member(pkg, f"{value.__module__}.{value.__qualname__}") if is_public else None
                if target is not None and target.name == name and value.__module__ != path:
                    found.append((package, name, target))
        for package, name, target in found:
            # What is in a hidden file is no event.
            for described in (target, *target.members.values()):
                _rewrite(described)
            # The line is beyond those of the imports by *, which replace what stands above them.
            package.members[name] = griffe.Alias(name, target=target, parent=package, lineno=sys.maxsize)


def _rewrite(obj: griffe.Object | griffe.Alias) -> None:
    """Write a docstring in Griffe's terms; a second time changes nothing."""
    if not obj.is_alias and obj.docstring is not None:
        text = re.sub(r"^( *)Example:$", r"\1Examples:", obj.docstring.value, flags=re.MULTILINE)
        text = re.sub(r":math:`([^`]+)`", lambda formula: _plain(formula[1]), text)
        obj.docstring.value = re.sub(r":(?:\w+:)?(?:func|class|meth|mod|attr|data|exc):(`[^`]+`)", r"\1", text)


def _member(package: griffe.Module, path: str) -> Any:
    """What a path of the package stands for, before anything is replaced; None where there is no such thing."""
    names = path.split(".")
    found: Any = package if names[0] == package.name else None
    for name in names[1:]:
        found = found.members.get(name) if isinstance(found, (griffe.Module, griffe.Class)) else None
    return found


def _plain(formula: str) -> str:
    """A formula of LaTeX in letters, as far as docstrings have any."""
    for name, letter in {
        r"\sqrt": "√",
        r"\epsilon": "ε",
        "^2": "²",
        "g_x": "gₓ",
        "g_y": "g_y",
        "{": "(",
        "}": ")",
    }.items():
        formula = formula.replace(name, letter)
    return formula
