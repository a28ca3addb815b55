"""Weighted sum of multi-scale structural dissimilarity and absolute differences."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor

from kvision import _check
from kvision._choices import Reduction
from kvision._dtype import as_dtype, compute_dtype, floats
from kvision._limits import MAX_SSIM_SCALES, MAX_SSIM_WEIGHTS
from kvision._modules import IMAGE, FunctionModule
from kvision._ops import register, vjp
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError
from kvision.filters.kernels import gaussian
from kvision.filters.separable import filter_separably
from kvision.losses.reduction import reduced
from kvision.metrics.ssim import CONSTANT, _backward, _both_gradients, _like
from kvision.metrics.ssim import _reference as similarity


def _reference(
    x: Tensor, y: Tensor, sigmas: Sequence[float], size: int, c1: float, c2: float, structure: float, absolute: float
) -> Tensor:
    """(B, H, W): the mean over the channels of 1 - similarity and of abs(x - y) in a window, each times its weight."""
    dtype = compute_dtype(x)
    x, y = x.to(dtype), y.to(dtype)
    similar = similarity(x, y, size, sigmas[-1], c1, c2, 0.0, CONSTANT, True)
    for sigma in sigmas[:-1]:
        similar = similar * similarity(x, y, size, sigma, c1, c2, 0.0, CONSTANT, False)
    kernel = gaussian(size, sigmas[-1], device=x.device, dtype=dtype)
    difference = filter_separably((x - y).abs(), kernel, kernel, "constant", True)
    return (structure * (1 - similar) + absolute * difference).mean(1)


def _supports(x: Tensor, y: Tensor, sigmas: Sequence[float], size: int, *_: float) -> str | None:
    """Images have channels, there are at most 16 scales, and their windows have at most 400 weights in all."""
    if len(sigmas) > MAX_SSIM_SCALES:
        return f"there is no kernel for {len(sigmas)} scales, only for up to {MAX_SSIM_SCALES}"
    if len(sigmas) * size > MAX_SSIM_WEIGHTS:
        return (
            f"there is no kernel for {len(sigmas)} windows of {size} pixels, only for {MAX_SSIM_WEIGHTS} pixels in all"
        )
    return None if x.shape[1] > 0 else "there is no kernel for images without channels"


_ms_ssim = register(
    "ms_ssim",
    _reference,
    fake=lambda x, *_: x.new_empty((x.shape[0], *x.shape[2:]), dtype=compute_dtype(x)),
    backward=_backward(
        register("ms_ssim_backward", vjp(_reference), fake=lambda grad, x, *_: _like(x), casts_outputs=True),
        register(
            "ms_ssim_backward_both",
            _both_gradients(_reference),
            fake=lambda grad, x, *_: [_like(x), _like(x)],
            casts_outputs=True,
        ),
    ),
    casts_outputs=True,
    supports=_supports,
)


class MS_SSIMLoss(FunctionModule):
    """Mix the structural similarity at several scales with absolute differences, both in Gaussian windows.

    The similarity is the product of the structure at every scale with the luminance at the last one, and its mean over the
    channels; the loss is compensation * (alpha * (1 - similarity) + (1 - alpha) * difference / data_range). The windows
    have 2 * int(2 * sigmas[-1]) + 1 pixels a side and end at the image, which is surrounded by zeros.

    Args:
        sigmas: standard deviations of the windows, in pixels.
        data_range: largest value that there can be, above 0.
        K: the constants of the similarity, which are (K * data_range)^2.
        alpha: weight of the similarity.
        compensation: factor of the loss.
        reduction: 'none', 'mean' or 'sum'.

    Its call takes two images (B, C, H, W), one of which may have B = 1 and serves all of the other; integers are computed
    in float32. It returns a number, or for 'none' (B, H, W).

    Raises:
        TypeCheckError: arguments of the wrong type; not two real tensors.
        ShapeError: not (B, C, H, W), or different shapes.
        ValueCheckError: sigmas or data_range not above 0; an unknown reduction, which is a NotImplementedError, too.
        DeviceError: the tensors are on different devices.

    Source: H. Zhao et al., "Loss functions for image restoration with neural networks" (2017).

    Example:
        >>> import torch, kvision as K
        >>> x = torch.rand(1, 3, 8, 8)
        >>> K.losses.MS_SSIMLoss()(x, x)
        tensor(0.)
    """

    samples = IMAGE, IMAGE

    def __init__(
        self,
        sigmas: Sequence[float] = (0.5, 1.0, 2.0, 4.0, 8.0),
        data_range: float = 1.0,
        K: tuple[float, float] = (0.01, 0.03),
        alpha: float = 0.025,
        compensation: float = 200.0,
        reduction: Reduction = "mean",
    ) -> None:
        op = "MS_SSIMLoss"
        for name, values in (("sigmas", sigmas), ("K", K)):
            if not isinstance(values, (tuple, list)):
                raise TypeCheckError(f"{op}: expected {name} to be a tuple of numbers, got {values!r}")
        numbers = [_check.number(op, "sigmas", sigma) for sigma in sigmas]
        numbers.append(_check.number(op, "data_range", data_range))
        if len(sigmas) == 0 or not min(numbers) > 0:
            raise ValueCheckError(f"{op}: expected sigmas and data_range above 0, got {sigmas!r} and {data_range!r}")
        if len(K) != 2:
            raise ValueCheckError(f"{op}: expected K of two numbers, got {K!r}")
        for name, value in (("K", K[0]), ("K", K[1]), ("alpha", alpha), ("compensation", compensation)):
            _check.number(op, name, value)
        _check.reduction(op, reduction)
        super().__init__(
            sigmas=tuple(sigmas),
            data_range=data_range,
            K=tuple(K),
            alpha=alpha,
            compensation=compensation,
            reduction=reduction,
        )

    def forward(self, img1: Tensor, img2: Tensor) -> Tensor:
        _check.images("MS_SSIMLoss", "img1", img1)
        _check.images("MS_SSIMLoss", "img2", img2)
        _check.same_device("MS_SSIMLoss", img1=img1, img2=img2)
        if img1.shape[1:] != img2.shape[1:] or (img1.shape[0] != img2.shape[0] and 1 not in (len(img1), len(img2))):
            raise ShapeError(
                f"MS_SSIMLoss: expected img2 of shape {tuple(img1.shape)} as img1, or one of both with a batch of 1, "
                f"got {tuple(img2.shape)}",
                actual_shape=img2.shape,
            )
        img1, img2 = floats(img1), as_dtype(floats(img2), floats(img1).dtype)
        if len(img1) < len(img2):
            img1, img2 = img2, img1  # img2 may be one image for the whole batch
        size = 2 * int(2 * self.sigmas[-1]) + 1
        c1, c2 = ((k * self.data_range) ** 2 for k in self.K)
        structure = self.compensation * self.alpha
        absolute = self.compensation * (1 - self.alpha) / self.data_range
        arguments = list(map(float, self.sigmas)), size, c1, c2, structure, absolute
        loss = _ms_ssim(img1, img2, *arguments)
        return as_dtype(reduced(loss, self.reduction), img1.dtype)
