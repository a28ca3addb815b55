"""Photometric error between views of a scene, warped by its depth, and a target view, in one pass over all."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision._choices import Distance
from kvision._dtype import compute_dtype, floats
from kvision._modes import INTERPOLATION, PADDING, PHOTOMETRIC_DISTANCE, PHOTOMETRIC_DISTANCE_NAMES
from kvision._ops import register
from kvision.core.exceptions import ShapeError
from kvision.geometry._photometric import DISTANCES, distance_derivative, distance_of, in_bounds_mask, weighted_gradient
from kvision.geometry.depth.warp import depth_warp_of, image_gradient_of, source_coords
from kvision.geometry.transform import sampling
from kvision.geometry.transform.sampling import cast_to_image

__all__ = ["photometric_depth_loss"]

_OPTIONS = INTERPOLATION["bilinear"], PADDING["fill"], True  # options of depth_warp


def _loss(views, target, depth, projections, distance, eps):
    """The loss (B,), in the separate steps that csrc/geometry/depth/photometric.h fuses, and its number of terms."""
    batch, count = views.shape[:2]
    total: Any = 0.0
    terms: Any = 0
    for i in range(count):
        view = views[:, i].to(depth.dtype)
        coords = source_coords(depth.expand(batch, -1, -1, -1), projections[:, i].expand(batch, -1, -1))
        residual = sampling.sample(view, coords, "bilinear", "fill", True) - target.to(depth.dtype)
        inside = in_bounds_mask(coords, view)
        total = total + torch.where(inside, distance_of(residual, PHOTOMETRIC_DISTANCE_NAMES[distance], eps), 0).sum(
            (1, 2, 3)
        )
        terms = terms + inside.sum((1, 2, 3)) * views.shape[2]
    return total / terms, terms


def _reference(views, target, depth, projections, *options):
    batch = len(views)
    tensors = depth.expand(batch, -1, -1, -1), projections.expand(batch, -1, -1, -1)
    loss, vjp_fn, terms = torch.func.vjp(lambda d, p: _loss(views, target, d, p, *options), *tensors, has_aux=True)
    to_depth, to_projections = vjp_fn(torch.ones_like(loss))
    weight = torch.where(terms > 0, 1, 0) / torch.where(terms > 0, terms, 1).to(loss.dtype)
    of_sum = torch.where(terms > 0, terms, 0).to(loss.dtype)[:, None, None, None]
    return loss, to_depth.nan_to_num() * of_sum, weight, to_projections.nan_to_num()


def _backward(needs, grad, _1, _2, _3, loss, to_depth, weight, to_projections, *tensors_and_options):
    views, target, depth, projections, *options = tensors_and_options
    if torch.is_grad_enabled():
        return _differentiable_backward(needs, grad, views, target, depth, projections, *options)
    grads = [None, None, None, None]
    if needs[0] or needs[1]:
        grads[:2] = _image_gradients(needs, grad * weight, views, target, depth, projections, *options)
    if needs[2]:
        grads[2] = weighted_gradient(to_depth, grad * weight, depth)
    if needs[3]:
        grads[3] = weighted_gradient(to_projections, grad, projections)
    return grads


def _image_gradients(needs, weight, views, target, depth, projections, distance, eps):
    batch, count = views.shape[:2]
    computes = compute_dtype(views)
    grad_views, grad_target = [], 0.0
    for i in range(count):
        view, projection = views[:, i].to(computes), projections[:, i]
        coords = source_coords(depth.expand(batch, -1, -1, -1), projection.expand(batch, -1, -1))
        residual = depth_warp_of(view, depth, projection, *_OPTIONS) - target.to(computes)
        grad_residual = (
            distance_derivative(residual, PHOTOMETRIC_DISTANCE_NAMES[distance], eps) * weight[:, None, None, None]
        )
        grad_residual = torch.where(in_bounds_mask(coords, view), grad_residual, 0)
        grad_target = grad_target - grad_residual
        if needs[0]:
            size = [*view.shape[2:]]
            grad_views.append(image_gradient_of(grad_residual, depth, projection, size, *_OPTIONS))
    return (
        torch.stack(grad_views, 1).to(views.dtype) if needs[0] else None,
        grad_target.to(target.dtype).sum_to_size(target.shape) if needs[1] else None,
    )


def _differentiable_backward(needs, grad, *tensors_and_options):
    tensors, options = tensors_and_options[:4], tensors_and_options[4:]
    where = [i for i, need in enumerate(needs) if need]

    def f(*values: Tensor) -> Tensor:
        full = list(tensors)
        for i, value in zip(where, values):
            full[i] = value
        return _loss(*full, *options)[0]

    _, vjp_fn = torch.func.vjp(f, *(tensors[i] for i in where))
    grads = dict(zip(where, vjp_fn(grad)))
    return [grads.get(i) for i in range(4)]


_photometric = register(
    "photometric_depth",
    _reference,
    fake=lambda views, target, depth, projections, *options: [
        depth.new_empty(len(views)),
        depth.new_empty(len(views), *depth.shape[1:]),
        depth.new_empty(len(views)),
        depth.new_empty(len(views), *projections.shape[1:]),
    ],
    backward=_backward,
    saves_results=True,
    non_differentiable=(1, 2, 3),
    casts_outputs=True,
)


def photometric_depth_loss(
    views: Tensor,
    target: Tensor,
    depth: Tensor,
    projections: Tensor,
    distance: Distance = "l1",
    eps: float = 1e-3,
) -> Tensor:
    """The mean distance of a target from views warped onto it by its depth, with gradients, in one pass over all.

    The mean is over the views and those pixels of the target that lie between four pixels of a view. How many
    these are counts as constant for the gradient. Nothing as large as an image is written but the gradient to depth.

    Args:
        views: images (B, V, C, H, W), V of each sample. Integers are computed in float32.
        target: images (B, C, h, w), one for all samples or one for each.
        depth: of the target, z, (B, 1, h, w), likewise.
        projections: (B, V, 3, 4), likewise: [A | b], where pixel (x, y) of the target at depth d is projected into a view at
            (u, v), (u, v, 1) being proportional to d A (x, y, 1) + b. :attr:`DepthWarper.projection` has them.
        distance: of two values: 'l1', the absolute difference; 'l2', its square; 'charbonnier', sqrt(r^2 + eps^2).
        eps: of the latter.

    Returns:
        (B,), of the type of `views`; NaN where no pixel of the target is projected into a view.

    Raises:
        TypeError: an argument does not have its documented type.
        ValueError: a shape or name is not as in Args, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> target, depth = torch.rand(1, 3, 8, 8), torch.ones(1, 1, 8, 8, requires_grad=True)
        >>> views = torch.stack([target, target + 0.5], 1)
        >>> loss = K.geometry.photometric_depth_loss(views, target, depth, torch.eye(3, 4).expand(1, 2, 3, 4))
        >>> loss.backward()
        >>> loss.detach().round(decimals=4), depth.grad.shape
        (tensor([0.2500]), torch.Size([1, 1, 8, 8]))
    """
    op = "photometric_depth_loss"
    _check.shape(op, "views", views, "B", "V", "C", "H", "W")
    if 0 in (views.shape[1], *views.shape[3:]):
        raise ShapeError(f"{op}: expected views with pixels, got {tuple(views.shape)}", actual_shape=views.shape)
    _check.images(op, "target", target)
    _check.shape(op, "depth", depth, "B", 1, *target.shape[2:])
    _check.shape(op, "projections", projections, "B", views.shape[1], 3, 4)
    _check.choice(op, "distance", distance, DISTANCES)
    eps = _check.number(op, "eps", eps, minimum=0)
    views, target = floats(views), floats(target)
    stored = views.dtype
    if stored != target.dtype:
        dtype = torch.promote_types(stored, target.dtype)
        views, target = views.to(dtype), target.to(dtype)
    if target.shape[1] != views.shape[2] or not _check.is_one_or(target.shape[0], views.shape[0]):
        raise ShapeError(
            f"{op}: expected target of shape {(views.shape[0], views.shape[2], 'h', 'w')}, got {tuple(target.shape)}",
            actual_shape=target.shape,
        )
    _check.same_device(op, views=views, target=target, depth=depth)
    depth = cast_to_image(op, views, "depth", depth)
    projections = cast_to_image(op, views, "projections", projections)
    outputs: Any = _photometric(views, target, depth, projections, PHOTOMETRIC_DISTANCE[distance], eps)
    loss: Tensor = outputs[0].to(stored)
    return loss
