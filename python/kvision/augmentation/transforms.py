"""The matrix of a chain of geometric transforms, from the columns of drawn parameters, in one launch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from kvision._limits import MAX_TRANSFORMS
from kvision._ops import register, vjp
from kvision.geometry.conversions.angles import cos_sin
from kvision.geometry.transform.matrices import from_unit_square, matrix_of

# Kinds of transforms by name: number (csrc/augmentation/transforms.h) and inputs. All map image pixels to result pixels.
#   affine: angle in degrees, counter-clockwise; translation x, y; scale x, y; shear x, y in degrees; center x, y. Shears,
#       scales and rotates about the center, then translates.
#   perspective: four source points x, y, four destination points x, y.
#   crop: first column, first row, width, height of a box; columns and rows of the result; 1 if the centers of the outermost
#       pixels correspond, 0 if their edges do.
#   matrix: nine entries by rows.
KINDS = {"affine": (0, 9), "perspective": (1, 16), "crop": (2, 7), "matrix": (3, 9)}
_NAMES = tuple(KINDS)


class Transform(NamedTuple):
    """One transform of a chain: each input is the index of a column, or a number."""

    kind: str
    inputs: Sequence[float]
    columns: Sequence[int]  # one of an input; -1 for a number

    def moved(self, first: int) -> Transform:
        """The same transform of columns that begin at column `first` of another tensor."""
        return self._replace(columns=[c + first if c >= 0 else c for c in self.columns])


# The inputs that have to be 0 so that rows are mapped to rows: the angle and the shears, and the entries of a matrix that are
# neither scales nor translations.
_ZEROS = {"affine": (0, 5, 6), "crop": (), "matrix": (1, 3, 6, 7)}


def keeps_rows(chain: Sequence[Transform]) -> bool:
    """Whether the matrices of a chain map rows to rows, whatever the columns are."""
    return all(t.kind in _ZEROS and all(t.columns[i] < 0 and t.inputs[i] == 0 for i in _ZEROS[t.kind]) for t in chain)


def center_of(shape: Sequence[int]) -> tuple[float, float]:
    """The center x, y of images of a shape (..., H, W): integer coordinates are the centers of pixels."""
    return (shape[-1] - 1) / 2, (shape[-2] - 1) / 2


def affine(
    center: tuple[float, float],
    *,
    angle: int = -1,
    translation: tuple[int, int] = (-1, -1),
    scale: tuple[int, int] = (-1, -1),
    shear: tuple[int, int] = (-1, -1),
    about: tuple[int, int] = (-1, -1),
) -> Transform:
    """An affine transform from the columns of its parameters; those at -1 are the identity's, and `center`."""
    return Transform("affine", (0, 0, 0, 1, 1, 0, 0, *center), (angle, *translation, *scale, *shear, *about))


def constant(matrix: Sequence[Sequence[float]]) -> Transform:
    """A matrix that is the same for all samples."""
    return Transform("matrix", [entry for row in matrix for entry in row], [-1] * 9)


# Arguments of the operator: columns (B, P), the plan, numbers. The plan has for each transform its kind and the columns of
# its inputs, -1 for the number at the same position in `numbers`.


def _reference(columns: Tensor, plan: Sequence[int], numbers: Sequence[float]) -> Tensor:
    matrix = torch.eye(3, dtype=torch.float64, device=columns.device).expand(columns.shape[0], 3, 3)
    columns = columns.double()
    at, number = 0, 0
    while at < len(plan):
        name = _NAMES[plan[at]]
        count = KINDS[name][1]
        inputs = [
            columns[:, c] if c >= 0 else columns.new_full((columns.shape[0],), x)
            for c, x in zip(plan[at + 1 : at + 1 + count], numbers[number : number + count])
        ]
        matrix = _MATRICES[name](inputs) @ matrix
        at, number = at + 1 + count, number + count
    return matrix + 0  # no negative zeros


