"""How far a warped image is from another one, in one pass over both."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import floats
from kvision._ops import register
from kvision.core.exceptions import ShapeError
from kvision.geometry.transform import sampling

__all__ = ["photometric_homography_loss", "photometric_normal_equations"]

_DISTANCES = ("l1", "l2", "charbonnier")


def _loss(source, target, matrix, distance, eps, align_corners, normalized):
    """(B,): the separate steps, of which csrc/geometry/transform/photometric.h makes one."""
    source, target = source.to(matrix.dtype), target.to(matrix.dtype)
    coords = sampling.source_coords(
        matrix.expand(len(source), -1, -1), target.shape[2:], source.shape[2:], align_corners, False, normalized
    )
    residual = sampling.sample(source, coords, "bilinear", "fill", align_corners) - target
    if distance == "l1":
        found = residual.abs()
    elif distance == "l2":
        found = residual * residual
    else:
        found = (residual * residual + eps * eps).sqrt()
    seen = _seen(coords, source)
    total = torch.where(seen, found, 0).sum((1, 2, 3))
    return total / (seen.sum((1, 2, 3)) * source.shape[1])


def _seen(coords, source):
    """Which places (B, 1, h, w) lie between four pixels."""
    height, width = source.shape[2:]
    u, v = (x.detach() for x in coords)
    return ((u >= 0) & (u < width - 1) & (v >= 0) & (v < height - 1))[:, None]


def _reference(source, target, matrix, *how):
    matrices = matrix.expand(len(source), -1, -1)
    loss, vjp_fn = torch.func.vjp(lambda m: _loss(source, target, m, *how), matrices)
    return loss, vjp_fn(torch.ones_like(loss))[0]


def _backward(needs, grad, _, loss, slope, source, target, matrix, *how):
    if torch.is_grad_enabled():
        return _differentiable_backward(needs, grad, source, target, matrix, *how)
    of_source = of_target = of_matrix = None
    if needs[0] or needs[1]:
        of_source, of_target = _image_gradients(grad, source, target, matrix, *how)
    if needs[2]:
        of_matrix = slope * (grad if len(grad) == 1 else grad.view(-1, 1, 1))  # each step costs as much as the kernel
        of_matrix = of_matrix if len(matrix) == len(slope) else of_matrix.sum_to_size(matrix.shape)
    return [of_source if needs[0] else None, of_target if needs[1] else None, of_matrix]


def _image_gradients(grad, source, target, matrix, distance, eps, align_corners, normalized):
    x, y = source.to(matrix.dtype), target.to(matrix.dtype)
    (*size,), matrices = y.shape[2:], matrix.expand(len(x), -1, -1)
    sampled = "bilinear", "fill", align_corners, False, normalized
    seen = _seen(sampling.source_coords(matrices, size, x.shape[2:], *sampled[2:]), x)
    residual = sampling.warp(x, matrices, None, size, *sampled) - y
    if distance == "l1":
        slope = residual.sign()
    elif distance == "l2":
        slope = 2 * residual
    else:
        slope = residual / (residual * residual + eps * eps).sqrt()
    share = grad / (seen.sum((1, 2, 3)) * x.shape[1])
    slope = torch.where(seen, slope * share[:, None, None, None], 0)
    of_source = sampling.warp_image_backward(slope, matrices, [*x.shape[2:]], *sampled)
    return of_source.to(source.dtype), -slope.to(target.dtype)


def _differentiable_backward(needs, grad, source, target, matrix, *how):
    tensors = (source, target, matrix)
    where = [i for i, need in enumerate(needs) if need]

    def f(*values: Tensor) -> Tensor:
        full = list(tensors)
        for i, value in zip(where, values):
            full[i] = value
        return _loss(*full, *how)

    _, vjp_fn = torch.func.vjp(f, *(tensors[i] for i in where))
    found = dict(zip(where, vjp_fn(grad)))
    return [found.get(i) for i in range(3)]


_photometric = register(
    "photometric",
    _reference,
    fake=lambda source, target, matrix, *how: [matrix.new_empty(len(source)), matrix.new_empty(len(source), 3, 3)],
    backward=_backward,
    saves_results=True,
    non_differentiable=(1,),
    casts_outputs=True,
)


def _normal_reference(source, target, matrix, distance, eps, align_corners, normalized):
    matrices = matrix.expand(len(source), -1, -1)
    size, (*source_size,) = target.shape[2:], source.shape[2:]

    def residuals(m: Tensor) -> Any:
        coords = sampling.source_coords(m, size, source_size, align_corners, False, normalized)
        residual = sampling.sample(source, coords, "bilinear", "fill", align_corners) - target
        return residual.flatten(1), (residual, _seen(coords, source))

    # The derivative by each number of the matrix, but for the last one.
    columns = []
    for i in range(8):
        direction = torch.zeros_like(matrices)
        direction[:, i // 3, i % 3] = 1
        (_, (residual, seen)), (column, _) = torch.func.jvp(residuals, (matrices,), (direction,))
        columns.append(column)
    jacobian = torch.stack(columns, 1)
    r, seen = residual.flatten(1), seen.expand_as(residual).flatten(1).to(matrix.dtype)
    if distance == "l1":
        value, weight = r.abs(), 1 / r.abs().clamp_min(eps)
    elif distance == "l2":
        value, weight = r * r, torch.full_like(r, 2)
    else:
        value = (r * r + eps * eps).sqrt()
        weight = 1 / value
    terms = seen.sum(1)
    some = terms.clamp_min(1)
    weighted = jacobian * (weight * seen)[:, None]
    normal = weighted @ jacobian.mT / some[:, None, None]
    return normal, (weighted @ r[..., None])[..., 0] / some[:, None], (value * seen).sum(1) / terms


_normal = register(
    "photometric_normal_equations",
    _normal_reference,
    fake=lambda source, target, matrix, *how: [(len(source), 8, 8), (len(source), 8), (len(source),)],
    non_differentiable=(0, 1, 2),
)


def photometric_homography_loss(
    source: Tensor,
    target: Tensor,
    src_homo_dst: Tensor,
    distance: str = "l1",
    eps: float = 1e-3,
    align_corners: bool = False,
    normalized_coordinates: bool = True,
) -> Tensor:
    """The mean distance of a target from an image warped onto it, with its gradient to the homography, in one pass.

    The mean is over the pixels of the target that the homography takes between four pixels of the source. How many
    these are counts as constant for the gradient. Nothing as large as an image is written.

    Args:
        source: images (B, C, H, W), the ones that are warped. Integers are computed in float32.
        target: images (B, C, h, w).
        src_homo_dst: (B, 3, 3), or (1, 3, 3) for all images: places of the target to places of the source, as
            :func:`homography_warp` takes it.
        distance: of two values: 'l1', the absolute difference; 'l2', its square; 'charbonnier', sqrt(r^2 + eps^2).
        eps: of the latter.
        align_corners: -1 and 1 are the middles of the outermost pixels, not their outer edges.
        normalized_coordinates: coordinates are from -1 to 1; else they are pixels.

    Returns:
        (B,), of the type of `source`; NaN where no pixel of the target is in the source.

    Raises:
        TypeError: an argument is of another kind.
        ValueError: a shape or name is not as above.

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
    stored = source.dtype if isinstance(source, Tensor) and source.is_floating_point() else torch.float32
    how = distance, eps, align_corners, normalized_coordinates
    found: Any = _photometric(*_checked(op, source, target, src_homo_dst, *how), *how)
    loss: Tensor = found[0]
    return loss if loss.dtype == stored else loss.to(stored)


