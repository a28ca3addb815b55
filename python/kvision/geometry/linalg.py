"""Rigid and projective transformations of points, and distances."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.compiler import is_compiling

from kvision import _check
from kvision._dtype import floats
from kvision._ops import with_kernel_casts
from kvision.core.exceptions import ShapeError
from kvision.geometry._formula import of_all, of_rows, register_formula
from kvision.geometry._transform_points import transformed
from kvision.geometry.conversions.homogeneous import divisor, homogeneous

__all__ = [
    "batched_dot_product",
    "batched_squared_norm",
    "compose_transformations",
    "euclidean_distance",
    "inverse_transformation",
    "point_line_distance",
    "relative_transformation",
    "squared_norm",
    "transform_points",
]

# --- transformations ------------------------------------------------------------------------------------------------


def compose_transformations(trans_01: Tensor, trans_12: Tensor) -> Tensor:
    """Compose transformations: T_01 T_12 = T_02, where T_ab maps points of frame b to frame a.

    Args:
        trans_01: transformations of shape (*, 4, 4). Their last row is assumed to be 0 0 0 1.
        trans_12: transformations of shape (*, 4, 4). Leading axes broadcast.

    Returns:
        Transformations of shape (*, 4, 4).

    Raises:
        TypeError: `trans_01` or `trans_12` is not a tensor of real numbers.
        ValueError: a shape is not as in Args, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> move = torch.eye(4)
        >>> move[0, 3] = 2
        >>> K.geometry.compose_transformations(move, move)[0, 3]
        tensor(4.)
    """
    _check_pair("compose_transformations", trans_01=trans_01, trans_12=trans_12)
    return of_all(_composed, 2, floats(trans_01), trans_12)


def _composed_reference(first: Tensor, second: Tensor) -> Tensor:
    return homogeneous(first[..., :3, :3] @ second[..., :3, :] + _translation(first))


def inverse_transformation(trans_12: Tensor) -> Tensor:
    """Invert rigid transformations: (R, t) becomes (R^T, -R^T t).

    Args:
        trans_12: rigid transformations of shape (*, 4, 4). Their last row is assumed to be 0 0 0 1.

    Returns:
        Transformations of shape (*, 4, 4).

    Raises:
        TypeError: `trans_12` is not a tensor of real numbers.
        ValueError: `trans_12` is not of shape (*, 4, 4).

    Example:
        >>> import torch, kvision as K
        >>> move = torch.eye(4)
        >>> move[0, 3] = 2
        >>> K.geometry.inverse_transformation(move)[0, 3]
        tensor(-2.)
    """
    _check.trailing_shape("inverse_transformation", "trans_12", trans_12, 4, 4)
    return of_rows(_inverted, floats(trans_12), 2)


def _inverted_reference(pose: Tensor) -> Tensor:
    back = pose[..., :3, :3].mT
    return homogeneous(torch.cat([back, -back @ pose[..., :3, 3:]], -1))


def relative_transformation(trans_01: Tensor, trans_02: Tensor) -> Tensor:
    """The transformation between two frames from their transformations to a third: T_01^-1 T_02 = T_12.

    Args:
        trans_01: rigid transformations of shape (*, 4, 4). Their last row is assumed to be 0 0 0 1.
        trans_02: transformations of shape (*, 4, 4). Leading axes broadcast.

    Returns:
        Transformations of shape (*, 4, 4).

    Raises:
        TypeError: `trans_01` or `trans_02` is not a tensor of real numbers.
        ValueError: a shape is not as in Args, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> a, b = torch.eye(4), torch.eye(4)
        >>> a[0, 3], b[0, 3] = 2, 5
        >>> K.geometry.relative_transformation(a, b)[0, 3]
        tensor(3.)
    """
    _check_pair("relative_transformation", trans_01=trans_01, trans_02=trans_02)
    return of_all(_relative, 2, floats(trans_01), trans_02)


def _relative_reference(first: Tensor, second: Tensor) -> Tensor:
    return homogeneous(first[..., :3, :3].mT @ (second[..., :3, :] - _translation(first)))


def _translation(pose: Tensor) -> Tensor:
    """A matrix (*, 3, 4) with a translation in the last column and 0 elsewhere."""
    return torch.cat([torch.zeros_like(pose[..., :3, :3]), pose[..., :3, 3:]], -1)


_composed = register_formula("compose_poses", _composed_reference, lambda *args: (4, 4))
_inverted = register_formula("invert_pose", _inverted_reference, lambda *args: (4, 4))
_relative = register_formula("relative_pose", _relative_reference, lambda *args: (4, 4))


def _check_pair(op: str, **poses: Tensor) -> None:
    for name, pose in poses.items():
        _check.trailing_shape(op, name, pose, 4, 4)
    _check.same_device(op, **poses)
    _check.broadcastable(op, **{name: pose.shape[:-2] for name, pose in poses.items()})


def transform_points(trans_01: Tensor, points_1: Tensor) -> Tensor:
    """Apply homogeneous transformations to points: multiply, then divide by the last coordinate.

    A point whose last coordinate has a magnitude of at most 1e-8 is not divided.

    Args:
        trans_01: one matrix for all points, of shape (D + 1, D + 1) or (1, D + 1, D + 1), or one for each sample, of shape
            (B, D + 1, D + 1). Projections (3, 4) or (B, 3, 4) take points of space to the plane.
        points_1: points of shape (*, D), or (B, *, D) with a matrix for each sample. Integers give the type of the matrix.

    Returns:
        Points of the shape of `points_1`; for projections (*, 2).

    Raises:
        TypeError: `trans_01` or `points_1` is not a tensor of real numbers.
        ValueError: a shape is not as in Args, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> matrix = torch.tensor([[[1.0, 0, 5], [0, 1, 0], [0, 0, 2]]])
        >>> K.geometry.transform_points(matrix, torch.tensor([[[1.0, 4.0]]]))
        tensor([[[3., 2.]]])
    """
    op = "transform_points"
    _check.numbers(op, "trans_01", trans_01)
    _check.numbers(op, "points_1", points_1)
    is_projection = trans_01.shape[-2:] == (3, 4)
    if (
        points_1.dim() == 0
        or trans_01.dim() not in (2, 3)
        or not (is_projection or trans_01.shape[-1] == trans_01.shape[-2])
    ):
        raise ShapeError(
            f"{op}: expected trans_01 of shape (B, D + 1, D + 1) and points_1 of shape (B, *, D), "
            f"got {tuple(trans_01.shape)} and {tuple(points_1.shape)}"
        )
    _check.trailing_shape(op, "points_1", points_1, trans_01.shape[-1] - 1)
    _check.same_device(op, trans_01=trans_01, points_1=points_1)
    batch = trans_01.shape[0] if trans_01.dim() == 3 else 1
    if batch != 1 and (points_1.dim() < 3 or points_1.shape[0] != batch):
        raise ShapeError(
            f"{op}: expected points_1 of shape ({batch}, *, {points_1.shape[-1]}), got {tuple(points_1.shape)}"
        )
    if not points_1.is_floating_point():
        points_1 = points_1.to(floats(trans_01).dtype)
    return transformed(points_1, trans_01)


def adjugate(matrix: Tensor) -> Tensor:
    """The adjugate of (*, 3, 3): the inverse times the determinant. A homography is defined up to such a factor."""
    a, b, c = matrix.unbind(-2)
    columns = [torch.linalg.cross(b, c), torch.linalg.cross(c, a), torch.linalg.cross(a, b)]
    return torch.stack(columns, -1)


def inverse3x3(matrix: Tensor) -> Tensor:
    """The inverse of (*, 3, 3) in closed form. Singular matrices give inf or NaN."""
    adjugates = adjugate(matrix)
    return adjugates / (matrix[..., 0, :] * adjugates[..., :, 0]).sum(-1)[..., None, None]


def inverse4x4(matrix: Tensor) -> Tensor:
    """The inverse of (*, 4, 4) in closed form, of its blocks of 2 x 2. Singular matrices give inf or NaN."""
    a, b, c, d = (block for half in matrix.split(2, -2) for block in half.split(2, -1))
    ab, dc = _adjugate2x2(a) @ b, _adjugate2x2(d) @ c
    det_a, det_b, det_c, det_d = map(_determinant2x2, (a, b, c, d))
    determinant = det_a * det_d + det_b * det_c - (ab * dc.mT).sum((-2, -1), keepdim=True)
    upper = [det_d * a - b @ dc, det_b * c - d @ _adjugate2x2(ab)]
    lower = [det_c * b - a @ _adjugate2x2(dc), det_a * d - c @ ab]
    return (
        torch.cat([torch.cat([_adjugate2x2(block) for block in row], -1) for row in (upper, lower)], -2) / determinant
    )


def _adjugate2x2(matrix: Tensor) -> Tensor:
    (a, b), (c, d) = (row.unbind(-1) for row in matrix.unbind(-2))
    return torch.stack([torch.stack([d, -b], -1), torch.stack([-c, a], -1)], -2)


def _determinant2x2(matrix: Tensor) -> Tensor:
    (a, b), (c, d) = (row.unbind(-1) for row in matrix.unbind(-2))
    return (a * d - b * c)[..., None, None]


def dominant_eigenvector(matrix: Tensor) -> Tensor:
    """Unit eigenvectors (*, n) of the largest eigenvalues of symmetric, positive matrices (*, n, n); 0 for the matrix 0.

    Repeated squaring turns a matrix into a multiple of v v^T. No solver is called, so nothing waits for the device. The gradient
    is finite for all other eigenvalues. Eigenvectors of eigenvalues whose relative difference is below 1e-4 are mixed.
    """
    shape, n = matrix.shape, matrix.shape[-1]
    matrix = matrix.reshape(-1, n, n)
    # Of a matrix of trace 1 no eigenvalue is above 1, and the largest one's power, at least n^-(2^squarings), is not 0.
    rounds, squarings = (2, 9) if n <= 3 else (3, 6)
    tiny = torch.finfo(matrix.dtype).tiny
    for _ in range(rounds):
        trace = matrix.diagonal(dim1=1, dim2=2).sum(1).clamp_min(tiny)
        matrix = matrix / trace.view(-1, 1, 1)
        for _ in range(squarings):
            matrix = torch.bmm(matrix, matrix)
    square, largest = matrix.diagonal(dim1=1, dim2=2).max(1, keepdim=True)
    row = matrix.gather(1, largest.unsqueeze(2).expand(-1, 1, n)).view(-1, n)  # also a column: the matrix is symmetric
    return (row / square.clamp_min(tiny).sqrt()).view(shape[:-1])


def product_plus(a: Tensor, b: Tensor, c: Tensor, sign: int = 1) -> Tensor:
    """c + sign a b for matrices whose leading axes broadcast: one call of torch for plain batches."""
    if not is_compiling() and a.dim() == b.dim() == c.dim() == 3 and a.shape[0] == b.shape[0] == c.shape[0]:
        return torch.baddbmm(c, a, b, alpha=sign)
    return torch.add(c, a @ b, alpha=sign)


# --- distances ------------------------------------------------------------------------------------------------------


def point_line_distance(point: Tensor, line: Tensor, eps: float = 1e-9) -> Tensor:
    """The distance between points and lines a x + b y + c = 0.

    Args:
        point: points (x, y) of shape (*, 2), or homogeneous points (x, y, w) of shape (*, 3).
        line: lines (a, b, c) of shape (*, 3), of any scale. Leading axes broadcast.
        eps: not used; accepted for compatibility, as the distance does not depend on the scale of `line`.

    Returns:
        Distances of shape (*). They are inf for points at infinity and for lines without a direction (a = b = 0).

    Raises:
        TypeError: `point` or `line` is not a tensor of real numbers.
        ValueError: a shape is not as in Args, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.point_line_distance(torch.tensor([1.0, 2.0]), torch.tensor([0.0, 2.0, 2.0]))
        tensor(3.)
    """
    op = "point_line_distance"
    _check.numbers(op, "point", point)
    if point.dim() == 0 or point.shape[-1] not in (2, 3):
        raise ShapeError(f"{op}: expected point of shape (*, 2) or (*, 3), got {tuple(point.shape)}")
    _check.trailing_shape(op, "line", line, 3)
    _check.same_device(op, point=point, line=line)
    _check.broadcastable(op, point=point.shape[:-1], line=line.shape[:-1])
    return _point_line_distance(floats(point), floats(line))


@with_kernel_casts
def _point_line_distance(point: Tensor, line: Tensor) -> Tensor:
    a, b, offset = line.unbind(-1)
    x, y, *w = point.unbind(-1)
    squared = torch.addcmul(a * a, b, b)
    if w:
        offset, squared = offset * w[0], squared * w[0] * w[0]
    above = torch.addcmul(torch.addcmul(offset, a, x), b, y)
    degenerate = squared == 0
    distance = above.abs() / squared.masked_fill(degenerate, 1).sqrt()
    return distance.masked_fill(degenerate, torch.inf)


def batched_dot_product(x: Tensor, y: Tensor, keepdim: bool = False) -> Tensor:
    """The dot product along the last axis.

    Args:
        x: vectors of shape (*, D).
        y: vectors of shape (*, D). Leading axes broadcast.
        keepdim: keep the last axis, with one entry.

    Returns:
        Dot products of shape (*), or (*, 1) with `keepdim`.

    Raises:
        TypeError: `x` or `y` is not a tensor of real numbers.
        ValueError: a shape is not as in Args, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.linalg.batched_dot_product(torch.tensor([1.0, 2.0]), torch.tensor([3.0, 4.0]))
        tensor(11.)
    """
    _check_vectors("batched_dot_product", x=x, y=y)
    return (x * y).sum(-1, keepdim)


def batched_squared_norm(x: Tensor, keepdim: bool = False) -> Tensor:
    """The sum of squares along the last axis.

    Args:
        x: vectors of shape (*, D).
        keepdim: keep the last axis, with one entry.

    Returns:
        Squared norms of shape (*), or (*, 1) with `keepdim`.

    Raises:
        TypeError: `x` is not a tensor of real numbers.
        ValueError: `x` has no axis.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.linalg.batched_squared_norm(torch.tensor([3.0, 4.0]))
        tensor(25.)
    """
    _check_vectors("batched_squared_norm", x=x)
    return x.square().sum(-1, keepdim)


squared_norm = batched_squared_norm


def euclidean_distance(x: Tensor, y: Tensor, keepdim: bool = False, eps: float = 1e-6) -> Tensor:
    """The Euclidean distance between points. Its gradient is 0 where they are equal.

    Args:
        x: points of shape (*, D).
        y: points of shape (*, D). Leading axes broadcast.
        keepdim: keep the last axis, with one entry.
        eps: not used; accepted for compatibility, as the distance is exact.

    Returns:
        Distances of shape (*), or (*, 1) with `keepdim`.

    Raises:
        TypeError: `x` or `y` is not a tensor of real numbers.
        ValueError: a shape is not as in Args, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.linalg.euclidean_distance(torch.tensor([1.0, 2.0]), torch.tensor([4.0, 6.0]))
        tensor(5.)
    """
    _check_vectors("euclidean_distance", x=x, y=y)
    return _distance(floats(x), floats(y), keepdim)


@with_kernel_casts
def _distance(x: Tensor, y: Tensor, keepdim: bool) -> Tensor:
    return root((x - y).square().sum(-1, keepdim))


def normalized(x: Tensor) -> Tensor:
    """Unit vectors (*, D) in the directions of `x`. The vector 0 remains 0."""
    return with_kernel_casts(lambda v: v / divisor(root(batched_squared_norm(v, keepdim=True)), 0))(floats(x))


def root(square: Tensor) -> Tensor:
    """The square root, with a gradient of 0 at 0."""
    zero = square <= 0
    return torch.where(zero, 0, torch.where(zero, 1, square).sqrt())


def _check_vectors(op: str, **vectors: Tensor) -> None:
    for name, x in vectors.items():
        _check.numbers(op, name, x)
        if x.dim() == 0:
            raise ShapeError(f"{op}: expected {name} of shape (*, D), got ()")
    _check.same_device(op, **vectors)
    _check.broadcastable(op, **{name: x.shape for name, x in vectors.items()})
