"""Builds and runs the C++ tests of csrc/core."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def newest_clang() -> str | None:
    names = ("clang++", *(f"clang++-{version}" for version in range(30, 18, -1)))
    return next(filter(shutil.which, names), None)


@pytest.mark.slow
@pytest.mark.parametrize("compiler", ["c++", "clang"])
def test_core(cmake: str, compiler: str) -> None:
    program = shutil.which(os.environ.get("CXX", "c++")) if compiler == "c++" else newest_clang()
    if program is None:
        pytest.skip(f"not installed: {compiler}")
    folder = ROOT / "build/tests" / compiler
    configure = (cmake, "-S", ROOT / "csrc/tests", "-B", folder, "--log-level=ERROR", f"-DCMAKE_CXX_COMPILER={program}")
    subprocess.run(configure, check=True)
    subprocess.run([cmake, "--build", folder, "--parallel", "2"], check=True)
    subprocess.run([cmake, "--build", folder, "--target", "test"], check=True)
