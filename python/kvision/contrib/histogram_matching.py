"""Histogram matching: gives the values of one image the distribution of another."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import compute_dtype
from kvision.core.exceptions import ShapeError


def interp(x: Tensor, xp: Tensor, fp: Tensor) -> Tensor:
    """Interpolate linearly between points. Outside of their range the first and the last segment continue.

    Args:
        x: coordinates to interpolate at, of any shape.
        xp: coordinates of the points (N,). They must increase, which is not checked. N is at least 2.
        fp: their values (N,).

    Returns:
        Values in the shape of x. Where several points have the same coordinate, the last one counts.

    Raises:
        TypeCheckError: not three real tensors.
        ShapeError: xp and fp not of one shape (N,), N at least 2.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.contrib.interp(torch.tensor([0.5, 3.0]), torch.tensor([0.0, 1.0, 2.0]), torch.tensor([0.0, 2.0, 3.0]))
        tensor([1., 4.])
    """
    for name, value in (("x", x), ("xp", xp), ("fp", fp)):
        _check.numbers("interp", name, value)
    if xp.dim() != 1 or xp.shape != fp.shape or xp.numel() < 2:
        raise ShapeError(
            f"interp: expected xp and fp of shape (N,) with N of at least 2, got {tuple(xp.shape)} and {tuple(fp.shape)}"
        )
    _check.same_device("interp", x=x, xp=xp, fp=fp)
    dtype = torch.promote_types(torch.promote_types(x.dtype, xp.dtype), fp.dtype)
    dtype = dtype if dtype.is_floating_point else torch.get_default_dtype()
    promoted = torch.promote_types(dtype, torch.float32)
    x, xp, fp = x.to(promoted), xp.to(promoted).contiguous(), fp.to(promoted)
    upper = torch.searchsorted(xp, x.detach().contiguous(), right=True).clamp(1, xp.numel() - 1)
    x0, x1, f0, f1 = xp[upper - 1], xp[upper], fp[upper - 1], fp[upper]
    point = x1 == x0
    weight = torch.where(point, 1, (x - x0) / torch.where(point, 1, x1 - x0))
    return torch.lerp(f0, f1, weight).to(dtype)


def histogram_matching(source: Tensor, template: Tensor) -> Tensor:
    """Replace every value of an image by the one of the same rank in another image.

    All values of a tensor are one distribution. The rank of a value is the fraction of values up to it. Values are
    interpolated between the ranks of the template.

    Args:
        source: an image of any shape.
        template: another one, with at least one value.

    Returns:
        The source with the template's values, floating point; differentiable in the template.

    Raises:
        TypeCheckError: not two real tensors.
        ShapeError: an empty template for a source that is not.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.contrib.histogram_matching(torch.tensor([3.0, 1.0, 2.0]), torch.tensor([10.0, 20.0, 30.0]))
        tensor([30., 10., 20.])
    """
    _check.numbers("histogram_matching", "source", source)
    _check.numbers("histogram_matching", "template", template)
    _check.same_device("histogram_matching", source=source, template=template)
    stored = source.dtype if source.is_floating_point() else torch.float32
    if source.numel() == 0:
        return source.to(stored)
    if template.numel() == 0:
        raise ShapeError("histogram_matching: expected a template with values, got none", actual_shape=template.shape)
    computes = compute_dtype(source)
    values = template.flatten().to(computes).sort().values
    source_ranks = torch.cat([values.new_zeros(1), _ranks(values.detach())])
    ordered, order = source.detach().flatten().to(computes).sort()
    matched = interp(_ranks(ordered), source_ranks, torch.cat([values[:1], values]))
    return torch.empty_like(matched).scatter(0, order, matched).view(source.shape).to(stored)


def _ranks(ordered: Tensor) -> Tensor:
    """The rank of each of the sorted values: the fraction of values that are not above it."""
    n = ordered.numel()
    if not ordered.is_cpu:  # on CUDA a scan of one row takes far longer than searches
        return torch.searchsorted(ordered, ordered, right=True).to(ordered.dtype) / n
    follows = torch.nn.functional.pad(ordered[1:] == ordered[:-1], (0, 1))
    last = torch.where(follows, n, torch.arange(1, n + 1, device=ordered.device))
    return last.flip(0).cummin(0).values.flip(0).to(ordered.dtype) / n
