"""Lays images out on a page: titled sections of labeled columns and rows, and a curve."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont
from torch import Tensor

from kvision.core.pixels import to_uint8
from kvision.image import tensor_to_image

MARGIN, GAP, LINE = 48, 10, 24
LARGEST = 1_000_000  # bytes of a file
PAPER, INK, FAINT, ACCENT = "white", "#1a1a1a", "#8a8a8a", "#c2410c"


@dataclass(frozen=True)
class Section:
    """A titled grid: `columns` (title, note), `rows` (label, cells), `captions` below the columns, `notes` below the rows."""

    title: str
    columns: Sequence[tuple[str, str]]
    rows: Sequence[tuple[str, Sequence[Image.Image]]]
    captions: Sequence[str] = ()
    notes: Sequence[str] = ()


def picture(tensor: Tensor) -> Image.Image:
    """(1 or 3, H, W) in [0, 1] as an RGB image."""
    return Image.fromarray(tensor_to_image(to_uint8(tensor), force_contiguous=True)).convert("RGB")


def curve(values: Sequence[float], width: int, height: int) -> Image.Image:
    """The values over their index, on a logarithmic scale."""
    scale = 3  # drawn larger and reduced: PIL's lines are not smooth
    image = Image.new("RGB", (scale * width, scale * height), PAPER)
    draw = ImageDraw.Draw(image)
    font = ImageFont.load_default(scale * 15)
    left, right, top, bottom = scale * 70, scale * (width - 16), scale * 16, scale * (height - 34)
    logs = [math.log10(max(value, 1e-30)) for value in values]
    low, high = math.floor(min(logs)), max(math.ceil(max(logs)), math.floor(min(logs)) + 1)

    def at(index: float, log: float) -> tuple[float, float]:
        x = left + (right - left) * index / max(1, len(values) - 1)
        return x, bottom - (bottom - top) * (log - low) / (high - low)

    for power in range(low, high + 1):
        y = at(0, power)[1]
        draw.line((left, y, right, y), fill="#e4e4e4", width=scale)
        draw.text((left - scale * 8, y), f"1e{power}", fill=FAINT, font=font, anchor="rm")
    draw.line([at(index, log) for index, log in enumerate(logs)], fill=ACCENT, width=scale * 2, joint="curve")
    draw.text((left, bottom + scale * 8), "0", fill=FAINT, font=font, anchor="lt")
    draw.text((right, bottom + scale * 8), f"{len(values) - 1} steps", fill=FAINT, font=font, anchor="rt")
    return image.resize((width, height), Image.Resampling.LANCZOS)


def page(title: str, note: str, sections: Sequence[Section]) -> Image.Image:
    """All sections under one another, as wide as the widest."""
    parts = [_heading(title, note), *map(_section, sections)]
    width = max(part.width for part in parts) + 2 * MARGIN
    height = sum(part.height for part in parts) + MARGIN * (len(parts) + 1)
    sheet = Image.new("RGB", (width, height), PAPER)
    y = MARGIN
    for part in parts:
        sheet.paste(part, (MARGIN, y))
        y += part.height + MARGIN
    return sheet


def save(sheet: Image.Image, path: Path) -> int:
    """Write a JPEG of less than LARGEST bytes, as well as that allows. Returns its quality."""
    for quality in range(88, 0, -8):
        written = BytesIO()
        sheet.save(written, "JPEG", quality=quality, optimize=True)
        if written.tell() < LARGEST:
            break
    path.write_bytes(written.getvalue())
    return quality


def _heading(title: str, note: str) -> Image.Image:
    large, small = ImageFont.load_default(52), ImageFont.load_default(22)
    image = Image.new("RGB", (math.ceil(max(large.getlength(title), small.getlength(note))), 100), PAPER)
    draw = ImageDraw.Draw(image)
    draw.text((0, 0), title, fill=INK, font=large, anchor="lt")
    draw.text((0, 94), note, fill=FAINT, font=small, anchor="ls")
    return image


def _section(section: Section) -> Image.Image:
    title_font, column_font, note_font = (ImageFont.load_default(size) for size in (32, 22, 18))
    widths = [max(cells[i].width for _, cells in section.rows) for i in range(len(section.columns))]
    heights = [max(cell.height for cell in cells) for _, cells in section.rows]
    first_x, first_y = 34, 92  # room for the row labels and for the titles
    captions = [_wrapped(text, width, note_font) for text, width in zip(section.captions, widths)]
    row_width = sum(widths) + GAP * (len(widths) - 1)
    notes = [_wrapped(text, row_width, note_font) for text in section.notes] or [""] * len(heights)
    below_rows = [8 + LINE * (text.count("\n") + 1) if text else 0 for text in notes]
    below = 8 + LINE * max((text.count("\n") + 1 for text in captions), default=0)
    size = (
        first_x + row_width,
        first_y + sum(heights) + sum(below_rows) + GAP * (len(heights) - 1) + below,
    )
    image = Image.new("RGB", size, PAPER)
    draw = ImageDraw.Draw(image)
    draw.text((0, 0), section.title, fill=INK, font=title_font, anchor="lt")
    draw.line((0, 48, size[0], 48), fill="#d0d0d0", width=2)
    x = first_x
    for (column, note), width in zip(section.columns, widths):
        draw.text((x, first_y - 12), column, fill=INK, font=column_font, anchor="ls")
        draw.text((x + width, first_y - 12), note, fill=FAINT, font=note_font, anchor="rs")
        x += width + GAP
    y = first_y
    for (label, cells), height, note, note_height in zip(section.rows, heights, notes, below_rows):
        _upward(image, label, note_font, y, height)
        x = first_x
        for cell, width in zip(cells, widths):
            image.paste(cell, (x, y))
            x += width + GAP
        draw.multiline_text((first_x, y + height + 2), note, fill=INK, font=note_font)
        y += height + note_height + GAP
    x = first_x
    for text, width in zip(captions, widths):
        draw.multiline_text((x, y - 2), text, fill=INK, font=note_font)
        x += width + GAP
    return image


def _wrapped(text: str, width: int, font: ImageFont.FreeTypeFont | ImageFont.ImageFont) -> str:
    """The text in lines that are no wider than a column; what is wider is broken behind underscores."""
    lines: list[str] = []
    for word in text.split():
        joint = " "
        for part in [word] if font.getlength(word) <= width else re.findall("[^_]*_|[^_]+$", word):
            longer = lines[-1] + joint + part if lines else part
            if lines and font.getlength(longer) <= width:
                lines[-1] = longer
            else:
                lines.append(part)
            joint = ""
    return "\n".join(lines)


def _upward(
    image: Image.Image, label: str, font: ImageFont.FreeTypeFont | ImageFont.ImageFont, y: int, height: int
) -> None:
    """Write a row's label from bottom to top, left of the row, shortened to its height."""
    while label and font.getlength(label) > height:
        label = label[:-2] + "…" if len(label) > 2 else ""
    strip = Image.new("RGB", (height, 24), PAPER)
    ImageDraw.Draw(strip).text((height / 2, 12), label, fill=FAINT, font=font, anchor="mm")
    image.paste(strip.rotate(90, expand=True), (0, y))
