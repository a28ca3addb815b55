"""Histograms as kernel density estimates: smooth counts, with gradients."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any, Literal, TypeAlias

import torch
from torch import Tensor

from kvision import _check
from kvision._clamp import clamp
from kvision._dtype import as_dtype, compute_dtype
from kvision._modes import HISTOGRAM_KERNEL, HISTOGRAM_KERNEL_NAMES
from kvision._ops import linearize, register, vjp
from kvision._torch_compat import in_function_transform, is_tracing
from kvision.core.exceptions import ShapeError, ValueCheckError

Kernel: TypeAlias = Literal["triangular", "gaussian", "uniform", "epanechnikov"]
_KERNELS: dict[str, Callable[[Tensor], Tensor]] = {
    "triangular": lambda u: clamp(1 - u, 0),
    "gaussian": lambda u: torch.exp(-0.5 * u * u),
    "uniform": lambda u: (u <= 1).to(u.dtype),
    "epanechnikov": lambda u: clamp(1 - u * u, 0),
}


Gradients = Callable[..., Sequence[Tensor | None]]


class _Recomputed(torch.autograd.Function):
    """`f(*tensors)`, recomputed in the backward pass, so that no intermediate result is stored.

    `gradients(needs, grad, *tensors)` may give the gradients by a shorter formula than autograd's.
    """

    generate_vmap_rule = True

    @staticmethod
    def forward(f: Callable[..., Tensor], gradients: Gradients | None, *tensors: Tensor) -> Tensor:
        return f(*tensors)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:
        ctx.f, ctx.gradients = inputs[:2]
        ctx.save_for_backward(*inputs[2:])
        ctx.save_for_forward(*inputs[2:])

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        if ctx.gradients is not None:
            return (None, None, *ctx.gradients(ctx.needs_input_grad[2:], grad, *ctx.saved_tensors))
        vjp_fn = torch.func.vjp(ctx.f, *ctx.saved_tensors)[1]
        return (None, None, *vjp_fn(grad))

    @staticmethod
    def jvp(ctx: Any, _: None, __: None, *tangents: Tensor | None) -> Tensor:
        tensors = ctx.saved_tensors
        jvp_fn = linearize(ctx.f, *tensors)[1]
        return jvp_fn(*(torch.zeros_like(x) if t is None else t for x, t in zip(tensors, tangents)))


def recomputed(f: Callable[..., Tensor], *tensors: Tensor, gradients: Gradients | None = None) -> Tensor:
    # torch.compile decides itself what to store, and cannot trace a Function with forward mode; torch.jit.trace saves none.
    return f(*tensors) if torch.compiler.is_compiling() or is_tracing() else _Recomputed.apply(f, gradients, *tensors)


def count_chunks(x: Tensor, bins: int) -> int:
    """The number of chunks of values (N, P). A chunk times the bins has at most the size of a few images.

    On a GPU, where each operator on a chunk is a launch, chunks have at least `_SMALL` numbers times bins. On a CPU small chunks
    stay in the caches.
    """
    chunks = min(x.shape[1], bins // 8)
    if x.is_cuda and not torch.compiler.is_compiling():  # a compiled graph keeps sizes symbolic
        chunks = min(chunks, -(-x.numel() * bins // _SMALL))
    return max(chunks, 1)


_SMALL = 1 << 23  # numbers, 32 MiB


def kernel_counts(x: Tensor, centers: Tensor, bandwidth: Tensor, kernel: Kernel) -> Tensor:
    """Sum the kernel at (x - center) / bandwidth over values (N, P) for centers (K,), to (N, K)."""
    centers, bandwidth = centers[None], bandwidth.reshape(1)
    if kernel == "gaussian":
        return _histogram(x, centers, bandwidth)
    return _counts_in_chunks(_KERNELS[kernel], x, centers, bandwidth)


def _counts_in_chunks(shape: Callable[[Tensor], Tensor], x: Tensor, centers: Tensor, bandwidth: Tensor) -> Tensor:
    """Compute kernel_counts with centers (N, K) or (1, K) and bandwidths (N,) or (1,)."""

    def counts(x: Tensor, centers: Tensor, bandwidth: Tensor) -> Tensor:
        return shape((x[:, None] - centers[..., None]).abs() / bandwidth[:, None, None]).sum(2)

    x = torch.where(x.isnan(), torch.finfo(x.dtype).max ** 0.5, x)  # out of reach of every center
    parts = x.chunk(count_chunks(x, centers.shape[1]), 1)
    return _total([recomputed(counts, part, centers, bandwidth) for part in parts])


def _reference(x: Tensor, centers: Tensor, bandwidth: Tensor) -> Tensor:
    return _counts_in_chunks(_KERNELS["gaussian"], x, centers, bandwidth)


register("histogram_backward", vjp(_reference), fake=lambda grad, x, *_: x.shape)


def _parameter_gradients(needs, grad, x, centers, bandwidth):
    """Those of centers and bandwidth, seldom learned, are computed in torch."""
    if torch.compiler.is_compiling() or in_function_transform():
        return _histogram.differentiate_reference(needs, grad, x, centers, bandwidth)
    return [None, *_parameter_grads(grad, x, centers, bandwidth)]


_CHUNK = 1 << 16  # samples times centers whose exponentials fit the caches of a CPU


def _parameter_grads(grad: Tensor, x: Tensor, centers: Tensor, bandwidth: Tensor) -> tuple[Tensor, Tensor]:
    """The gradients to centers and bandwidth: sums over samples of u g and u^2 g, g being the Gaussian of u times grad."""
    inverse = bandwidth[:, None].reciprocal()

    def sums(x: Tensor, grad: Tensor, centers: Tensor, inverse: Tensor) -> Tensor:
        u = (x[:, None] - centers[..., None]) * inverse[..., None]
        product = torch.exp(-0.5 * u * u) * u
        return torch.stack([product.sum(2), (product * u).sum(2)]) * grad

    x = torch.where(x.isnan(), torch.finfo(x.dtype).max ** 0.5, x)  # out of reach of every center
    if x.is_cpu:
        chunks = x.split(max(1, _CHUNK // max(1, x.shape[0] * centers.shape[1])), 1)
    else:
        chunks = x.chunk(count_chunks(x, centers.shape[1]), 1)
    first, second = _total([recomputed(sums, part, grad, centers, inverse) for part in chunks]) * inverse
    return first.sum_to_size(centers.shape), second.sum(1).sum_to_size(bandwidth.shape)


_histogram = register(
    "histogram",
    _reference,
    fake=lambda x, centers, _: (x.shape[0], centers.shape[1]),
    gradients="x: histogram_backward; centers, bandwidth: by_hand",
    backward=_parameter_gradients,
)


def _reference_normalize(counts: Tensor, eps: float) -> Tensor:
    """Divide each row of (N, K) by its sum plus `eps`."""
    counts = counts.contiguous()  # torch adds numbers of other strides in another order
    return counts / (counts.sum(1, keepdim=True) + eps)


register("normalize_counts_backward", vjp(_reference_normalize))
_normalize_counts = register("normalize_counts", _reference_normalize, gradients="counts: normalize_counts_backward")


def joint_counts(x1: Tensor, x2: Tensor, bins: Tensor, bandwidth: Tensor) -> Tensor:
    """Sum the products of two Gaussians over pairs of values (N, P) for bins (K,), to (N, K, K)."""
    gaussian = _KERNELS["gaussian"]

    def counts(x1: Tensor, x2: Tensor, bins: Tensor, bandwidth: Tensor) -> Tensor:
        products = []
        for pair in zip(_short_rows(x1), _short_rows(x2)):
            k1, k2 = (gaussian((x[:, :, None] - bins[:, None]) / bandwidth) for x in pair)
            products.append((k1 @ k2.mT).sum(1))
        return _total(products)

    n = count_chunks(x1, bins.shape[0])
    pairs = zip(x1.chunk(n, 1), x2.chunk(n, 1))
    return _total([recomputed(counts, a, b, bins, bandwidth, gradients=_joint_gradients) for a, b in pairs])


def _joint_gradients(
    needs: Sequence[bool], grad: Tensor, x1: Tensor, x2: Tensor, bins: Tensor, bandwidth: Tensor
) -> list[Tensor | None]:
    """The gradients of joint_counts for samples (N, P): autograd would pass over (N, K, P) twice as often."""
    distances = [(x[:, None] - bins[:, None]) / bandwidth for x in (x1, x2)]  # (N, K, P)
    weights = [_KERNELS["gaussian"](u) for u in distances]
    grad_bins, grad_bandwidth = None, None
    grads: list[Tensor | None] = [None, None]
    of_weights = (grad, weights[1]), (grad.mT, weights[0])
    for i, (u, weight, (matrix, other)) in enumerate(zip(distances, weights, of_weights)):
        if not (needs[i] or needs[2] or needs[3]):
            continue
        of_distance = (matrix @ other) * weight * u  # with the opposite sign
        if needs[i]:
            grads[i] = of_distance.sum(1) / -bandwidth
        if needs[2]:
            part = of_distance.sum((0, 2))
            grad_bins = part if grad_bins is None else grad_bins + part
        if needs[3]:
            part = (of_distance * u).sum()
            grad_bandwidth = part if grad_bandwidth is None else grad_bandwidth + part
    return [*grads, *(None if g is None else g / bandwidth for g in (grad_bins, grad_bandwidth))]


_SHORT = 256  # samples


def _short_rows(x: Tensor) -> list[Tensor]:
    """Split (N, P) into (N, P / 256, 256) and the remainder (N, 1, P % 256).

    Libraries compute one product of long thin matrices with few threads, and a batch of short ones with many.
    """
    if torch.compiler.is_compiling() or is_tracing():  # graphs keep sizes symbolic
        return [x[:, None]]
    count, rest = divmod(x.shape[1], _SHORT)
    rows = [x[:, : count * _SHORT].unflatten(1, (count, _SHORT))] if count else []
    return [*rows, x[:, None, count * _SHORT :]] if rest else rows


def _total(parts: Sequence[Tensor]) -> Tensor:
    return functools.reduce(torch.add, parts)


def _reference_grid(x: Tensor, low: float, width: float, bins: int, kernel: int) -> Tensor:
    """Compute kernel_counts of (N, P) for centers one bandwidth apart and a kernel that is 0 beyond one bandwidth:
    a value adds to at most three bins."""
    shape = _KERNELS[HISTOGRAM_KERNEL_NAMES[kernel]]
    near = ((x.detach() - low) / width - 0.5).round()
    counts = torch.zeros_like(x[:, :1]).expand(-1, bins)
    for offset in (-1, 0, 1):
        bin = near + offset
        u = (x - (low + width * (bin + 0.5))).abs() / width
        counted = (u <= 1) & (bin >= 0) & (bin < bins)  # not NaN
        weight = torch.where(counted, shape(torch.where(counted, u, 1)), 0)
        counts = counts.scatter_add(1, torch.where(counted, bin, 0).long(), weight)
    return counts


register("image_histogram2d_backward", vjp(_reference_grid), fake=lambda grad, x, *_: x.shape)
_image_histogram2d = register(
    "image_histogram2d",
    _reference_grid,
    fake=lambda x, low, width, bins, kernel: (x.shape[0], bins),
    gradients="x: image_histogram2d_backward",
)


def histogram(x: Tensor, bins: Tensor, bandwidth: Tensor, epsilon: float = 1e-10) -> Tensor:
    """Estimate the density of values at the centers `bins`, with a Gaussian kernel.

    Args:
        x: samples (B, D).
        bins: the points (K,).
        bandwidth: standard deviation of the kernel, a tensor without axes, positive, or a number.
        epsilon: added to the sum that the result is divided by.

    Returns:
        (B, K), each row of sum 1; differentiable in x, bins and bandwidth. Memory grows with the samples, not with
        samples times bins. Half types are computed in float32.

    Raises:
        TypeCheckError: x or bins is not a real tensor, bandwidth neither tensor nor number.
        ShapeError: x is not (B, D) with at least one sample, bins is not (K,), bandwidth has axes.
        DeviceError: the tensors are on different devices; parameters in CPU memory are moved.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.histogram(torch.tensor([[0.0, 1.0, 1.0]]), torch.tensor([0.0, 1.0]), torch.tensor(0.1))
        tensor([[0.3333, 0.6667]])
    """
    _check.shape("histogram", "x", x, "B", "D")
    promoted, centers, width, dtype = _arguments("histogram", x, bins, bandwidth)
    epsilon = _check.number("histogram", "epsilon", epsilon, minimum=0)
    counts = kernel_counts(promoted, centers, width, "gaussian")
    return _normalize_counts(counts, epsilon * x.shape[1]).to(dtype)  # epsilon goes with counts divided by D


def histogram2d(x1: Tensor, x2: Tensor, bins: Tensor, bandwidth: Tensor, epsilon: float = 1e-10) -> Tensor:
    """Estimate the joint density of pairs of values on the grid of the centers `bins`, with a Gaussian kernel.

    Args:
        x1: the first values of the samples (B, D).
        x2: the second values (B, D).
        bins: the points along both axes (K,).
        bandwidth: standard deviation of the kernel, a tensor without axes, positive, or a number.
        epsilon: added to the sum that the result is divided by.

    Returns:
        (B, K, K), rows for x1 and columns for x2, each matrix of sum 1; differentiable in all four tensors. Memory is as
        for :func:`histogram`.

    Raises:
        TypeCheckError, DeviceError: as :func:`histogram`.
        ShapeError: as :func:`histogram`, or x1 and x2 of different shapes.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.tensor([[0.0, 1.0]])
        >>> K.enhance.histogram2d(x, 1 - x, torch.tensor([0.0, 1.0]), torch.tensor(0.5))
        tensor([[[0.1050, 0.3950],
                 [0.3950, 0.1050]]])
    """
    _check.shape("histogram2d", "x1", x1, "B", "D")
    _check.shape("histogram2d", "x2", x2, *x1.shape)
    _check.same_device("histogram2d", x1=x1, x2=x2)
    promoted, centers, width, dtype = _arguments("histogram2d", x1, bins, bandwidth)
    epsilon = _check.number("histogram2d", "epsilon", epsilon, minimum=0)
    with torch.autocast(x1.device.type, enabled=False):
        counts = joint_counts(promoted, x2.to(promoted.dtype), centers, width)
    return _normalize_counts(counts.flatten(1), epsilon).view_as(counts).to(dtype)


def _arguments(op: str, x: Tensor, bins: Tensor, bandwidth: Tensor) -> tuple[Tensor, Tensor, Tensor, torch.dtype]:
    """Samples, bins and bandwidth in the computing type, and the type of the result."""
    _check.shape(op, "bins", bins, "K")
    if not isinstance(bandwidth, Tensor):
        bandwidth = torch.full((), _check.number(op, "bandwidth", bandwidth), device=x.device)
    _check.shape(op, "bandwidth", bandwidth)
    bins, bandwidth = (_check.to_device_of(op, x, n, p, of="x") for n, p in (("bins", bins), ("bandwidth", bandwidth)))
    if x.shape[1] == 0:
        raise ShapeError(f"{op}: expected at least one sample, got {tuple(x.shape)}", actual_shape=x.shape)
    dtype = torch.promote_types(x.dtype, bins.dtype)
    dtype = dtype if dtype.is_floating_point else torch.float32
    computes = torch.float64 if dtype == torch.float64 else torch.float32
    return x.to(computes), bins.to(computes), bandwidth.to(computes), dtype


def image_histogram2d(
    image: Tensor,
    min: float = 0.0,
    max: float = 255.0,
    n_bins: int = 256,
    bandwidth: float | None = None,
    centers: Tensor | None = None,
    return_pdf: bool = False,
    kernel: Kernel = "triangular",
    eps: float = 1e-10,
) -> tuple[Tensor, Tensor]:
    """Count the values of every image plane with a smooth kernel.

    Args:
        image: (H, W), (C, H, W) or (B, C, H, W). NaN does not count.
        min: where the first bin begins.
        max: where the last bin ends; sets the bandwidth.
        n_bins: number of bins.
        bandwidth: where the kernel has fallen to 0, or the standard deviation of a Gaussian one; by default (or -1) the
            width of a bin, (max - min) / n_bins.
        centers: centers of the bins (n_bins,); by default min + (i + 0.5) * bandwidth. With them min, max and n_bins
            count for the bandwidth only.
        return_pdf: give the densities as well.
        kernel: 'triangular', 'gaussian', 'uniform' or 'epanechnikov', of height 1.
        eps: added to the sum that the densities are divided by.

    Returns:
        Counts and densities, (n_bins,), (C, n_bins) or (B, C, n_bins), differentiable in image and centers, in float32,
        or in float64 for float64 images. Densities are zeros unless asked for.

    Raises:
        TypeCheckError: image is not a real tensor; an argument is of the wrong type.
        ShapeError: image has another rank or no pixels; centers is not (n_bins,).
        ValueCheckError: max not above min, n_bins below 1, bandwidth not positive, an unknown kernel.
        DeviceError: the tensors are on different devices; parameters in CPU memory are moved.

    Example:
        >>> import torch, kvision as K
        >>> counts, _ = K.enhance.image_histogram2d(torch.tensor([[0.5, 1.5, 1.5]]), 0.0, 3.0, 3)
        >>> counts
        tensor([1., 2., 0.])
    """
    op = "image_histogram2d"
    _check.numbers(op, "image", image)
    if not 2 <= image.dim() <= 4 or 0 in image.shape[-2:]:
        raise ShapeError(
            f"{op}: expected image of shape (B, C, H, W), got {tuple(image.shape)}", actual_shape=image.shape
        )
    low, high = _check.number(op, "min", min), _check.number(op, "max", max)
    (n_bins,) = _check.ints(op, "n_bins", n_bins, 1)
    _check.choice(op, "kernel", kernel, tuple(_KERNELS))
    _check.flag(op, "return_pdf", return_pdf)
    eps = _check.number(op, "eps", eps, minimum=0)
    if not low < high:
        raise ValueCheckError(f"{op}: expected max above min, got {max!r} and {min!r}")
    width = -1.0 if bandwidth is None else _check.number(op, "bandwidth", bandwidth)
    if width == -1:
        width = (high - low) / n_bins
    if not 0 < width < float("inf"):
        raise ValueCheckError(f"{op}: expected a bandwidth above 0, got {width!r}", actual_value=width)

    dtype = compute_dtype(image)
    x = as_dtype(image, dtype).reshape(math.prod(image.shape[:-2]), image.shape[-2] * image.shape[-1])
    if centers is not None:
        _check.shape(op, "centers", centers, "n_bins")
        centers = _check.to_device_of(op, image, "centers", centers, of="image")
        counts = kernel_counts(x, centers.to(dtype), x.new_full((), width), kernel)
    elif kernel == "gaussian":
        middles = low + width * (torch.arange(n_bins, device=x.device, dtype=dtype) + 0.5)
        counts = kernel_counts(x, middles, x.new_full((), width), kernel)
    else:
        counts = _image_histogram2d(x, low, width, n_bins, HISTOGRAM_KERNEL[kernel])
    densities = _normalize_counts(counts, eps) if return_pdf else torch.zeros_like(counts)
    shape = (*image.shape[:-2], counts.shape[1])
    return counts.reshape(shape), densities.reshape(shape)
