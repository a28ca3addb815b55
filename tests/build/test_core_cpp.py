"""Builds and runs the C++ tests of csrc/core."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.skipif(shutil.which(os.environ.get("CXX", "c++")) is None, reason="there is no C++ compiler")
def test_core() -> None:
    cmake, folder = Path(sys.executable).with_name("cmake"), ROOT / "build/tests"
    subprocess.run([cmake, "-S", ROOT / "csrc/tests", "-B", folder, "--log-level=ERROR"], check=True)
    subprocess.run([cmake, "--build", folder], check=True)
    subprocess.run([cmake.with_name("ctest"), "--test-dir", folder, "--output-on-failure"], check=True)
