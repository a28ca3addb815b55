"""Mutual information of signals, from a differentiable joint histogram."""

from __future__ import annotations

import math
from enum import Enum
from typing import Any

import torch
from torch import Tensor, nn

from kvision import _check
from kvision._dtype import compute_dtype
from kvision._modes import BIN_KERNEL
from kvision._ops import register
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError


class MIKernel(Enum):
    """The weight of a value in a bin, as a function of its distance x from the center, at most one radius.

    Example:
        >>> import kvision as K
        >>> [kernel.name for kernel in K.losses.MIKernel]
        ['xu', 'rectangular', 'truncated_gaussian']
    """

    xu = "xu"
    rectangular = "rectangular"
    truncated_gaussian = "truncated_gaussian"


_KERNELS = tuple(map(MIKernel, BIN_KERNEL))


def _weights(kernel: int, x: Tensor, radius: float) -> Tensor:
    """The weights for distances x in radii."""
    if _KERNELS[kernel] == MIKernel.rectangular:
        return (x <= 1).to(x.dtype)
    if _KERNELS[kernel] == MIKernel.truncated_gaussian:
        inside = torch.exp(-x.square() / 2) / (radius * math.sqrt(2 * math.pi))
    else:  # two parabolas, with values 1 and 0 at the ends; continuously differentiable in the middle
        inside = torch.where(x < 0.5, (-1.8 * x - 0.1) * x + 1, (1.8 * x - 3.7) * x + 1.9)
    return torch.where(x <= 1, inside, 0)


