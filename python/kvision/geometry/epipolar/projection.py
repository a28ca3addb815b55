"""Cameras as projection matrices P = K [R | t], and their decomposition."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import promoted
from kvision._leading import broadcast_shapes
from kvision.core.exceptions import ShapeError, ValueCheckError
from kvision.geometry._formula import of_rows, register_formula
from kvision.geometry._intrinsics import camera_matrix_of
from kvision.geometry._precision import in_full_precision
from kvision.geometry.conversions.rotations import cross_matrix
from kvision.geometry.linalg import product_plus
from kvision.geometry.solvers.null_vector import null_vector_3x3

__all__ = [
    "KRt_from_projection",
    "cross_product_matrix",
    "depth_from_point",
    "intrinsics_like",
    "projection_from_KRt",
    "projections_from_fundamental",
    "random_intrinsics",
    "scale_intrinsics",
]


def cross_product_matrix(x: Tensor) -> Tensor:
    """Write the cross product with vectors as matrices: [x]x y = x times y.

    Args:
        x: (*, 3), floating point.

    Returns:
        (*, 3, 3).

    Raises:
        TypeCheckError: `x` is not a floating-point tensor.
        ShapeError: `x` is not (*, 3).

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.cross_product_matrix(torch.tensor([1.0, 2.0, 3.0]))
        tensor([[ 0., -3.,  2.],
                [ 3.,  0., -1.],
                [-2.,  1.,  0.]])
    """
    _check.floating_trailing_shape("cross_product_matrix", "x", x, 3)
    return of_rows(cross_matrix, x, 1)


@in_full_precision
def projection_from_KRt(K: Tensor, R: Tensor, t: Tensor) -> Tensor:
    """Compose projections from world to image: K [R | t].

    Args:
        K: camera matrices, (*, 3, 3), floating point.
        R: rotations from the world to the camera, (*, 3, 3).
        t: translations, (*, 3, 1).

    Returns:
        (*, 3, 4).

    Raises:
        TypeCheckError: an argument is not a floating-point tensor.
        ShapeError: a shape is not as in Args, or not all with the same number of axes.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.projection_from_KRt(torch.eye(3), torch.eye(3), torch.ones(3, 1))
        tensor([[1., 0., 0., 1.],
                [0., 1., 0., 1.],
                [0., 0., 1., 1.]])
    """
    op = "projection_from_KRt"
    _check.floating_trailing_shape(op, "K", K, 3, 3)
    _check.floating_trailing_shape(op, "R", R, 3, 3)
    _check.floating_trailing_shape(op, "t", t, 3, 1)
    _check.same_device(op, K=K, R=R, t=t)
    if not K.dim() == R.dim() == t.dim():
        raise ShapeError(f"{op}: expected K, R and t with as many axes, got {K.dim()}, {R.dim()} and {t.dim()}")
    _check.leading_axes(op, 2, K=K, R=R, t=t)
    leading = broadcast_shapes(R.shape[:-2], t.shape[:-2])
    return K @ torch.cat([R.expand(*leading, 3, 3), t.expand(*leading, 3, 1)], -1)


@in_full_precision
def KRt_from_projection(P: Tensor, eps: float = 1e-6) -> tuple[Tensor, Tensor, Tensor]:
    """Decompose projection matrices into camera matrices, rotations and translations: the inverse of :func:`projection_from_KRt`.

    Args:
        P: (B, 3, 4) of any scale, floating point.
        eps: of no effect, since signs are exact.

    Returns:
        K, (B, 3, 3), upper triangular with a diagonal of at least 0; R, (B, 3, 3), a rotation; t, (B, 3, 1). K [R | t]
        is P, or -P where the determinant of its first three columns is negative. NaN or inf where that is 0.

    Raises:
        TypeCheckError: `P` is not a floating-point tensor.
        ShapeError: `P` is not (B, 3, 4).

    Example:
        >>> import torch, kvision as K
        >>> P = torch.diag(torch.tensor([2.0, 3.0, 1.0])) @ torch.eye(3, 4)
        >>> K.geometry.KRt_from_projection(P[None])[0][0]
        tensor([[2., 0., 0.],
                [0., 3., 0.],
                [0., 0., 1.]])
    """
    _check.shape("KRt_from_projection", "P", P, "B", 3, 4)
    _check.floating("KRt_from_projection", "P", P)
    parts = _parts(P)
    return parts[:, :3], parts[:, 3:6], parts[:, 6, :, None]


def _parts_reference(P: Tensor) -> Tensor:
    """The rows of K, those of R, and t: (B, 7, 3)."""
    # RQ decomposition: from the last row up, a row of R is the normalized component orthogonal to the rows below it.
    a, b, c = promoted(P)[..., :3].unbind(-2)
    f, third = _unit(c)
    e = (b * third).sum(-1)
    d, second = _unit(b - e[:, None] * third)
    m, n = (a * second).sum(-1), (a * third).sum(-1)
    h, first = _unit(a - m[:, None] * second - n[:, None] * third)
    sign = torch.where((torch.linalg.cross(first, second) * third).sum(-1) < 0, -1.0, 1.0).to(d.dtype)[:, None]
    u, v, w = (promoted(P)[..., 3] * sign).unbind(-1)
    z = w / f
    y = (v - e * z) / d
    x = (u - m * y - n * z) / h
    zero = torch.zeros_like(h)
    K = torch.stack([h, m, n, zero, d, e, zero, zero, f], -1).unflatten(-1, (3, 3))
    R = torch.stack([first, second, third], -2) * sign[..., None]
    return torch.cat([K, R, torch.stack([x, y, z], -1)[:, None]], 1).to(P.dtype)


_parts = register_formula("decompose_projection", _parts_reference, lambda *args: (7, 3))


def _unit(x: Tensor) -> tuple[Tensor, Tensor]:
    size = torch.linalg.vector_norm(x, dim=-1)
    return size, x / size[..., None]


@in_full_precision
def depth_from_point(R: Tensor, t: Tensor, X: Tensor) -> Tensor:
    """Compute the depth of points before a camera: z of R X + t.

    Args:
        R: rotations from the world to the camera, (*, 3, 3), floating point.
        t: translations, (*, 3, 1).
        X: points, (*, N, 3).

    Returns:
        (*, N).

    Raises:
        TypeCheckError: an argument is not a floating-point tensor.
        ShapeError: a shape is not as in Args.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.depth_from_point(torch.eye(3), torch.ones(3, 1), torch.zeros(2, 3))
        tensor([1., 1.])
    """
    op = "depth_from_point"
    _check.floating_trailing_shape(op, "R", R, 3, 3)
    _check.floating_trailing_shape(op, "t", t, 3, 1)
    _check.floating_trailing_shape(op, "X", X, "N", 3)
    _check.same_device(op, R=R, t=t, X=X)
    _check.leading_axes(op, 2, R=R, t=t, X=X)
    return product_plus(R, X.mT, t).select(-2, 2)  # of a few points, views of a row take longer than the other rows


@in_full_precision
def projections_from_fundamental(F_mat: Tensor) -> Tensor:
    """Compute a pair of cameras from fundamental matrices: [I | 0] and [[e]x F | e], e being the epipole.

    Args:
        F_mat: (B, 3, 3), floating point.

    Returns:
        (B, 3, 4, 2): the projections of both images along the last axis. The epipole is that of the second image, of
        length 1 and either sign.

    Raises:
        TypeCheckError: `F_mat` is not a floating-point tensor.
        ShapeError: `F_mat` is not (B, 3, 3).

    Source: R. Hartley and A. Zisserman, "Multiple View Geometry" (2003), result 9.14.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.projections_from_fundamental(torch.rand(2, 3, 3)).shape
        torch.Size([2, 3, 4, 2])
    """
    _check.shape("projections_from_fundamental", "F_mat", F_mat, "B", 3, 3)
    _check.floating("projections_from_fundamental", "F_mat", F_mat)
    e = null_vector_3x3(F_mat.mT)
    first = torch.eye(3, 4, device=F_mat.device, dtype=F_mat.dtype).expand(F_mat.shape[0], 3, 4)
    e = e[..., None]
    second = torch.cat([torch.linalg.cross(e, F_mat, dim=-2), e], -1)
    return torch.stack([first, second], -1)


# --- camera matrices ------------------------------------------------------------------------------------------------


def intrinsics_like(focal: float | Tensor, input: Tensor, pixel_centers: bool = False) -> Tensor:
    """Make the camera matrix of a focal length for each image, with the principal point at half of width and height.

    Args:
        focal: in pixels, above 0: a number, or a tensor () or (B,), which gets a gradient and is not checked by value.
        input: images (B, C, H, W), floating point; they give sizes, device and dtype.
        pixel_centers: put the principal point at half of width - 1 and height - 1, the center of the image where the center of
            the first pixel is (0, 0), as :func:`resize` and warps have it. False is Kornia's.

    Returns:
        (B, 3, 3).

    Raises:
        TypeCheckError: focal is neither number nor tensor, input not a floating-point tensor.
        ShapeError: input is not (B, C, H, W); focal is neither () nor (B,).
        ValueCheckError: focal is not above 0.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.intrinsics_like(100.0, torch.zeros(1, 3, 20, 30))
        tensor([[[100.,   0.,  15.],
                 [  0., 100.,  10.],
                 [  0.,   0.,   1.]]])
        >>> K.geometry.intrinsics_like(100.0, torch.zeros(1, 3, 20, 30), pixel_centers=True)[0, :2, 2]
        tensor([14.5000,  9.5000])
    """
    _check.images("intrinsics_like", "input", input)
    _check.floating("intrinsics_like", "input", input)
    _check.flag("intrinsics_like", "pixel_centers", pixel_centers)
    b, _, h, w = input.shape
    if pixel_centers:
        h, w = h - 1, w - 1
    if isinstance(focal, Tensor):
        _check.numbers("intrinsics_like", "focal", focal)
        if focal.shape not in ((), (1,), (b,)):
            raise ShapeError(
                f"intrinsics_like: expected focal of shape () or ({b},), got {tuple(focal.shape)}",
                actual_shape=focal.shape,
            )
        focal = _check.to_device_of("intrinsics_like", input, "focal", focal).to(input.dtype).expand(b)
    else:
        number = _check.number("intrinsics_like", "focal", focal)
        if not number > 0:
            raise ValueCheckError(f"intrinsics_like: expected focal above 0, got {focal!r}", actual_value=focal)
        focal = input.new_full((b,), number)
    zero = torch.zeros_like(focal)
    return torch.stack([focal, zero, zero + w / 2, zero, focal, zero + h / 2, zero, zero, zero + 1], -1).unflatten(
        -1, (3, 3)
    )


def random_intrinsics(low: float | Tensor, high: float | Tensor) -> Tensor:
    """Draw a camera matrix whose focal lengths and principal point are uniform in a range.

    Args:
        low: least value, a number or a tensor of one.
        high: largest value.

    Returns:
        (1, 3, 3), in the type and on the device of a tensor that was given.

    Raises:
        TypeCheckError: no numbers.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.random_intrinsics(1.0, 2.0)[0, 2]
        tensor([0., 0., 1.])
    """
    for name, value in (("low", low), ("high", high)):
        if isinstance(value, Tensor):
            _check.numbers("random_intrinsics", name, value)
            _check.floating("random_intrinsics", name, value)
            if value.shape not in ((), (1,), (4,)):
                raise ShapeError(f"random_intrinsics: expected {name} of shape () or (4,), got {tuple(value.shape)}")
        else:
            _check.number("random_intrinsics", name, value)
    like = next((v for v in (low, high) if isinstance(v, Tensor)), torch.empty(0))
    low, high = (v if isinstance(v, Tensor) else float(v) for v in (low, high))
    fx, fy, cx, cy = (low + (high - low) * torch.rand(4, device=like.device, dtype=like.dtype)).unbind()
    return camera_matrix_of(fx, fy, cx, cy)[None]


def scale_intrinsics(camera_matrix: Tensor, scale_factor: float | Tensor, pixel_centers: bool = False) -> Tensor:
    """Multiply focal lengths and principal points of camera matrices.

    Args:
        camera_matrix: (*, 3, 3), floating point.
        scale_factor: a number, or a tensor (*) or of one number.
        pixel_centers: give the cameras of images after :func:`resize` to `scale_factor` times their size, which maps the
            coordinate x of a pixel center to (x + 0.5) `scale_factor` - 0.5. False is Kornia's, which maps x to x
            `scale_factor`, as for coordinates that begin at the edge of the image, and leaves a skew.

    Returns:
        (*, 3, 3).

    Raises:
        TypeCheckError: an argument is neither a floating-point tensor nor a number.
        ShapeError: `camera_matrix` is not (*, 3, 3).

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.scale_intrinsics(torch.ones(1, 3, 3), 2.0)
        tensor([[[2., 1., 2.],
                 [1., 2., 2.],
                 [1., 1., 1.]]])
        >>> camera = torch.tensor([[50.0, 0, 31.5], [0, 50, 23.5], [0, 0, 1]])  # of images 64 by 48
        >>> K.geometry.scale_intrinsics(camera, 0.5, pixel_centers=True)  # of resize(images, (24, 32))
        tensor([[25.0000,  0.0000, 15.5000],
                [ 0.0000, 25.0000, 11.5000],
                [ 0.0000,  0.0000,  1.0000]])
    """
    _check.floating_trailing_shape("scale_intrinsics", "camera_matrix", camera_matrix, 3, 3)
    if not isinstance(scale_factor, Tensor):
        scale_factor = _check.number("scale_intrinsics", "scale_factor", scale_factor)
    else:
        _check.numbers("scale_intrinsics", "scale_factor", scale_factor)
        _check.broadcastable(
            "scale_intrinsics", camera_matrix=camera_matrix.shape[:-2], scale_factor=scale_factor.shape
        )
    _check.flag("scale_intrinsics", "pixel_centers", pixel_centers)
    factor = scale_factor[..., None, None] if isinstance(scale_factor, Tensor) else scale_factor
    if pixel_centers:
        top, last = camera_matrix.split((2, 1), -2)
        top = top * factor + last * ((factor - 1) / 2)
        return torch.cat([top, last.to(top.dtype).expand(*top.shape[:-2], 1, 3)], -2)
    scaled = camera_matrix * factor
    k = camera_matrix.to(scaled.dtype).expand_as(scaled).flatten(-2).unbind(-1)
    s = scaled.flatten(-2).unbind(-1)
    # Of these entries, not by a mask: making one on the GPU would wait for it.
    return torch.stack([s[0], k[1], s[2], k[3], s[4], s[5], *k[6:]], -1).unflatten(-1, (3, 3))
