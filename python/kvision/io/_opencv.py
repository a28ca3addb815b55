"""OpenCV, imported when the first file is read or written: `import kvision` does not need it."""

from __future__ import annotations

from types import ModuleType


def opencv() -> ModuleType:
    try:
        import cv2
    except ImportError as error:
        raise ImportError(
            "kvision.io reads and writes files with OpenCV: pip install opencv-python-headless"
        ) from error
    if not hasattr(cv2, "imdecodeWithMetadata"):
        raise ImportError(
            f"kvision.io needs OpenCV 4.12 or newer, found {cv2.__version__}: pip install -U opencv-python-headless"
        )
    return cv2
