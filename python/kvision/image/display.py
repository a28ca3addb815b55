"""`show`: images and their labels in a notebook, a window or a file."""

from __future__ import annotations

import ast
import importlib.util
import linecache
import os
import sys
import tempfile
from collections.abc import Sequence
from types import FrameType
from typing import Any

import numpy as np
import torch
from torch import Tensor

from kvision import _check
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError
from kvision.image import drawing
from kvision.image.adapter import label_image, to_tensor
from kvision.io.write import encoded, write_image

__all__ = ["show"]


def show(
    *images: Any,
    masks: Any = None,
    boxes: Any = None,
    keypoints: Any = None,
    captions: Sequence[str] | None = None,
    columns: int = 4,
    size: int = 256,
    file: str | os.PathLike[str] | None = None,
) -> None:
    """Draw images with their masks, boxes and key points, each above the expression that made it.

    The sheet appears in the notebook; without one, in a window of matplotlib where that has any; else in a new file, whose
    path is printed. With `file` it is written there and nowhere else.

    Floating point in [0, 1] and uint8 are drawn as they are. Other values, labels among them, are stretched from the smallest
    to the largest of an argument, which the caption says. Images of other than 1, 3 or 4 channels are drawn channel by channel.

    Args:
        *images: tensors (H, W), (C, H, W) or (B, ..., C, H, W), or what :func:`to_tensor` takes: arrays with the channels last,
            PIL images, paths; or lists of those.
        masks: of one image (H, W) or (C, H, W): labels, or a channel for each region. Of more images a batch or a list, with
            None for images without; boxes and keypoints likewise.
        boxes: of one image (N, 4), edges of pixels (x1, y1, x2, y2) as "bbox_xyxy" has them; or corners (N, 4, 2).
        keypoints: of one image (N, 2), as (x, y).
        captions: a text for each image; default: the arguments as they are written in the call.
        columns: images in a row.
        size: the longer side of a drawn image, in pixels.
        file: an image file to write to.

    Raises:
        TypeError: an image or a label is none of these.
        ValueError: there is no image; a shape is another one; the number of labels or captions is not that of the images;
            `columns` or `size` is not positive.

    Example:
        >>> import pathlib, tempfile, torch, kvision as K
        >>> image, box = torch.rand(3, 48, 64), torch.tensor([[8.0, 8.0, 40.0, 30.0]])
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     sheet = pathlib.Path(folder, "sheet.png")
        ...     K.show(image, K.filters.sobel(image[None]), boxes=[box, None], size=128, file=sheet)
        ...     K.io.load_image(sheet).shape[2]
        268
    """
    for name, value in (("columns", columns), ("size", size)):
        if not _check.is_int(value) or value < 1:
            raise ValueCheckError(f"show: expected {name} to be a positive int, got {value!r}", actual_value=value)
    if not images:
        raise ValueCheckError("show: expected at least one image, got none")
    names = _expressions(sys._getframe(1), len(images))
    pictures, texts = [], []
    for i, image in enumerate(images):
        tensors, note = _pictures(i, image)
        pictures += tensors
        texts += [f"{names[i]}[{k}]{note}" if len(tensors) > 1 else f"{names[i]}{note}" for k in range(len(tensors))]
    count = len(pictures)
    if captions is not None:
        texts = list(captions)
        if len(texts) != count or not all(isinstance(text, str) for text in texts):
            raise ValueCheckError(f"show: expected {count} captions, one text for each image, got {captions!r}")
    masks = _labels("masks", masks, count, ("H", "W"), ("C", "H", "W"))
    boxes = _labels("boxes", boxes, count, ("N", 4), ("N", 4, 2))
    points = _labels("keypoints", keypoints, count, ("N", 2))
    cells, below = [], []
    for i, picture in enumerate(pictures):
        planes = [picture] if len(picture) in (1, 3, 4) else list(picture[:, None])
        for k, plane in enumerate(planes):
            cells.append(
                drawing.with_labels(drawing.on_white(plane), size, masks[i], [_corners(b) for b in boxes[i]], points[i])
            )
            below.append(texts[i] if len(planes) == 1 else f"{texts[i]}, channel {k}")
    sheet = drawing.sheet_of(cells, columns, 4, below)
    if file is not None:
        write_image(file, sheet)
    else:
        _display(sheet)


# --- images and labels ----------------------------------------------------------------------------------------------


