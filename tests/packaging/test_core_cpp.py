"""Builds and runs the C++ tests of csrc/core."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_core(cmake: str) -> None:
    folder = ROOT / "build/tests"
    subprocess.run([cmake, "-S", ROOT / "csrc/tests", "-B", folder, "--log-level=ERROR"], check=True)
    subprocess.run([cmake, "--build", folder, "--parallel", "2"], check=True)
    subprocess.run([cmake, "--build", folder, "--target", "test"], check=True)
