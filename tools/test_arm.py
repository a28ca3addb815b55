"""Cross-compile the CPU kernels for 64-bit ARM, whose vectors are NEON, and run their C++ tests in an emulator.

    python tools/test_arm.py                           csrc/tests: half a minute
    python tools/test_arm.py --library                 besides, all of libkvision.so, compiled, linked and audited: minutes
    python tools/test_arm.py --torch FOLDER...         besides, an operator in the LibTorch for ARM of these folders

It needs an aarch64 GCC and qemu-user: apt install g++-aarch64-linux-gnu qemu-user. The library is linked with an empty stand-in for
libtorch_cpu.so, and the audit finds nothing undefined but torch's stable interface and the runtimes of C and C++. FOLDER is
torch/lib of the aarch64 wheel of the installed version of torch:

    pip download --no-deps --platform manylinux_2_28_aarch64 --only-binary=:all: torch==VERSION
    unzip torch-*.whl 'torch/lib/*'

The wheels of PyPI also need the folders of libcudart and libcupti, which are in nvidia-cuda-runtime and nvidia-cuda-cupti.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
import audit_symbols

ROOT = Path(__file__).parents[1]
TOOLCHAIN = ROOT / "tools/aarch64.cmake"


def missing() -> list[str]:
    """The programs that are not installed."""
    return [name for name in ("aarch64-linux-gnu-g++", "qemu-aarch64", "cmake", "ninja") if shutil.which(name) is None]


def run(*command: object) -> None:
    subprocess.run([str(word) for word in command], check=True)


def configure(source: Path, folder: Path, *arguments: str) -> None:
    run("cmake", "-S", source, "-B", folder, "-G", "Ninja", f"-DCMAKE_TOOLCHAIN_FILE={TOOLCHAIN}", *arguments)


def run_tests(folder: Path) -> None:
    configure(ROOT / "csrc/tests", folder)
    run("cmake", "--build", folder)
    run("ctest", "--test-dir", folder, "--output-on-failure", "--no-tests=error")


def torch_headers() -> Path:
    torch = importlib.util.find_spec("torch")
    assert torch is not None and torch.origin is not None, "torch is needed for its headers"
    return Path(torch.origin).parent / "include"


def build_library(folder: Path) -> Path:
    """libkvision.so for ARM."""
    folder.mkdir(parents=True, exist_ok=True)
    stand_in = folder / "libtorch_cpu.so"
    empty = folder / "empty.cpp"
    empty.write_text("")
    run("aarch64-linux-gnu-g++", "-shared", "-fPIC", "-Wl,-soname,libtorch_cpu.so", "-o", stand_in, empty)
    configure(
        ROOT,
        folder,
        "-DKVISION_CUDA=OFF",
        "-DKVISION_PYTHON=OFF",
        f"-DTorchStable_INCLUDE_DIR={torch_headers()}",
        f"-DTorchStable_CPU_LIBRARY={stand_in}",
        f"-DCMAKE_SHARED_LINKER_FLAGS=-Wl,--no-as-needed -L{folder}",
        *os.environ.get("CMAKE_ARGS", "").split(),
    )
    run("cmake", "--build", folder)
    library = folder / "libkvision.so"
    header = subprocess.run(["readelf", "-h", library], check=True, capture_output=True, text=True).stdout
    if not re.search(r"Machine:\s+AArch64", header):
        sys.exit(f"{library} is not for ARM:\n{header}")
    problems = [
        *audit_symbols.undefined_symbols(library),
        *audit_symbols.needed_libraries(library, {"libtorch_cpu.so"}),
    ]
    if problems:
        sys.exit("\n".join(problems))
    return library


def call_operator(library: Path, torch: list[Path], folder: Path) -> None:
    """The library in the LibTorch for ARM of the folders `torch`."""
    headers, program = torch_headers(), folder / "call_operator"
    run(
        *("aarch64-linux-gnu-g++", "-std=c++20", "-w", f"-I{headers}", f"-I{headers}/torch/csrc/api/include"),
        *(ROOT / "tools/call_operator.cpp", "-o", program, f"-L{torch[0]}", "-lc10", "-ltorch_cpu"),
        *("-Wl,--allow-shlib-undefined", "-rdynamic"),
    )
    path = ":".join(str(part.resolve()) for part in torch)
    run("qemu-aarch64", "-L", "/usr/aarch64-linux-gnu", "-E", f"LD_LIBRARY_PATH={path}", program, library)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--library", action="store_true", help="compile and link libkvision.so as well")
    parser.add_argument("--torch", type=Path, nargs="+", metavar="FOLDER", help="LibTorch for ARM, and what it needs")
    parser.add_argument("--folder", type=Path, default=ROOT / "build/arm", help="where to build (%(default)s)")
    options = parser.parse_args()
    if missing():
        sys.exit(f"missing: {', '.join(missing())}; apt install g++-aarch64-linux-gnu qemu-user cmake ninja-build")
    run_tests(options.folder / "tests")
    if options.library or options.torch:
        library = build_library(options.folder / "library")
        print(f"{library}: {library.stat().st_size / 1e6:.1f} MB, stable symbols only")
        if options.torch:
            call_operator(library, options.torch, options.folder)
