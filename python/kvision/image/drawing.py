"""Labels drawn on images, and sheets of images with captions: what `show` and `augmentation.preview` have in common.

Images are RGB (3, H, W), floating point in [0, 1]. Colors are those of objects in their order.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from kvision.io._opencv import opencv

# Orange, blue, green, pink, yellow, purple, red, cyan.
_PALETTE = (0xFF8C00, 0x2E86FF, 0x00C853, 0xFF4FA3, 0xFFD600, 0x9C4DFF, 0xF4343C, 0x00C2D8)
_PAPER, _ACCENT = 1.0, 0xC2410C
_SQUARES = 8  # the factor from which enlarged pixels are squares
_LINES = 3  # of a caption


def _fitted(image: Tensor, size: int) -> tuple[Tensor, float]:
    """The image with its longer side `size` pixels, and the factor. Few pixels are enlarged to squares, more are interpolated."""
    scale = size / max(image.shape[1:])
    h, w = (max(1, round(n * scale)) for n in image.shape[1:])
    if (h, w) == image.shape[1:]:
        return image.clamp(0, 1), scale
    if scale >= _SQUARES:
        return F.interpolate(image[None], (h, w), mode="nearest-exact")[0].clamp(0, 1), scale
    return F.interpolate(image[None], (h, w), mode="bilinear", antialias=True)[0].clamp(0, 1), scale


def with_labels(
    image: Tensor, size: int, masks: Sequence[Tensor] = (), boxes: Sequence[Tensor] = (), points: Sequence[Tensor] = ()
) -> Tensor:
    """The image with its longer side `size` pixels, masks below corners (N, 4, 2) of boxes below points (N, 2)."""
    image, scale = _fitted(image, size)
    stroke = max(1.0, size / 110)
    for mask in masks:
        image = _with_mask(image, mask)
    for corners in boxes:
        image = _with_boxes(image, corners, scale, stroke)
    for point in points:
        image = _with_points(image, point, scale, 1.5 * stroke)
    return image


def framed(image: Tensor, width: int) -> Tensor:
    """The image with a frame on its outermost pixels."""
    image, accent = image.clone(), _rgb_of(_ACCENT, image)
    image[:, :width], image[:, -width:] = accent, accent
    image[:, :, :width], image[:, :, -width:] = accent, accent
    return image


def sheet_of(cells: Sequence[Tensor], columns: int, gap: int, captions: Sequence[str] | None = None) -> Tensor:
    """Cells row by row, each in the middle of its grid cell, with their captions below."""
    columns = min(columns, len(cells))
    h, w = (max(cell.shape[axis] for cell in cells) for axis in (1, 2))
    texts = [] if captions is None else [_text(caption, w) for caption in captions]
    below = max((text.shape[1] for text in texts), default=0)
    rows, row = -(-len(cells) // columns), h + below + gap
    sheet = cells[0].new_full((3, rows * row + gap, columns * (w + gap) + gap), _PAPER)
    for i, cell in enumerate(cells):
        top, left = gap + i // columns * row, gap + i % columns * (w + gap)
        _paste(sheet, cell, top + (h - cell.shape[1]) // 2, left + (w - cell.shape[2]) // 2)
        if texts:
            _paste(sheet, texts[i], top + h, left)
    return sheet


def _paste(sheet: Tensor, cell: Tensor, top: int, left: int) -> None:
    sheet[:, top : top + cell.shape[1], left : left + cell.shape[2]] = cell


def _text(text: str, width: int) -> Tensor:
    """A caption in black on white, broken into at most three lines of a width; what has no glyph is a question mark."""
    cv2 = opencv()
    style = cv2.FONT_HERSHEY_SIMPLEX, 0.4
    height, lines = 17, [""]
    for letter in text.encode("ascii", "replace").decode():
        if cv2.getTextSize(lines[-1] + letter, *style, 1)[0][0] > width - 2:
            lines.append("")
        lines[-1] += letter
    if len(lines) > _LINES:
        lines = [*lines[: _LINES - 1], lines[_LINES - 1][:-3] + "..."]
    page = np.full((height * len(lines) + 4, width, 3), 255, np.uint8)
    for i, line in enumerate(lines):
        cv2.putText(page, line, (1, height * (i + 1) - 2), *style, (40, 40, 40), 1, cv2.LINE_AA)
    return torch.from_numpy(page).permute(2, 0, 1) / 255


def rgb(image: Tensor) -> Tensor:
    """The first three channels, or the first one three times."""
    return image[:3] if len(image) >= 3 else image[:1].expand(3, -1, -1)


def on_white(image: Tensor) -> Tensor:
    """RGB; what is transparent in four channels is white."""
    return rgb(image) if len(image) < 4 else 1 + image[3] * (image[:3] - 1)


def _color(i: int, like: Tensor) -> Tensor:
    return _rgb_of(_PALETTE[i % len(_PALETTE)], like)


def _rgb_of(code: int, like: Tensor) -> Tensor:
    return torch.tensor([code >> 16 & 255, code >> 8 & 255, code & 255], device=like.device)[:, None, None] / 255


def _blend(image: Tensor, color: Tensor | float, opacity: Tensor) -> Tensor:
    return image + opacity * (color - image)


def _with_mask(image: Tensor, mask: Tensor) -> Tensor:
    """The regions of a mask (C, H, W) in colors under a contour: labels, or a channel for each region."""
    labels = (mask[0] > 0.5 if mask.is_floating_point() else mask[0]).long()
    if len(mask) > 1:
        covers = mask > 0.5 if mask.is_floating_point() else mask != 0
        labels = torch.where(covers.any(0), 1 + covers.int().argmax(0), 0)
    rows, columns = (
        ((torch.arange(n, device=mask.device) + 0.5) * (m / n)).long().clamp_max(m - 1)
        for n, m in zip(image.shape[1:], labels.shape)
    )
    labels = labels[rows[:, None], columns]
    around = F.pad(labels[None, None].double(), (1, 1, 1, 1), mode="replicate")
    contour = F.max_pool2d(around, 3, 1) != -F.max_pool2d(-around, 3, 1)
    palette = torch.cat([_color(i, image) for i in range(len(_PALETTE))], 2)[:, 0]
    color = palette[:, (labels - 1) % len(_PALETTE)]
    image = _blend(image, color, 0.35 * (labels != 0))
    return _blend(image, color, 0.6 * (contour[0, 0] & (labels != 0)))


def _with_boxes(image: Tensor, corners: Tensor, scale: float, stroke: float) -> Tensor:
    """Quadrangles (N, 4, 2) of the unscaled image, as lines on a dark halo."""
    corners = _scaled(corners, scale)
    for i, box in enumerate(corners):
        extent = box.amax(0) - box.amin(0)
        if bool((extent > 0).all()):
            distance = _distance_to_sides(image, box)
            image = _blend(image, 0.0, 0.45 * _coverage(distance, 0.5 * stroke + 1))
            image = _blend(image, _color(i, image), _coverage(distance, 0.5 * stroke))
    return image


def _with_points(image: Tensor, points: Tensor, scale: float, radius: float) -> Tensor:
    """Discs with a white border at points (N, 2) of the unscaled image."""
    y, x = _pixels(image)
    for i, point in enumerate(_scaled(points, scale)):
        distance = torch.hypot(x - point[0], y - point[1])
        image = _blend(image, 0.0, 0.45 * _coverage(distance, 1.5 * radius + 1))
        image = _blend(image, 1.0, _coverage(distance, 1.5 * radius))
        image = _blend(image, _color(i, image), _coverage(distance, radius))
    return image


def _scaled(points: Tensor, scale: float) -> Tensor:
    """Points of an image on the image scaled about the edges of its pixels."""
    return (points.float() + 0.5) * scale - 0.5


def _pixels(image: Tensor) -> tuple[Tensor, Tensor]:
    y, x = (torch.arange(n, device=image.device, dtype=torch.float32) for n in image.shape[1:])
    return y[:, None], x


def _coverage(distance: Tensor, radius: float) -> Tensor:
    """How much of a pixel is nearer than a radius."""
    return (radius + 0.5 - distance).clamp(0, 1).nan_to_num(0)


def _distance_to_sides(image: Tensor, corners: Tensor) -> Tensor:
    """(H, W): the distance of each pixel to the nearest side of a quadrangle (4, 2)."""
    y, x = _pixels(image)
    nearest = torch.full((), math.inf, device=image.device)
    for start, end in zip(corners, corners.roll(-1, 0)):
        along = end - start
        dx, dy = x - start[0], y - start[1]
        t = ((dx * along[0] + dy * along[1]) / (along.square().sum() + 1e-12)).clamp(0, 1)
        nearest = torch.minimum(nearest, torch.hypot(dx - t * along[0], dy - t * along[1]))
    return nearest
