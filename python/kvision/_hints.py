"""Hints at what works, and is hardly what was meant. KVISION_HINTS=0 in the environment turns them off."""

from __future__ import annotations

import contextlib
import os
import sys
import warnings
from collections.abc import Iterator
from contextvars import ContextVar
from importlib import metadata
from pathlib import Path

import torch
from torch import Tensor, nn

from kvision import _check

__all__ = ["RangeWarning"]

_PACKAGES = tuple(
    f"{Path(module.__file__).parent}{os.sep}" for module in (_check, torch) if module.__file__
)  # between a call and this
_MOST_VALUES = 1 << 20  # that are looked at


class RangeWarning(UserWarning):
    """Floating-point images with values up to 255, which an operator clamps to [0, 1]: said once in a process.

    Looked at are images on the CPU of at most 2^20 values, in the first call of each operator that clamps. KVISION_HINTS=0 in the
    environment turns it off, as does `warnings.simplefilter("ignore", kvision.RangeWarning)`.

    Example:
        >>> import kvision as K
        >>> issubclass(K.RangeWarning, UserWarning)
        True
    """


class _Hints:
    are_on = os.environ.get("KVISION_HINTS") != "0"
    are_kept_back = ContextVar("are_kept_back", default=False)


@contextlib.contextmanager
def without_hints() -> Iterator[None]:
    """No hints from calls inside, as of a rule of vmap, which torch calls outside of the transform."""
    token = _Hints.are_kept_back.set(True)
    try:
        yield
    finally:
        _Hints.are_kept_back.reset(token)


def look_at_range(image: Tensor) -> None:
    """Warn if the values of an image that is clamped to [0, 1] are those of bytes. To be called where time does not matter."""
    if not _Hints.are_on or _Hints.are_kept_back.get():
        return
    if type(image) not in (Tensor, nn.Parameter) or not _check.values_are_readable(image):
        return
    if not image.is_cpu or not image.is_floating_point() or not 0 < image.numel() <= _MOST_VALUES:
        return
    if not 2 < (largest := image.detach().amax().item()) <= 255:
        return
    _Hints.are_on = False
    _warn(
        f"kvision: expected floating-point images in [0, 1], which values are clamped to, got values up to {largest:g}: divide by "
        "255, or pass uint8",
        RangeWarning,
    )


def look_at_opencv() -> None:
    """Warn if several distributions of OpenCV are installed. To be called when it is first used."""
    if os.environ.get("KVISION_HINTS") != "0" and (advice := advice_on_opencv()):
        _warn(f"kvision: {advice}", UserWarning)


def advice_on_opencv() -> str:
    """What to do about several distributions of OpenCV; nothing where there is one."""
    found = opencvs()
    if len(found) < 2:
        return ""
    return f"{' and '.join(found)} overwrite one another's files: uninstall all of them and install one."


def opencvs() -> list[str]:
    """The distributions of OpenCV that are installed: all write the one folder cv2."""
    found = []
    for name in ("opencv-python", "opencv-python-headless", "opencv-contrib-python", "opencv-contrib-python-headless"):
        try:
            found.append(f"{name} {metadata.version(name)}")
        except metadata.PackageNotFoundError:
            pass
    return found


def _warn(text: str, category: type[Warning]) -> None:
    """Warn at the line of the user's that led here."""
    level, frame = 1, sys._getframe()
    while frame.f_back is not None and frame.f_code.co_filename.startswith(_PACKAGES):
        level, frame = level + 1, frame.f_back
    warnings.warn(text, category, stacklevel=level)
