"""The C++ API of include/kvision: right gradients, options and errors."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import kvision  # noqa: F401  declares the operators
from kvision import _backend

ROOT = Path(__file__).parents[2]
built = pytest.mark.skipif("cpu" in _backend.unserved, reason="the operators are declared by libkvision.so")


@pytest.fixture(scope="module")
def programs(cmake: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the programs of tests/cpp, built as a user builds against kvision."""
    folder = tmp_path_factory.mktemp("cpp")
    command = [sys.executable, "-m", "kvision.info", "--cmake-prefix-path"]
    prefixes = subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()
    subprocess.run([cmake, "-S", ROOT / "tests/cpp", "-B", folder, f"-DCMAKE_PREFIX_PATH={prefixes}"], check=True)
    subprocess.run([cmake, "--build", folder, "--parallel", "2"], check=True)
    return folder


@pytest.mark.slow
@built
@pytest.mark.parametrize("name", ["gradients", "api"])
def test_program(programs: Path, name: str) -> None:
    result = subprocess.run([programs / name], capture_output=True, text=True)
    assert result.returncode == 0 and " 0 failures" in result.stdout, result.stdout + result.stderr
