"""Builds kvision for pip: CMake and ninja make the libraries, setuptools packs them. All metadata is in pyproject.toml.

Environment:
    KVISION_BUILD   auto (the default): pure Python, saying why, where there is no compiler or no torch to build with, and
                    on systems other than Linux; native: that is an error, and others are tried; reference: pure Python.
                    Code that does not compile is always an error.
    KVISION_CUDA    AUTO (the default): the CUDA kernels where a GPU is visible and nvcc is found; ON, or OFF.
    KVISION_PYTHONS more interpreters to build kvision._C for, separated by colons; tools/build_wheels.py sets it.
    CMAKE_ARGS      passed on to CMake, say "-DKVISION_ISA=avx2" or "-DCMAKE_CUDA_ARCHITECTURES=89". Editable builds are
                    compiled for the instruction sets of this machine; "-DKVISION_ISA=" compiles them for all.
    CXX, CUDACXX    the compilers, read by CMake.
"""

from __future__ import annotations

import importlib.util
import os
import shlex
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

from setuptools import Command, Distribution, setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build import build
from setuptools.command.build_py import build_py

ROOT = Path(__file__).parent.resolve()
BUILD = os.environ.get("KVISION_BUILD", "auto")
if BUILD not in ("auto", "native", "reference"):
    sys.exit(f"KVISION_BUILD must be one of auto, native, reference; got {BUILD!r}")
CUDA = os.environ.get("KVISION_CUDA") or "AUTO"
if CUDA not in ("AUTO", "ON", "OFF"):
    sys.exit(f"KVISION_CUDA must be one of AUTO, ON, OFF; got {CUDA!r}")


def torch_root() -> Path | None:
    """The folder of a torch whose headers will do, hidden from import by build isolation or not."""
    spec = importlib.util.find_spec("torch")
    folders = [Path(spec.origin).parent] if spec and spec.origin else []
    folders += [Path(sysconfig.get_path(name), "torch") for name in ("purelib", "platlib")]
    stable = [folder for folder in folders if (folder / "include/torch/csrc/stable/library.h").exists()]
    return stable[0] if stable else None


def program(name: str) -> str | None:
    """A program installed by pip, for this Python or in the build environment, else one of the system."""
    return shutil.which(name, path=os.pathsep.join([sysconfig.get_path("scripts"), os.environ.get("PATH", "")]))


def why_pure() -> str | None:
    """Why nothing will be compiled, as far as that is known before CMake runs, when pip asks for the version."""
    if BUILD == "reference":
        return "KVISION_BUILD=reference asked for it"
    if BUILD == "auto" and sys.platform != "linux":
        return "its kernels were compiled on Linux alone so far; KVISION_BUILD=native tries it here"
    if torch_root() is None:
        return "there is no torch >= 2.11 to take the headers from"
    if not all(map(program, ("cmake", "ninja"))):
        return "cmake or ninja is missing"
    compilers = shlex.split(os.environ.get("CXX", ""))[:1] or ["c++", "g++", "clang++"]
    return None if any(map(is_served, compilers)) else "there is no GCC or Clang"


def is_served(compiler: str) -> bool:
    """Whether it is GCC or Clang, which defines the same; CMakeLists.txt refuses others."""
    if shutil.which(compiler) is None:
        return False
    command = (compiler, "-dM", "-E", "-x", "c++", os.devnull)
    return "__GNUC__" in subprocess.run(command, capture_output=True, text=True).stdout


class NativeDistribution(Distribution):
    def has_ext_modules(self) -> bool:
        return True  # "holds machine code": what is packed belongs in platlib


