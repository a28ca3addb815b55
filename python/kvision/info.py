"""Versions, libraries and what the kernels serve: `kvision.info()` and `python -m kvision.info`.

The module itself is callable, so that both are one name. kvision/__init__.py imports it on first use.
"""

from __future__ import annotations

import argparse
import ctypes
import platform
import shutil
import sys
import textwrap
import time
import types
from collections.abc import Iterator
from pathlib import Path

import torch

from kvision import _backend, _hints, _ops
from kvision._version import __version__

try:
    from kvision import _C
except ImportError:  # not built, or built for another Python; only this report uses it
    _C = None

_PACKAGE = Path(__file__).parent
_DTYPES = (*_ops.FLOATS, torch.uint8, torch.int64)


def report(operators: bool = False) -> str:
    """The text that `kvision.info()` prints: versions, libraries, what the kernels serve, what to do about the rest.

    Args:
        operators: with the table of all operators, and the conditions under which their kernels serve a call.

    Returns:
        Lines of text, 80 columns wide without the table.

    Example:
        >>> import kvision as K
        >>> print(K.info.report())  # doctest: +ELLIPSIS
        kvision ...
    """
    parts = [_versions(), _libraries(), _speed(), _operators() if operators else _operator_counts(), _next_steps()]
    return "\n\n".join("\n".join(part if operators else map(_wrapped, part)) for part in parts)


