"""Weighted sum of two images."""

from __future__ import annotations

from torch import Tensor

from kvision import _check
from kvision._dtype import compute_dtype, floats
from kvision._modules import FunctionModule
from kvision.core.exceptions import ShapeError
from kvision.enhance.batch import as_batch, broadcast, check_broadcast, shaped
from kvision.enhance.brightness import line


def add_weighted(
    src1: Tensor, alpha: float | Tensor, src2: Tensor, beta: float | Tensor, gamma: float | Tensor
) -> Tensor:
    """Mix two images: src1 * alpha + src2 * beta + gamma.

    Args:
        src1: an image of any shape; integers are computed in float32.
        alpha: a number, or a tensor that broadcasts to src1 as torch does: from the last axis, so that one weight a
            sample is (B, 1, 1, 1).
        src2: an image of the same shape.
        beta: of the same kinds as alpha.
        gamma: of the same kinds as alpha.

    Returns:
        The mix, not clamped, in the type of src1; differentiable in all five.

    Raises:
        TypeCheckError: an image is no real tensor; a weight is neither number nor tensor.
        ShapeError: src1 and src2 differ in shape; a weight does not broadcast to them.
        DeviceError: tensors on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.add_weighted(torch.ones(2), 0.5, torch.tensor([0.0, 1.0]), 0.25, 1.0)
        tensor([1.5000, 1.7500])
    """
    _check.numbers("add_weighted", "src1", src1)
    _check.numbers("add_weighted", "src2", src2)
    _check.same_device("add_weighted", src1=src1, src2=src2)
    if src1.shape != src2.shape:
        raise ShapeError(
            f"add_weighted: expected src2 of the shape of src1, {tuple(src1.shape)}, got {tuple(src2.shape)}",
            actual_shape=src2.shape,
            expected_shape=src1.shape,
        )
    a, b, c = (_weight(n, w, src1) for n, w in (("alpha", alpha), ("beta", beta), ("gamma", gamma)))
    x = floats(src1)
    a, c = (broadcast(w, x) if isinstance(w, Tensor) else w for w in (a, c))
    first = shaped(line(as_batch(x.to(compute_dtype(x))), a, c, False), x)
    second = src2.to(first.dtype)
    return (first + second * b if isinstance(b, Tensor) else first.add(second, alpha=b)).to(x.dtype)


def _weight(name: str, weight: float | Tensor, x: Tensor) -> float | Tensor:
    if not isinstance(weight, Tensor):
        return _check.number("add_weighted", name, weight)
    check_broadcast("add_weighted", name, weight, x)
    return weight


class AddWeighted(FunctionModule):
    """Module form of :func:`add_weighted`; a weight that is an nn.Parameter is learnt.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.AddWeighted(0.5, 0.5, 0.0)(torch.ones(2), torch.zeros(2))
        tensor([0.5000, 0.5000])
    """

    def __init__(self, alpha: float | Tensor, beta: float | Tensor, gamma: float | Tensor) -> None:
        super().__init__(alpha=alpha, beta=beta, gamma=gamma)

    def forward(self, src1: Tensor, src2: Tensor) -> Tensor:
        return add_weighted(src1, self.alpha, src2, self.beta, self.gamma)