def _bins(
    signal: Tensor, mask: Tensor | None, kernel: int, count: int, radius: float
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """(B, count, N): the weight of every sample of signals (B, N) in every bin of the range within the mask; also the
    range, and whether it is valid."""
    low = signal if mask is None else signal.masked_fill(~mask, torch.inf)
    high = signal if mask is None else signal.masked_fill(~mask, -torch.inf)
    low, high = low.amin(-1, keepdim=True), high.amax(-1, keepdim=True)
    flat = ~(high - low > torch.finfo(signal.dtype).eps)
    last = (count - 1) / radius
    coord = torch.where(flat, 0, (signal - low) / torch.where(flat, 1, high - low) * last)
    centers = torch.arange(count, device=signal.device, dtype=signal.dtype) / radius
    weights = _weights(kernel, (centers[:, None] - coord[..., None, :]).abs(), radius)
    return weights if mask is None else torch.where(mask[:, None], weights, 0), low, high, (high - low).isfinite()


def _reference(
    x: Tensor,
    y: Tensor,
    x_mask: Tensor | None,
    y_mask: Tensor | None,
    kernel: int,
    bins: int,
    radius: float,
    normalized: bool,
) -> tuple[Tensor, Tensor, Tensor]:
    """(B): the negative mutual information of signals (B, N); (B, bins, bins): its gradients by the joint histogram;
    (B, 4): the ranges of both."""
    (of_x, *range_x, x_sound), (of_y, *range_y, y_sound) = (
        _bins(s, mask, kernel, bins, radius) for s, mask in ((x, x_mask), (y, y_mask))
    )
    counts = torch.einsum("...in,...jn->...ij", of_x, of_y.expand(x.shape[0], -1, -1))
    joint = counts.clamp_min(torch.finfo(counts.dtype).eps)
    total = joint.sum((-1, -2), keepdim=True)
    joint = joint / total

    def entropy(p: Tensor) -> Tensor:
        return -(p * p.log()).sum((-1, -2), keepdim=True)

    rows, columns = joint.sum(-1, keepdim=True), joint.sum(-2, keepdim=True)
    of_both, separately = entropy(joint), entropy(rows) + entropy(columns)
    loss = -separately / of_both if normalized else of_both - separately
    loss = torch.where((x_sound & y_sound)[..., None], loss, torch.nan)
    count_grads = rows.log() + columns.log()
    count_grads = (count_grads + loss * joint.log()) / of_both if normalized else count_grads - joint.log() - loss
    count_grads = torch.where(counts < torch.finfo(counts.dtype).eps, 0, count_grads / total)
    ranges = [end.expand(x.shape[0], 1) for end in (*range_x, *range_y)]
    return loss[:, 0, 0], count_grads.detach(), torch.cat(ranges, 1).detach()


def _fake(x: Tensor, y: Tensor, x_mask: Any, y_mask: Any, kernel: int, bins: int, *_: Any) -> list[Any]:
    return [(x.shape[0],), (x.shape[0], bins, bins), (x.shape[0], 4)]


def _backward_reference(grad: Tensor, count_grads: Tensor, ranges: Tensor, x: Tensor, y: Tensor, *args: Any) -> Tensor:
    *options, by_other = args
    x, y = x.expand(grad.shape[0], -1), y.expand(grad.shape[0], -1)
    return torch.func.vjp(lambda x, y: _reference(x, y, *options)[0], x, y)[1](grad)[by_other]


register(
    "mutual_information_backward",
    _backward_reference,
    fake=lambda grad, count_grads, ranges, x, *_: (grad.shape[0], x.shape[1]),
)
_information = register(
    "mutual_information",
    _reference,
    fake=_fake,
    gradients="input: mutual_information_backward(count_gradients=result1, ranges=result2, by_other=False); "
    "other: mutual_information_backward(count_gradients=result1, ranges=result2, by_other=True)",
    non_differentiable=(1, 2),
)


class _FromRef(nn.Module):
    _axes = 1  # axes of a signal
    _normalized = False
    reference: Tensor
    mask: Tensor | None

    def __init__(
        self,
        reference_signal: Tensor,
        mask: Tensor | None = None,
        kernel_function: MIKernel = MIKernel.xu,
        num_bins: int = 64,
        window_radius: float = 1.0,
    ) -> None:
        super().__init__()
        self._op = type(self).__name__
        _check_options(self._op, kernel_function, num_bins, window_radius)
        self.kernel_function, self.num_bins, self.window_radius = kernel_function, num_bins, float(window_radius)
        _check.numbers(self._op, "reference_signal", reference_signal)
        self.shape, self.dtype = reference_signal.shape, reference_signal.dtype
        signal, mask = _flattened(self._op, self._axes, "reference_signal", reference_signal, "mask", mask)
        self.register_buffer("reference", signal)
        self.register_buffer("mask", mask)

    def forward(self, other_signal: Tensor, other_mask: Tensor | None = None) -> Tensor:
        other, mask = _flattened(self._op, self._axes, "other_signal", other_signal, "other_mask", other_mask)
        if other_signal.shape != self.shape:
            raise ShapeError(
                f"{self._op}: expected other_signal of shape {tuple(self.shape)}, got {tuple(other_signal.shape)}",
                actual_shape=other_signal.shape,
            )
        _check.same_device(self._op, reference_signal=self.reference, other_signal=other_signal)
        options = (self.kernel_function, self.num_bins, self.window_radius, self._normalized)
        return _losses(other, self.reference, mask, self.mask, *options).to(self.dtype)

    def extra_repr(self) -> str:
        return f"num_bins={self.num_bins}, window_radius={self.window_radius}"


def _check_options(op: str, kernel: MIKernel, bins: int, radius: float) -> None:
    if not isinstance(kernel, MIKernel):
        raise ValueCheckError(f"{op}: expected kernel_function to be an MIKernel, got {kernel!r}")
    _check.ints(op, "num_bins", bins, 1, 2)
    if not _check.number(op, "window_radius", radius) > 0:
        raise ValueCheckError(f"{op}: expected window_radius above 0, got {radius!r}", actual_value=radius)


def _flattened(
    op: str, axes: int, name: str, signal: Tensor, mask_name: str, mask: Tensor | None
) -> tuple[Tensor, Tensor | None]:
    """Signals (*, N), and their mask (N,)."""
    _check.numbers(op, name, signal)
    _check.floating(op, name, signal)
    if signal.dim() < axes or 0 in signal.shape[signal.dim() - axes :]:
        want = ", ".join(("*", *("D", "H", "W")[-axes:])) if axes > 1 else "*, N"
        raise ShapeError(f"{op}: expected {name} of shape ({want}) with samples, got {tuple(signal.shape)}")
    if mask is not None:
        _check.shape(op, mask_name, mask, *signal.shape[signal.dim() - axes :])
        if mask.dtype not in (torch.bool, torch.uint8):
            raise TypeCheckError(f"{op}: expected {mask_name} of bool or uint8, got {mask.dtype}")
        _check.same_device(op, **{name: signal, mask_name: mask})
        mask = mask.bool().flatten()
    return signal.flatten(signal.dim() - axes), mask


def _loss(
    op: str,
    axes: int,
    input: Tensor,
    target: Tensor,
    input_mask: Tensor | None,
    target_mask: Tensor | None,
    kernel: MIKernel,
    num_bins: int,
    radius: float,
    normalized: bool,
) -> Tensor:
    _check_options(op, kernel, num_bins, radius)
    x, x_mask = _flattened(op, axes, "input", input, "input_mask", input_mask)
    y, y_mask = _flattened(op, axes, "target", target, "target_mask", target_mask)
    _check.same_shape(op, input=input, target=target)
    _check.same_device(op, input=input, target=target)
    return _losses(x, y, x_mask, y_mask, kernel, num_bins, radius, normalized).to(target.dtype)


def _losses(
    x: Tensor,
    y: Tensor,
    x_mask: Tensor | None,
    y_mask: Tensor | None,
    kernel: MIKernel,
    bins: int,
    radius: float,
    normalized: bool,
) -> Tensor:
    """The losses (*) of signals (*, N) with masks (N,)."""
    dtype = torch.promote_types(compute_dtype(x), compute_dtype(y))
    samples = (s.to(dtype).reshape(math.prod(s.shape[:-1]), s.shape[-1]) for s in (x, y))
    masks = (None if mask is None else mask[None] for mask in (x_mask, y_mask))
    return _information(*samples, *masks, _KERNELS.index(kernel), bins, radius, normalized)[0].reshape(x.shape[:-1])


def mutual_information_loss(
    input: Tensor,
    target: Tensor,
    input_mask: Tensor | None = None,
    target_mask: Tensor | None = None,
    kernel_function: MIKernel = MIKernel.xu,
    num_bins: int = 64,
    window_radius: float = 1.0,
) -> Tensor:
    """Compute the negative mutual information of two signals.

    The range of each signal within its mask is divided into num_bins bins; a value adds to the bins within
    window_radius of it. The mutual information is that of the joint histogram of the samples
    that are in both masks, in nats.

    Args:
        input: signals (*, N), floating point.
        target: signals in the same shape.
        input_mask: which samples of input count (N,), bool or uint8; None for all. Without a sample the loss is NaN.
        target_mask: the same for target.
        kernel_function: how much a value adds to a bin.
        num_bins: how many bins, at least 2.
        window_radius: in bins, above 0.

    Returns:
        (*), in the type of target; differentiable in both signals, except with the rectangular kernel.

    Raises:
        TypeCheckError: no floating-point tensors; masks of another type; num_bins or window_radius of the wrong type.
        ShapeError: different shapes, or no samples.
        ValueCheckError: num_bins or window_radius too small; kernel_function no MIKernel.
        DeviceError: the tensors are on different devices.

    Source: J. Xu et al., "A novel parametric kernel for mutual information based registration" (2008).

    Example:
        >>> import torch, kvision as K
        >>> x, y = torch.rand(2, 1000)
        >>> loss = K.losses.mutual_information_loss
        >>> bool(loss(x, x) < loss(x, y))
        True
    """
    op = "mutual_information_loss"
    return _loss(op, 1, input, target, input_mask, target_mask, kernel_function, num_bins, window_radius, False)


def mutual_information_loss_2d(
    input: Tensor,
    target: Tensor,
    input_mask: Tensor | None = None,
    target_mask: Tensor | None = None,
    kernel_function: MIKernel = MIKernel.xu,
    num_bins: int = 64,
    window_radius: float = 1.0,
) -> Tensor:
    """Compute the negative mutual information of two images; see :func:`mutual_information_loss`.

    Args:
        input: images (*, H, W), floating point.
        target: images in the same shape.
        input_mask: which samples of input count (H, W), bool or uint8; None for all.
        target_mask: the same for target.
        kernel_function: how much a value adds to a bin.
        num_bins: how many bins, at least 2.
        window_radius: in bins, above 0.

    Returns:
        (*), in the type of target.

    Raises:
        TypeCheckError, ShapeError, ValueCheckError, DeviceError: as :func:`mutual_information_loss`.

    Example:
        >>> import torch, kvision as K
        >>> x, y = torch.rand(2, 20, 50)
        >>> loss = K.losses.mutual_information_loss_2d
        >>> bool(loss(x, x) < loss(x, y))
        True
    """
    op = "mutual_information_loss_2d"
    return _loss(op, 2, input, target, input_mask, target_mask, kernel_function, num_bins, window_radius, False)


def mutual_information_loss_3d(
    input: Tensor,
    target: Tensor,
    input_mask: Tensor | None = None,
    target_mask: Tensor | None = None,
    kernel_function: MIKernel = MIKernel.xu,
    num_bins: int = 64,
    window_radius: float = 1.0,
) -> Tensor:
    """Compute the negative mutual information of two volumes; see :func:`mutual_information_loss`.

    Args:
        input: volumes (*, D, H, W), floating point.
        target: volumes in the same shape.
        input_mask: which samples of input count (D, H, W), bool or uint8; None for all.
        target_mask: the same for target.
        kernel_function: how much a value adds to a bin.
        num_bins: how many bins, at least 2.
        window_radius: in bins, above 0.

    Returns:
        (*), in the type of target.

    Raises:
        TypeCheckError, ShapeError, ValueCheckError, DeviceError: as :func:`mutual_information_loss`.

    Example:
        >>> import torch, kvision as K
        >>> x, y = torch.rand(2, 4, 5, 50)
        >>> loss = K.losses.mutual_information_loss_3d
        >>> bool(loss(x, x) < loss(x, y))
        True
    """
    op = "mutual_information_loss_3d"
    return _loss(op, 3, input, target, input_mask, target_mask, kernel_function, num_bins, window_radius, False)


def normalized_mutual_information_loss(
    input: Tensor,
    target: Tensor,
    input_mask: Tensor | None = None,
    target_mask: Tensor | None = None,
    kernel_function: MIKernel = MIKernel.xu,
    num_bins: int = 64,
    window_radius: float = 1.0,
) -> Tensor:
    """Compute -(H(a) + H(b)) / H(a, b) of two signals, H as in :func:`mutual_information_loss`.

    Args:
        input: signals (*, N), floating point.
        target: signals in the same shape.
        input_mask: which samples of input count (N,), bool or uint8; None for all.
        target_mask: the same for target.
        kernel_function: how much a value adds to a bin.
        num_bins: how many bins, at least 2.
        window_radius: in bins, above 0.

    Returns:
        (*), in the type of target.

    Raises:
        TypeCheckError, ShapeError, ValueCheckError, DeviceError: as :func:`mutual_information_loss`.

    Example:
        >>> import torch, kvision as K
        >>> x, y = torch.rand(2, 1000)
        >>> loss = K.losses.normalized_mutual_information_loss
        >>> bool(loss(x, x) < loss(x, y))
        True
    """
    op = "normalized_mutual_information_loss"
    return _loss(op, 1, input, target, input_mask, target_mask, kernel_function, num_bins, window_radius, True)


def normalized_mutual_information_loss_2d(
    input: Tensor,
    target: Tensor,
    input_mask: Tensor | None = None,
    target_mask: Tensor | None = None,
    kernel_function: MIKernel = MIKernel.xu,
    num_bins: int = 64,
    window_radius: float = 1.0,
) -> Tensor:
    """Compute -(H(a) + H(b)) / H(a, b) of two images, H as in :func:`mutual_information_loss`.

    Args:
        input: images (*, H, W), floating point.
        target: images in the same shape.
        input_mask: which samples of input count (H, W), bool or uint8; None for all.
        target_mask: the same for target.
        kernel_function: how much a value adds to a bin.
        num_bins: how many bins, at least 2.
        window_radius: in bins, above 0.

    Returns:
        (*), in the type of target.

    Raises:
        TypeCheckError, ShapeError, ValueCheckError, DeviceError: as :func:`mutual_information_loss`.

    Example:
        >>> import torch, kvision as K
        >>> x, y = torch.rand(2, 20, 50)
        >>> loss = K.losses.normalized_mutual_information_loss_2d
        >>> bool(loss(x, x) < loss(x, y))
        True
    """
    op = "normalized_mutual_information_loss_2d"
    return _loss(op, 2, input, target, input_mask, target_mask, kernel_function, num_bins, window_radius, True)


def normalized_mutual_information_loss_3d(
    input: Tensor,
    target: Tensor,
    input_mask: Tensor | None = None,
    target_mask: Tensor | None = None,
    kernel_function: MIKernel = MIKernel.xu,
    num_bins: int = 64,
    window_radius: float = 1.0,
) -> Tensor:
    """Compute -(H(a) + H(b)) / H(a, b) of two volumes, H as in :func:`mutual_information_loss`.

    Args:
        input: volumes (*, D, H, W), floating point.
        target: volumes in the same shape.
        input_mask: which samples of input count (D, H, W), bool or uint8; None for all.
        target_mask: the same for target.
        kernel_function: how much a value adds to a bin.
        num_bins: how many bins, at least 2.
        window_radius: in bins, above 0.

    Returns:
        (*), in the type of target.

    Raises:
        TypeCheckError, ShapeError, ValueCheckError, DeviceError: as :func:`mutual_information_loss`.

    Example:
        >>> import torch, kvision as K
        >>> x, y = torch.rand(2, 4, 5, 50)
        >>> loss = K.losses.normalized_mutual_information_loss_3d
        >>> bool(loss(x, x) < loss(x, y))
        True
    """
    op = "normalized_mutual_information_loss_3d"
    return _loss(op, 3, input, target, input_mask, target_mask, kernel_function, num_bins, window_radius, True)


class MILossFromRef(_FromRef):
    """Module form of :func:`mutual_information_loss` that keeps its target: a call takes the input and its mask.

    Example:
        >>> import torch, kvision as K
        >>> x, y = torch.rand(2, 1000)
        >>> bool(K.losses.MILossFromRef(x)(x) == K.losses.mutual_information_loss(x, x))
        True
    """


class MILossFromRef2D(_FromRef):
    """Module form of :func:`mutual_information_loss_2d` that keeps its target: a call takes the input and its mask.

    Example:
        >>> import torch, kvision as K
        >>> x, y = torch.rand(2, 20, 50)
        >>> bool(K.losses.MILossFromRef2D(x)(x) == K.losses.mutual_information_loss_2d(x, x))
        True
    """

    _axes = 2


class MILossFromRef3D(_FromRef):
    """Module form of :func:`mutual_information_loss_3d` that keeps its target: a call takes the input and its mask.

    Example:
        >>> import torch, kvision as K
        >>> x, y = torch.rand(2, 4, 5, 50)
        >>> bool(K.losses.MILossFromRef3D(x)(x) == K.losses.mutual_information_loss_3d(x, x))
        True
    """

    _axes = 3


class NMILossFromRef(_FromRef):
    """Module form of :func:`normalized_mutual_information_loss` that keeps its target: a call takes the input and its mask.

    Example:
        >>> import torch, kvision as K
        >>> x, y = torch.rand(2, 1000)
        >>> bool(K.losses.NMILossFromRef(x)(x) == K.losses.normalized_mutual_information_loss(x, x))
        True
    """

    _normalized = True


class NMILossFromRef2D(_FromRef):
    """Module form of :func:`normalized_mutual_information_loss_2d` that keeps its target: a call takes the input and its mask.

    Example:
        >>> import torch, kvision as K
        >>> x, y = torch.rand(2, 20, 50)
        >>> bool(K.losses.NMILossFromRef2D(x)(x) == K.losses.normalized_mutual_information_loss_2d(x, x))
        True
    """

    _axes = 2
    _normalized = True


class NMILossFromRef3D(_FromRef):
    """Module form of :func:`normalized_mutual_information_loss_3d` that keeps its target: a call takes the input and its mask.

    Example:
        >>> import torch, kvision as K
        >>> x, y = torch.rand(2, 4, 5, 50)
        >>> bool(K.losses.NMILossFromRef3D(x)(x) == K.losses.normalized_mutual_information_loss_3d(x, x))
        True
    """

    _axes = 3
    _normalized = True
