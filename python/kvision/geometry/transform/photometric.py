"""Photometric error between a warped image and a target, in one pass over both."""

from __future__ import annotations

from typing import Any, get_args

import torch
from torch import Tensor

from kvision import _check
from kvision._choices import Distance
from kvision._dtype import floats
from kvision._modes import INTERPOLATION, PADDING, PHOTOMETRIC_DISTANCE
from kvision._ops import linearize, register
from kvision.core.exceptions import ShapeError
from kvision.geometry.transform import sampling

__all__ = ["photometric_homography_loss", "photometric_normal_equations"]

_DISTANCES = get_args(Distance)


def _loss(source, target, matrix, distance, eps, align_corners, normalized):
    """The loss (B,), in the separate steps that csrc/geometry/transform/photometric.h fuses."""
    source, target = source.to(matrix.dtype), target.to(matrix.dtype)
    coords = sampling.source_coords(
        matrix.expand(source.shape[0], -1, -1), target.shape[2:], source.shape[2:], align_corners, False, normalized
    )
    residual = sampling.sample(source, coords, "bilinear", "fill", align_corners) - target
    if distance == PHOTOMETRIC_DISTANCE["l1"]:
        error = residual.abs()
    elif distance == PHOTOMETRIC_DISTANCE["l2"]:
        error = residual * residual
    else:
        error = (residual * residual + eps * eps).sqrt()
    valid = _is_between_pixels(coords, source)
    total = torch.where(valid, error, 0).sum((1, 2, 3))
    return total / (valid.sum((1, 2, 3)) * source.shape[1])


def _is_between_pixels(coords, source):
    """The mask (B, 1, h, w) of sampling coordinates that lie between four pixels of the source."""
    height, width = source.shape[2:]
    u, v = (x.detach() for x in coords)
    return ((u >= 0) & (u < width - 1) & (v >= 0) & (v < height - 1))[:, None]


def _reference(source, target, matrix, *options):
    matrices = matrix.expand(source.shape[0], -1, -1)
    loss, vjp_fn = torch.func.vjp(lambda m: _loss(source, target, m, *options), matrices)
    return loss, vjp_fn(torch.ones_like(loss))[0]


def _backward(needs, grad, _, loss, matrix_grads, source, target, matrix, *options):
    if torch.is_grad_enabled():
        return _differentiable_backward(needs, grad, source, target, matrix, *options)
    grad_source = grad_target = grad_matrix = None
    if needs[0] or needs[1]:
        grad_source, grad_target = _image_gradients(grad, source, target, matrix, *options)
    if needs[2]:
        # A torch call costs as much as the kernel, so there are as few as possible.
        grad_matrix = matrix_grads * (grad if grad.shape[0] == 1 else grad.view(-1, 1, 1))
        grad_matrix = grad_matrix if matrix.shape[0] == matrix_grads.shape[0] else grad_matrix.sum_to_size(matrix.shape)
    return [grad_source if needs[0] else None, grad_target if needs[1] else None, grad_matrix]


def _image_gradients(grad, source, target, matrix, distance, eps, align_corners, normalized):
    x, y = source.to(matrix.dtype), target.to(matrix.dtype)
    (*size,), matrices = y.shape[2:], matrix.expand(x.shape[0], -1, -1)
    sampled = INTERPOLATION["bilinear"], PADDING["fill"], align_corners, False, normalized
    valid = _is_between_pixels(sampling.source_coords(matrices, size, x.shape[2:], *sampled[2:]), x)
    residual = sampling.warp(x, matrices, None, None, size, *sampled) - y
    if distance == PHOTOMETRIC_DISTANCE["l1"]:
        grad_residual = residual.sign()
    elif distance == PHOTOMETRIC_DISTANCE["l2"]:
        grad_residual = 2 * residual
    else:
        grad_residual = residual / (residual * residual + eps * eps).sqrt()
    weights = grad / (valid.sum((1, 2, 3)) * x.shape[1])
    grad_residual = torch.where(valid, grad_residual * weights[:, None, None, None], 0)
    grad_source = sampling.warp_image_backward(grad_residual, matrices, None, [len(x), *x.shape[2:]], *sampled)
    return grad_source.to(source.dtype), -grad_residual.to(target.dtype)


