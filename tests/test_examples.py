"""The examples in Python run, and show what they say."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"


@pytest.mark.slow
def test_segmentation_losses(tmp_path: Path) -> None:
    spec = importlib.util.spec_from_file_location("segmentation_losses", EXAMPLES / "segmentation_losses.py")
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    reached = example.main(["--out", str(tmp_path / "curves.png"), "--device", "cpu"])
    assert reached.keys() == example.LOSSES.keys()
    assert min(reached.values()) > 0.9
    assert (tmp_path / "curves.png").stat().st_size > 0
