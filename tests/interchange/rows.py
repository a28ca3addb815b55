"""The rows of docs/interchange.md: what a library does, what kvision does, and the test that both are true.

A file test_SUBJECT.py is a table of the page; its docstring is the heading and what comes below it. `@row` makes a test a row of
the table. `make interchange` installs the packages and runs all; `python tests/interchange/rows.py` writes the page.
"""

from __future__ import annotations

import functools
import importlib
import re
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch

FOLDER = Path(__file__).parent
PAGE = FOLDER.parents[1] / "docs" / "interchange.md"
SUBJECTS = (
    "resizing",
    "color",
    "directions",
    "warps",
    "filters",
    "measures",
    "rotations",
    "cameras",
    "volumes",
    "boxes",
    "features",
    "exchange",
    "training",
)
# The name on the page: the module to import, the distribution.
LIBRARIES = {
    "AlbumentationsX": ("albumentations", "albumentationsx"),
    "COLMAP": ("pycolmap", "pycolmap"),
    "colour": ("colour", "colour-science"),
    "DALI": ("nvidia.dali", "nvidia-dali-cuda120"),
    "jax": ("jax", "jax"),
    "Kornia": ("kornia", "kornia"),
    "Matplotlib": ("matplotlib", "matplotlib"),
    "nibabel": ("nibabel", "nibabel"),
    "NumPy": ("numpy", "numpy"),
    "OpenCV": ("cv2", "opencv-python-headless"),
    "OpenVINO": ("openvino", "openvino"),
    "Pillow": ("PIL", "pillow"),
    "piq": ("piq", "piq"),
    "PyAV": ("av", "av"),
    "pycocotools": ("pycocotools", "pycocotools"),
    "PyPose": ("pypose", "pypose"),
    "pyquaternion": ("pyquaternion", "pyquaternion"),
    "pyvips": ("pyvips", "pyvips"),
    "pyarrow": ("pyarrow", "pyarrow"),
    "scikit-image": ("skimage", "scikit-image"),
    "SimpleITK": ("SimpleITK", "simpleitk"),
    "SciPy": ("scipy", "scipy"),
    "torch": ("torch", "torch"),
    "torchdata": ("torchdata", "torchdata"),
    "torchmetrics": ("torchmetrics", "torchmetrics"),
    "transforms3d": ("transforms3d", "transforms3d"),
    "torchvision": ("torchvision", "torchvision"),
}


class Row(NamedTuple):
    library: str
    fact: str
    kvision: str


def row(library: str, fact: str, kvision: str) -> Callable[[Callable[[Any], None]], Callable[[], None]]:
    """Make a test, which gets the module of the library, a row of the page."""

    def decorate(check: Callable[[Any], None]) -> Callable[[], None]:
        @functools.wraps(check)
        def test() -> None:
            module = load(library)
            try:
                check(module)
            except AssertionError as error:
                raise AssertionError(
                    f"{library} {version(library)}, pinned {PINNED[library]}: no longer {fact!r}"
                ) from error

        del test.__wrapped__  # type: ignore[attr-defined]  # pytest would read its arguments
        test.row = Row(library, fact, kvision)  # type: ignore[attr-defined]
        return pytest.mark.interchange(test)

    return decorate


def version(library: str) -> str:
    return metadata.version(LIBRARIES[library][1]).partition("+")[0]


def load(library: str) -> Any:
    try:
        metadata.version(LIBRARIES[library][1])
    except metadata.PackageNotFoundError:
        pytest.skip(f"{library} is not installed")
    if library == "torchvision":
        _declare_operators_of_torchvision()
    return importlib.import_module(LIBRARIES[library][0])


@functools.cache
def _declare_operators_of_torchvision() -> torch.library.Library | None:
    """The wheels of PyPI are built for CUDA: beside a torch for the CPU their operators do not load, and the import fails."""
    if torch.version.cuda is not None:
        return None
    operators = torch.library.Library("torchvision", "FRAGMENT")
    for name in ("nms", "qnms"):
        operators.define(f"{name}(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")
    return operators


def _pinned() -> dict[str, str]:
    files = FOLDER.parents[1] / "constraints.txt", *sorted(FOLDER.glob("*.txt"))
    pins = re.findall(r"^([\w.-]+)==([^\s+;]+)", "\n".join(file.read_text() for file in files), re.MULTILINE)
    first = dict(reversed(pins))  # what constraints.txt pins again is for older Pythons
    return {library: first[distribution] for library, (_, distribution) in LIBRARIES.items()}


PINNED = _pinned()


# --- values ---------------------------------------------------------------------------------------------------------


def array(x: Any) -> np.ndarray:
    return x.detach().cpu().numpy() if isinstance(x, torch.Tensor) else np.asarray(x)


def same(a: Any, b: Any, tolerance: float = 1e-5) -> bool:
    """Of one shape, up to axes of size 1, and equal to within the tolerance."""
    a, b = array(a).squeeze().astype(np.float64), array(b).squeeze().astype(np.float64)
    return a.shape == b.shape and float(np.abs(a - b).max(initial=0)) <= tolerance


def noise(*shape: int, dtype: Any = np.float32) -> np.ndarray:
    random = np.random.default_rng(0)
    return random.integers(0, 256, shape, np.uint8) if dtype == np.uint8 else random.random(shape).astype(dtype)


def chw(image: np.ndarray) -> torch.Tensor:
    """An array (H, W) or (H, W, C) as a tensor (1, C, H, W)."""
    return torch.from_numpy(np.array(image, order="C").reshape(*image.shape[:2], -1)).permute(2, 0, 1)[None]


def hwc(images: torch.Tensor) -> np.ndarray:
    return images[0].permute(1, 2, 0).numpy()


def dot(height: int, width: int, x: int, y: int) -> np.ndarray:
    """A black image with one white pixel."""
    image = np.zeros((height, width), np.float32)
    image[y, x] = 1
    return image


def brightest(image: Any) -> tuple[int, int]:
    """(x, y) of the brightest pixel."""
    image = array(image).squeeze()
    y, x = np.unravel_index(image.argmax(), image.shape)
    return int(x), int(y)


# --- the page -------------------------------------------------------------------------------------------------------


def page() -> str:
    lines = [
        "# Interchange with other libraries",
        "",
        "What other libraries do, on which version it was run, and how kvision gives the same. Each row is a test of",
        "[tests/interchange](../tests/interchange) that computes both; `make interchange` installs the packages in an environment",
        "of their own and runs all of them. `python tests/interchange/rows.py` makes this page from the tests.",
        "[differences.md](differences.md) lists where results differ from Kornia's.",
        "",
        "```python",
        "import torch, kvision as K",
        "G = K.geometry",
        "```",
    ]
    for subject in SUBJECTS:
        module = importlib.import_module(f"interchange.test_{subject}")
        title, _, text = (module.__doc__ or "").strip().partition("\n")
        lines += ["", f"## {title.rstrip('.')}", *([text.rstrip()] if text.strip() else []), ""]
        lines += ["| library | what it does | in kvision |", "|---|---|---|"]
        for test in vars(module).values():
            if isinstance(found := getattr(test, "row", None), Row):
                lines.append(f"| {found.library} {PINNED[found.library]} | {found.fact} | {found.kvision} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    import sys

    sys.path.insert(0, str(FOLDER.parent))
    PAGE.write_text(importlib.import_module("interchange.rows").page())
