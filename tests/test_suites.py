"""Every operator is tested by an inherited suite."""

from __future__ import annotations

import importlib.util
import pkgutil
import sys
from collections.abc import Iterator
from pathlib import Path

import kvision
from kvision import _ops
from op_tests import OpTests
from point_op_tests import PointOpTests

TESTS = Path(__file__).parent


def subclasses(cls: type) -> Iterator[type]:
    for derived in cls.__subclasses__():
        yield derived
        yield from subclasses(derived)


def test_a_suite_claims_every_operator():
    """Importing all modules registers all operators; importing all test files defines all suites."""
    for module in pkgutil.walk_packages(kvision.__path__, "kvision."):
        if not module.name.startswith("kvision.demo") and module.name != "kvision._C":
            importlib.import_module(module.name)
    for path in sorted(TESTS.rglob("test_*.py")):
        name = "suites." + ".".join(path.relative_to(TESTS).with_suffix("").parts)
        spec = importlib.util.spec_from_file_location(name, path)
        sys.modules[name] = module = importlib.util.module_from_spec(spec)
        try:
            spec.loader.exec_module(module)
        except BaseException as error:  # skipped as a whole, where a package is missing
            if type(error).__name__ != "Skipped":
                raise
    claimed = {name for suite in (OpTests, PointOpTests) for c in subclasses(suite) for name in c.operators}
    registered = {n for n, o in _ops.operators.items() if o.definition.__module__.startswith("kvision.")}
    assert sorted(registered - claimed) == [], "operators of no suite"
    assert sorted(claimed - set(_ops.operators)) == [], "suites of operators that do not exist"
