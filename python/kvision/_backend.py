"""The backend: which libraries of kernels are loaded, and whether the process or a block chose kernels or references.

The only module that loads kvision's libraries. `_ops.Operator` calls it to find what serves a call.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
import threading
import warnings
from collections.abc import Iterator
from contextvars import ContextVar
from pathlib import Path

import torch
import torch.compiler.config
from torch.compiler import is_compiling

from kvision import _check
from kvision._torch_compat import find_operator, has_kernel
from kvision._version import __version__
from kvision.core.exceptions import ValueCheckError

# --- libraries ------------------------------------------------------------------------------------------------------

_SUFFIX = ".dylib" if sys.platform == "darwin" else ".so"
LIBRARIES = {"cpu": f"libkvision{_SUFFIX}", "cuda": f"libkvision_cuda{_SUFFIX}"}
LIBRARY_FOLDER = Path(__file__).parent / "lib"

# device type -> why its kernels are not there; a device missing here is served.
unserved: dict[str, str] = {}
# What is slower than it need be, and why: the warning of the import.
slower: dict[str, str] = {}


def _load() -> None:
    for device, name in LIBRARIES.items():
        path = LIBRARY_FOLDER / name
        if device == "cuda" and not torch.backends.cuda.is_built():
            unserved[device] = "this torch was built without CUDA"
        elif device == "cuda" and "cpu" in unserved:
            unserved[device] = f"{LIBRARIES['cpu']}, which declares the operators, is not loaded"
        elif not path.exists():
            unserved[device] = f"{name} was not built: reinstall kvision on a machine with {_compiler(device)}"
        else:
            if device == "cpu":
                _refuse_another_copy(path)
            try:
                torch.ops.load_library(path)
            except OSError as error:
                unserved[device] = f"{name} does not load: {error}"
            else:
                if device == "cuda" and (reason := _old_driver(path)):
                    unserved[device] = slower["images on the GPU"] = reason


def _refuse_another_copy(library: Path) -> None:
    """Raise ImportError where another file has declared the operators: loading this one would abort the process."""
    if find_operator("kvision", "sobel") is None:
        return
    try:
        ctypes.CDLL(str(library), mode=os.RTLD_NOLOAD)
    except OSError:
        others = [path for path in torch.ops.loaded_libraries if Path(path).name == library.name]
        raise ImportError(
            f"kvision: {library} cannot be loaded beside the copy that this process has loaded already"
            f"{''.join(f', {path}' for path in others)}; import kvision from one place only",
            path=str(library),
        ) from None


def _old_driver(library: Path) -> str:
    """Why the driver cannot run the CUDA library, which brings its own runtime. Empty if it can, or if there is no driver."""
    driver = ctypes.c_int()
    try:
        ctypes.CDLL("libcuda.so.1").cuDriverGetVersion(ctypes.byref(driver))
    except OSError:
        return ""
    latest, needed = driver.value // 1000, ctypes.CDLL(str(library)).kvision_cuda_runtime() // 1000
    if not 0 < latest < needed:  # a driver runs all minor versions of its CUDA
        return ""
    return f"the driver runs CUDA {latest} at most, {library.name} was built with CUDA {needed}"


# What the library and its build read from the environment, after KVISION_.
_VARIABLES = ("BACKEND", "BUILD", "CUDA", "HINTS", "ISA", "PYTHONS", "SHARED_MEMORY")


def _check_environment() -> None:
    """Warn of variables whose names are nearly those of the library's, and of an instruction set that is not in use."""
    for variable in os.environ:
        prefix, _, name = variable.partition("_")
        if prefix.upper() != "KVISION" or (prefix == "KVISION" and name in _VARIABLES):
            continue
        if nearest := _check.nearest_name(name, _VARIABLES):
            warnings.warn(
                f"kvision: {variable} in the environment has no effect; did you mean KVISION_{nearest}?", stacklevel=3
            )
    chosen = os.environ.get("KVISION_ISA")
    if chosen and "cpu" not in unserved:
        library = ctypes.CDLL(str(LIBRARY_FOLDER / LIBRARIES["cpu"]))
        library.kvision_active_isa.restype = ctypes.c_char_p
        if (active := library.kvision_active_isa().decode()) != chosen:
            warnings.warn(f"kvision: KVISION_ISA={chosen} is not supported here; {active} is in use", stacklevel=3)


def _compiler(device: str) -> str:
    return "nvcc and a C++20 compiler" if device == "cuda" else "a C++20 compiler"


_load()
_check_environment()
if "cpu" in unserved:
    slower["everything"] = unserved["cpu"]

# torch finds the compiled graphs that it keeps on disk by the names of the operators in them. Those of another kvision may
# have other arguments and other gradients.
torch.compiler.config.cache_key_tag += f";kvision {__version__}"

