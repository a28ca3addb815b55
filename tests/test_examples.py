"""The examples reach what they say."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest


def example(name: str) -> ModuleType:
    path = Path(__file__).parents[1] / "examples" / f"{name}.py"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("solver, iterations", [("gauss-newton", 20), ("adam", 150)])
def test_registration_of_a_photograph(solver, iterations, device):
    pytest.importorskip("skimage")
    registration = example("image_registration")
    pair = next(registration.synthetic(device))
    found, levels = registration.register(pair, solver, iterations)
    assert registration.corner_error(pair.start, pair) > 5
    assert registration.corner_error(found, pair) < pair.limit
    assert len(levels) == registration.LEVELS


def test_registration_of_real_pairs(data, device):
    registration = example("image_registration")
    pairs = list(registration.real(data / "homography", device))
    for pair in pairs:
        found, _ = registration.register(pair, "gauss-newton", 20)
        assert registration.corner_error(found, pair) < pair.limit, pair.name
    assert pairs
