"""All cases by name. Every file in this folder that defines CASES is included."""

from __future__ import annotations

import importlib
import pkgutil

from benchmarks.case import Case

ALL: dict[str, Case] = {
    case.name: case
    for module in pkgutil.iter_modules(__path__)
    for case in importlib.import_module(f"{__name__}.{module.name}").CASES
}