def photometric_normal_equations(
    source: Tensor,
    target: Tensor,
    src_homo_dst: Tensor,
    distance: str = "l1",
    eps: float = 1e-3,
    align_corners: bool = False,
    normalized_coordinates: bool = True,
) -> tuple[Tensor, Tensor, Tensor]:
    """A step of Gauss and Newton for :func:`photometric_homography_loss`, in one pass over both images.

    The unknowns are the first eight numbers of the homography; its last one stays. The step to add to them is the solution
    x of `normal x = -gradient`. Residuals r are weighted by w = d'(r) / r: `normal` is the mean of w J J^T over the pixels
    that are seen, `gradient` that of w r J. Nothing here has a gradient itself.

    Args:
        source: as there; half types are computed in float32.
        target: as there.
        src_homo_dst: as there.
        distance: as there.
        eps: of 'charbonnier'; for 'l1', residuals that are smaller weigh as much as this one.
        align_corners: as there.
        normalized_coordinates: as there.

    Returns:
        normal (B, 8, 8), gradient (B, 8) and the distance (B,), of the type of the homography that computes.

    Raises:
        TypeError: an argument is of another kind.
        ValueError: a shape or name is not as there.

    Example:
        >>> import torch, kvision as K
        >>> image, other = torch.rand(2, 1, 3, 8, 8)
        >>> normal, gradient, _ = K.geometry.photometric_normal_equations(image, other, torch.eye(3)[None])
        >>> torch.linalg.solve(normal, -gradient).shape
        torch.Size([1, 8])
    """
    op = "photometric_normal_equations"
    how = distance, eps, align_corners, normalized_coordinates
    source, target, matrix = _checked(op, source, target, src_homo_dst, *how)
    found: tuple[Tensor, Tensor, Tensor] = _normal(source.to(matrix.dtype), target.to(matrix.dtype), matrix, *how)
    return found


def _checked(op, source, target, src_homo_dst, distance, eps, align_corners, normalized_coordinates):
    """The images, of one type, and the homography as the operators take them."""
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
        together = torch.promote_types(source.dtype, target.dtype)
        source, target = source.to(together), target.to(together)
    if source.shape[:2] != target.shape[:2]:
        raise ShapeError(
            f"{op}: expected target of shape {(*source.shape[:2], 'h', 'w')}, got {tuple(target.shape)}",
            actual_shape=target.shape,
        )
    return source, target, sampling.cast_to_image(op, source, "src_homo_dst", src_homo_dst)
