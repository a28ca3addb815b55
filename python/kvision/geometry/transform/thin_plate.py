"""Thin-plate splines: the maps of least bending energy between corresponding points."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision import _check
from kvision._choices import PaddingOrFill
from kvision._dtype import as_dtype, compute_dtype, floats, pixels
from kvision._modes import INTERPOLATION
from kvision._ops import register
from kvision.geometry.transform import matrices, sampling

__all__ = ["get_tps_transform", "warp_image_tps", "warp_points_tps"]

# --- points mapped by a spline --------------------------------------------------------------------------------------


def _kernel(p: Tensor, q: Tensor) -> Tensor:
    """r^2 log r for the distances r of points (B, N, 2) and (B, M, 2)."""
    square = (p[:, :, None] - q[:, None]).square().sum(-1)
    far = square > 0
    return torch.where(far, 0.5 * square * torch.where(far, square, 1).log(), 0)


def _points_reference(points, centers, weights, affine):
    return _kernel(points, centers) @ weights + points @ affine[:, 1:] + affine[:, :1]


def _map_reference(centers, weights, affine, size, align_corners):
    x, y = (_unit(n, align_corners, centers) for n in reversed(size))
    grid = torch.stack([x.expand(*size), y[:, None].expand(*size)], -1).reshape(1, -1, 2)
    return _points_reference(grid, centers, weights, affine).mT.unflatten(2, size)


def _unit(size: int, align_corners: bool, like: Tensor) -> Tensor:
    """Coordinates of the pixels of an axis in [-1, 1]."""
    less = 1 if align_corners else 0
    middle = torch.arange(size, dtype=like.dtype, device=like.device) - (size - 1) / 2
    return middle * (2 / max(size - less, 1))


def _points_gradient_reference(grad, *args):
    _, vjp_fn = torch.func.vjp(_points_reference, *(x.expand(grad.shape[0], -1, -1) for x in args))
    return vjp_fn(grad)


def _map_gradient_reference(grad, centers, weights, affine, align_corners):
    def of_spline(centers, weights, affine):
        return _map_reference(centers, weights, affine, grad.shape[2:], align_corners)

    _, vjp_fn = torch.func.vjp(of_spline, *(x.expand(grad.shape[0], -1, -1) for x in (centers, weights, affine)))
    return vjp_fn(grad)


def _batch(*args: Tensor) -> int:
    return next((x.shape[0] for x in args if x.shape[0] != 1), 1)


_points = register(
    "thin_plate_points",
    _points_reference,
    fake=lambda points, *spline: (_batch(points, *spline), *points.shape[1:]),
    gradients="points, centers, weights, affine: thin_plate_points_backward",
)
_points_gradient = register(
    "thin_plate_points_backward",
    _points_gradient_reference,
    fake=lambda grad, points, centers, weights, affine: [
        (grad.shape[0], *x.shape[1:]) for x in (points, centers, weights, affine)
    ],
)
# The spline's values at the pixels of an image in [-1, 1]: (B, 2, h, w).
_map = register(
    "thin_plate_map",
    _map_reference,
    fake=lambda centers, weights, affine, size, _: (_batch(centers, weights, affine), 2, *size),
    gradients="centers, weights, affine: thin_plate_map_backward",
)
register(
    "thin_plate_map_backward",
    _map_gradient_reference,
    fake=lambda grad, *args: [(grad.shape[0], *x.shape[1:]) for x in args[:3]],
)

# --- the spline of corresponding points -----------------------------------------------------------------------------


def _weights_reference(centers, right):
    linear = torch.cat([torch.ones_like(centers[..., :1]), centers], -1)
    zero = centers.new_zeros(centers.shape[0], 3, 3)
    system = torch.cat([torch.cat([_kernel(centers, centers), linear], -1), torch.cat([linear.mT, zero], -1)], -2)
    return torch.linalg.solve_ex(system.double(), right.double())[0].to(centers.dtype)


def _weights_backward(needs, grad, spline, centers, right):
    """The system is symmetric. It maps the weights to the spline at its centers and the sums of weights."""
    grad_right = _weights(centers, grad)
    grad_centers = None
    if needs[0]:
        (to, rest), (weights, affine) = ((x[:, :-3], x[:, -3:]) for x in (grad_right, spline))
        at_points, at_centers, _, _ = _points_gradient(to, centers, centers, weights, affine)
        grad_centers = -(at_points + at_centers + weights @ rest[:, 1:].mT).sum_to_size(centers.shape)
    return [grad_centers, grad_right.sum_to_size(right.shape) if needs[1] else None]


# The weights (B, N + 3, 2) of centers (B, N, 2), then of the affine part. The right side `right` has the values at the
# centers and three sums.
_weights = register(
    "thin_plate_weights",
    _weights_reference,
    fake=lambda centers, right: (_batch(centers, right), *right.shape[1:]),
    backward=_weights_backward,
    saves_results=True,
)

# --- functions ------------------------------------------------------------------------------------------------------


def get_tps_transform(points_src: Tensor, points_dst: Tensor) -> tuple[Tensor, Tensor]:
    """Compute the thin-plate splines that map points to others.

    Args:
        points_src: (B, N, 2), floating point, at least three and not all on a line. Coordinates in [-1, 1] give the
            best accuracy.
        points_dst: the points that they map to, (B, N, 2).

    Returns:
        Weights of the kernels around `points_src`, (B, N, 2), and of the affine part, (B, 3, 2). Solved in float64; where
        there is no solution they are NaN, inf or arbitrary.

    Raises:
        TypeError: `points_src` or `points_dst` is not a floating-point tensor.
        ValueError: `points_src` is not (B, N, 2); `points_dst` does not have the shape of `points_src`; the tensors are
            on different devices.

    Source: F. Bookstein, "Principal warps: thin-plate splines and the decomposition of deformations" (1989).

    Example:
        >>> import torch, kvision as K
        >>> points = torch.tensor([[[-1.0, -1], [1, -1], [1, 1], [-1, 1]]])
        >>> weights, affine = K.geometry.get_tps_transform(points, 2 * points)
        >>> weights.abs().max() < 1e-6, affine.round(decimals=4)[0, 1]
        (tensor(True), tensor([2., 0.]))
    """
    op = "get_tps_transform"
    for name, points in (("points_src", points_src), ("points_dst", points_dst)):
        _check.shape(op, name, points, "B", "N", 2)
        _check.floating(op, name, points)
    _check.shape(op, "points_dst", points_dst, *points_src.shape)
    _check.same_device(op, points_src=points_src, points_dst=points_dst)
    values = torch.nn.functional.pad(matrices.promoted(points_dst), (0, 0, 0, 3))
    weights = as_dtype(_weights(matrices.promoted(points_src), values), points_src.dtype)
    return weights[:, :-3], weights[:, -3:]


def warp_points_tps(
    points_src: Tensor, kernel_centers: Tensor, kernel_weights: Tensor, affine_weights: Tensor
) -> Tensor:
    """Map points by thin-plate splines.

    Args:
        points_src: points (B, M, 2).
        kernel_centers: (B, N, 2), `points_src` of :func:`get_tps_transform`.
        kernel_weights: (B, N, 2), the first result of :func:`get_tps_transform`.
        affine_weights: (B, 3, 2), the second result of :func:`get_tps_transform`.

    Returns:
        (B, M, 2).

    Raises:
        TypeError: an argument is not a tensor of real numbers.
        ValueError: `points_src` is not (B, M, 2); `kernel_centers` is not (B, N, 2); `kernel_weights` does not have its
            shape; `affine_weights` is not (B, 3, 2); the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> points = torch.tensor([[[-1.0, -1], [1, -1], [1, 1], [-1, 1]]])
        >>> weights = K.geometry.get_tps_transform(points, points + 1)
        >>> K.geometry.warp_points_tps(torch.zeros(1, 1, 2), points, *weights).round(decimals=4)
        tensor([[[1., 1.]]])
    """
    op = "warp_points_tps"
    _check.shape(op, "points_src", points_src, "B", "M", 2)
    _check_spline(op, kernel_centers, kernel_weights, affine_weights)
    _check.same_device(op, points_src=points_src, kernel_centers=kernel_centers)
    _check.leading_axes(op, 2, points_src=points_src, kernel_centers=kernel_centers)
    points = floats(points_src)
    dtype = compute_dtype(points)
    args = (as_dtype(x, dtype) for x in (points, kernel_centers, kernel_weights, affine_weights))
    return as_dtype(_points(*args), points.dtype)


def _check_spline(op: str, centers: Tensor, weights: Tensor, affine: Tensor) -> None:
    _check.shape(op, "kernel_centers", centers, "B", "N", 2)
    _check.shape(op, "kernel_weights", weights, *centers.shape)
    _check.shape(op, "affine_weights", affine, centers.shape[0], 3, 2)
    _check.same_device(op, kernel_centers=centers, kernel_weights=weights, affine_weights=affine)


def warp_image_tps(
    image: Tensor,
    kernel_centers: Tensor,
    kernel_weights: Tensor,
    affine_weights: Tensor,
    align_corners: bool = False,
    padding_mode: PaddingOrFill = "zeros",
) -> Tensor:
    """Resample images at the coordinates that thin-plate splines map the pixels of the result to.

    The splines map points of the result to points of the image, in coordinates from -1 to 1.

    Args:
        image: images (B, C, H, W), floating point or uint8. Other integers are computed in float32.
        kernel_centers: (B, N, 2), `points_src` of :func:`get_tps_transform`.
        kernel_weights: (B, N, 2), the first result of :func:`get_tps_transform`.
        affine_weights: (B, 3, 2), the second result of :func:`get_tps_transform`.
        align_corners: -1 and 1 are the centers of the outermost pixels, not their outer edges.
        padding_mode: 'zeros', 'border' or 'reflection'.

    Returns:
        (B, C, H, W), of the dtype of `image`.

    Raises:
        TypeError: a tensor is not a tensor of real numbers; `align_corners` is not a bool.
        ValueError: `image` is not (B, C, H, W); `kernel_centers` is not (B, N, 2); `kernel_weights` does not have its
            shape; `affine_weights` is not (B, 3, 2); `padding_mode` is unknown; the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> image = torch.rand(1, 3, 8, 8)
        >>> points = torch.tensor([[[-1.0, -1], [1, -1], [1, 1], [-1, 1]]])
        >>> still = K.geometry.warp_image_tps(image, points, *K.geometry.get_tps_transform(points, points))
        >>> torch.allclose(still, image, atol=1e-4)
        True
    """
    op = "warp_image_tps"
    _check.images(op, "image", image)
    _check_spline(op, kernel_centers, kernel_weights, affine_weights)
    sampling.check_options(op, "bilinear", padding_mode, align_corners)
    images = pixels(image)
    spline = (sampling.cast_to_image(op, images, "spline", x) for x in (kernel_centers, kernel_weights, affine_weights))
    x, y = _map(*spline, list(image.shape[2:]), align_corners).unbind(1)
    padding, _ = sampling.padding_and_fill(op, images, padding_mode, None)
    return sampling.remap(images, x, y, None, None, INTERPOLATION["bilinear"], padding, align_corners, True, False)
