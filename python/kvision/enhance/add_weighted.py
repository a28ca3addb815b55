"""Weighted sum of two images."""

from __future__ import annotations

from torch import Tensor

from kvision import _check
from kvision._dtype import compute_dtype, floats
from kvision._modules import IMAGE, FunctionModule
from kvision._ops import register, with_kernel_casts
from kvision.color.scale_shift import scale_shift
from kvision.core.exceptions import ShapeError
from kvision.enhance.batch import as_batch, broadcast, broadcastable, shaped


def _reference(
    x: Tensor,
    y: Tensor,
    alpha: Tensor | None,
    beta: Tensor | None,
    gamma: Tensor | None,
    a: float,
    b: float,
    c: float,
) -> Tensor:
    """Images (B, C, H, W) with weights (B or 1, C or 1, 1); a weight that is None is replaced by its number."""
    return _mixed(x, y, *(n if w is None else w[..., None] for w, n in ((alpha, a), (beta, b), (gamma, c))))


def _mixed(x: Tensor, y: Tensor, alpha: float | Tensor, beta: float | Tensor, gamma: float | Tensor) -> Tensor:
    return x * alpha + y * beta + gamma


def _backward(needs, grad, x, y, alpha, beta, gamma, a, b, c):
    def of_weight(weight: Tensor, image: Tensor | None) -> Tensor:
        promoted = grad.to(weight.dtype)
        pixels = promoted if image is None else promoted * image
        return pixels.sum((2, 3))[..., None].sum_to_size(weight.shape)

    def scaled(number: float, weight: Tensor | None) -> Tensor:
        return grad * number if weight is None else scale_shift(grad, weight, 0.0, False)

    return [
        scaled(a, alpha) if needs[0] else None,
        scaled(b, beta).sum_to_size(y.shape) if needs[1] else None,
        of_weight(alpha, x) if needs[2] else None,
        of_weight(beta, y) if needs[3] else None,
        of_weight(gamma, None) if needs[4] else None,
    ]


_add_weighted = register("add_weighted", _reference, backward=_backward)
_composed = with_kernel_casts(_mixed)  # weights of single pixels, images of two types or without pixels


def add_weighted(
    src1: Tensor, alpha: float | Tensor, src2: Tensor, beta: float | Tensor, gamma: float | Tensor
) -> Tensor:
    """Add two images with weights: src1 * alpha + src2 * beta + gamma.

    Args:
        src1: an image of any shape; integers are computed in float32.
        alpha: a number, or a tensor that broadcasts to src1 as torch does: from the last axis, so that one weight a
            sample is (B, 1, 1, 1).
        src2: an image of the same shape.
        beta: of the same kinds as alpha.
        gamma: of the same kinds as alpha.

    Returns:
        The weighted sum, not clamped, in the type of src1; differentiable in all five arguments.

    Raises:
        TypeCheckError: an image is not a real tensor; a weight is neither number nor tensor.
        ShapeError: src1 and src2 differ in shape; a weight does not broadcast to them.
        DeviceError: the tensors are on different devices; parameters in CPU memory are moved.

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
    weights = [_weight(n, w, src1) for n, w in (("alpha", alpha), ("beta", beta), ("gamma", gamma))]
    x, y = floats(src1), floats(src2)
    rows = [broadcast(w, x) if isinstance(w, Tensor) else w for w in weights]
    if 0 in x.shape or x.dtype != y.dtype or any(isinstance(w, Tensor) and w.dim() > 3 for w in rows):
        return _composed(x, y, *weights)
    tensors = [w.to(compute_dtype(x)) if isinstance(w, Tensor) else None for w in rows]
    numbers = [0.0 if isinstance(w, Tensor) else w for w in rows]
    return shaped(_add_weighted(as_batch(x), as_batch(y), *tensors, *numbers), x)


def _weight(name: str, weight: float | Tensor, x: Tensor) -> float | Tensor:
    if not isinstance(weight, Tensor):
        return _check.number("add_weighted", name, weight)
    return broadcastable("add_weighted", name, weight, x)


class AddWeighted(FunctionModule):
    """Module form of :func:`add_weighted`; a weight that is an nn.Parameter is learned.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.AddWeighted(0.5, 0.5, 0.0)(torch.ones(2), torch.zeros(2))
        tensor([0.5000, 0.5000])
    """

    samples = IMAGE, IMAGE

    def __init__(self, alpha: float | Tensor, beta: float | Tensor, gamma: float | Tensor) -> None:
        super().__init__(alpha=alpha, beta=beta, gamma=gamma)

    def forward(self, src1: Tensor, src2: Tensor) -> Tensor:
        return add_weighted(src1, self.alpha, src2, self.beta, self.gamma)
