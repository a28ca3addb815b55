"""Cross-compile the CPU kernels for 64-bit ARM, whose vectors are NEON, and run their C++ tests in an emulator.

    python tools/test_arm.py                           csrc/tests: half a minute
    python tools/test_arm.py --library                 besides, all of libkvision.so, compiled, linked and audited: minutes
    python tools/test_arm.py --torch FOLDER...         besides, CALLS by it in the LibTorch for ARM of these folders: a minute more
    CXX=clang++-19 python tools/test_arm.py ...        compiled by Clang instead of GCC

It needs an aarch64 GCC, which brings the headers and libraries that Clang uses too, and qemu-user:
apt install g++-aarch64-linux-gnu qemu-user. The library is linked with an empty stand-in for
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
import warnings
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
import audit_symbols

ROOT = Path(__file__).parents[1]
TOOLCHAIN = ROOT / "tools/aarch64.cmake"
# Of benchmarks/sample_calls, one or more for each way in which kernels read memory.
CALLS = (
    "color.rgb_to_grayscale color.rgb_to_hsv color.rgb_to_lab contrib.connected_components contrib.distance_transform "
    "contrib.extract_tensor_patches enhance.adjust_hue enhance.equalize enhance.equalize_clahe enhance.jpeg_codec_differentiable "
    "filters.bilateral_blur filters.box_blur filters.canny filters.filter2d filters.gaussian_blur2d filters.median_blur "
    "filters.sobel filters.spatial_gradient geometry.hflip geometry.pyrdown geometry.remap geometry.resize geometry.warp_affine "
    "geometry.warp_perspective losses.ssim_loss losses.total_variation morphology.dilation"
).split()


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


def trace_calls(folder: Path) -> list[Path]:
    """CALLS, traced here; each gives its largest difference from this machine's result."""
    sys.path.insert(0, str(ROOT))
    import torch

    import kvision as K
    from benchmarks.sample_calls import Size, sample_calls
    from benchmarks.sample_calls.model import SampleCall

    folder.mkdir(parents=True, exist_ok=True)

    class Call(torch.nn.Module):
        def __init__(self, call: SampleCall) -> None:
            super().__init__()
            self.call, self.tensors = call, call.tensors(Size(2, 3, 17, 70))
            self.expected = self.results()

        def results(self) -> list[torch.Tensor]:
            result = self.call.call(K, self.tensors)
            return [result] if isinstance(result, torch.Tensor) else list(result)

        def forward(self) -> torch.Tensor:
            both = zip(self.results(), self.expected)
            return torch.stack([(a.double() - b.double()).abs().max() for a, b in both]).max()

    calls = {call.name: call for call in sample_calls()}
    paths, operators = [], set()
    for name in CALLS:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of sizes that are recorded as numbers
            traced = torch.jit.trace(Call(calls[name]), ())
        operators |= set(re.findall(r"kvision::(\w+)", str(traced.inlined_graph)))
        paths.append(folder / f"{name}.pt")
        traced.save(str(paths[-1]))
    print(f"{len(operators)} operators: {' '.join(sorted(operators))}")
    return paths


def call_operators(library: Path, torch: list[Path], folder: Path) -> None:
    """The library in the LibTorch for ARM of the folders `torch`."""
    headers, program = torch_headers(), folder / "call_operator"
    run(
        *("aarch64-linux-gnu-g++", "-std=c++20", "-w", f"-I{headers}", f"-I{headers}/torch/csrc/api/include"),
        *(ROOT / "tools/call_operator.cpp", "-o", program, f"-L{torch[0]}", "-lc10", "-ltorch_cpu"),
        *("-Wl,--allow-shlib-undefined", "-rdynamic"),
    )
    path = ":".join(str(part.resolve()) for part in torch)
    emulator = ("qemu-aarch64", "-L", "/usr/aarch64-linux-gnu", "-E", f"LD_LIBRARY_PATH={path}")
    run(*emulator, program, library, *trace_calls(folder / "calls"))


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
            call_operators(library, options.torch, options.folder)
