"""Otsu's threshold between the dark and the bright pixels of an image."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.compiler import is_compiling

from kvision import _check
from kvision.core.exceptions import ShapeError, TypeCheckError

# For the gradient: how far a pixel spreads over the bins, and how close to the best variance counts as good.
_BANDWIDTH = 0.5
_TEMPERATURE = 0.01
_WIDER = {torch.uint16: torch.int32, torch.uint32: torch.int64}
_BLOCK = 1 << 17  # pixels of planes that are computed together, so that intermediate results stay in the caches


def otsu_threshold(
    x: Tensor, nbins: int = 256, slow_and_differentiable: bool = False, return_mask: bool = False
) -> tuple[Tensor, Tensor]:
    """Split every image plane in two by the threshold that maximizes the variance between the parts.

    The values from the smallest to the largest are counted in nbins bins of equal width. The threshold is the upper
    edge of the best bin, or the largest dark value where a bright one lies on that edge. A plane of one value has that
    value as its threshold.

    Args:
        x: a plane (H, W), or planes (C, H, W), (B, C, H, W) or (F, B, C, H, W); any real type but bool.
        nbins: number of bins, at least 2.
        slow_and_differentiable: give the thresholds a gradient, that of a soft maximum over a smooth histogram. Needs
            memory for nbins numbers a pixel.
        return_mask: give the mask x > threshold instead of the thresholded image.

    Returns:
        x with 0 for the values that are not above their plane's threshold (or the mask), of the shape of x; and the
        thresholds (planes,), in the type of x.

    Raises:
        TypeCheckError: x is not a tensor of real numbers, nbins not an int.
        ShapeError: x has more than 5 axes or no pixels.
        ValueCheckError: nbins below 2.

    Source: N. Otsu, "A threshold selection method from gray-level histograms" (1979).

    Example:
        >>> import torch, kvision as K
        >>> mask, threshold = K.filters.otsu_threshold(torch.tensor([[1, 2, 2], [8, 9, 9]]), return_mask=True)
        >>> mask
        tensor([[False, False, False],
                [ True,  True,  True]])
    """
    _check.numbers("otsu_threshold", "x", x)
    if x.dtype in _WIDER:  # torch does not compare these
        result, thresholds = otsu_threshold(x.to(_WIDER[x.dtype]), nbins, slow_and_differentiable, return_mask)
        return result if return_mask else result.to(x.dtype), thresholds.to(x.dtype)
    planes = _planes(x)
    (nbins,) = _check.ints("otsu_threshold", "nbins", nbins, 1, minimum=2)
    _check.flag("otsu_threshold", "slow_and_differentiable", slow_and_differentiable)
    _check.flag("otsu_threshold", "return_mask", return_mask)
    values, pixels = planes.detach(), planes.shape[1]
    if x.is_cpu and not is_compiling() and values.numel() > _BLOCK:
        thresholds = torch.cat([_thresholds(block, nbins) for block in values.split(max(1, _BLOCK // pixels))])
    else:
        thresholds = _thresholds(values, nbins)
    if slow_and_differentiable and x.is_floating_point() and planes.shape[0]:
        promoted = planes if x.dtype == torch.float64 else planes.float()
        soft = torch.stack([_soft_threshold(plane, nbins) for plane in promoted]).to(x.dtype)
        thresholds = thresholds + (soft - soft.detach())
    mask = (planes > thresholds[:, None]).reshape(x.shape)
    if return_mask:
        return mask, thresholds
    # A product, because the CPU chooses by random masks slowly. Nothing infinite is above a threshold.
    finite = x.nan_to_num(0.0, 0.0, 0.0) if x.is_floating_point() else x
    return finite * mask, thresholds


def _thresholds(planes: Tensor, nbins: int) -> Tensor:
    exact = torch.float64 if planes.dtype in (torch.float64, torch.int32, torch.int64) else torch.float32
    values = planes.to(exact)
    low, high = values.amin(1, keepdim=True), values.amax(1, keepdim=True)  # aminmax is slow on the CPU
    span = high - low
    # By way of int32: float to int64 is not vectorized on the CPU. The second clamp is for NaN.
    # In place, because new memory costs more than arithmetic.
    scaled = (values - low).mul_(nbins).div_(torch.where(span > 0, span, 1))
    bins = scaled.clamp_(0, nbins - 1).int().clamp_(min=0).long()
    one = torch.ones_like(bins[:, :1])
    histogram = (0 * one).repeat(1, nbins).scatter_add_(1, bins, one.expand_as(bins))
    variance = _variance_between(histogram.double())
    variance = torch.where(histogram[:, :-1] > 0, variance, -torch.inf)  # a gap is cut at its lower end
    best = variance.argmax(1, keepdim=True)

    bright, largest = (bins > best).to(exact), torch.finfo(exact).max
    largest_dark = values.add(bright, alpha=-largest).amax(1, keepdim=True)
    smallest_bright = values.add(1 - bright, alpha=largest).amin(1, keepdim=True)
    edge = low + (best + 1) * span / nbins
    edge = edge.to(planes.dtype).to(exact) if planes.is_floating_point() else edge.ceil() - 1
    edge = torch.where(edge < smallest_bright, torch.maximum(edge, largest_dark), largest_dark)
    return torch.where(span > 0, edge, low)[:, 0].to(planes.dtype)


def _variance_between(histogram: Tensor) -> Tensor:
    """(N, bins - 1): the variance between the classes when (N, bins) is cut after each bin, -inf where one is empty."""
    position = torch.arange(histogram.shape[1], device=histogram.device, dtype=histogram.dtype)
    weight, moment = histogram.cumsum(1), (histogram * position).cumsum(1)
    dark, dark_moment = weight[:, :-1], moment[:, :-1]
    bright, bright_moment = weight[:, -1:] - dark, moment[:, -1:] - dark_moment
    product = dark * bright
    occupied = product > 0
    difference = dark_moment * bright - bright_moment * dark
    return torch.where(occupied, difference**2 / torch.where(occupied, product, 1), -torch.inf)


def _soft_threshold(plane: Tensor, nbins: int) -> Tensor:
    """A smooth function of (pixels,) near the threshold: edges averaged with weights that fall with their variance."""
    low, high = plane.amin(), plane.amax()
    span = torch.where(high > low, high - low, 1)
    edges = torch.arange(1, nbins, device=plane.device, dtype=plane.dtype)
    above = torch.special.ndtr(((plane[:, None] - low) / span * nbins - edges) / _BANDWIDTH).mean(0)
    histogram = -torch.cat([above.new_ones(1), above, above.new_zeros(1)]).diff()
    variance = _variance_between(histogram[None])[0]
    weights = torch.softmax(variance / (_TEMPERATURE * variance.amax().clamp(min=1e-12)), 0)
    return low + (weights * edges).sum() / nbins * span


def _planes(x: Tensor) -> Tensor:
    """(planes, pixels)."""
    _check.numbers("otsu_threshold", "x", x)
    if x.dtype == torch.bool:
        raise TypeCheckError("otsu_threshold: expected x to hold numbers, got torch.bool", actual_type=x.dtype)
    if x.dim() > 5 or 0 in x.shape[-2:]:
        raise ShapeError(f"otsu_threshold: expected x of shape (F, B, C, H, W) or less, got {tuple(x.shape)}")
    return x.reshape(1, -1) if x.dim() <= 2 else x.flatten(-2).flatten(0, -2)


class OtsuThreshold(nn.Module):
    """Module form of :func:`otsu_threshold`.

    Example:
        >>> import torch, kvision as K
        >>> thresholded, thresholds = K.filters.OtsuThreshold()(torch.rand(2, 3, 8, 8))
        >>> thresholds.shape
        torch.Size([6])
    """

    def forward(self, x: Tensor, nbins: int = 256, slow_and_differentiable: bool = False) -> tuple[Tensor, Tensor]:
        return otsu_threshold(x, nbins, slow_and_differentiable)

    def transform_input(self, x: Tensor, original_shape: torch.Size | None = None) -> tuple[Tensor, torch.Size]:
        """The planes of an image as rows (planes, pixels), and the shape to give them back."""
        return _planes(x), x.shape if original_shape is None else original_shape