def _wrapped(line: str) -> str:
    """In 80 columns, continued four to the right of where the line begins."""
    indent = " " * (len(line) - len(line.lstrip()) + 4)
    return textwrap.fill(line, 80, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


def _versions() -> Iterator[str]:
    yield f"kvision {__version__}  ({_PACKAGE})"
    yield f"torch {torch.__version__}, Python {platform.python_version()}, {platform.machine()}"
    yield ", ".join(_hints.opencvs()) or "no OpenCV"


def _libraries() -> Iterator[str]:
    yield "Libraries"
    yield f"  cpu   {_backend.unserved.get('cpu') or _cpu_library()}"
    yield from _why_pure()
    yield f"  cuda  {_backend.unserved.get('cuda') or _cuda_library()}"
    if "cuda" not in _backend.unserved:
        yield from (f"        {line}" for line in _gpus())


def _cpu_library() -> str:
    name = _backend.LIBRARIES["cpu"]
    if _C is None:
        return f"{name}; no details, as kvision._C was not built for this Python"
    sets = ", ".join(
        isa + (" (in use)" if isa == _C.active_isa() else "")
        for isa in ("baseline", "avx2", "avx512", "neon")
        if _C.isa_supported(isa)
    )
    return f"{name} {_C.version()}, compiler {_C.compiler()}; instruction sets here: {sets}; KVISION_ISA chooses"


def _why_pure() -> Iterator[str]:
    record = _backend.LIBRARY_FOLDER / "pure_python.txt"  # written by setup.py
    if record.exists():
        yield f"        installed as pure Python: {record.read_text().strip()}"


def _cuda_library() -> str:
    runtime = _cuda().kvision_cuda_runtime()
    return (
        f"{_backend.LIBRARIES['cuda']}, CUDA {runtime // 1000}.{runtime % 1000 // 10}, architectures {_architectures()}"
    )


def _cuda() -> ctypes.CDLL:
    library = ctypes.CDLL(str(_backend.LIBRARY_FOLDER / _backend.LIBRARIES["cuda"]))
    library.kvision_cuda_architectures.restype = ctypes.c_char_p
    return library


def _architectures() -> str:
    return _cuda().kvision_cuda_architectures().decode()


def _gpus() -> Iterator[str]:
    for i in range(torch.cuda.device_count()):
        major, minor = torch.cuda.get_device_capability(i)
        fits = "" if _has_code_for(_architectures(), 10 * major + minor) else ": NO KERNELS for it, see below"
        yield f"{torch.cuda.get_device_name(i)}, architecture {major}{minor}{fits}"
    if not torch.cuda.is_available():
        yield "no GPU is visible"


def _has_code_for(architectures: str, capability: int) -> bool:
    """Whether one of CMake's architectures, say "80-real;90" or "80-real,90", runs on a GPU of this compute capability.

    Machine code runs on GPUs of its generation whose number is as high or higher. PTX runs on all later ones, too; "90" has
    it, "90-real" does not.
    """
    for architecture in architectures.replace(",", ";").split(";"):
        number, _, kind = architecture.partition("-")
        code = int(number.rstrip("af"))
        if code <= capability and (kind != "real" or code // 10 == capability // 10):
            return True
    return False


def _speed() -> Iterator[str]:
    yield "Memory: what an operator that reads an image and writes one can reach"
    yield f"  cpu   copies {_copy_speed('cpu'):.1f} GB/s, read and written, with {torch.get_num_threads()} threads"
    if torch.cuda.is_available():
        yield f"  cuda  copies {_copy_speed('cuda'):.0f} GB/s, read and written"


def _copy_speed(device: str) -> float:
    """Gigabytes read and written in a second, by the fastest of five copies of 64 MiB, more than a cache holds."""
    source = torch.zeros(2**26, dtype=torch.uint8, device=device)
    target = torch.zeros_like(source)
    seconds = []
    for _ in range(5):
        _synchronize(device)
        begin = time.perf_counter()
        target.copy_(source)
        _synchronize(device)
        seconds.append(time.perf_counter() - begin)
    return 2 * source.numel() / min(seconds) / 1e9


def _synchronize(device: str) -> None:
    if device == "cuda":
        torch.cuda.synchronize()


def _operator_counts() -> Iterator[str]:
    names = [name for name in _ops.operators if "backward" not in name]
    yield f"Operators (backend {_backend.current_backend()!r}): python -m kvision.info --operators lists them"
    for device in ("cpu", "cuda"):
        yield f"  {device:5} kernels serve {sum(bool(_served(name, device)) for name in names)} of {len(names)}"
    missing = list(_missing_operators())
    yield from missing[:3]
    if len(missing) > 3:
        yield f"  and {len(missing) - 3} more"
    yield "  The reference serves the rest: the same results from plain torch, slower."


def _missing_operators() -> Iterator[str]:
    """Why single operators, those for backward too, have no kernel on a device that others have kernels for."""
    for operator in _ops.operators.values():
        yield from (f"  {reason}" for device, reason in operator.unserved.items() if device not in _backend.unserved)


def _operators() -> Iterator[str]:
    names = sorted(name for name in _ops.operators if "backward" not in name)
    width = max(map(len, names), default=0)
    yield f"Operators (backend {_backend.current_backend()!r}): what the kernels serve, gradients likewise"
    yield f"  {'':{width}}  {'cpu':42}  cuda"
    for name in names:
        served = [" ".join(_served(name, device)) or "reference" for device in ("cpu", "cuda")]
        yield f"  {name:{width}}  {served[0]:42}  {served[1]}"
    yield from _missing_operators()
    yield "Everything else is served by the reference: the same results from plain torch, slower."
    yield ""
    yield "Conditions: where they do not hold the reference serves, and backend 'native' raises"
    for name, operator in sorted(_ops.operators.items()):
        yield from (f"  {name}: {condition}" for condition in operator.conditions())


def _served(name: str, device: str) -> list[str]:
    operator = _ops.operators[name]
    if device in operator.unserved or _backend.current_backend() == "reference":
        return []
    return [str(dtype).removeprefix("torch.") for dtype in _DTYPES if dtype in operator.dtypes]


def _next_steps() -> Iterator[str]:
    steps = []
    if _backend.current_backend() == "reference":
        steps.append("for the kernels, unset KVISION_BACKEND or leave the block `with kvision.backend('reference')`.")
    if "cpu" in _backend.unserved:
        steps.append(
            "for the kernels, install a C++20 compiler (GCC >= 12 or Clang >= 19) and install kvision again; "
            "KVISION_BUILD=native then makes a build that cannot be done an error that says why."
        )
    if "cuda" in _backend.unserved:
        if shutil.which("nvidia-smi") is None:
            steps.append("there is no NVIDIA driver here, so nothing is lost without CUDA.")
        elif not torch.backends.cuda.is_built():
            steps.append("to use the GPU, install a torch with CUDA: https://pytorch.org/get-started")
        elif "images on the GPU" in _backend.slower:
            steps.append("to use the GPU, update its driver, or install kvision again with the nvcc of an older CUDA.")
        else:
            steps.append("to use the GPU, put nvcc (CUDA >= 12) on the PATH and install kvision again.")
    elif any("NO KERNELS" in line for line in _gpus()):
        steps.append("install kvision again on this machine, or with CUDAARCHS set to the GPU's architecture.")
    if advice := _hints.advice_on_opencv():
        steps.append(advice)
    yield "What to do"
    yield from (f"  {step}" for step in steps or ["nothing: every kernel this machine can use is in use."])


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m kvision.info", description=__doc__.partition("\n")[0])
    parser.add_argument(
        "--cmake-prefix-path",
        action="store_true",
        help="print the folders where CMake's find_package finds kvision and torch, for -DCMAKE_PREFIX_PATH",
    )
    parser.add_argument("--operators", action="store_true", help="print the table of all operators as well")
    options = parser.parse_args()
    if options.cmake_prefix_path:
        print(f"{_PACKAGE};{torch.utils.cmake_prefix_path}")
    else:
        print(report(options.operators))


class _Callable(types.ModuleType):
    def __call__(self) -> None:
        """Print what was built, which types the kernels serve on which device, why not others, and what to do about it.

        Example:
            >>> import kvision as K
            >>> K.info()  # doctest: +ELLIPSIS
            kvision ...
        """
        print(report())


if __name__ == "__main__":
    main()
else:
    sys.modules[__name__].__class__ = _Callable
