"""Matrices of geometric transforms, as the warps take them.

Angles and shears are tensors (B,). Centers and translations are (B, 2) or (B, 3), in the order (x, y) or (x, y, z).
Every function is differentiable, and none waits for the device.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import promoted
from kvision.core.exceptions import ShapeError, TypeCheckError
from kvision.geometry._formula import batch_of, register_formula
from kvision.geometry.bbox import corners
from kvision.geometry.conversions.angles import cos_sin
from kvision.geometry.conversions.homogeneous import homogeneous
from kvision.geometry.conversions.rotations import axis_angle_to_rotation_matrix
from kvision.geometry.linalg import adjugate, inverse4x4

__all__ = [
    "get_affine_matrix2d",
    "get_affine_matrix3d",
    "get_perspective_transform",
    "get_perspective_transform3d",
    "get_projective_transform",
    "get_rotation_matrix2d",
    "get_shear_matrix2d",
    "get_shear_matrix3d",
    "get_translation_matrix2d",
    "invert_affine_transform",
    "projection_from_Rt",
]

# --- building blocks ------------------------------------------------------------------------------------------------


def matrix_of(rows: list[list[Tensor | float]], like: Tensor) -> Tensor:
    """A matrix for each sample of `like` (B, ...), from its entries, each (B,) or a number."""
    shape = like.shape[:1]

    def entry(value: Tensor | float) -> Tensor:
        return value if isinstance(value, Tensor) else like.new_full(shape, value)

    return torch.stack([torch.stack([entry(value) for value in row], -1) for row in rows], -2)


def about(linear: Tensor, center: Tensor) -> Tensor:
    """The affine map (B, n, n + 1) that is `linear` (B, n, n) about `center` (B, n)."""
    moved = center - (linear @ center[..., None])[..., 0]
    return torch.cat([linear, moved[..., None]], -1)


def _batch(op: str, **vectors: tuple[Tensor, int]) -> None:
    """Raise unless all tensors are (B,) (for width 0) or (B, width), of one batch size, type and device."""
    for name, (x, width) in vectors.items():
        _check.shape(op, name, x, *(("B", width) if width else ("B",)))
        _check.floating(op, name, x)
    tensors = {name: x for name, (x, _) in vectors.items()}
    _check.same_device(op, **tensors)
    shapes = {name: tuple(x.shape) for name, x in tensors.items()}
    first, *others = (shape[0] for shape in shapes.values())
    if any(size != first for size in others):
        raise ShapeError(f"{op}: expected tensors of one batch size, got {shapes}")
    dtypes = {name: x.dtype for name, x in tensors.items()}
    if len(set(dtypes.values())) > 1:
        raise TypeCheckError(f"{op}: expected tensors of one type, got {dtypes}")


def _column(x: Tensor | None) -> Tensor | None:
    """One number a sample, (B,), also where it came as a column (B, 1)."""
    return x[:, 0] if isinstance(x, Tensor) and not x.is_nested and x.dim() == 2 and x.shape[1] == 1 else x


def _optional_vectors(**vectors: Tensor | None) -> dict[str, tuple[Tensor, int]]:
    return {name: (x, 0) for name, x in vectors.items() if x is not None}


# --- the operators: references and registrations ---------------------------------------------------------------------


def _affine2d_reference(degrees, translation, scale, shear_x, shear_y, center, sign, x, y, rows):
    """Shear, scale and rotate about a center, by default (x, y), then translate: (B, rows, 3), rows = 2 or 3."""
    c, s = cos_sin(sign * degrees)
    linear = matrix_of([[c, s], [-s, c]], degrees)
    if scale is not None:
        linear = linear * scale[:, None]
    if shear_x is not None or shear_y is not None:
        linear = linear @ _shears(shear_x, shear_y, degrees[:1])
    return _placed(linear, translation, center, (x, y), rows)


def _shears(shear_x: Tensor | None, shear_y: Tensor | None, like: Tensor) -> Tensor:
    a, b = torch.broadcast_tensors(*(torch.zeros_like(like) if s is None else s.tan() for s in (shear_x, shear_y)))
    return matrix_of([[1, -a], [-b, 1 + a * b]], a)


def _placed(linear, translation, center, otherwise, rows):
    """Apply a linear map (B, n, n) about a center, then translate: `rows` rows of the homography (B, n + 1, n + 1)."""
    batch, n = batch_of(linear, translation, center), linear.shape[1]
    if center is None:
        center = torch.stack([linear.new_full((1,), c) for c in otherwise], -1)
    linear, center = linear.expand(batch, -1, -1), center.expand(batch, -1)
    matrix = about(linear, center)
    if translation is not None:
        matrix = torch.cat([linear, matrix[..., n:] + translation[..., None]], -1)
    matrix = matrix + 0  # no negative zeros
    return matrix if rows == n else homogeneous(matrix)[:, :rows]


def _translation_reference(translation, *numbers_and_rows):
    *more, rows = numbers_and_rows
    n = len(more)
    columns = [x + number for x, number in zip(translation.unbind(-1), more)]
    matrix = [[*(float(i == k) for k in range(n)), column] for i, column in enumerate([*columns, 1.0])]
    return matrix_of(matrix[:rows], translation)


def _scale2d_reference(scale, center, x, y):
    return _placed(torch.diag_embed(scale), None, center, (x, y), 2)


def _shear2d_reference(center, shear_x, shear_y):
    return _placed(_shears(shear_x, shear_y, center[:1, 0]), None, center, (), 3)


def _shear_factor2d_reference(factors):
    x, y = factors.unbind(-1)
    return matrix_of([[1, x, 0], [y, 1, 0]], factors)


def _inverse2d_reference(matrix):
    (a, b, x), (c, d, y) = (row.unbind(-1) for row in matrix.unbind(-2))
    inverse = matrix_of([[d, -b, b * y - d * x], [-c, a, c * x - a * y]], matrix) / (a * d - b * c)[:, None, None]
    return inverse + 0  # no negative zeros


def _perspective_reference(points_src, points_dst):
    matrix = from_unit_square(promoted(points_dst)) @ adjugate(from_unit_square(promoted(points_src)))
    return (matrix / matrix[:, 2:, 2:] + 0).to(points_src.dtype)  # no negative zeros


def _crop_matrix_reference(quads, first, across, down):
    """The map from result pixels to image pixels. In this direction a side of one pixel needs no special case."""
    matrix = from_unit_square(promoted(quads))
    last = matrix[:, 2:, 2:]
    right, downwards, origin = (matrix / torch.where(last == 0, 1, last)).split(1, -1)
    right, downwards = right / across, downwards / down
    if first is not None:
        x, y = promoted(first)[..., None, None].unbind(1)
        origin = origin - right * x - downwards * y
    linear = torch.cat([right, downwards], -1)
    return torch.cat([linear.expand(origin.shape[0], -1, -1), origin], -1).to(quads.dtype)


def _perspective3d_reference(points_src, points_dst, *extent):
    if points_dst is None:
        last = matrix_of([list(extent)], points_src[:1])[:, 0]
        points_dst = corners(torch.zeros_like(last), last)
    p, q = (
        promoted(torch.cat([x[:, :3], x[:, 5::2]], 1)) for x in (points_src, points_dst)
    )  # no four of them coplanar
    matrix = _from_simplex(q) @ inverse4x4(_from_simplex(p))
    return (matrix / matrix[:, 3:, 3:]).to(points_src.dtype)


def _from_simplex(points: Tensor) -> Tensor:
    """The homography from the unit vectors and their sum to five `points` (B, 5, 3)."""
    p = torch.cat([points, torch.ones_like(points[..., :1])], -1).mT
    weights = inverse4x4(p[..., :4]) @ p[..., 4:]
    return p[..., :4] * weights.mT


def _affine3d_reference(x, y, z, translation, scale, center, xy, xz, yx, yz, zx, zy, sign, cx, cy, cz, rows):
    """Shear, scale and rotate about a center, by default (cx, cy, cz), then translate: (B, rows, 4), with 3 or 4 rows."""
    shears = (xy, xz, yx, yz, zx, zy)
    batch = batch_of(x, y, z, translation, scale, center, *shears)
    axis = torch.stack([angle.expand(batch) for angle in (x, y, z)], -1)
    linear = axis_angle_to_rotation_matrix(torch.deg2rad(sign * axis))
    if scale is not None:
        linear = linear * scale[:, None]
    if any(s is not None for s in shears):
        linear = linear @ _shears3d(shears, x[:1])
    return _placed(linear, translation, center, (cx, cy, cz), rows)


def _shears3d(angles: Sequence[Tensor | None], like: Tensor) -> Tensor:
    tangents = (torch.zeros_like(like) if s is None else -s.tan() for s in angles)
    xy, xz, yx, yz, zx, zy = torch.broadcast_tensors(*tangents)
    along_x = matrix_of([[1, 0, 0], [xy, 1, 0], [xz, 0, 1]], xy)
    along_y = matrix_of([[1, yx, 0], [0, 1, 0], [0, yz, 1]], xy)
    along_z = matrix_of([[1, 0, zx], [0, 1, zy], [0, 0, 1]], xy)
    return along_x @ along_y @ along_z


def _shear3d_reference(center, *angles):
    return _placed(_shears3d(angles, center[:1, 0]), None, center, (), 4)


# The kernels take None and broadcast arguments directly, so that a matrix needs one launch.
affine_matrix2d = register_formula("affine_matrix2d", _affine2d_reference, lambda *args: (args[-1], 3))
translation_matrix2d = register_formula("translation_matrix2d", _translation_reference, lambda *args: (args[-1], 3))
scale_matrix2d = register_formula("scale_matrix2d", _scale2d_reference, lambda *args: (2, 3))
shear_factor_matrix2d = register_formula("shear_factor_matrix2d", _shear_factor2d_reference, lambda *args: (2, 3))
translation_matrix3d = register_formula("translation_matrix3d", _translation_reference, lambda *args: (args[-1], 4))
affine_matrix3d = register_formula("affine_matrix3d", _affine3d_reference, lambda *args: (args[-1], 4))
_shear_matrix2d = register_formula("shear_matrix2d", _shear2d_reference, lambda *args: (3, 3))
_shear_matrix3d = register_formula("shear_matrix3d", _shear3d_reference, lambda *args: (4, 4))
_invert_affine2d = register_formula("invert_affine2d", _inverse2d_reference, lambda *args: (2, 3))
_perspective_matrix = register_formula("perspective_matrix", _perspective_reference, lambda *args: (3, 3))
perspective_matrix3d = register_formula("perspective_matrix3d", _perspective3d_reference, lambda *args: (4, 4))
# Maps from pixels of the result to the quadrangles (B, 4, 2) that are resampled into a rectangle of the result. Its
# first pixel is `first` (B, 2), None for (0, 0). Its last pixel is `across` columns and `down` rows further.
crop_matrix = register_formula("crop_matrix", _crop_matrix_reference, lambda *args: (3, 3))

# --- two dimensions -------------------------------------------------------------------------------------------------


def get_rotation_matrix2d(center: Tensor, angle: Tensor, scale: Tensor) -> Tensor:
    """Compute affine matrices that scale, then rotate about a center.

    Args:
        center: (B, 2) as (x, y).
        angle: (B,) in degrees, counter-clockwise as displayed. Multiples of 90 degrees are exact.
        scale: (B, 2) along x and y.

    Returns:
        (B, 2, 3), source pixels to result pixels.

    Raises:
        TypeError: an argument is not a floating-point tensor; the tensors have different dtypes.
        ValueError: `center` is not (B, 2); `angle` is not (B,); `scale` is not (B, 2); the batch sizes differ; the
            tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.get_rotation_matrix2d(torch.tensor([[1.0, 0]]), torch.tensor([90.0]), torch.ones(1, 2))
        tensor([[[ 0.,  1.,  1.],
                 [-1.,  0.,  1.]]])
    """
    _batch("get_rotation_matrix2d", center=(center, 2), angle=(angle, 0), scale=(scale, 2))
    return affine_matrix2d(angle, None, scale, None, None, center, 1.0, 0.0, 0.0, 2)


def get_translation_matrix2d(translations: Tensor) -> Tensor:
    """Compute homographies that translate by (x, y) pixels.

    Args:
        translations: (B, 2) as (x, y), floating point, in pixels.

    Returns:
        (B, 3, 3), source pixels to result pixels.

    Raises:
        TypeError: `translations` is not a floating-point tensor.
        ValueError: `translations` is not (B, 2).

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.get_translation_matrix2d(torch.tensor([[2.0, 3]]))
        tensor([[[1., 0., 2.],
                 [0., 1., 3.],
                 [0., 0., 1.]]])
    """
    _batch("get_translation_matrix2d", translations=(translations, 2))
    return translation_matrix2d(translations, 0.0, 0.0, 3)


def get_shear_matrix2d(center: Tensor, sx: Tensor | None = None, sy: Tensor | None = None) -> Tensor:
    """Compute homographies that shear along x, then along y, about a center.

    Args:
        center: (B, 2) as (x, y).
        sx: angles of the shear along x in radians, (B,); None for 0.
        sy: angles of the shear along y in radians, (B,) or (B, 1); None for 0.

    Returns:
        (B, 3, 3) with the linear part [[1, -tan sx], [-tan sy, 1 + tan sx tan sy]].

    Raises:
        TypeError: an argument is not a floating-point tensor; the tensors have different dtypes.
        ValueError: `center` is not (B, 2); `sx` is not (B,); `sy` is not (B,); the batch sizes differ; the tensors are
            on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.get_shear_matrix2d(torch.zeros(1, 2), torch.tensor([0.5]))[0, 0]
        tensor([ 1.0000, -0.5463,  0.0000])
    """
    sx, sy = _column(sx), _column(sy)
    _batch("get_shear_matrix2d", center=(center, 2), **_optional_vectors(sx=sx, sy=sy))
    return _shear_matrix2d(center, sx, sy)


def get_affine_matrix2d(
    translations: Tensor,
    center: Tensor,
    scale: Tensor,
    angle: Tensor,
    sx: Tensor | None = None,
    sy: Tensor | None = None,
) -> Tensor:
    """Compute homographies that shear, scale and rotate about a center, then translate.

    Args:
        translations: (B, 2) in pixels as (x, y).
        center: (B, 2) as (x, y), in pixels.
        scale: (B, 2) along x and y.
        angle: (B,) in degrees, clockwise as displayed.
        sx: angles of the shear along x in radians, (B,) or (B, 1), as :func:`get_shear_matrix2d` takes them; None for 0.
        sy: angles of the shear along y in radians, (B,) or (B, 1); None for 0.

    Returns:
        (B, 3, 3), source pixels to result pixels.

    Raises:
        TypeError: an argument is not a floating-point tensor; the tensors have different dtypes.
        ValueError: `translations` is not (B, 2); `center` is not (B, 2); `scale` is not (B, 2); `angle` is not (B,);
            `sx` is not (B,); `sy` is not (B,); the batch sizes differ; the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> zero, one = torch.zeros(1, 2), torch.ones(1, 2)
        >>> K.geometry.get_affine_matrix2d(one, zero, 2 * one, torch.tensor([90.0]))
        tensor([[[ 0., -2.,  1.],
                 [ 2.,  0.,  1.],
                 [ 0.,  0.,  1.]]])
    """
    sx, sy = _column(sx), _column(sy)
    parts = {"translations": (translations, 2), "center": (center, 2), "scale": (scale, 2), "angle": (angle, 0)}
    _batch("get_affine_matrix2d", **parts, **_optional_vectors(sx=sx, sy=sy))
    return affine_matrix2d(angle, translations, scale, sx, sy, center, -1.0, 0.0, 0.0, 3)


def invert_affine_transform(matrix: Tensor) -> Tensor:
    """Invert affine matrices.

    Args:
        matrix: (B, 2, 3).

    Returns:
        (B, 2, 3); inf or NaN where there is no inverse.

    Raises:
        TypeError: `matrix` is not a floating-point tensor.
        ValueError: `matrix` is not (B, 2, 3).

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.invert_affine_transform(torch.tensor([[[2.0, 0, 1], [0, 4, 0]]]))
        tensor([[[ 0.5000,  0.0000, -0.5000],
                 [ 0.0000,  0.2500,  0.0000]]])
    """
    _check.shape("invert_affine_transform", "matrix", matrix, "B", 2, 3)
    _check.floating("invert_affine_transform", "matrix", matrix)
    return _invert_affine2d(matrix)


def get_perspective_transform(points_src: Tensor, points_dst: Tensor) -> Tensor:
    """Compute the homographies that map four points to four others, in closed form.

    Args:
        points_src: (B, 4, 2) as (x, y), in order around a quadrangle.
        points_dst: the points that they map to, (B, 4, 2).

    Returns:
        (B, 3, 3) whose last entry is 1. NaN or inf where three of four points are on a line.

    Raises:
        TypeError: an argument is not a floating-point tensor; the tensors have different dtypes.
        ValueError: `points_src` is not (B, 4, 2); `points_dst` does not have the shape of `points_src`; the tensors are
            on different devices.

    Source: P. Heckbert, "Fundamentals of Texture Mapping and Image Warping" (1989), section 2.2.3.

    Example:
        >>> import torch, kvision as K
        >>> square = torch.tensor([[[0.0, 0], [1, 0], [1, 1], [0, 1]]])
        >>> K.geometry.get_perspective_transform(square, 2 * square + 1)
        tensor([[[2., 0., 1.],
                 [0., 2., 1.],
                 [0., 0., 1.]]])
    """
    op = "get_perspective_transform"
    for name, points in (("points_src", points_src), ("points_dst", points_dst)):
        _check.shape(op, name, points, "B", 4, 2)
        _check.floating(op, name, points)
    _check.shape(op, "points_dst", points_dst, *points_src.shape)
    _check.same_device(op, points_src=points_src, points_dst=points_dst)
    if points_src.dtype != points_dst.dtype:
        raise TypeCheckError(f"{op}: expected points of one type, got {points_src.dtype} and {points_dst.dtype}")
    return _perspective_matrix(points_src, points_dst)


def from_unit_square(points: Tensor) -> Tensor:
    """A homography from (0, 0), (1, 0), (1, 1), (0, 1) to `points` (B, 4, 2), which may be in one line."""
    p0, p1, p2, p3 = points.unbind(-2)

    def area(a: Tensor, b: Tensor) -> Tensor:
        return a[:, :1] * b[:, 1:] - a[:, 1:] * b[:, :1]

    u, v, skew = p1 - p2, p3 - p2, p0 - p1 + p2 - p3
    g, h, w = area(skew, v), area(u, skew), area(u, v)
    # For a box without area all three are 0; it is treated as a parallelogram.
    flat = (w == 0) & (skew == 0).all(-1, keepdim=True)
    w = torch.where(flat, 1, w)
    columns = [w * (p1 - p0) + g * p1, w * (p3 - p0) + h * p3, w * p0]
    return torch.stack([torch.cat([c, d], -1) for c, d in zip(columns, (g, h, w))], -1)


# --- three dimensions -----------------------------------------------------------------------------------------------


def get_projective_transform(center: Tensor, angles: Tensor, scales: Tensor) -> Tensor:
    """Compute affine matrices of space that scale, then rotate about a center.

    Args:
        center: (B, 3) as (x, y, z).
        angles: (B, 3), the axis of rotation times the angle in degrees.
        scales: (B, 3) along x, y and z, or (B, 1) along all of them.

    Returns:
        (B, 3, 4), source voxels to result voxels.

    Raises:
        TypeError: an argument is not a floating-point tensor; the tensors have different dtypes.
        ValueError: `center` is not (B, 3); `angles` is not (B, 3); `scales` is not (B, 3); the batch sizes differ; the
            tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> about_z = torch.tensor([[0.0, 0, 90]])
        >>> K.geometry.get_projective_transform(torch.zeros(1, 3), about_z, torch.ones(1, 3)).round().long()[0, 0]
        tensor([ 0, -1,  0,  0])
    """
    if isinstance(scales, Tensor) and not scales.is_nested and scales.dim() == 2 and scales.shape[1] == 1:
        scales = scales.expand(-1, 3)
    _batch("get_projective_transform", center=(center, 3), angles=(angles, 3), scales=(scales, 3))
    return affine_matrix3d(*angles.unbind(-1), None, scales, center, *[None] * 6, 1.0, 0.0, 0.0, 0.0, 3)


def get_shear_matrix3d(
    center: Tensor,
    sxy: Tensor | None = None,
    sxz: Tensor | None = None,
    syx: Tensor | None = None,
    syz: Tensor | None = None,
    szx: Tensor | None = None,
    szy: Tensor | None = None,
) -> Tensor:
    """Compute homographies of space that shear along z, then y, then x, about a center.

    Args:
        center: (B, 3) as (x, y, z).
        sxy: angle in radians by which y moves with x, (B,); None for 0.
        sxz: angle in radians by which z moves with x, (B,); None for 0.
        syx: angle in radians by which x moves with y, (B,); None for 0.
        syz: angle in radians by which z moves with y, (B,); None for 0.
        szx: angle in radians by which x moves with z, (B,); None for 0.
        szy: angle in radians by which y moves with z, (B,); None for 0.

    Returns:
        (B, 4, 4).

    Raises:
        TypeError: an argument is not a floating-point tensor; the tensors have different dtypes.
        ValueError: `center` is not (B, 3); an angle is not (B,); the batch sizes differ; the tensors are on different
            devices.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.get_shear_matrix3d(torch.zeros(1, 3), szx=torch.tensor([0.5]))[0, 0]
        tensor([ 1.0000,  0.0000, -0.5463,  0.0000])
    """
    angles = {"sxy": sxy, "sxz": sxz, "syx": syx, "syz": syz, "szx": szx, "szy": szy}
    _batch("get_shear_matrix3d", center=(center, 3), **_optional_vectors(**angles))
    return _shear_matrix3d(center, *angles.values())


def get_affine_matrix3d(
    translations: Tensor,
    center: Tensor,
    scale: Tensor,
    angles: Tensor,
    sxy: Tensor | None = None,
    sxz: Tensor | None = None,
    syx: Tensor | None = None,
    syz: Tensor | None = None,
    szx: Tensor | None = None,
    szy: Tensor | None = None,
) -> Tensor:
    """Compute homographies of space that shear, scale and rotate about a center, then translate.

    Args:
        translations: (B, 3) in voxels as (x, y, z).
        center: (B, 3) as (x, y, z), in voxels.
        scale: (B, 3) along x, y and z.
        angles: (B, 3), the axis of rotation times the angle in degrees; the rotation is opposite to that of
            :func:`get_projective_transform`.
        sxy: angle in radians by which y moves with x, (B,); None for 0.
        sxz: angle in radians by which z moves with x, (B,); None for 0.
        syx: angle in radians by which x moves with y, (B,); None for 0.
        syz: angle in radians by which z moves with y, (B,); None for 0.
        szx: angle in radians by which x moves with z, (B,); None for 0.
        szy: angle in radians by which y moves with z, (B,); None for 0.

    Returns:
        (B, 4, 4), source voxels to result voxels.

    Raises:
        TypeError: an argument is not a floating-point tensor; the tensors have different dtypes.
        ValueError: `translations`, `center`, `scale` or `angles` is not (B, 3); a shear is not (B,); the batch sizes
            differ; the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> zero, one = torch.zeros(1, 3), torch.ones(1, 3)
        >>> K.geometry.get_affine_matrix3d(one, zero, 2 * one, zero)[0, 0]
        tensor([2., 0., 0., 1.])
    """
    shears = {"sxy": sxy, "sxz": sxz, "syx": syx, "syz": syz, "szx": szx, "szy": szy}
    parts = {"translations": (translations, 3), "center": (center, 3), "scale": (scale, 3), "angles": (angles, 3)}
    _batch("get_affine_matrix3d", **parts, **_optional_vectors(**shears))
    rotation = angles.unbind(-1)
    return affine_matrix3d(*rotation, translations, scale, center, *shears.values(), -1.0, 0.0, 0.0, 0.0, 4)


def get_perspective_transform3d(src: Tensor, dst: Tensor) -> Tensor:
    """Compute the homographies of space that map the corners of a box to others.

    Five of the corners determine it: the first three, the sixth and the eighth.

    Args:
        src: (B, 8, 3) as (x, y, z): the front four corners in order around, then the back four.
        dst: the points that they map to, (B, 8, 3).

    Returns:
        (B, 4, 4) whose last entry is 1. NaN or inf where four of the five corners are in a plane.

    Raises:
        TypeError: an argument is not a floating-point tensor; the tensors have different dtypes.
        ValueError: `src` is not (B, 8, 3); `dst` does not have the shape of `src`; the tensors are on different
            devices.

    Example:
        >>> import torch, kvision as K
        >>> x, y, z = [0.0, 1, 1, 0] * 2, [0.0, 0, 1, 1] * 2, [0.0] * 4 + [1.0] * 4
        >>> cube = torch.tensor([x, y, z]).T[None]
        >>> K.geometry.get_perspective_transform3d(cube, 2 * cube + 1).round(decimals=3)[0, 0] + 0
        tensor([2., 0., 0., 1.])
    """
    op = "get_perspective_transform3d"
    for name, points in (("src", src), ("dst", dst)):
        _check.shape(op, name, points, "B", 8, 3)
        _check.floating(op, name, points)
    _check.shape(op, "dst", dst, *src.shape)
    _check.same_device(op, src=src, dst=dst)
    if src.dtype != dst.dtype:
        raise TypeCheckError(f"{op}: expected points of one type, got {src.dtype} and {dst.dtype}")
    return perspective_matrix3d(src, dst, 0.0, 0.0, 0.0)


def projection_from_Rt(rmat: Tensor, tvec: Tensor) -> Tensor:
    """Concatenate rotations and translations to projection matrices [R | t].

    Args:
        rmat: rotations (*, 3, 3).
        tvec: translations (*, 3, 1), with the same leading axes.

    Returns:
        (*, 3, 4).

    Raises:
        TypeError: `rmat` or `tvec` is not a tensor of real numbers.
        ValueError: `rmat` is not (*, 3, 3); `tvec` is not (*, 3, 1); their leading axes differ.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.projection_from_Rt(torch.eye(3), torch.ones(3, 1))[0]
        tensor([1., 0., 0., 1.])
    """
    _check.numbers("projection_from_Rt", "rmat", rmat)
    _check.numbers("projection_from_Rt", "tvec", tvec)
    _check.same_device("projection_from_Rt", rmat=rmat, tvec=tvec)
    r, t = rmat.shape, tvec.shape
    if r[-2:] != (3, 3):
        raise ShapeError(f"projection_from_Rt: expected rmat of shape (*, 3, 3), got {tuple(r)}")
    if t != (*r[:-1], 1):
        raise ShapeError(f"projection_from_Rt: expected tvec of shape {(*r[:-1], 1)}, got {tuple(t)}")
    return torch.cat([rmat, tvec], -1)