def _differentiable_backward(needs, grad, source, target, matrix, *options):
    tensors = (source, target, matrix)
    where = [i for i, need in enumerate(needs) if need]

    def f(*values: Tensor) -> Tensor:
        full = list(tensors)
        for i, value in zip(where, values):
            full[i] = value
        return _loss(*full, *options)

    _, vjp_fn = torch.func.vjp(f, *(tensors[i] for i in where))
    grads = dict(zip(where, vjp_fn(grad)))
    return [grads.get(i) for i in range(3)]


_photometric = register(
    "photometric",
    _reference,
    fake=lambda source, target, matrix, *options: [
        matrix.new_empty(source.shape[0]),
        matrix.new_empty(source.shape[0], 3, 3),
    ],
    backward=_backward,
    saves_results=True,
    non_differentiable=(1,),
    casts_outputs=True,
)


def _normal_reference(source, target, matrix, distance, eps, align_corners, normalized):
    matrices = matrix.expand(source.shape[0], -1, -1)
    size, (*source_size,) = target.shape[2:], source.shape[2:]

    def source_coords(m: Tensor) -> list[Tensor]:
        return sampling.source_coords(m, size, source_size, align_corners, False, normalized)

    def residuals(m: Tensor) -> Tensor:
        return sampling.sample(source, source_coords(m), "bilinear", "fill", align_corners) - target

    residual, jvp_fn = linearize(residuals, matrices)
    # The derivatives by all entries of the matrix but the last.
    directions = torch.eye(9, dtype=matrix.dtype, device=matrix.device)[:8].view(8, 1, 3, 3)
    jacobian = torch.stack([jvp_fn(d.expand_as(matrices)).flatten(1) for d in directions], 1)
    valid = _is_between_pixels(source_coords(matrices), source)
    r, valid = residual.flatten(1), valid.expand_as(residual).flatten(1).to(matrix.dtype)
    if distance == PHOTOMETRIC_DISTANCE["l1"]:
        value, weight = r.abs(), 1 / r.abs().clamp_min(eps)
    elif distance == PHOTOMETRIC_DISTANCE["l2"]:
        value, weight = r * r, torch.full_like(r, 2)
    else:
        value = (r * r + eps * eps).sqrt()
        weight = 1 / value
    terms = valid.sum(1)
    divisor = terms.clamp_min(1)
    weighted = jacobian * (weight * valid)[:, None]
    normal = weighted @ jacobian.mT / divisor[:, None, None]
    return normal, (weighted @ r[..., None])[..., 0] / divisor[:, None], (value * valid).sum(1) / terms


_normal = register(
    "photometric_normal_equations",
    _normal_reference,
    fake=lambda source, target, matrix, *options: [(source.shape[0], 8, 8), (source.shape[0], 8), (source.shape[0],)],
    non_differentiable=(0, 1, 2),
)


def photometric_homography_loss(
    source: Tensor,
    target: Tensor,
    src_homo_dst: Tensor,
    distance: Distance = "l1",
    eps: float = 1e-3,
    align_corners: bool = False,
    normalized_coordinates: bool = True,
) -> Tensor:
    """Compute the mean photometric error of warped images against targets, and its gradient, in one pass.

    The mean is over the pixels of the target that the homography maps between four pixels of the source. Their
    number is constant for the gradient. Nothing of the size of an image is written.

    Args:
        source: images (B, C, H, W) that are warped. Integers are computed in float32.
        target: images (B, C, h, w).
        src_homo_dst: (B, 3, 3), or (1, 3, 3) for all images: coordinates in the target to coordinates in the source, as
            :func:`homography_warp` takes it.
        distance: error of a residual r: 'l1', |r|; 'l2', r^2; 'charbonnier', sqrt(r^2 + eps^2).
        eps: of 'charbonnier', at least 0.
        align_corners: -1 and 1 are the centers of the outermost pixels, not their outer edges.
        normalized_coordinates: coordinates are from -1 to 1; else they are pixels.

    Returns:
        (B,), of the dtype of `source`, float32 for integers; NaN where no pixel of the target is in the source.

    Raises:
        TypeError: `source`, `target` or `src_homo_dst` is not a tensor of real numbers; `eps` is not a number;
            `align_corners` or `normalized_coordinates` is not a bool.
        ValueError: `source` is not (B, C, H, W); `target` is not (B, C, h, w); `src_homo_dst` is not (B, 3, 3) or (1,
            3, 3); `distance` is unknown; `eps` is negative; the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> image = torch.rand(1, 3, 8, 8)
        >>> homography = torch.eye(3)[None].requires_grad_()
        >>> loss = K.geometry.photometric_homography_loss(image, image + 0.5, homography)
        >>> loss.backward()
        >>> loss.detach().round(decimals=4), homography.grad.shape
        (tensor([0.5000]), torch.Size([1, 3, 3]))
    """
    op = "photometric_homography_loss"
    dtype = source.dtype if isinstance(source, Tensor) and source.is_floating_point() else torch.float32
    options = distance, eps, align_corners, normalized_coordinates
    tensors = _checked(op, source, target, src_homo_dst, *options)
    results: Any = _photometric(*tensors, PHOTOMETRIC_DISTANCE[distance], *options[1:])
    loss: Tensor = results[0]
    return loss if loss.dtype == dtype else loss.to(dtype)


