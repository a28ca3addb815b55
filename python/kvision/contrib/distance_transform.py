"""Distance transforms: the distance to the nearest pixel of a mask."""

from __future__ import annotations

import math
from itertools import product
from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision._clamp import clamp
from kvision._dtype import floats
from kvision._modules import FunctionModule
from kvision._ops import is_compiling, register, wants_derivative, with_kernel_casts
from kvision._torch_compat import in_onnx_export, largest
from kvision.core.exceptions import ShapeError, ValueCheckError
from kvision.filters.filter2d import filter2d
from kvision.filters.filter3d import filter3d


def distance_transform(image: Tensor, kernel_size: int = 3, h: float = 0.35, exact: bool = False) -> Tensor:
    """Compute the distance of every pixel to the nearest 1.

    By default distances are approximate and differentiable: masks grow step by step, by kernel_size // 2 pixels, and
    within a step the distance is -h log of the mask blurred with exp(-distance / h).

    Args:
        image: masks (B, C, H, W) or (B, C, D, H, W), 1 at the sources and 0 elsewhere. Integers are computed in
            float32.
        kernel_size: window of a step, odd and at least 3.
        h: how soft it is: small is closer to the true distance, too small is not precise.
        exact: compute the Euclidean distance instead, which has no gradient; infinity where there is no source.

    Returns:
        Pixels, in the shape of the image. Where the approximation reaches no source it is 0.

    Raises:
        TypeCheckError: image is not a real tensor; arguments of the wrong type.
        ShapeError: image of another rank.
        ValueCheckError: an even or too small kernel_size; an h that is not above 0, too small or too large for it.

    Source: D. Pham et al., "Differentiable distance transform" (2021); P. Felzenszwalb, D. Huttenlocher, "Distance
    transforms of sampled functions" (2012).

    Example:
        >>> import torch, kvision as K
        >>> x = torch.tensor([[[[1., 0., 0., 0.]]]])
        >>> K.contrib.distance_transform(x, exact=True)
        tensor([[[[0., 1., 2., 3.]]]])
    """
    op = "distance_transform"
    _check.numbers(op, "image", image)
    image = floats(image)
    if image.dim() not in (4, 5) or 0 in image.shape[2:]:
        raise ShapeError(
            f"{op}: expected image of shape (B, C, H, W) or (B, C, D, H, W) with pixels, got {tuple(image.shape)}",
            actual_shape=image.shape,
        )
    (size,) = _check.ints(op, "kernel_size", kernel_size, 1, 3)
    _check.odd(op, "kernel_size", (size,))
    h = _check.number(op, "h", h)
    _check.flag(op, "exact", exact)
    if exact:
        return _exact(image.detach())
    axes = image.dim() - 2
    distances = [math.hypot(*offset) for offset in product(range(-(size // 2), size // 2 + 1), repeat=axes)]
    if not h > 0 or math.exp(-max(distances) / h) < torch.finfo(torch.float32).tiny:
        raise ValueCheckError(f"{op}: expected h to be larger for a kernel_size of {size}, got {h!r}", actual_value=h)
    if sum(math.exp(-d / h) for d in distances) - 1 > 0.999:  # else sources all around would give distance 0
        raise ValueCheckError(f"{op}: expected h to be smaller for a kernel_size of {size}, got {h!r}", actual_value=h)
    return _approximate(image, size, h)


def _grow(
    grown: Tensor, total: Tensor, kernel: Tensor, distance: float | Tensor, scale: float | Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """A step: the grown masks, the distances, and the pixels that are reached, at scale * log(blurred) from the mask before."""
    blur = filter2d if grown.dim() == 4 else filter3d
    near = blur(grown, kernel, "replicate")
    reached = (near > 0) & (near < 1)
    within = scale * torch.where(reached, near, 0.5).log()
    return torch.where(reached, 1, grown), total + torch.where(reached, distance + within, 0), reached


def _step_reference(grown: Tensor, total: Tensor, kernel: Tensor, distance: float, h: float) -> tuple[Tensor, Tensor]:
    return _grow(grown, total, kernel, distance, -h)[:2]


def _fake(grown: Tensor, *_: Any) -> list[Tensor]:
    return [torch.empty_like(grown, memory_format=torch.contiguous_format) for _ in range(2)]


_step = register("distance_transform_step", _step_reference, fake=_fake)

_SMALL = 7  # windows that the kernel, which reads each pixel of a window from memory, takes


@with_kernel_casts
def _approximate(x: Tensor, size: int, h: float) -> Tensor:
    squares = (torch.arange(size, dtype=x.dtype, device=x.device) - size // 2) ** 2
    coords = torch.meshgrid(*[squares] * (x.dim() - 2), indexing="ij")
    kernel = (sum(coords[1:], coords[0]).sqrt() / -h).exp()[None]
    radius, scale = size // 2, x.new_full((), -h)  # a tensor, because loops of graphs take no symbolic floats

    def advance(
        step: int | Tensor, grown: Tensor, total: Tensor, _: Tensor
    ) -> tuple[int | Tensor, Tensor, Tensor, Tensor]:
        grown, total, reached = _grow(grown, total, kernel, step * radius, scale)
        return step + 1, grown, total, reached.any()  # where none is, later steps reach none

    sides = x.shape[2:]
    grown = clamp(x, 0, 1).contiguous()
    total = torch.zeros_like(grown)
    changed = torch.ones((), dtype=torch.bool, device=x.device)
    # ONNX gets no loop: its body is traced as if it were for torch.
    if is_compiling() and not in_onnx_export() and not wants_derivative(x):
        # A graph has loops of its own, whose length depends on sizes. Their gradients are wrong in torch 2.13, and torch.func
        # does not take them.
        steps = (largest(*sides) + radius - 1) // radius
        state = torch.zeros((), dtype=torch.int64, device=x.device), grown, total, changed
        return torch.while_loop(lambda step, *state: (step < steps) & state[-1], advance, state)[2]
    has_kernel = size <= _SMALL and not is_compiling() and not wants_derivative(x)
    for step in range(math.ceil(max(sides) / radius)):
        before = total  # in which every pixel that is reached changes
        if has_kernel:
            grown, total = _step(grown, total, kernel, float(step * radius), h)
        else:
            _, grown, total, changed = advance(step, grown, total, changed)
        # Each read waits for the GPU, so there it is read after 1, 2, 4, ... steps: at most twice the steps are computed.
        is_due = not x.is_cuda or (step & (step + 1)) == 0
        if is_due and _check.values_are_readable(x, may_wait=True):
            if torch.equal(before, total) if has_kernel else not changed:
                break
    return total


def _exact_reference(x: Tensor) -> Tensor:
    """The squared distance, axis by axis: each step is a lower envelope of parabolas on the previous result."""
    squared = torch.where(x == 1, torch.zeros_like(x), torch.inf)
    for axis in range(2, x.dim()):
        n, below = x.shape[axis], squared
        for d in range(1, n):
            nearer = below.narrow(axis, 0, n - d) + d * d, below.narrow(axis, d, n - d) + d * d
            far = torch.full_like(below.narrow(axis, 0, d), torch.inf)
            squared = torch.minimum(squared, torch.cat([far, nearer[0]], axis))
            squared = torch.minimum(squared, torch.cat([nearer[1], far], axis))
    return squared.sqrt()


def _exact_supports(x: Tensor) -> str | None:
    """Sides are below 32768, and their squares add up to less than 2^31."""
    sides = x.shape[2:]
    if max(sides) < 32768 and sum(n * n for n in sides) < 1 << 31:
        return None
    return f"sides of {tuple(sides)} are too large for distances in 32 bits"


_exact_kernel = register(
    "distance_transform_exact",
    _exact_reference,
    fake=lambda x: torch.empty_like(x, memory_format=torch.contiguous_format),
    non_differentiable=(0,),
    supports=_exact_supports,
)


@with_kernel_casts
def _exact(x: Tensor) -> Tensor:
    return _exact_kernel(x)


class DistanceTransform(FunctionModule):
    """Module form of :func:`distance_transform`.

    Example:
        >>> import torch, kvision as K
        >>> K.contrib.DistanceTransform()(torch.eye(4)[None, None]).shape
        torch.Size([1, 1, 4, 4])
    """

    def __init__(self, kernel_size: int = 3, h: float = 0.35, exact: bool = False) -> None:
        super().__init__(kernel_size=kernel_size, h=h, exact=exact)

    def forward(self, image: Tensor) -> Tensor:
        return distance_transform(image, self.kernel_size, self.h, self.exact)
