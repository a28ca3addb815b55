"""All inherited test suites, and a program that calls each of their variants once, for compute-sanitizer:

    PYTHONPATH=python:tests:. compute-sanitizer --tool memcheck python -m suites --device cuda

Images are small, and each call is made forward and backward. Results are not compared; the tool's report is the result.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import inspect
import pkgutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import torch

import kvision as K
from op_tests import OpTests
from point_op_tests import PointOpTests

TESTS = Path(__file__).parent
SMALL = (2, 3, 9, 11)  # image sizes are odd, so that no row is a whole number of vectors


def load() -> None:
    """Import kvision's modules, which register all operators, and the test files, which define all suites."""
    for module in pkgutil.walk_packages(K.__path__, "kvision."):
        if not module.name.startswith("kvision.demo") and module.name != "kvision._C":
            importlib.import_module(module.name)
    for path in sorted(TESTS.rglob("test_*.py")):
        name = "suites." + ".".join(path.relative_to(TESTS).with_suffix("").parts)
        spec = importlib.util.spec_from_file_location(name, path)
        assert spec is not None and spec.loader is not None
        sys.modules[name] = module = importlib.util.module_from_spec(spec)
        try:
            spec.loader.exec_module(module)
        except BaseException as error:  # a file that is skipped because a package is missing
            if type(error).__name__ != "Skipped":
                raise


def subclasses(cls: type) -> Iterator[type]:
    for derived in cls.__subclasses__():
        yield derived
        yield from subclasses(derived)


def calls(device: torch.device) -> Iterator[tuple[str, Callable[[], object]]]:
    """The calls of every suite, with their names."""
    for cls in dict.fromkeys(subclasses(OpTests)):
        if not cls.__name__.startswith("Test"):
            continue  # a base suite
        suite = cls()
        shape = SMALL if len(cls.shape) == 4 and cls.shape == OpTests.shape else cls.shape
        dtypes = (torch.float32, torch.float16, *([torch.uint8] if cls.bytes else []))
        for (i, variant), dtype in ((v, d) for v in enumerate(cls.variants) for d in dtypes):

            def call(suite=suite, variant=variant, dtype=dtype, shape=shape) -> None:
                x, kwargs = suite.setup(variant, device, dtype, shape)
                if dtype.is_floating_point:
                    suite.exercise(x, kwargs)
                else:
                    suite.call(x, kwargs)

            yield f"{cls.__name__}[{i}-{str(dtype).removeprefix('torch.')}]", call
    for cls in dict.fromkeys(subclasses(PointOpTests)):
        suite = cls()
        for name, cases in cls.calls.items():
            for i, case in enumerate(cases):
                for dtype in dict.fromkeys(case.dtypes[:2]):

                    def call(suite=suite, name=name, case=case, dtype=dtype) -> None:
                        suite.with_gradients(name, case, suite.rows(case, 3, device, dtype))

                    yield f"{cls.__name__}[{name}-{i}-{str(dtype).removeprefix('torch.')}]", call


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m suites", description=inspect.getdoc(sys.modules[__name__]))
    parser.add_argument("--device", default="cuda", choices=("cpu", "cuda"))
    parser.add_argument("--only", default="", help="a part of the names of the calls to make")
    parser.add_argument("--list", action="store_true", help="print the names of the calls and make none")
    options = parser.parse_args()
    device = torch.device(options.device)
    load()
    made = failed = 0
    for name, call in calls(device):
        if options.only not in name:
            continue
        made += 1
        if options.list:
            print(name)
            continue
        torch.manual_seed(0)
        try:
            call()
            if device.type == "cuda":
                torch.cuda.synchronize()
        except K.core.exceptions.BaseError as error:
            print(f"{name}: not called: {error}")  # a size or a type that the function does not take
        except Exception as error:
            failed += 1
            print(f"{name}: FAILED: {error!r}")
    print(f"{made} calls, {failed} failed")
    return 1 if failed or not made else 0


if __name__ == "__main__":
    sys.modules["suites"] = sys.modules["__main__"]
    sys.exit(main())
