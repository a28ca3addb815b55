"""The C++ tests of csrc, compiled for ARM and run in an emulator."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
spec = importlib.util.spec_from_file_location("test_arm_tool", ROOT / "tools/test_arm.py")
tool = importlib.util.module_from_spec(spec)
spec.loader.exec_module(tool)


@pytest.mark.slow
def test_kernels_for_arm(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    if tool.missing():
        pytest.skip(f"not installed: {', '.join(tool.missing())}")
    tool.run_tests(tmp_path)
    output = capfd.readouterr().out
    assert "kernels" in output and "lanes_baseline" in output and "100% tests passed" in output
