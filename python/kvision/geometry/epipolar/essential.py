"""Essential matrices: x2^T E x1 = 0 for the projections x1, x2 of one point in camera coordinates, E = [t]x R."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.compiler import is_compiling

from kvision import _check
from kvision._dtype import promoted
from kvision._ops import register, vjp
from kvision.core.exceptions import ShapeError, ValueCheckError
from kvision.geometry._formula import of_all, register_formula
from kvision.geometry._precision import in_full_precision
from kvision.geometry.epipolar.projection import cross_product_matrix, depth_from_point, projection_from_KRt
from kvision.geometry.epipolar.triangulation import triangulate_points, triangulated_backward
from kvision.geometry.linalg import inverse3x3, product_plus, root
from kvision.geometry.solvers._minimal import five_points, minimal_solver
from kvision.geometry.solvers.correspondences import check_correspondences
from kvision.geometry.solvers.null_vector import null_vector_3x3

__all__ = [
    "decompose_essential_matrix",
    "decompose_essential_matrix_no_svd",
    "essential_from_Rt",
    "essential_from_fundamental",
    "find_essential",
    "motion_from_essential",
    "motion_from_essential_choose_solution",
    "project_to_essential",
    "relative_camera_motion",
]


# --- from correspondences -------------------------------------------------------------------------------------------


@in_full_precision
def find_essential(
    points1: Tensor,
    points2: Tensor,
    weights: Tensor | None = None,
    K1: Tensor | None = None,
    K2: Tensor | None = None,
) -> Tensor:
    """Estimate essential matrices from five or more correspondences.

    Args:
        points1: (B, N, 2) in the first camera's coordinates, that is K1^-1 (x, y, 1) for pixels, floating point. Pixels with `K1`.
        points2: the same points in the second camera's, (B, N, 2). Pixels with `K2`.
        weights: of no effect.
        K1: camera matrices of the first image, (3, 3) or (B, 3, 3), with the last row 0, 0, 1; None for points without one.
        K2: those of the second image, which both have or neither.

    Returns:
        (B, 10, 3, 3): up to ten candidates of norm 1, NaN for those that are missing. All of them fit five points; of
        more points the four combinations that fit them best are searched.

    Raises:
        TypeCheckError: an argument is not a floating-point tensor.
        ShapeError: a shape is not as in Args; there are fewer than five points.
        ValueCheckError: one of `K1` and `K2` is None.
        DeviceError: the tensors are on different devices.

    Source: D. Nister, "An Efficient Solution to the Five-Point Relative Pose Problem" (2004).

    Example:
        >>> import torch, kvision as K
        >>> x1, x2 = torch.rand(2, 1, 5, 2, dtype=torch.float64)
        >>> E = K.geometry.find_essential(x1, x2)
        >>> E.shape, bool(torch.linalg.det(E).nan_to_num().abs().max() < 1e-9)
        (torch.Size([1, 10, 3, 3]), True)
    """
    op = "find_essential"
    check_correspondences(op, points1, points2, weights, min_points=5)
    if (K1 is None) != (K2 is None):
        raise ValueCheckError(f"{op}: expected K1 and K2, or neither, got {'K2' if K1 is None else 'K1'} alone")
    if K1 is not None and K2 is not None:
        points1, points2 = (_in_camera(op, f"K{i}", K, x) for i, K, x in ((1, K1, points1), (2, K2, points2)))
    if points1.shape[1] == 5:
        return minimal_solver(points1, points2, None, "essential")
    return five_points(points1, points2)


def _in_camera(op: str, name: str, K: Tensor, points: Tensor) -> Tensor:
    """The points (B, N, 2) of the plane at depth 1 that a camera sees at pixels (B, N, 2)."""
    _check.floating_trailing_shape(op, name, K, 3, 3)
    _check.same_device(op, points=points, **{name: K})
    _check.broadcastable(op, points=points.shape[:1], **{name: K.shape[:-2]})
    inverse = inverse3x3(K)
    return points @ inverse[..., :2, :2].mT + inverse[..., None, :2, 2]


@in_full_precision
def essential_from_fundamental(F_mat: Tensor, K1: Tensor, K2: Tensor) -> Tensor:
    """Convert fundamental matrices to essential ones: K2^T F K1.

    Args:
        F_mat: (*, 3, 3), floating point.
        K1: camera matrices of the first image, (*, 3, 3).
        K2: those of the second image, (*, 3, 3).

    Returns:
        (*, 3, 3).

    Raises:
        TypeCheckError: an argument is not a floating-point tensor.
        ShapeError: a shape is not as in Args.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.essential_from_fundamental(torch.ones(3, 3), 2 * torch.eye(3), torch.eye(3))[0]
        tensor([2., 2., 2.])
    """
    for name, x in (("F_mat", F_mat), ("K1", K1), ("K2", K2)):
        _check.floating_trailing_shape("essential_from_fundamental", name, x, 3, 3)
    _check.same_device("essential_from_fundamental", F_mat=F_mat, K1=K1, K2=K2)
    _check.leading_axes("essential_from_fundamental", 2, F_mat=F_mat, K1=K1, K2=K2)
    return of_all(_from_fundamental, 2, F_mat, K1, K2)


def _from_fundamental_reference(F: Tensor, K1: Tensor, K2: Tensor) -> Tensor:
    return K2.mT @ F @ K1


_from_fundamental = register_formula("essential_from_fundamental", _from_fundamental_reference, lambda *args: (3, 3))


# --- essential matrices and poses -----------------------------------------------------------------------------------


@in_full_precision
def essential_from_Rt(R1: Tensor, t1: Tensor, R2: Tensor, t2: Tensor) -> Tensor:
    """Compute the essential matrices of two cameras: [t]x R of the motion from the first to the second.

    Args:
        R1: rotations from the world to the first camera, (*, 3, 3), floating point.
        t1: its translations, (*, 3, 1).
        R2: rotations to the second camera, (*, 3, 3).
        t2: its translations, (*, 3, 1).

    Returns:
        (*, 3, 3).

    Raises:
        TypeCheckError: an argument is not a floating-point tensor.
        ShapeError: a shape is not as in Args.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> eye, t = torch.eye(3), torch.tensor([[1.0], [0.0], [0.0]])
        >>> K.geometry.essential_from_Rt(eye, 0 * t, eye, t)
        tensor([[ 0.,  0.,  0.],
                [ 0.,  0., -1.],
                [ 0.,  1.,  0.]])
    """
    _check_motions("essential_from_Rt", R1, t1, R2, t2)
    return of_all(_from_motions, 2, R1, t1, R2, t2)


@in_full_precision
def relative_camera_motion(R1: Tensor, t1: Tensor, R2: Tensor, t2: Tensor) -> tuple[Tensor, Tensor]:
    """Compute the motion from a first camera to a second: R = R2 R1^T, t = t2 - R t1.

    Args:
        R1: rotations from the world to the first camera, (*, 3, 3), floating point.
        t1: its translations, (*, 3, 1).
        R2: rotations to the second camera, (*, 3, 3).
        t2: its translations, (*, 3, 1).

    Returns:
        R, (*, 3, 3), and t, (*, 3, 1).

    Raises:
        TypeCheckError: an argument is not a floating-point tensor.
        ShapeError: a shape is not as in Args.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> eye, t = torch.eye(3), torch.tensor([[1.0], [0.0], [0.0]])
        >>> K.geometry.relative_camera_motion(eye, t, eye, 3 * t)[1].flatten()
        tensor([2., 0., 0.])
    """
    _check_motions("relative_camera_motion", R1, t1, R2, t2)
    if R1.is_cpu and not is_compiling() and R1.shape[:-2] == t1.shape[:-2] == R2.shape[:-2] == t2.shape[:-2]:
        return _motion(R1, t1, R2, t2)
    motion = of_all(_camera_motion, 2, R1, t1, R2, t2)  # on CUDA one launch
    R, t = motion.split((3, 1), -2)
    return R, t.mT


def _check_motions(op: str, R1: Tensor, t1: Tensor, R2: Tensor, t2: Tensor) -> None:
    for name, x in (("R1", R1), ("R2", R2)):
        _check.floating_trailing_shape(op, name, x, 3, 3)
    for name, x in (("t1", t1), ("t2", t2)):
        _check.floating_trailing_shape(op, name, x, 3, 1)
    _check.same_device(op, R1=R1, t1=t1, R2=R2, t2=t2)
    _check.leading_axes(op, 2, R1=R1, t1=t1, R2=R2, t2=t2)


def _motion(R1: Tensor, t1: Tensor, R2: Tensor, t2: Tensor) -> tuple[Tensor, Tensor]:
    R = R2 @ R1.mT
    return R, product_plus(R, t1, t2, -1)


def _camera_motion_reference(*args: Tensor) -> Tensor:
    """The three rows of the rotation and the translation: (B, 4, 3)."""
    R, t = _motion(*args)
    return torch.cat([R.expand(t.shape[0], 3, 3), t.mT], -2)


def _from_motions_reference(*args: Tensor) -> Tensor:
    R, t = _motion(*args)
    return cross_product_matrix(t[..., 0]) @ R


_camera_motion = register_formula("camera_motion", _camera_motion_reference, lambda *args: (4, 3))
_from_motions = register_formula("essential_from_motions", _from_motions_reference, lambda *args: (3, 3))


@in_full_precision
def project_to_essential(E_mat: Tensor) -> Tensor:
    """Project matrices to the nearest essential matrices, whose singular values are s, s and 0.

    Args:
        E_mat: (*, 3, 3), floating point.

    Returns:
        (*, 3, 3), s being the mean of the two larger singular values.

    Raises:
        TypeCheckError: `E_mat` is not a floating-point tensor.
        ShapeError: `E_mat` is not (*, 3, 3).

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.epipolar.project_to_essential(torch.diag(torch.tensor([3.0, 1.0, 0.5])))
        tensor([[2., 0., 0.],
                [0., 2., 0.],
                [0., 0., 0.]])
    """
    _check.floating_trailing_shape("project_to_essential", "E_mat", E_mat, 3, 3)
    return nearest_essential(E_mat.reshape(E_mat.numel() // 9, 3, 3)).reshape(E_mat.shape)


def _nearest_reference(E: Tensor) -> Tensor:
    isometry, size = _polar(promoted(E))
    return (isometry * (size / 2)[..., None, None]).to(E.dtype) + 0


# The operator behind `project_to_essential`; takes (B, 3, 3).
nearest_essential = register("nearest_essential", _nearest_reference, gradients="matrix: nearest_essential_backward")
register("nearest_essential_backward", vjp(_nearest_reference))


def _polar(E: Tensor) -> tuple[Tensor, Tensor]:
    """u1 v1^T + u2 v2^T of the two largest singular values' vectors, and the sum of both singular values.

    The form is closed, because singular vectors have no derivative where the values are equal, as those of E are.
    On the row space of E, S = E^T E has the square root (S + d P) / s with the determinant d^2 of S there,
    s = sqrt(tr S + 2 d), and the projection P onto the row space.
    """
    v = null_vector_3x3(E)[..., None]
    F = E - (E @ v) @ v.mT  # E without its smallest singular value
    S = F.mT @ F
    trace = S.diagonal(dim1=-2, dim2=-1).sum(-1)
    d = root(((trace.square() - S.square().sum((-2, -1))) / 2).clamp(min=0))
    s = root(trace + 2 * d)
    below = (d * s)[..., None, None]
    isometry = ((trace + d)[..., None, None] * F - F @ S) / torch.where(below > 0, below, 1)
    return isometry, s


@in_full_precision
def decompose_essential_matrix(E_mat: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Decompose essential matrices into the two possible rotations and the direction of the translation.

    Args:
        E_mat: (*, 3, 3), floating point; others count as the nearest essential one.

    Returns:
        Both rotations, (*, 3, 3), and the direction, (*, 3, 1), of length 1 and either sign.

    Raises:
        TypeCheckError: `E_mat` is not a floating-point tensor.
        ShapeError: `E_mat` is not (*, 3, 3).

    Example:
        >>> import torch, kvision as K
        >>> t = torch.tensor([0.0, 0.0, 2.0])
        >>> R1, R2, direction = K.geometry.decompose_essential_matrix(K.geometry.cross_product_matrix(t))
        >>> direction.abs().flatten(), R1.diagonal().sum() + R2.diagonal().sum()
        (tensor([0., 0., 1.]), tensor(2.))
    """
    _check.floating_trailing_shape("decompose_essential_matrix", "E_mat", E_mat, 3, 3)
    R, t = _motions(E_mat.reshape(E_mat.numel() // 9, 3, 3))
    leading = E_mat.shape[:-2]
    return R[:, 0].reshape(*leading, 3, 3), R[:, 2].reshape(*leading, 3, 3), t[:, 0].reshape(*leading, 3, 1)


def _motions_reference(E: Tensor) -> tuple[Tensor, Tensor]:
    """The rotations (B, 4, 3, 3) and directions (B, 4, 3, 1) of `motion_from_essential` for E (B, 3, 3)."""
    E, dtype = promoted(E), E.dtype
    isometry, _ = _polar(E)
    t = null_vector_3x3(E.mT)
    # [t]x rotates by 90 degrees about t, one way or the other. `_completion` adds the component along t.
    rotated = cross_product_matrix(t) @ isometry
    axis = _completion(rotated, t)
    first, second = rotated + axis, axis - rotated
    t = t[..., None]
    return torch.stack([first, first, second, second], 1).to(dtype), torch.stack([t, -t, t, -t], 1).to(dtype)


def _motions_backward_reference(grad: Tensor, grad_directions: Tensor, E: Tensor) -> Tensor:
    return torch.func.vjp(_motions_reference, E)[1]((grad, grad_directions))[0]


_motions = register(
    "essential_motions",
    _motions_reference,
    fake=lambda E: [(E.shape[0], 4, 3, 3), (E.shape[0], 4, 3, 1)],
    gradients="matrix: essential_motions_backward",
)
_motions_backward = register(
    "essential_motions_backward", _motions_backward_reference, fake=lambda *args: args[2].shape
)


def _completion(A: Tensor, t: Tensor) -> Tensor:
    """The cofactors of A: t v^T, which completes A, an isometry from the plane normal to v, to a rotation."""
    a, b, c = A.unbind(-2)
    return torch.stack([torch.linalg.cross(b, c), torch.linalg.cross(c, a), torch.linalg.cross(a, b)], -2)


@in_full_precision
def decompose_essential_matrix_no_svd(E_mat: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Another name of `decompose_essential_matrix`, with all leading axes as one.

    Args:
        E_mat: (*, 3, 3), floating point.

    Returns:
        Both rotations, (B, 3, 3), and the direction, (B, 3, 1), of length 1 and either sign.

    Raises:
        TypeCheckError: `E_mat` is not a floating-point tensor.
        ShapeError: `E_mat` is not (*, 3, 3).

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.decompose_essential_matrix_no_svd(torch.rand(2, 5, 3, 3))[0].shape
        torch.Size([10, 3, 3])
    """
    _check.floating_trailing_shape("decompose_essential_matrix_no_svd", "E_mat", E_mat, 3, 3)
    return decompose_essential_matrix(E_mat.reshape(E_mat.numel() // 9, 3, 3))


@in_full_precision
def motion_from_essential(E_mat: Tensor) -> tuple[Tensor, Tensor]:
    """List the four motions of an essential matrix: (R1, t), (R1, -t), (R2, t), (R2, -t).

    Args:
        E_mat: (*, 3, 3), floating point.

    Returns:
        Rotations (*, 4, 3, 3) and translations (*, 4, 3, 1) of length 1.

    Raises:
        TypeCheckError: `E_mat` is not a floating-point tensor.
        ShapeError: `E_mat` is not (*, 3, 3).

    Example:
        >>> import torch, kvision as K
        >>> R, t = K.geometry.motion_from_essential(torch.rand(2, 3, 3))
        >>> R.shape, t.shape
        (torch.Size([2, 4, 3, 3]), torch.Size([2, 4, 3, 1]))
    """
    _check.floating_trailing_shape("motion_from_essential", "E_mat", E_mat, 3, 3)
    R, t = _motions(E_mat.reshape(E_mat.numel() // 9, 3, 3))
    leading = E_mat.shape[:-2]
    return R.reshape(*leading, 4, 3, 3), t.reshape(*leading, 4, 3, 1)


@in_full_precision
def motion_from_essential_choose_solution(
    E_mat: Tensor, K1: Tensor, K2: Tensor, x1: Tensor, x2: Tensor, mask: Tensor | None = None
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Recover the pose from essential matrices: the motion that has the most points in front of both cameras.

    Args:
        E_mat: (3, 3) or (B, 3, 3), floating point.
        K1: camera matrices of the first image, in the shape of `E_mat`.
        K2: those of the second image.
        x1: (N, 2) or (B, N, 2) as (x, y) in pixels.
        x2: the same points in the second image.
        mask: bool, (N,) or (B, N): which points count.

    Returns:
        R, (*, 3, 3); t, (*, 3, 1), of length 1; the points in the first camera's coordinates, (*, N, 3); how many of
        them are in front, (*).

    Raises:
        TypeCheckError: an argument is not a floating-point tensor.
        ShapeError: a shape is not as in Args.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> X = torch.rand(9, 3) + torch.tensor([0.0, 0.0, 2.0])
        >>> t = torch.tensor([1.0, 0.0, 0.0])
        >>> projections = [Y[:, :2] / Y[:, 2:] for Y in (X, X + t)]
        >>> E = K.geometry.cross_product_matrix(t)
        >>> R, t, points, count = K.geometry.motion_from_essential_choose_solution(
        ...     E, torch.eye(3), torch.eye(3), *projections)
        >>> t.flatten() + 0, count
        (tensor([1., 0., 0.]), tensor(9))
    """
    op = "motion_from_essential_choose_solution"
    for name, x in (("E_mat", E_mat), ("K1", K1), ("K2", K2)):
        _check.floating_trailing_shape(op, name, x, 3, 3)
    for name, x in (("x1", x1), ("x2", x2)):
        _check.floating_trailing_shape(op, name, x, "N", 2)
    _check.same_shape(op, x1=x1, x2=x2)
    _check.same_device(op, E_mat=E_mat, K1=K1, K2=K2, x1=x1, x2=x2)
    if E_mat.dim() not in (2, 3) or x1.dim() != E_mat.dim() or not K1.dim() == K2.dim() == E_mat.dim():
        got = ", ".join(str(tuple(x.shape)) for x in (E_mat, K1, K2, x1))
        raise ShapeError(f"{op}: expected E_mat, K1, K2 and x1 all with a batch or all without, got {got}")
    _check.leading_axes(op, 2, E_mat=E_mat, K1=K1, K2=K2, x1=x1)
    if mask is not None:
        _check.shape(op, "mask", mask, *x1.shape[:-1])
    single = E_mat.dim() == 2
    E, K, L, x, y = (v[None] if single else v for v in (E_mat, K1, K2, x1, x2))
    batch = max(E.shape[0], K.shape[0], L.shape[0], x.shape[0])
    E, K, L, x, y = (v.expand(batch, *v.shape[1:]) for v in (E, K, L, x, y))
    if mask is not None and single:
        mask = mask[None]
    R, t, X, count, _ = _motion_choice(E, K, L, x, y, mask)
    return (R[0], t[0], X[0], count[0]) if single else (R, t, X, count)


def _choice_reference(
    E: Tensor, K1: Tensor, K2: Tensor, x1: Tensor, x2: Tensor, mask: Tensor | None
) -> tuple[Tensor, ...]:
    """`motion_from_essential_choose_solution` of E (B, 3, 3) and points (B, N, 2), and the index of the solution."""
    R, t = _motions(E)
    eye = torch.eye(3, device=R.device, dtype=R.dtype).expand_as(R)
    P1, P2 = (
        projection_from_KRt(K[:, None], *motion) for K, motion in ((K1, (eye, torch.zeros_like(t))), (K2, (R, t)))
    )
    X = triangulate_points(P1, P2, x1[:, None], x2[:, None])  # (B, 4, N, 3)
    in_front = (X[..., 2] > 0) & (depth_from_point(R, t, X) > 0)
    if mask is not None:
        in_front = in_front & mask[:, None].bool()
    count, best = in_front.sum(-1).max(-1)

    def chosen(x: Tensor) -> Tensor:
        return x.gather(1, best[:, None, None, None].expand(-1, 1, *x.shape[2:]))[:, 0]

    return chosen(R), chosen(t), chosen(X), count, best


def _choice_gradient(
    needs: Sequence[bool],
    grad: Tensor | None,
    grad_direction: Tensor | None,
    grad_points: Tensor | None,
    _grad_count: Tensor | None,
    _grad_best: Tensor | None,
    R: Tensor,
    t: Tensor,
    X: Tensor,
    count: Tensor,
    best: Tensor,
    E: Tensor,
    K1: Tensor,
    K2: Tensor,
    x1: Tensor,
    x2: Tensor,
    mask: Tensor | None,
) -> list[Tensor | None]:
    """Gradients of the points through the triangulation, and of the matrix through the chosen motion."""
    to_R, to_t, to_X = (
        torch.zeros_like(y) if g is None else g for g, y in ((grad, R), (grad_direction, t), (grad_points, X))
    )
    motion = torch.cat([R, t], -1)
    P1 = torch.nn.functional.pad(K1, (0, 1))
    to_x1, to_x2, to_P1, to_P2 = triangulated_backward(to_X, x1, x2, P1, K2 @ motion)
    to_motion = K2.mT @ to_P2 + torch.cat([to_R, to_t], -1)
    chosen = torch.arange(4, device=best.device) == best[:, None]
    of_four = torch.where(chosen[:, :, None, None], to_motion[:, None], 0)
    to_E = _motions_backward(of_four[..., :3], of_four[..., 3:], E)
    return [to_E, to_P1[..., :3], to_P2 @ motion.mT, to_x1, to_x2, None]


_motion_choice = register(
    "motion_choice",
    _choice_reference,
    fake=lambda E, K1, K2, x1, *rest: [
        E.shape,
        (E.shape[0], 3, 1),
        (*x1.shape[:2], 3),
        *(E.new_empty(E.shape[0], dtype=torch.int64) for _ in range(2)),
    ],
    casts_outputs=True,
    backward=_choice_gradient,
    saves_results=True,
    non_differentiable=(3, 4),
)
