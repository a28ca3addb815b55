"""Reading and writing point clouds in PLY files."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO, Literal, NamedTuple, overload

import numpy as np
import torch
from torch import Tensor

from kvision import _check
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError

__all__ = [
    "load_pointcloud_ply",
    "load_pointcloud_ply_binary",
    "save_pointcloud_ply",
    "save_pointcloud_ply_binary",
]

TYPES = {
    **dict.fromkeys(("char", "int8"), torch.int8),
    **dict.fromkeys(("uchar", "uint8"), torch.uint8),
    **dict.fromkeys(("short", "int16"), torch.int16),
    **dict.fromkeys(("ushort", "uint16"), torch.uint16),
    **dict.fromkeys(("int", "int32"), torch.int32),
    **dict.fromkeys(("uint", "uint32"), torch.uint32),
    **dict.fromkeys(("float", "float32"), torch.float32),
    **dict.fromkeys(("double", "float64"), torch.float64),
}
FORMATS = ("ascii", "binary_little_endian", "binary_big_endian")
_POINT, _COLOR = ("x", "y", "z"), ("red", "green", "blue")


def save_pointcloud_ply(filename: str | os.PathLike[str], pointcloud: Tensor, colors: Tensor | None = None) -> None:
    """Write points to an ASCII PLY file, without loss of precision.

    Args:
        filename: a path that ends in .ply. An existing file is replaced.
        pointcloud: points of shape (*, 3), of any real type. They are stored as float64.
        colors: of the points, (*, 3) as RGB, uint8 or floating point in [0, 1]. They are stored as uint8.

    Raises:
        TypeError: `pointcloud` is not a tensor of real numbers, `colors` is of another type, or `filename` is not a str or a path.
        ValueError: `pointcloud` is not of shape (*, 3), `colors` of another shape, or `filename` does not end in .ply.

    Example:
        >>> import tempfile, torch, kvision as K
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     K.geometry.pointcloud.save_pointcloud_ply(folder + "/cloud.ply", torch.ones(2, 3))
        ...     K.geometry.pointcloud.load_pointcloud_ply(folder + "/cloud.ply")
        tensor([[1., 1., 1.],
                [1., 1., 1.]])
    """
    path, points, rgb = _to_write("save_pointcloud_ply", filename, pointcloud, colors)
    rows = "".join(" ".join(map(repr, point + color)) + "\n" for point, color in zip(points.tolist(), rgb.tolist()))
    path.write_text(_header("ascii", points, rgb) + rows, encoding="ascii", newline="\n")


def save_pointcloud_ply_binary(
    filename: str | os.PathLike[str], pointcloud: Tensor, colors: Tensor | None = None
) -> None:
    """Write points to a binary, little-endian PLY file.

    Args:
        filename: a path that ends in .ply. An existing file is replaced.
        pointcloud: points of shape (*, 3), of any real type. They are stored as float64.
        colors: of the points, (*, 3) as RGB, uint8 or floating point in [0, 1]. They are stored as uint8.

    Raises:
        TypeError: `pointcloud` is not a tensor of real numbers, `colors` is of another type, or `filename` is not a str or a path.
        ValueError: `pointcloud` is not of shape (*, 3), `colors` of another shape, or `filename` does not end in .ply.

    Example:
        >>> import tempfile, torch, kvision as K
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     K.geometry.pointcloud.save_pointcloud_ply_binary(folder + "/cloud.ply", torch.ones(1, 3))
        ...     K.geometry.pointcloud.load_pointcloud_ply_binary(folder + "/cloud.ply")
        tensor([[1., 1., 1.]])
    """
    path, points, rgb = _to_write("save_pointcloud_ply_binary", filename, pointcloud, colors)
    rows = np.concatenate([points.numpy().astype("<f8").view(np.uint8), rgb.numpy()], axis=1)
    path.write_bytes(_header("binary_little_endian", points, rgb).encode() + rows.tobytes())


def _to_write(
    op: str, filename: str | os.PathLike[str], pointcloud: Tensor, colors: Tensor | None
) -> tuple[Path, Tensor, Tensor]:
    """The path, points (N, 3) and colors (N, 3), which are (N, 0) without any."""
    path = _path(op, filename)
    _check.trailing_shape(op, "pointcloud", pointcloud, 3)
    points = pointcloud.detach().reshape(-1, 3).to("cpu", torch.float64)
    if colors is None:
        return path, points, torch.empty(len(points), 0, dtype=torch.uint8, device="cpu")
    _check.is_tensor(op, "colors", colors)
    _check.floating_or_bytes(op, "colors", colors)
    if colors.shape != pointcloud.shape:
        raise ShapeError(f"{op}: expected colors of shape {tuple(pointcloud.shape)}, got {tuple(colors.shape)}")
    rgb = colors.detach().reshape(-1, 3).cpu()
    return path, points, rgb if rgb.dtype == torch.uint8 else (255 * rgb.double().clamp(0, 1)).round().byte()


def _path(op: str, filename: str | os.PathLike[str]) -> Path:
    if not isinstance(filename, (str, os.PathLike)):
        raise TypeCheckError(f"{op}: expected filename to be a str or a path, got {type(filename).__name__}")
    path = Path(filename)
    if path.suffix.lower() != ".ply":
        raise ValueCheckError(f"{op}: expected filename to end in .ply, got {str(filename)!r}")
    return path


def _header(kind: str, points: Tensor, rgb: Tensor) -> str:
    properties = [f"property double {name}\n" for name in _POINT]
    properties += [f"property uchar {name}\n" for name in _COLOR[: rgb.shape[1]]]
    return f"ply\nformat {kind} 1.0\nelement vertex {len(points)}\n{''.join(properties)}end_header\n"


@overload
def load_pointcloud_ply(
    filename: str | os.PathLike[str], header_size: int | None = None, return_colors: Literal[False] = False
) -> Tensor: ...
@overload
def load_pointcloud_ply(
    filename: str | os.PathLike[str], header_size: int | None = None, *, return_colors: bool
) -> Tensor | tuple[Tensor, Tensor | None]: ...
def load_pointcloud_ply(
    filename: str | os.PathLike[str], header_size: int | None = None, return_colors: bool = False
) -> Tensor | tuple[Tensor, Tensor | None]:
    """Read the points of an ASCII PLY file.

    Elements and properties other than x, y, z and colors of the vertices are skipped.

    Args:
        filename: a path that ends in .ply.
        header_size: not used; accepted for compatibility, as the header marks its end.
        return_colors: also return the properties red, green and blue.

    Returns:
        Points of shape (N, 3), float32. With `return_colors` also RGB of shape (N, 3), of the type that the file has, as a rule
        uint8, or None.

    Raises:
        TypeError: `filename` is not a str or a path.
        ValueError: `filename` does not end in .ply, or the file is not a PLY file of this format.
        OSError: the file cannot be read.

    Example:
        >>> import tempfile, torch, kvision as K
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     K.geometry.pointcloud.save_pointcloud_ply(folder + "/cloud.ply", torch.ones(1, 3))
        ...     K.geometry.pointcloud.load_pointcloud_ply(folder + "/cloud.ply")
        tensor([[1., 1., 1.]])
    """
    op = "load_pointcloud_ply"
    _check.flag(op, "return_colors", return_colors)
    with _path(op, filename).open("rb") as file:
        before, vertex = _read_header(op, file, FORMATS[:1])[1:]
        for _ in range(sum(element.rows for element in before)):
            file.readline()
        try:
            lines = [file.readline().split() for _ in range(vertex.rows)]
            points = [[float(line[i]) for i in vertex.columns_of(_POINT)] for line in lines]
            colors = [[float(line[i]) for i in vertex.columns_of(_COLOR)] for line in lines] if vertex.has_color else []
        except (IndexError, ValueError) as error:
            raise ValueCheckError(f"{op}: expected {vertex.rows} vertices in {str(filename)!r}, {error}") from error
    xyz = torch.tensor(points, dtype=torch.float32).reshape(-1, 3)
    if not return_colors:
        return xyz
    return xyz, torch.tensor(colors, dtype=vertex.color_type).reshape(-1, 3) if vertex.has_color else None


@overload
def load_pointcloud_ply_binary(
    filename: str | os.PathLike[str], header_size: int | None = None, return_colors: Literal[False] = False
) -> Tensor: ...
@overload
def load_pointcloud_ply_binary(
    filename: str | os.PathLike[str], header_size: int | None = None, *, return_colors: bool
) -> Tensor | tuple[Tensor, Tensor | None]: ...
def load_pointcloud_ply_binary(
    filename: str | os.PathLike[str], header_size: int | None = None, return_colors: bool = False
) -> Tensor | tuple[Tensor, Tensor | None]:
    """Read the points of a binary PLY file, of either byte order.

    Elements and properties other than x, y, z and colors of the vertices are skipped.

    Args:
        filename: a path that ends in .ply.
        header_size: not used; accepted for compatibility, as the header marks its end.
        return_colors: also return the properties red, green and blue.

    Returns:
        Points of shape (N, 3), float32. With `return_colors` also RGB of shape (N, 3), of the type that the file has, as a rule
        uint8, or None.

    Raises:
        TypeError: `filename` is not a str or a path.
        ValueError: `filename` does not end in .ply, the file is not a PLY file of this format, or an element up to the
            vertices has properties that are lists.
        OSError: the file cannot be read.

    Example:
        >>> import tempfile, torch, kvision as K
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     K.geometry.pointcloud.save_pointcloud_ply_binary(folder + "/cloud.ply", torch.ones(1, 3))
        ...     K.geometry.pointcloud.load_pointcloud_ply_binary(folder + "/cloud.ply")
        tensor([[1., 1., 1.]])
    """
    op = "load_pointcloud_ply_binary"
    _check.flag(op, "return_colors", return_colors)
    with _path(op, filename).open("rb") as file:
        kind, before, vertex = _read_header(op, file, FORMATS[1:])
        file.seek(sum(element.rows * element.size(op) for element in before), os.SEEK_CUR)
        stride = vertex.size(op)
        data = bytearray(file.read(vertex.rows * stride))
    if len(data) != vertex.rows * stride:
        raise ValueCheckError(f"{op}: expected {vertex.rows} vertices in {str(filename)!r}, the file ends before")
    swapped = (kind == FORMATS[1]) != (sys.byteorder == "little")

    def read(names: Sequence[str], dtype: torch.dtype) -> Tensor:
        if not data:
            return torch.zeros(0, 3, dtype=dtype)
        table = torch.frombuffer(data, dtype=torch.uint8).reshape(vertex.rows, stride)
        columns = []
        for index in vertex.columns_of(names):
            kind = vertex.types[index]
            start = sum(t.itemsize for t in vertex.types[:index])
            column = table[:, start : start + kind.itemsize]
            columns.append((column.flip(1) if swapped else column).contiguous().view(kind)[:, 0].to(dtype))
        return torch.stack(columns, 1)

    points = read(_POINT, torch.float32)
    if not return_colors:
        return points
    return points, read(_COLOR, vertex.color_type) if vertex.has_color else None


class _Element(NamedTuple):
    """An element of a PLY file: a table with named columns. Columns of lists have no type."""

    name: str
    rows: int
    columns: list[str]
    types: list[torch.dtype]
    lists: list[str]

    @property
    def has_color(self) -> bool:
        return set(_COLOR) <= set(self.columns)

    @property
    def color_type(self) -> torch.dtype:
        return self.types[self.columns.index(_COLOR[0])]

    def columns_of(self, names: Sequence[str]) -> list[int]:
        return [self.columns.index(name) for name in names]

    def size(self, op: str) -> int:
        """Bytes of a row."""
        if self.lists:
            raise ValueCheckError(
                f"{op}: expected no list properties up to the vertices, got {self.name} with {self.lists}"
            )
        return sum(t.itemsize for t in self.types)


def _read_header(op: str, file: BinaryIO, formats: tuple[str, ...]) -> tuple[str, list[_Element], _Element]:
    """Read the format, the elements before the vertices, and the vertex element."""
    kind, elements = "", []
    if file.readline().strip() != b"ply":
        raise ValueCheckError(f"{op}: expected a PLY file, got {file.name!r}, which does not begin with 'ply'")
    while True:
        line = file.readline()
        match line.decode("ascii", "replace").split():
            case ["end_header"]:
                break
            case ["format", name, _]:
                kind = name
            case ["element", name, count] if count.isdecimal():
                elements.append(_Element(name, int(count), [], [], []))
            case ["property", "list", _, _, name] if elements:
                elements[-1].lists.append(name)
            case ["property", dtype, name] if elements and dtype in TYPES:
                elements[-1].columns.append(name)
                elements[-1].types.append(TYPES[dtype])
            case ["comment" | "obj_info", *_]:
                pass
            case []:
                if not line:
                    raise ValueCheckError(f"{op}: expected a header up to end_header, got {file.name!r}")
            case _:
                raise ValueCheckError(f"{op}: expected a line of a PLY header, got {line!r} in {file.name!r}")
    if kind not in formats:
        raise ValueCheckError(f"{op}: expected a file of format {' or '.join(formats)}, got {kind!r} in {file.name!r}")
    for i, element in enumerate(elements):
        if element.name == "vertex" and set(_POINT) <= set(element.columns):
            if element.lists:
                element.size(op)
            return kind, elements[:i], element
    raise ValueCheckError(f"{op}: expected vertices with x, y and z, {file.name!r} has none")
