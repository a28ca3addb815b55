"""The matrix of a chain of geometric transforms, from the columns of drawn parameters, in one launch."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from kvision._limits import AFFINE_INPUTS, CROP_INPUTS, MATRIX_INPUTS, MAX_TRANSFORMS, PERSPECTIVE_INPUTS
from kvision._modes import TRANSFORM_KIND, TRANSFORM_KIND_NAMES
from kvision._ops import register, vjp
from kvision.augmentation.columns import Input, Names, bind, split_inputs
from kvision.core.exceptions import ValueCheckError
from kvision.geometry.conversions.angles import cos_sin
from kvision.geometry.transform.matrices import from_unit_square, matrix_of

# How many inputs a kind of transform has, which Transform explains. All map image pixels to result pixels.
INPUTS = {"affine": AFFINE_INPUTS, "perspective": PERSPECTIVE_INPUTS, "crop": CROP_INPUTS, "matrix": MATRIX_INPUTS}


class Transform:
    """A formula of the matrix by which an augmentation moves pixels: its kind, and inputs that are drawn or given.

    An augmentation lists the transforms of its images in `transforms`, the first one first.

    Args:
        kind: 'affine', 'perspective', 'crop' or 'matrix'; :meth:`affine` and :meth:`constant` make the usual ones.
        *inputs: numbers, or names of fields of the generator, each of which stands for all columns of its field:

            - 'affine': angle in degrees, counter-clockwise; translation x, y; scale x, y; shear x, y in degrees; center x, y
            - 'perspective': four points x, y of the image, and where they go; nothing moves where one of its sides has no
              length, as that of a single pixel
            - 'crop': first column, first row, width and height of a window; columns and rows of the result; 1 if the centers
              of the outermost pixels correspond, 0 if their edges do
            - 'matrix': nine entries by rows

    Raises:
        ValueError: `kind` is unknown; in a call, a name that is none of a field, or another number of inputs.

    Example:
        >>> import kvision as K
        >>> K.augmentation.Transform.affine((7.5, 7.5), angle="degrees")
        Transform('affine', 'degrees', 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 7.5, 7.5)
    """

    def __init__(self, kind: str, *inputs: Input) -> None:
        if kind not in TRANSFORM_KIND:
            raise ValueCheckError(f"Transform: expected kind to be one of {', '.join(TRANSFORM_KIND)}, got {kind!r}")
        self.kind, self.inputs = kind, inputs

    def __repr__(self) -> str:
        return f"Transform({', '.join(map(repr, (self.kind, *self.inputs)))})"

    @staticmethod
    def affine(
        center: Pair,
        *,
        angle: Input = 0.0,
        translation: Pair = (0.0, 0.0),
        scale: Pair = (1.0, 1.0),
        shear: Pair = (0.0, 0.0),
    ) -> Transform:
        """Shear, scale and rotate about a center, then translate.

        Args:
            center: x, y: integer coordinates are the centers of pixels.
            angle: in degrees, counter-clockwise.
            translation: along x and y, in pixels; a pair, or the name of a field of two columns.
            scale: along x and y.
            shear: along x and y, in degrees.

        Returns:
            The transform.
        """
        pairs = [(pair,) if isinstance(pair, str) else pair for pair in (translation, scale, shear, center)]
        return Transform("affine", angle, *[x for pair in pairs for x in pair])

    @staticmethod
    def constant(matrix: Sequence[Sequence[float]]) -> Transform:
        """The same matrix (3, 3) for all samples, from pixels of the image to those of the result."""
        return Transform("matrix", *[entry for row in matrix for entry in row])

    def _bound(self, names: Names) -> Transform:
        """The same transform with columns in place of their names."""
        transform = Transform(self.kind, *bind(self.inputs, names))
        count = INPUTS[self.kind]
        if len(transform.inputs) != count:
            raise ValueCheckError(
                f"Transform: expected {count} inputs of {self.kind!r}, got {len(transform.inputs)} of {self!r}"
            )
        return transform


Pair = str | tuple[Input, Input]

# The inputs that have to be 0 so that rows are mapped to rows: the angle and the shears, and the entries of a matrix that are
# neither scales nor translations.
_ZEROS = {"affine": (0, 5, 6), "crop": (), "matrix": (1, 3, 6, 7)}


def keeps_rows(chain: Sequence[Transform]) -> bool:
    """Whether the matrices of a chain map rows to rows, whatever the columns are."""
    return all(t.kind in _ZEROS and all(t.inputs[i] == 0 for i in _ZEROS[t.kind]) for t in chain)


def center_of(shape: Sequence[int]) -> tuple[float, float]:
    """The center x, y of images of a shape (..., H, W): integer coordinates are the centers of pixels."""
    return (shape[-1] - 1) / 2, (shape[-2] - 1) / 2


# Arguments of the operator: columns (B, P), the plan, numbers. The plan has for each transform its kind and the columns of
# its inputs, -1 for the number at the same position in `numbers`.


def _reference(columns: Tensor, plan: Sequence[int], numbers: Sequence[float]) -> Tensor:
    matrix = torch.eye(3, dtype=torch.float64, device=columns.device).expand(columns.shape[0], 3, 3)
    columns = columns.double()
    at, number = 0, 0
    while at < len(plan):
        name = TRANSFORM_KIND_NAMES[plan[at]]
        count = INPUTS[name]
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
    # No matrix takes points that lie on one another apart: where a side is a single pixel it is the identity.
    no_side = (source[:, :2] == source[:, 1:3]).all(-1).any(-1)[:, None, None]
    square = source.new_tensor([[0, 0], [1, 0], [1, 1], [0, 1]])
    source, destination = (torch.where(no_side, square, points) for points in (source, destination))
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
    """The plan of at most MAX_TRANSFORMS bound transforms, and their numbers."""
    plan: list[int] = []
    numbers: list[float] = []
    for transform in transforms:
        own, columns = split_inputs(transform.inputs)
        plan += [TRANSFORM_KIND[transform.kind], *columns]
        numbers += own
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
