"""What the built libraries may contain and need; tools/audit_symbols.py says why."""

from __future__ import annotations

import importlib.util
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from kvision import _backend

ROOT = Path(__file__).parents[2]
spec = importlib.util.spec_from_file_location("audit_symbols", ROOT / "tools/audit_symbols.py")
audit_symbols = importlib.util.module_from_spec(spec)
spec.loader.exec_module(audit_symbols)

CPU = _backend.LIBRARY_FOLDER / "libkvision.so"
CUDA = _backend.LIBRARY_FOLDER / "libkvision_cuda.so"

built = pytest.mark.skipif(not CPU.exists() or shutil.which("nm") is None, reason="no library, or no nm to read it")
built_for_cuda = pytest.mark.skipif(not CUDA.exists() or shutil.which("nm") is None, reason="no CUDA library, or no nm")


def test_torch_is_included_by_the_glue_alone() -> None:
    assert not list(audit_symbols.torch_includes())


def test_a_constant_of_an_entry_has_no_namesake() -> None:
    """Entries of a module are compiled together: one file's constant would replace a header's in all of them."""
    where: dict[str, list[Path]] = {}
    for path in (*ROOT.glob("csrc/*/*_op.cpp"), *ROOT.glob("csrc/*/*.h")):
        for name in re.findall(r"^(?:inline )?constexpr [\w:]+ (\w+)(?:\[\])? =", path.read_text(), re.MULTILINE):
            where.setdefault(name, []).append(path)
    assert where
    assert not {n: p for n, p in where.items() if len(p) > 1 and any(q.name.endswith("_op.cpp") for q in p)}


@built
def test_cpu_library_needs_stable_symbols_only() -> None:
    assert not list(audit_symbols.undefined_symbols(CPU))
    assert not list(audit_symbols.needed_libraries(CPU, {"libtorch_cpu.so"}))


@built_for_cuda
def test_cuda_library_needs_stable_symbols_only() -> None:
    assert not list(audit_symbols.undefined_symbols(CUDA))
    assert not list(audit_symbols.needed_libraries(CUDA, {"libtorch_cpu.so", "libtorch_cuda.so"}))


@built
def test_instruction_sets_share_no_symbols() -> None:
    folder = audit_symbols.build_folder()
    if folder is None:
        pytest.skip("the objects are not here, this is an installed package")
    assert not list(audit_symbols.shared_symbols(folder))


@built
def test_audit_reports_forbidden_symbols(tmp_path: Path, monkeypatch) -> None:
    """A library with an unstable symbol is found out, and one that needs a libstdc++ newer than allowed."""
    if shutil.which("c++") is None:
        pytest.skip("there is no C++ compiler")
    source = tmp_path / "unstable.cpp"
    source.write_text("""
#include <new>
namespace c10 { void get_backtrace(); }
void f() { c10::get_backtrace(); throw std::bad_alloc(); }
""")
    subprocess.run(["c++", "-shared", "-fPIC", source, "-o", tmp_path / "unstable.so"], check=True)
    unstable = "unstable.so: needs c10::get_backtrace(), which is not part of the stable interface"
    assert list(audit_symbols.undefined_symbols(tmp_path / "unstable.so")) == [unstable]
    monkeypatch.setattr(audit_symbols, "NEWEST_LIBSTDCXX", (3, 3))
    newer = set(audit_symbols.undefined_symbols(tmp_path / "unstable.so")) - {unstable}
    assert any(re.search(r"needs _ZNSt9bad_alloc\w+@GLIBCXX_3.4, which is newer", line) for line in newer)
    assert list(audit_symbols.needed_libraries(tmp_path / "unstable.so", {"libtorch_cpu.so"}))


@built
def test_cpu_library_loads_without_cuda() -> None:
    program = """
import torch
torch.ops.load_library(LIBRARY)
assert torch.ops.kvision.sobel(torch.zeros(1, 1, 4, 4), True, 1e-6).shape == (1, 1, 4, 4)
assert not any("kvision_cuda" in line for line in open("/proc/self/maps"))
"""
    subprocess.run(
        [sys.executable, "-c", program.replace("LIBRARY", repr(str(CPU)))], check=True, env={"CUDA_VISIBLE_DEVICES": ""}
    )
