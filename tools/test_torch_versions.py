"""`python tools/test_torch_versions.py [VERSION ...]`: the core of the suite on other versions of torch.

Makes a virtual environment for each version below build/ and runs there the tests of the operator path, of the private
parts of torch that kvision reaches and of two filters. Nothing is compiled: the libraries in python/kvision/lib use
torch's stable ABI only, so the built ones have to work with every torch from the oldest supported one on.

Default: the oldest version that pyproject.toml admits and the newest that pip finds. Run it before a release. An
environment is reused; a new one takes minutes. For Linux PyPI has CUDA builds of torch, 3 GB to download and 6 GB
on disk, which need all of NVIDIA's packages to be imported. `--index https://download.pytorch.org/whl/cpu` takes the CPU
builds from PyTorch's own index instead: 0.2 GB.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import venv
from pathlib import Path

ROOT = Path(__file__).parents[1]
TESTS = (
    *("tests/test_ops.py", "tests/packaging/test_torch_compat.py"),
    *("tests/filters/edges/test_sobel.py", "tests/filters/smoothing/test_box.py"),
)
# What the tests import besides torch.
PACKAGES = ("numpy", "opencv-python-headless>=4.12", "scikit-image", "scipy", "kornia", "pytest", "hypothesis")


class FailedError(Exception):
    """A command failed. The message is its output."""


def oldest() -> str:
    """The oldest version that pyproject.toml admits."""
    match = re.search(r'"torch>=([\d.]+)"', (ROOT / "pyproject.toml").read_text())
    if match is None:
        raise FailedError("pyproject.toml states no oldest version of torch")
    return match[1]


def newest(index: list[str]) -> str:
    """The newest version that pip finds for this Python."""
    output = run(sys.executable, "-m", "pip", "index", "versions", "torch", *index)
    match = re.search(r"Available versions: ([\d.]+)", output)
    if match is None:
        raise FailedError(f"pip finds no version of torch:\n{output}")
    return match[1]


def run(*command: str | Path, **variables: str) -> str:
    """Return the command's output. Raises FailedError with the output if it fails."""
    done = subprocess.run(
        [str(part) for part in command],
        cwd=ROOT,
        env={**os.environ, **variables},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    if done.returncode != 0:
        raise FailedError(done.stdout)
    return done.stdout


def python_with_torch(version: str, index: list[str]) -> Path:
    """The Python of the environment with this version of torch. Creates the environment if it is not complete."""
    folder = ROOT / "build" / f"torch-{version}"
    python, complete = folder / "bin" / "python", folder / "complete"
    if not complete.exists():
        venv.create(folder, with_pip=True, clear=True)
        # torch alone from the index, which may lack the rest. Those that need a torch are content with the installed one.
        run(python, "-m", "pip", "install", "--quiet", f"torch=={version}", *index)
        run(python, "-m", "pip", "install", "--quiet", *PACKAGES, f"torch=={version}")
        complete.touch()
    return python


def test(version: str, tests: list[str], index: list[str]) -> bool:
    """Run the tests on one version and print a line with the result. Returns whether all tests passed."""
    try:
        python = python_with_torch(version, index)
    except FailedError as error:
        print(f"torch {version:10} NOT INSTALLED\n{str(error)[-3000:]}", flush=True)
        return False
    path = str(ROOT / "python")
    torch_version = run(python, "-c", "import torch; print(torch.__version__)").strip()
    try:
        output = run(
            *(python, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--disable-warnings", "-m", "not slow", *tests),
            PYTHONPATH=path,
        )
    except FailedError as error:
        print(f"torch {torch_version:10} FAILED\n{str(error)[-6000:]}", flush=True)
        return False
    print(f"torch {torch_version:10} {output.strip().splitlines()[-1]}", flush=True)
    return True


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("versions", nargs="*", metavar="VERSION", help="default: the oldest and the newest supported")
    parser.add_argument("--tests", nargs="+", default=TESTS, metavar="PATH", help=f"default: {' '.join(TESTS)}")
    parser.add_argument("--index", metavar="URL", help="package index to take torch from; default: that of pip")
    options = parser.parse_args()
    if not (ROOT / "python/kvision/lib/libkvision.so").exists():
        parser.error("python/kvision/lib/libkvision.so is missing: build kvision first")
    index = ["--index-url", options.index] if options.index else []
    try:
        versions = options.versions or [oldest(), newest(index)]
    except FailedError as error:
        parser.error(str(error))
    return 0 if all([test(version, options.tests, index) for version in versions]) else 1


if __name__ == "__main__":
    sys.exit(main())