# --- which backend serves a call ------------------------------------------------------------------------------------

_BACKENDS = ("auto", "native", "reference")


def _checked_backend(name: str) -> str:
    if name not in _BACKENDS:
        raise ValueCheckError(f"backend: expected one of {', '.join(_BACKENDS)}; got {name!r}", actual_value=name)
    return name


def set_default_backend(name: str) -> None:
    """Choose what serves calls outside of `backend` blocks, in all threads; KVISION_BACKEND is the first choice."""
    global default_backend, ask_backend
    with _blocks_lock:
        default_backend = _checked_backend(name)
        ask_backend = _blocks > 0 or default_backend != "auto"


class _ThreadBackend(threading.local):
    """The backend of the block that a thread entered last. torch.compile can guard on it, but not on a ContextVar."""

    def __init__(self) -> None:
        self.name: str | None = None
        self.blocks: list[list[str]] = []  # names of the open ones, which tasks that take turns end in any order


_task_backend: ContextVar[str | None] = ContextVar("kvision_backend", default=None)
_thread_backend = _ThreadBackend()
_blocks, _blocks_lock = 0, threading.Lock()  # how many blocks are open in the process
# Whether a call has to ask current_backend(), which costs more than this global. False in a process that chooses nothing.
ask_backend = False
default_backend = "auto"
set_default_backend(os.environ.get("KVISION_BACKEND") or "auto")


def current_backend() -> str:
    """What this task has chosen: the name of its innermost `backend` block, else the default of the process."""
    name = _thread_backend.name if is_compiling() else _task_backend.get()
    return default_backend if name is None else name


for _what, _why in slower.items() if default_backend == "auto" else ():
    warnings.warn(
        f"kvision computes {_what} in plain torch, which is slower: {_why}. `python -m kvision.info` says "
        "what to do; KVISION_BACKEND=reference in the environment accepts it.",
        RuntimeWarning,
        stacklevel=2,
    )


@contextlib.contextmanager
def backend(name: str) -> Iterator[None]:
    """Choose what serves kvision's operators inside a `with` block.

    The choice holds for the thread and, under asyncio, the task that entered the block; a thread started inside begins
    with the default of the process. Gradients are served as the call that they belong to was. A function compiled by
    torch.compile follows the block that its thread entered last, also where tasks take turns in this thread.

    Args:
        name: "auto" takes the kernel where there is one and the reference elsewhere; "reference" always takes the
            pure-torch reference; "native" makes a missing kernel an error that says what is missing. The environment
            variable KVISION_BACKEND sets the default of the process.

    Returns:
        A context manager, which is also a decorator of functions.

    Raises:
        ValueCheckError: `name` is none of the three.

    Example:
        >>> import torch, kvision as K
        >>> with K.backend("reference"):
        ...     K.filters.sobel(torch.zeros(1, 1, 2, 2))
        tensor([[[[0.0010, 0.0010],
                  [0.0010, 0.0010]]]])
    """
    _checked_backend(name)
    if is_compiling():
        with _traced_backend(name):
            yield
        return
    task, blocks, block = _task_backend.get(), _thread_backend.blocks, [name]
    _count_blocks(1)
    _task_backend.set(name)
    blocks.append(block)
    _thread_backend.name = name
    try:
        yield
    finally:
        _task_backend.set(task)  # not reset(): an asynchronous generator may end in another context
        blocks[:] = [other for other in blocks if other is not block]
        _thread_backend.name = _thread_backend.blocks[-1][0] if _thread_backend.blocks else None
        _count_blocks(-1)


@contextlib.contextmanager
def _traced_backend(name: str) -> Iterator[None]:
    """`backend` in terms that torch.compile traces: neither locks nor ContextVars."""
    global ask_backend
    ask, thread = ask_backend, _thread_backend.name
    ask_backend, _thread_backend.name = True, name
    try:
        yield
    finally:
        ask_backend, _thread_backend.name = ask, thread


def _count_blocks(change: int) -> None:
    global _blocks, ask_backend
    with _blocks_lock:
        _blocks += change
        ask_backend = _blocks > 0 or default_backend != "auto"


def unserved_devices(name: str) -> dict[str, str]:
    """Device type -> why no kernel serves operator `name` there: the whole library, or an older one that lacks it."""
    reasons = dict(unserved)
    for device, library in LIBRARIES.items():
        if "cpu" in unserved or device in unserved:
            continue
        declared = find_operator("kvision", name) is not None
        if not declared or not has_kernel(f"kvision::{name}", device.upper()):
            reasons[device] = f"{name} is not in {library}, which is older: build kvision again"
    return reasons
