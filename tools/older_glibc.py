"""Link against an older glibc than this machine's, so that the libraries run where only that one is.

    python tools/older_glibc.py build/glibc-2.28          the flags for CMake

glibc gives a program the newest version of each function that was there when it was linked. A library linked here would need
this machine's glibc. So the linker gets other libraries to link with: stubs, which have the names and versions of glibc 2.28
and no code. The package ziglang makes them for every version of glibc; its compiler is not used. libstdc++ is linked statically
and hidden, since the one of an old system lacks what this compiler uses of it, and tools/older_glibc.c has what it takes of
later versions.
"""

from __future__ import annotations

import argparse
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
GLIBC = "2.28"
LIBRARIES = {"c": "libc.so.6", "m": "libm.so.6", "dl": "libdl.so.2", "pthread": "libpthread.so.0", "rt": "librt.so.1"}
LOADER = "libld.so.2"  # ziglang's name of ld-linux-x86-64.so.2


def make_stubs(folder: Path, glibc: str = GLIBC) -> None:
    """The stubs and the object of older_glibc.c in `folder`, where they stay."""
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch:
        program = Path(scratch, "program.c")
        program.write_text("int main(void) { return 0; }\n")
        # Its cache has the stubs of one version only, since nothing else was compiled into it.
        environment = {
            **os.environ,
            "ZIG_GLOBAL_CACHE_DIR": f"{scratch}/cache",
            "ZIG_LOCAL_CACHE_DIR": f"{scratch}/cache",
        }
        zig = (sys.executable, "-m", "ziglang", "cc", "-target", f"x86_64-linux-gnu.{glibc}")
        subprocess.run([*zig, program, "-o", program.with_suffix("")], check=True, env=environment)
        (stubs,) = (path.parent for path in Path(scratch, "cache/o").glob("*/libc.so.6"))
        for name, file in LIBRARIES.items():
            shutil.copy(stubs / file, folder / f"lib{name}.so")
        shutil.copy(stubs / LOADER, folder / LOADER)
    compiler = os.environ.get("CC", "cc")
    source = ROOT / "tools/older_glibc.c"
    subprocess.run([compiler, "-O1", "-Wall", "-fPIC", "-c", source, "-o", folder / "older_glibc.o"], check=True)


def cmake_arguments(folder: Path) -> list[str]:
    """What CMake needs to link with the stubs in `folder`."""
    folder = folder.resolve()
    # Hidden, or another libstdc++ of the process could take its place. gcc's own -lc and -lm find the stubs first.
    link = f"-static-libstdc++ -Wl,--exclude-libs,ALL -L{folder} {folder}/older_glibc.o"
    # In 2.28 threads and the loader are libraries of their own; libstdc++.a, which comes after them, needs both.
    libraries = f"-Wl,--push-state,--no-as-needed -lpthread -ldl -l:{LOADER} -Wl,--pop-state"
    return [
        f"-DCMAKE_SHARED_LINKER_FLAGS={link}",
        f"-DCMAKE_MODULE_LINKER_FLAGS={link}",
        f"-DCMAKE_CXX_STANDARD_LIBRARIES={libraries}",
        f"-DCMAKE_CUDA_STANDARD_LIBRARIES={libraries}",
    ]


def needed_versions(library: Path) -> Iterator[tuple[str, tuple[int, ...]]]:
    """The versions that the library needs of others' symbols: ("GLIBC", (2, 27)), ("GLIBCXX", (3, 4, 29))."""
    table = subprocess.run(["readelf", "--version-info", library], check=True, capture_output=True, text=True).stdout
    _, _, needs = table.partition(".gnu.version_r")
    for name, version in re.findall(r"Name: ([A-Z]+)_([\d.]+)", needs):
        yield name, tuple(map(int, version.split(".")))


def this_glibc() -> tuple[int, ...]:
    """The version of this machine."""
    return tuple(map(int, (os.confstr("CS_GNU_LIBC_VERSION") or "glibc 0").split()[1].split(".")))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--glibc", default=GLIBC)
    options = parser.parse_args()
    make_stubs(options.folder, options.glibc)
    print(shlex.join(cmake_arguments(options.folder)))
