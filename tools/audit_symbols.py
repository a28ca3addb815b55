"""Checks the invariants of the design on the built files. The exit status is 1 if one is violated.

- The libraries need torch's stable C interface and the C and C++ runtimes, nothing else of torch or CUDA. So one build
  serves every torch from 2.11 on, and the CPU library loads where there is no CUDA.
- The libstdc++ of GCC 12 is new enough, whichever compiler built them.
- No two instruction sets share a symbol. The linker keeps one of equal symbols, and code for AVX-512 must not run on a
  processor without it.
- torch is included by csrc/glue and the *_op.cpp files alone.
- ptxas takes the PTX that is in the CUDA library: an instruction that its architecture has not is seen without machine code for it.
"""

from __future__ import annotations

import argparse
import itertools
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).parents[1]
PTX = re.compile(rb"\.version \d+\.\d+\n\.target sm_(\d+)[^\0]*")
LIBRARIES = ROOT / "python/kvision/lib"
ISAS = ("baseline", "avx2", "avx512")

# Versioned symbols of the C, C++ and compiler runtimes, torch's C interface, and hooks that GCC leaves optional: those of
# transactional memory (_ITM, _ZGT) come with a static libstdc++.
ALLOWED = re.compile(
    r".+@(GLIBC|GLIBCXX|CXXABI|GCC)_[\w.]+|(aoti_)?torch_\w+|_ITM_\w+|_ZGT\w+|__gmon_start__|__cxa_(finalize|pure_virtual)"
)
NEWEST_LIBSTDCXX = (3, 4, 30)  # GLIBCXX of GCC 12
RUNTIMES = re.compile(r"(libc|libm|libstdc\+\+|libgcc_s|libpthread|libdl|librt|ld-linux[\w-]*)\.so\.\d+")


def run(*command: str | Path, input: str | None = None) -> str:
    return subprocess.run(command, check=True, capture_output=True, text=True, input=input).stdout


def demangled(symbols: Iterable[str]) -> list[str]:
    return run("c++filt", input="\n".join(symbols)).splitlines()


def undefined_symbols(library: Path) -> Iterator[str]:
    """Symbols of torch or others that another version may not have."""
    symbols = [line.split()[-1] for line in run("nm", "-D", "--undefined-only", library).splitlines()]
    for symbol in demangled(symbol for symbol in symbols if not ALLOWED.fullmatch(symbol)):
        yield f"{library.name}: needs {symbol}, which is not part of the stable interface"
    for symbol in symbols:
        version = re.search(r"@GLIBCXX_([\d.]+)", symbol)
        if version and tuple(map(int, version[1].split("."))) > NEWEST_LIBSTDCXX:
            yield f"{library.name}: needs {symbol}, which is newer than the libstdc++ of GCC 12"


def needed_libraries(library: Path, torch: set[str]) -> Iterator[str]:
    """The libraries it names: `torch` exactly, besides the runtimes."""
    needed = set(re.findall(r"\(NEEDED\).*\[(.*)\]", run("readelf", "-d", library)))
    for name in sorted(needed - torch):
        if not RUNTIMES.fullmatch(name):
            yield f"{library.name}: names {name} as needed"
    for name in sorted(torch - needed):
        yield f"{library.name}: does not name {name} as needed"


def build_folder() -> Path | None:
    """The CMake folder of an editable install or of a manual build."""
    folders = (ROOT / "build/cmake", ROOT / "build")
    return next((f for f in folders for isa in ISAS if (f / f"CMakeFiles/kvision_{isa}.dir").is_dir()), None)


def shared_symbols(build: Path) -> Iterator[str]:
    """Symbols that objects of two instruction sets define, and those outside of their set's namespace."""
    defined: dict[str, set[str]] = {}
    for isa in ISAS:
        objects = sorted((build / f"CMakeFiles/kvision_{isa}.dir").rglob("*_cpu.cpp.o"))
        if objects:
            lines = run("nm", "--defined-only", "--extern-only", *objects).splitlines()
            defined[isa] = {line.split()[2] for line in lines if len(line.split()) == 3}
            for symbol in demangled(sorted(defined[isa])):
                if not re.search(rf"\bkv::(\w+::)?{isa}::", symbol):
                    yield f"{isa}: defines {symbol} outside of namespace kv::MODULE::{isa}"
    for a, b in itertools.combinations(defined, 2):
        for symbol in demangled(sorted(defined[a] & defined[b])):
            yield f"{a} and {b} both define {symbol}"


def torch_includes() -> Iterator[str]:
    """Files that include torch outside of the glue and the *_op.cpp files."""
    for path in sorted((ROOT / "csrc").rglob("*.*")):
        if path.parent.name == "glue" or path.name.endswith("_op.cpp"):
            continue
        if re.search(r"#include\s*[<\"](torch|ATen|c10)/", path.read_text()):
            yield f"{path.relative_to(ROOT)}: includes torch"


def refused_ptx(library: Path) -> Iterator[str]:
    """What ptxas says of the PTX in a library, which the driver would say on a user's machine."""
    programs = [(int(found[1]), found[0]) for found in PTX.finditer(library.read_bytes())]
    if not programs:
        yield f"{library.name}: has no PTX that is not compressed; nvcc --compress-mode=none leaves it as it is"
        return
    if shutil.which("ptxas") is None:
        yield f"{library.name}: its PTX was not read, as ptxas is not on the PATH"
        return
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(os.cpu_count()) as pool:

        def refused(number: int) -> list[str]:
            architecture, text = programs[number]
            path = Path(folder, f"{number}.ptx")
            path.write_bytes(text)
            # A name that asks for no machine code.
            result = subprocess.run(
                ["ptxas", f"-arch=compute_{architecture}", path], capture_output=True, text=True, cwd=folder
            )
            return result.stderr.splitlines() if result.returncode else []

        for lines in pool.map(refused, range(len(programs))):
            yield from (line.replace(f"{folder}/", "") for line in lines)


def audit() -> Iterator[str]:
    """One line for each violated invariant."""
    cpu, cuda = LIBRARIES / "libkvision.so", LIBRARIES / "libkvision_cuda.so"
    yield from torch_includes()
    yield from undefined_symbols(cpu)
    yield from needed_libraries(cpu, {"libtorch_cpu.so"})
    if cuda.exists():
        yield from undefined_symbols(cuda)
        yield from needed_libraries(cuda, {"libtorch_cpu.so", "libtorch_cuda.so"})
        yield from refused_ptx(cuda)
    if build := build_folder():
        yield from shared_symbols(build)


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    problems = list(audit())
    print("\n".join(problems) or "audit: the libraries keep their promises")
    sys.exit(bool(problems))