def photometric_normal_equations(
    source: Tensor,
    target: Tensor,
    src_homo_dst: Tensor,
    distance: Distance = "l1",
    eps: float = 1e-3,
    align_corners: bool = False,
    normalized_coordinates: bool = True,
) -> tuple[Tensor, Tensor, Tensor]:
    """Compute the normal equations of a Gauss-Newton step for :func:`photometric_homography_loss`, in one pass.

    The unknowns are the first eight entries of the homography; the last one stays. The step to add to them is the
    solution x of `normal x = -gradient`. Residuals r are weighted by w = d'(r) / r, with the distance d. `normal`
    is the mean of w J J^T over the pixels that the homography maps into the source, and `gradient` is the mean of w
    r J. The results have no gradients.

    Args:
        source: images (B, C, H, W) that are warped. Integers and half types are computed in float32.
        target: images (B, C, h, w).
        src_homo_dst: (B, 3, 3), or (1, 3, 3) for all images: coordinates in the target to coordinates in the source.
        distance: error of a residual r: 'l1', |r|; 'l2', r^2; 'charbonnier', sqrt(r^2 + eps^2).
        eps: of 'charbonnier', at least 0; for 'l1', smaller residuals get the weight of a residual of this size.
        align_corners: -1 and 1 are the centers of the outermost pixels, not their outer edges.
        normalized_coordinates: coordinates are from -1 to 1; else they are pixels.

    Returns:
        normal (B, 8, 8), gradient (B, 8) and the mean error (B,), in float64 for float64 images and in float32 else.

    Raises:
        TypeError: `source`, `target` or `src_homo_dst` is not a tensor of real numbers; `eps` is not a number;
            `align_corners` or `normalized_coordinates` is not a bool.
        ValueError: `source` is not (B, C, H, W); `target` is not (B, C, h, w); `src_homo_dst` is not (B, 3, 3) or (1,
            3, 3); `distance` is unknown; `eps` is negative; the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> image, other = torch.rand(2, 1, 3, 8, 8)
        >>> normal, gradient, _ = K.geometry.photometric_normal_equations(image, other, torch.eye(3)[None])
        >>> torch.linalg.solve(normal, -gradient).shape
        torch.Size([1, 8])
    """
    op = "photometric_normal_equations"
    options = distance, eps, align_corners, normalized_coordinates
    source, target, matrix = _checked(op, source, target, src_homo_dst, *options)
    equations: tuple[Tensor, Tensor, Tensor] = _normal(
        source.to(matrix.dtype), target.to(matrix.dtype), matrix, PHOTOMETRIC_DISTANCE[distance], *options[1:]
    )
    return equations


def _checked(op, source, target, src_homo_dst, distance, eps, align_corners, normalized_coordinates):
    """The images in one dtype, and the homography in the layout of the operators."""
    _check.images(op, "source", source)
    _check.images(op, "target", target)
    _check.shape(op, "src_homo_dst", src_homo_dst, "B", 3, 3)
    _check.choice(op, "distance", distance, _DISTANCES)
    _check.number(op, "eps", eps, minimum=0)
    _check.flag(op, "align_corners", align_corners)
    _check.flag(op, "normalized_coordinates", normalized_coordinates)
    source, target = floats(source), floats(target)
    _check.same_device(op, source=source, target=target)
    if source.dtype != target.dtype:
        common_dtype = torch.promote_types(source.dtype, target.dtype)
        source, target = source.to(common_dtype), target.to(common_dtype)
    if source.shape[:2] != target.shape[:2]:
        raise ShapeError(
            f"{op}: expected target of shape {(*source.shape[:2], 'h', 'w')}, got {tuple(target.shape)}",
            actual_shape=target.shape,
        )
    return source, target, sampling.cast_to_image(op, source, "src_homo_dst", src_homo_dst)
