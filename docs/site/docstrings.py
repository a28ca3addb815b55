"""An extension of Griffe, which reads the docstrings for mkdocstrings: kvision's style in terms of Griffe's."""

from __future__ import annotations

import re
from typing import Any

import griffe


class Docstrings(griffe.Extension):
    """Doctests below "Example:" are code, and roles of Sphinx are code or formulas in plain text."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        if obj.docstring is not None:
            text = re.sub(r"^( *)Example:$", r"\1Examples:", obj.docstring.value, flags=re.MULTILINE)
            text = re.sub(r":math:`([^`]+)`", lambda formula: _plain(formula[1]), text)
            obj.docstring.value = re.sub(r":(?:\w+:)?(?:func|class|meth|mod|attr|data|exc):(`[^`]+`)", r"\1", text)


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