def _pictures(i: int, images: Any) -> tuple[list[Tensor], str]:
    """The images (C, H, W) of an argument, with values in [0, 1], and what its caption says of them."""
    planes: list[Tensor] = []
    for image in images if isinstance(images, (list, tuple)) else [images]:
        if isinstance(image, (list, tuple)) or not (
            isinstance(image, (Tensor, np.ndarray, str, os.PathLike)) or _check.is_pil(image)
        ):
            raise TypeCheckError(
                f"show: expected images[{i}] to be a Tensor, an array, a PIL image or a path, or a list of those, got "
                f"{type(image).__name__}",
                actual_type=type(image),
            )
        x = to_tensor(image)
        assert isinstance(x, Tensor)  # of one image or one batch
        if x.dim() < 2 or 0 in x.shape or x.is_complex():
            raise ShapeError(
                f"show: expected images[{i}] of shape (H, W), (C, H, W) or (B, C, H, W), got {tuple(x.shape)} of {x.dtype}",
                actual_shape=x.shape,
            )
        x = x.detach().cpu()
        planes += x.flatten(0, -4) if x.dim() > 3 else x[None] if x.dim() == 3 else x[None, None]
    if all(plane.dtype in (torch.uint8, torch.bool) for plane in planes):
        return [plane.float() / (255 if plane.dtype == torch.uint8 else 1) for plane in planes], ""
    planes = [plane.double() for plane in planes]
    values = torch.cat([plane.flatten() for plane in planes])
    finite = values[values.isfinite()]
    note = "" if len(finite) == len(values) else f", {len(values) - len(finite)} not finite"
    low, high = (finite.min().item(), finite.max().item()) if len(finite) else (0.0, 1.0)
    if low < 0 or high > 1:
        planes = [(plane - low) / max(high - low, 1e-30) for plane in planes]
        note = f": {low:.4g} to {high:.4g}{note}"
    return [plane.nan_to_num(0.0, 1.0, 0.0).float() for plane in planes], note


def _labels(name: str, values: Any, count: int, *shapes: tuple[Any, ...]) -> list[list[Tensor]]:
    """For each image its labels of a kind: none or one tensor of one of these shapes."""
    if values is None:
        return [[]] * count
    if not isinstance(values, (list, tuple)):
        values = _label(name, values)
        values = [values] if count == 1 and _fits(values, shapes) else list(values) if values.dim() else [values]
    if len(values) != count:
        raise ValueCheckError(f"show: expected {name} of {count} images, got those of {len(values)}")
    labels = [[] if value is None else [_label(f"{name}[{i}]", value)] for i, value in enumerate(values)]
    for i, label in enumerate(labels):
        if label and not _fits(label[0], shapes):
            listed = " or ".join("(" + ", ".join(map(str, shape)) + ")" for shape in shapes)
            raise ShapeError(f"show: expected {name}[{i}] of shape {listed}, got {tuple(label[0].shape)}")
    return [[x if x.dim() != 2 or name != "masks" else x[None] for x in label] for label in labels]


def _label(name: str, value: Any) -> Tensor:
    x = value if isinstance(value, Tensor) else label_image(value) if _check.is_pil(value) else torch.as_tensor(value)
    return x.detach().cpu()


def _fits(x: Tensor, shapes: tuple[tuple[Any, ...], ...]) -> bool:
    return any(
        x.dim() == len(shape) and all(isinstance(m, str) or n == m for n, m in zip(x.shape, shape)) for shape in shapes
    )


def _corners(boxes: Tensor) -> Tensor:
    """Corners (N, 4, 2) in the coordinates of pixel centers of boxes by their edges; corners as they are."""
    if boxes.dim() == 3:
        return boxes.float()
    x1, y1, x2, y2 = (boxes.float() - 0.5).unbind(1)
    return torch.stack([x1, y1, x2, y1, x2, y2, x1, y2], 1).view(-1, 4, 2)


# --- captions -------------------------------------------------------------------------------------------------------


def _expressions(frame: FrameType, count: int) -> list[str]:
    """The arguments of the call that a frame makes as they are written; numbers where the source does not tell."""
    numbers = [f"{i}" for i in range(count)]
    positions = list(frame.f_code.co_positions())[frame.f_lasti // 2] if hasattr(frame.f_code, "co_positions") else ()
    if None in positions or not positions:
        return numbers
    first, last, start, end = positions
    lines = [line.encode() for line in linecache.getlines(frame.f_code.co_filename, frame.f_globals)[first - 1 : last]]
    if len(lines) != last - first + 1:
        return numbers
    lines[-1] = lines[-1][:end]  # before the start, which may be in the same line
    lines[0] = lines[0][start:]
    try:
        call = ast.parse(b"(" + b"".join(lines) + b")", mode="eval").body
    except SyntaxError:
        return numbers
    if not isinstance(call, ast.Call) or len(call.args) != count or any(isinstance(x, ast.Starred) for x in call.args):
        return numbers
    return [ast.unparse(argument) for argument in call.args]


# --- display --------------------------------------------------------------------------------------------------------


def _display(sheet: Tensor) -> None:
    ipython = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    if hasattr(shell, "kernel"):  # a notebook, not a terminal
        from IPython.display import Image, display  # type: ignore[import-not-found,unused-ignore]

        display(Image(data=encoded("sheet.png", sheet)))
    elif not _in_window(sheet):
        handle, path = tempfile.mkstemp(prefix="kvision-", suffix=".png")
        os.close(handle)
        write_image(path, sheet)
        print(f"kvision.show: {path}")


def _in_window(sheet: Tensor) -> bool:
    """Draw in a window of matplotlib; False where it is not installed, or has none, as on a machine without a screen."""
    if importlib.util.find_spec("matplotlib") is None:
        return False
    from matplotlib import pyplot

    if pyplot.get_backend().lower() in ("agg", "cairo", "pdf", "pgf", "ps", "svg", "template"):
        return False
    figure = pyplot.figure(figsize=(sheet.shape[2] / 100, sheet.shape[1] / 100), dpi=100)
    figure.add_axes((0, 0, 1, 1), frameon=False).imshow(sheet.movedim(0, -1).numpy())
    pyplot.axis("off")
    pyplot.show()
    return True