class BuildNative(Command):
    """Build the libraries into the package: for an editable one in build/cmake, kept for ninja; else from scratch."""

    description = "build the C++ and CUDA libraries with CMake"
    # setuptools sets editable_mode for `pip install --editable`; the Makefile builds with it before pip, which hides progress.
    user_options = [("editable-mode", None, "build into python/kvision, in build/cmake")]
    boolean_options = ["editable-mode"]
    editable_mode = False

    def initialize_options(self) -> None:
        self.build_lib: str | None = None

    def finalize_options(self) -> None:
        self.set_undefined_options("build", ("build_lib", "build_lib"))

    def get_source_files(self) -> list[str]:
        return []  # MANIFEST.in lists them

    def run(self) -> None:
        package = ROOT / "python/kvision" if self.editable_mode else Path(self.build_lib or "", "kvision").resolve()
        record = package / "lib/pure_python.txt"  # read by kvision.info
        record.unlink(missing_ok=True)
        reason = why_pure() or self.build(package)
        if reason is None:
            return
        if BUILD == "native":
            sys.exit(f"kvision: KVISION_BUILD=native, but {reason}")
        record.parent.mkdir(parents=True, exist_ok=True)
        record.write_text(reason)
        print(f"\n*** kvision is installed as pure Python, without its fast kernels: {reason}. ***\n", file=sys.stderr)

    def build(self, package: Path) -> str | None:
        """Build and install into `package`; where that cannot be done here, the reason."""
        cmake, ninja, torch = program("cmake"), program("ninja"), torch_root()
        assert cmake and ninja and torch  # why_pure
        folder = ROOT / "build" / ("cmake" if self.editable_mode else "wheel")
        if not self.editable_mode:
            shutil.rmtree(ROOT / "build/wheel", ignore_errors=True)
        configure = [
            *(cmake, "-S", ROOT, "-B", folder, "-G", "Ninja", f"-DCMAKE_MAKE_PROGRAM={ninja}"),
            *("-U", "TorchStable_*", f"-DTORCH_ROOT={torch}", f"-DPython_EXECUTABLE={sys.executable}"),
            *("-DCMAKE_INSTALL_LIBDIR=lib", f"-DKVISION_INPLACE={'ON' if self.editable_mode else 'OFF'}"),
            f"-DKVISION_CUDA={CUDA}",
            *(["-DKVISION_ISA=native"] if self.editable_mode else []),
            f"-DKVISION_PYTHONS={os.environ.get('KVISION_PYTHONS', '').replace(os.pathsep, ';')}",
            *shlex.split(os.environ.get("CMAKE_ARGS", "")),
        ]
        if subprocess.run(configure).returncode != 0:
            return "CMake found no GCC or Clang with C++20 or no torch it can build with (its output: pip install -v)"
        left_out = folder / "cuda_left_out.txt"  # written by CMakeLists.txt
        note = f"kvision: {left_out.read_text()}\n" if left_out.exists() else ""
        print(
            f"{note}kvision: compiling takes {self.minutes()}; [n/m, s] counts what is done and the seconds", flush=True
        )
        progress = {"NINJA_STATUS": "[%f/%t, %e s] ", **os.environ}
        if subprocess.run([cmake, "--build", folder], env=progress).returncode != 0:
            sys.exit("kvision: the build failed. KVISION_BUILD=reference installs pure Python instead.")
        print(note, end="", flush=True)
        if not self.editable_mode:
            for component in ([], ["--component", "python"]):
                subprocess.run([cmake, "--install", folder, "--prefix", package, *component], check=True)
        return None

    def minutes(self) -> str:
        """About how long the CPU library takes, from scratch and on idle cores."""
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        seconds = (235 if self.editable_mode else 320) / cores
        return f"about {max(round(seconds / 60), 1)} min on {cores} cores, the CUDA kernels as much again"


class Build(build):
    sub_commands = [("build_py", None), ("build_native", None)]

    def run(self) -> None:
        shutil.rmtree(ROOT / "build/pip", ignore_errors=True)  # modules deleted since the last build
        super().run()


class BuildPy(build_py):
    """The modules, and the table of differences that kvision.migrate reads."""

    def run(self) -> None:
        super().run()
        if not self.editable_mode:
            self.copy_file("docs/differences.md", str(Path(self.build_lib, "kvision/differences.md")))


class BdistWheel(bdist_wheel):
    """The libraries serve every Python; kvision._C serves the one it was built with, and kvision works without it."""

    def get_tag(self) -> tuple[str, str, str]:
        native = any(Path(self.bdist_dir).glob("kvision/lib/libkvision.*"))
        return "py3", "none", super().get_tag()[2] if native else "any"


options = {"build": {"build_base": "build/pip"}}
if BUILD != "native" and why_pure() and "sdist" not in sys.argv:
    options["egg_info"] = {"tag_build": "+python"}  # the version 0.1.0+python, which pip prints
setup(
    distclass=NativeDistribution,
    cmdclass={"build": Build, "build_py": BuildPy, "build_native": BuildNative, "bdist_wheel": BdistWheel},
    options=options,
    # For an isolated build where no torch is installed: any will do, so none is fetched where one is.
    setup_requires=["torch>=2.11"] if BUILD != "reference" and torch_root() is None else [],
)
