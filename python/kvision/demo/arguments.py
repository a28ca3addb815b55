"""The command lines of the examples. A missing input ends a program with a message of one line."""

from __future__ import annotations

import argparse
import importlib.util
from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor

from kvision.core.exceptions import ImageError
from kvision.io import load_image


def demo_parser() -> argparse.ArgumentParser:
    """The command line of the demo."""
    parse = argparse.ArgumentParser(
        prog="python -m kvision.demo", description="Photographs in, a gallery of filtered ones out."
    )
    parse.add_argument("images", nargs="*", type=Path, metavar="IMAGE", help="any file OpenCV reads; default: samples")
    parse.add_argument("--out", type=Path, default=Path("out/demo"), metavar="DIR", help="default: out/demo")
    parse.add_argument("--device", choices=("auto", "cpu", "cuda"), default="auto")
    return parse


def device_of(parser: argparse.ArgumentParser, name: str, index: int | None = None) -> torch.device:
    """The device of `--device`; without a number, the GPU of this index."""
    try:
        device = torch.device(name)
    except RuntimeError:
        parser.error(f"--device {name}: expected cpu or cuda")
    if device.type not in ("cpu", "cuda"):
        parser.error(f"--device {name}: expected cpu or cuda")
    if device.type == "cuda" and device.index is None and index is not None:
        device = torch.device("cuda", index)
    if device.type == "cuda" and (device.index or 0) >= torch.cuda.device_count():
        parser.error(f"--device {name}: torch finds no CUDA device" + (f" {device.index}" if device.index else ""))
    return device


EXTRA = {"PIL", "matplotlib", "skimage", "tqdm"}  # modules of the extra `examples`


def require(parser: argparse.ArgumentParser, *modules: str) -> None:
    """Modules that kvision itself does not need; called before a program starts to compute."""
    for name in modules:
        if importlib.util.find_spec(name) is None:
            parser.error(f"needs {name}: pip install " + ('".[examples]"' if name in EXTRA else name))


def make_folder(parser: argparse.ArgumentParser, path: Path) -> None:
    """Make the folder of the results; called before a program starts to compute."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        parser.error(f"results cannot go to {path}: {error.strerror}")


def images_of(parser: argparse.ArgumentParser, paths: Sequence[Path]) -> list[Tensor]:
    """The files of `--image` as (1, 3, H, W), float32 in [0, 1]."""
    images = []
    for path in paths:
        try:
            images.append(load_image(path)[None])
        except (OSError, ValueError, ImageError) as error:
            parser.error(f"--image {path}: {str(error).splitlines()[0]}")
    return images
