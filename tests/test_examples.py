"""The examples in Python run, and show what they say."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"


def example(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_segmentation_losses(tmp_path: Path) -> None:
    losses = example("segmentation_losses")
    reached = losses.main(["--out", str(tmp_path / "curves.png"), "--device", "cpu"])
    assert reached.keys() == losses.LOSSES.keys()
    assert min(reached.values()) > 0.9
    assert (tmp_path / "curves.png").stat().st_size > 0


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
