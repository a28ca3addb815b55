"""tools/new_operator.py writes a complete operator. That it compiles and passes its tests was tried by hand."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def test_writes_six_files(tmp_path: Path) -> None:
    write = runpy.run_path(str(ROOT / "tools/new_operator.py"))["main"]
    write("filters/smoothing/soft_glow", tmp_path)
    texts = {str(path.relative_to(tmp_path)): path.read_text() for path in tmp_path.rglob("*.*")}
    assert sorted(texts) == [
        *(f"csrc/filters/smoothing/soft_glow{end}" for end in (".cu", ".h", "_cpu.cpp", "_op.cpp")),
        "python/kvision/filters/smoothing/soft_glow.py",
        "tests/filters/smoothing/test_soft_glow.py",
    ]
    for path, text in texts.items():
        assert not any(word in text for word in ("NAME", "CLASS", "MODULE", "PACKAGE", "FOLDER")), path
        if path.endswith(".py"):
            compile(text, path, "exec")
    assert "struct SoftGlow {" in texts["csrc/filters/smoothing/soft_glow.h"]
    assert "namespace kv::filters::cuda" in texts["csrc/filters/smoothing/soft_glow.cu"]
    with pytest.raises(SystemExit, match="there is csrc/filters/smoothing/soft_glow.h"):
        write("filters/smoothing/soft_glow", tmp_path)
    with pytest.raises(SystemExit, match="expected a folder and a name"):
        write("SoftGlow", tmp_path)
