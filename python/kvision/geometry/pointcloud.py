"""Reading and writing point clouds in PLY files."""

from __future__ import annotations

import array
import os
import sys
from pathlib import Path
from typing import BinaryIO, NamedTuple

import torch
from torch import Tensor

from kvision import _check
from kvision.core.exceptions import TypeCheckError, ValueCheckError

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


def save_pointcloud_ply(filename: str | os.PathLike[str], pointcloud: Tensor) -> None:
    """Write points to an ASCII PLY file, without loss of precision.

    Args:
        filename: a path that ends in .ply. An existing file is replaced.
        pointcloud: points of shape (*, 3), of any real type. They are stored as float64.

    Raises:
        TypeError: `pointcloud` is not a tensor of real numbers, or `filename` is not a str or a path.
        ValueError: `pointcloud` is not of shape (*, 3), or `filename` does not end in .ply.

    Example:
        >>> import tempfile, torch, kvision as K
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     K.geometry.pointcloud.save_pointcloud_ply(folder + "/cloud.ply", torch.ones(2, 3))
        ...     K.geometry.pointcloud.load_pointcloud_ply(folder + "/cloud.ply")
        tensor([[1., 1., 1.],
                [1., 1., 1.]])
    """
    path, points = _to_write("save_pointcloud_ply", filename, pointcloud)
    rows = "".join(f"{x!r} {y!r} {z!r}\n" for x, y, z in points.tolist())
    path.write_text(_header("ascii", len(points)) + rows, encoding="ascii", newline="\n")


def save_pointcloud_ply_binary(filename: str | os.PathLike[str], pointcloud: Tensor) -> None:
    """Write points to a binary, little-endian PLY file.

    Args:
        filename: a path that ends in .ply. An existing file is replaced.
        pointcloud: points of shape (*, 3), of any real type. They are stored as float64.

    Raises:
        TypeError: `pointcloud` is not a tensor of real numbers, or `filename` is not a str or a path.
        ValueError: `pointcloud` is not of shape (*, 3), or `filename` does not end in .ply.

    Example:
        >>> import tempfile, torch, kvision as K
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     K.geometry.pointcloud.save_pointcloud_ply_binary(folder + "/cloud.ply", torch.ones(1, 3))
        ...     K.geometry.pointcloud.load_pointcloud_ply_binary(folder + "/cloud.ply")
        tensor([[1., 1., 1.]])
    """
    path, points = _to_write("save_pointcloud_ply_binary", filename, pointcloud)
    data = array.array("d", points.flatten().tolist())
    if sys.byteorder == "big":
        data.byteswap()
    path.write_bytes(_header("binary_little_endian", len(points)).encode() + data.tobytes())


def _to_write(op: str, filename: str | os.PathLike[str], pointcloud: Tensor) -> tuple[Path, Tensor]:
    path = _path(op, filename)
    _check.trailing_shape(op, "pointcloud", pointcloud, 3)
    return path, pointcloud.detach().reshape(-1, 3).to("cpu", torch.float64)


def _path(op: str, filename: str | os.PathLike[str]) -> Path:
    if not isinstance(filename, (str, os.PathLike)):
        raise TypeCheckError(f"{op}: expected filename to be a str or a path, got {type(filename).__name__}")
    path = Path(filename)
    if path.suffix.lower() != ".ply":
        raise ValueCheckError(f"{op}: expected filename to end in .ply, got {str(filename)!r}")
    return path


def _header(kind: str, count: int) -> str:
    properties = "".join(f"property double {axis}\n" for axis in "xyz")
    return f"ply\nformat {kind} 1.0\nelement vertex {count}\n{properties}end_header\n"


def load_pointcloud_ply(filename: str | os.PathLike[str], header_size: int | None = None) -> Tensor:
    """Read the points of an ASCII PLY file.

    Elements and properties other than x, y and z of the vertices are skipped.

    Args:
        filename: a path that ends in .ply.
        header_size: not used; accepted for compatibility, as the header marks its end.

    Returns:
        Points of shape (N, 3), float32.

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
    with _path(op, filename).open("rb") as file:
        before, vertex = _read_header(op, file, FORMATS[:1])[1:]
        for _ in range(sum(element.rows for element in before)):
            file.readline()
        try:
            lines = [file.readline().split() for _ in range(vertex.rows)]
            points = [[float(line[i]) for i in vertex.xyz_columns] for line in lines]
        except (IndexError, ValueError) as error:
            raise ValueCheckError(f"{op}: expected {vertex.rows} vertices in {str(filename)!r}, {error}") from error
    return torch.tensor(points, dtype=torch.float32).reshape(-1, 3)


def load_pointcloud_ply_binary(filename: str | os.PathLike[str], header_size: int | None = None) -> Tensor:
    """Read the points of a binary PLY file, of either byte order.

    Elements and properties other than x, y and z of the vertices are skipped.

    Args:
        filename: a path that ends in .ply.
        header_size: not used; accepted for compatibility, as the header marks its end.

    Returns:
        Points of shape (N, 3), float32.

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
    with _path(op, filename).open("rb") as file:
        kind, before, vertex = _read_header(op, file, FORMATS[1:])
        file.seek(sum(element.rows * element.size(op) for element in before), os.SEEK_CUR)
        stride = vertex.size(op)
        data = bytearray(file.read(vertex.rows * stride))
    if len(data) != vertex.rows * stride:
        raise ValueCheckError(f"{op}: expected {vertex.rows} vertices in {str(filename)!r}, the file ends before")
    if not data:
        return torch.zeros(0, 3)
    table = torch.frombuffer(data, dtype=torch.uint8).reshape(vertex.rows, stride)
    swapped = (kind == FORMATS[1]) != (sys.byteorder == "little")
    columns = []
    for index in vertex.xyz_columns:
        dtype = vertex.types[index]
        start = sum(t.itemsize for t in vertex.types[:index])
        column = table[:, start : start + dtype.itemsize]
        columns.append((column.flip(1) if swapped else column).contiguous().view(dtype)[:, 0].float())
    return torch.stack(columns, 1)


class _Element(NamedTuple):
    """An element of a PLY file: a table with named columns. Columns of lists have no type."""

    name: str
    rows: int
    columns: list[str]
    types: list[torch.dtype]
    lists: list[str]

    @property
    def xyz_columns(self) -> tuple[int, int, int]:
        x, y, z = (self.columns.index(axis) for axis in "xyz")
        return x, y, z

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
        if element.name == "vertex" and {"x", "y", "z"} <= set(element.columns):
            if element.lists:
                element.size(op)
            return kind, elements[:i], element
    raise ValueCheckError(f"{op}: expected vertices with x, y and z, {file.name!r} has none")