def _affine(inputs: list[Tensor]) -> Tensor:
    angle, x, y, scale_x, scale_y, shear_x, shear_y, center_x, center_y = inputs
    c, s = cos_sin(angle)
    a, b = torch.deg2rad(shear_x).tan(), torch.deg2rad(shear_y).tan()
    right, down = (scale_x * c, -scale_x * s), (scale_y * s, scale_y * c)
    rows: list[list[Tensor | float]] = []
    for r, d, center, offset in zip(right, down, (center_x, center_y), (x, y)):
        # The columns of the linear map: those of the rotation and scale, times [[1, -a], [-b, 1 + a b]].
        first = r - b * d
        second = d - a * first
        rows.append([first, second, center + offset - first * center_x - second * center_y])
    return matrix_of([*rows, [0.0, 0.0, 1.0]], angle)


def _perspective(inputs: list[Tensor]) -> Tensor:
    source, destination = (torch.stack(inputs[i : i + 8], -1).reshape(-1, 4, 2) for i in (0, 8))
    from_square = from_unit_square(source)
    a, b, c, d, e, f, g, h, i = from_square.flatten(1).unbind(1)
    adjugate = matrix_of(
        [
            [e * i - f * h, c * h - b * i, b * f - c * e],
            [f * g - d * i, a * i - c * g, c * d - a * f],
            [d * h - e * g, b * g - a * h, a * e - b * d],
        ],
        a,
    )
    matrix = from_unit_square(destination) @ adjugate
    matrix = matrix / matrix[:, 2:, 2:]
    # Exactly the identity where the points are the same, with the derivatives of the formula.
    same = (source == destination).flatten(1).all(1)[:, None, None]
    return matrix + torch.where(same, torch.eye(3, dtype=matrix.dtype, device=a.device) - matrix, 0.0).detach()


def _crop(inputs: list[Tensor]) -> Tensor:
    x, y, w, h, columns, rows, corners = inputs
    entries = []
    for first, size, result in ((x, w, columns), (y, h, rows)):
        between_centers = (result - 1).clamp(min=_SIDE) / (size - 1).clamp(min=_SIDE)
        scale = torch.where(corners > 0, between_centers, result / size)
        # Between edges the first pixel's center is half a pixel inside.
        half = torch.where(corners > 0, 0.0, 0.5)
        entries.append((scale, (half - first) * scale - half))
    (scale_x, offset_x), (scale_y, offset_y) = entries
    return matrix_of([[scale_x, 0.0, offset_x], [0.0, scale_y, offset_y], [0.0, 0.0, 1.0]], x)


_SIDE = 2.0**-20  # instead of a side of one pixel, whose ends are the same, so that the matrix has an inverse

_MATRICES = {
    "affine": _affine,
    "perspective": _perspective,
    "crop": _crop,
    "matrix": lambda inputs: torch.stack(inputs, -1).reshape(-1, 3, 3),
}

_transform_matrix_backward = register(
    "transform_matrix_backward",
    vjp(_reference),
    fake=lambda grad, columns, plan, numbers: columns.shape,
    layout_of=1,
)
_transform_matrix = register(
    "transform_matrix",
    _reference,
    fake=lambda columns, plan, numbers: (columns.shape[0], 3, 3),
    gradients="columns: transform_matrix_backward",
)


def make_plan(transforms: Sequence[Transform]) -> tuple[list[int], list[float]]:
    """The plan of at most MAX_TRANSFORMS transforms, and their numbers."""
    plan: list[int] = []
    numbers: list[float] = []
    for kind, inputs, columns in transforms:
        plan.append(KINDS[kind][0])
        plan += columns
        numbers += inputs
    return plan, numbers


class MatrixPlan:
    """The matrix of a chain of transforms, of which the first one is applied first: planned once, computed for any columns."""

    def __init__(self, transforms: Sequence[Transform]) -> None:
        starts = range(0, max(len(transforms), 1), MAX_TRANSFORMS)
        self.launches = [make_plan(transforms[start : start + MAX_TRANSFORMS]) for start in starts]

    def matrix(self, columns: Tensor) -> Tensor:
        """The homographies (B, 3, 3) from columns (B, P)."""
        first, *rest = self.launches
        matrix: Tensor = _transform_matrix(columns, *first)
        for launch in rest:
            matrix = _transform_matrix(columns, *launch) @ matrix
        return matrix


def transform_matrix(columns: Tensor, transforms: Sequence[Transform]) -> Tensor:
    """The homographies (B, 3, 3) of a chain, of which the first transform is applied first, from columns (B, P)."""
    return MatrixPlan(transforms).matrix(columns)
