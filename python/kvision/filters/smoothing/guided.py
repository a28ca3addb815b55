"""Guided filter: an edge-preserving blur made of box blurs."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from kvision import _check
from kvision._choices import Border
from kvision._dtype import promoted
from kvision._modules import IMAGE, FunctionModule
from kvision._ops import match_layout
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError
from kvision.filters.smoothing.box import box_blur
from kvision.filters.smoothing.gaussian import batch_of


def guided_blur(
    guidance: Tensor,
    input: Tensor,
    kernel_size: tuple[int, int] | int,
    eps: float | Tensor,
    border_type: Border = "reflect",
    subsample: int = 1,
    separable: bool = False,
) -> Tensor:
    """Blur an image but keep the edges of a guidance image, which may be the image itself.

    For every window the linear function of the guidance is found that fits the input best; a pixel takes the mean of
    the functions of all windows it is in.

    Args:
        guidance: image (B, C, H, W); the fit is to all its channels together.
        input: image (B, N, H, W).
        kernel_size: size of the windows, an int or (y, x).
        eps: where the variance of the guidance is below eps, its edges are blurred; in squared units of the guidance. A
            number, or a tensor (1,) or (B,).
        border_type: 'constant' (zeros), 'reflect', 'replicate' or 'circular'.
        subsample: fit on every subsample-th row and column, with windows smaller by as much (fast guided filter).
        separable: for compatibility; the result is the same.

    Returns:
        The blurred input (B, N, H, W), floating point; differentiable in both images and eps.

    Raises:
        TypeCheckError: an image is not a real tensor; an argument of the wrong type.
        ShapeError: images that differ in batch, height or width; a border wider than the (subsampled) image.
        ValueCheckError: a kernel_size or subsample below 1, a negative eps, an unknown border_type.
        DeviceError: the tensors are on different devices; parameters in CPU memory are moved.

    Source: K. He, J. Sun and X. Tang, "Guided image filtering" (2010); K. He and J. Sun, "Fast guided filter" (2015).

    Example:
        >>> import torch, kvision as K
        >>> x = torch.tensor([[[[0., 0.1, 1., 0.9]]]])
        >>> K.filters.guided_blur(x, x, (1, 3), 0.01, "replicate")
        tensor([[[[0.0239, 0.0970, 0.9654, 0.9137]]]])
    """
    _check.images("guided_blur", "guidance", guidance)
    _check.images("guided_blur", "input", input)
    b, _, h, w = guidance.shape
    if (input.shape[0], *input.shape[2:]) != (b, h, w):
        raise ShapeError(
            f"guided_blur: expected input of shape ({b}, N, {h}, {w}), got {tuple(input.shape)}",
            actual_shape=input.shape,
        )
    _check.same_device("guided_blur", guidance=guidance, input=input)
    ky, kx = _check.pair("guided_blur", "kernel_size", kernel_size)
    (subsample,) = _check.ints("guided_blur", "subsample", subsample, 1)

    stored = torch.promote_types(*(x.dtype if x.is_floating_point() else torch.float32 for x in (guidance, input)))
    # A variance is a small difference of large numbers: float32 has none of the digits of 1000.5^2 that it needs.
    guide, x = promoted(guidance), promoted(input)
    computed = guide.dtype
    eps = _checked_eps(guide, eps)
    full_guide = guide
    if subsample > 1:
        rows, columns = (_subsampled_indices(n, subsample, guide.device) for n in (h, w))
        guide, x = (image[..., rows[:, None], columns] for image in (guide, x))
        ky, kx = ((k - 1) // subsample + 1 for k in (ky, kx))
    _check.border("guided_blur", border_type)
    _check.reflectable("guided_blur", guide, (ky // 2, kx // 2), border_type)

    def mean(planes: Tensor) -> Tensor:
        """Window means of (B, *, H, W)."""
        blurred = box_blur(planes.flatten(1, -3), (ky, kx), border_type)
        return blurred.reshape(*planes.shape)

    mean_guide, mean_x = mean(guide), mean(x)
    variance = mean(guide[:, :, None] * guide[:, None]) - mean_guide[:, :, None] * mean_guide[:, None]
    covariance = mean(guide[:, :, None] * x[:, None]) - mean_guide[:, :, None] * mean_x[:, None]
    ridge = torch.eye(guide.shape[1], device=guide.device, dtype=computed)[:, :, None, None] * eps
    gain = _solve(variance + ridge, covariance)
    offset = mean_x - (gain * mean_guide[:, :, None]).sum(1)
    gain, offset = mean(gain), mean(offset)
    if subsample > 1:
        gain, offset = _upsample(gain, h, w), _upsample(offset, h, w)
    return match_layout(((gain * full_guide[:, :, None]).sum(1) + offset).to(stored), input)


def _checked_eps(guide: Tensor, eps: float | Tensor) -> Tensor | float:
    if isinstance(eps, Tensor):
        eps = eps.reshape(1) if eps.dim() == 0 else eps
        _check.shape("guided_blur", "eps", eps, "B")
        return batch_of("guided_blur", "eps", guide, eps)[:, None, None, None, None]
    eps = _check.scalar("guided_blur", "eps", eps)
    if not isinstance(eps, (int, float)):
        raise TypeCheckError(
            f"guided_blur: expected eps to be a number or a Tensor (B,), got {eps!r}", actual_type=type(eps)
        )
    if not eps >= 0 or not _check.fits_float(eps):  # also refuses NaN
        raise ValueCheckError(f"guided_blur: expected eps of at least 0, got {eps!r}", actual_value=eps)
    return float(eps)


def _subsampled_indices(size: int, step: int, device: torch.device) -> Tensor:
    """The pixels nearest to the centers of size // step equal parts of an axis, but one at least."""
    parts = max(size // step, 1)
    i = torch.arange(parts, device=device)
    return (((2 * i + 1) * size + parts * (1 - step)) // (2 * parts)).clamp(0, size - 1)


def _upsample(planes: Tensor, h: int, w: int) -> Tensor:
    """(*, H, W) resized bilinearly."""
    return F.interpolate(planes.flatten(0, -3)[:, None], (h, w), mode="bilinear").reshape(*planes.shape[:-2], h, w)


def _solve(a: Tensor, y: Tensor) -> Tensor:
    """The solution (B, C, N, H, W) of a s = y in every pixel, `a` (B, C, C, H, W) symmetric and positive definite.

    Gauss-Jordan elimination, which needs no pivots then: plain arithmetic on planes, where a call to a solver would
    gather a matrix for each pixel and wait for the device.
    """
    channels = a.shape[1]
    if channels > 4 and _check.is_symbolic(channels):  # a graph for any number of them
        planes = torch.linalg.solve_ex(a.movedim((1, 2), (-2, -1)), y.movedim((1, 2), (-2, -1)))[0]
        return planes.movedim((-2, -1), (1, 2))
    rows = list(torch.cat((a, y), 2).unbind(1))
    if not rows:
        return y
    for i in range(len(rows)):
        pivot = rows[i] / rows[i][:, i : i + 1]
        rows = [pivot if j == i else row - row[:, i : i + 1] * pivot for j, row in enumerate(rows)]
    return torch.stack(rows, 1)[:, :, len(rows) :]


class GuidedBlur(FunctionModule):
    """Module form of :func:`guided_blur`.

    Example:
        >>> import torch, kvision as K
        >>> K.filters.GuidedBlur(3, 0.01)(torch.rand(2, 3, 8, 8), torch.rand(2, 1, 8, 8)).shape
        torch.Size([2, 1, 8, 8])
    """

    samples = IMAGE, IMAGE

    def __init__(
        self,
        kernel_size: tuple[int, int] | int,
        eps: float | Tensor,
        border_type: Border = "reflect",
        subsample: int = 1,
        separable: bool = False,
    ) -> None:
        super().__init__(
            kernel_size=kernel_size, eps=eps, border_type=border_type, subsample=subsample, separable=separable
        )

    def forward(self, guidance: Tensor, input: Tensor) -> Tensor:
        return guided_blur(
            guidance, input, self.kernel_size, self.eps, self.border_type, self.subsample, self.separable
        )
