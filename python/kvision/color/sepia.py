"""Sepia: the brown tone of old photographs."""

from __future__ import annotations

from torch import Tensor

from kvision import _check
from kvision._dtype import compute_dtype, floats
from kvision._leading import apply_on_batch
from kvision._modules import FunctionModule
from kvision.color.matrix import affine
from kvision.core.exceptions import ShapeError

SEPIA = (
    (0.393, 0.769, 0.189),
    (0.349, 0.686, 0.168),
    (0.272, 0.534, 0.131),
)


_toned = affine(SEPIA)


def _sepia(x: Tensor, rescale: bool, eps: float) -> Tensor:
    if not rescale:
        return _toned(x)
    y = _toned(x.to(compute_dtype(x)))
    return (y / (y.amax((1, 2, 3), keepdim=True) + eps)).to(x.dtype)


def sepia(input: Tensor, rescale: bool = True, eps: float = 1e-6) -> Tensor:
    """Tone images brown.

    Args:
        input: RGB images (*, 3, H, W) in [0, 1]. Integers are computed in float32, unscaled.
        rescale: divide each image by its largest value, so that this becomes 1; otherwise white gives 1.351, 1.203, 0.937.
        eps: added to the largest value.

    Returns:
        RGB images of the same shape.

    Raises:
        TypeCheckError: input is not a tensor, rescale not a bool, eps not a number.
        ShapeError: input is not (*, 3, H, W), or has no pixels.
        ValueCheckError: eps is negative.

    Example:
        >>> import torch, kvision as K
        >>> K.color.sepia(torch.ones(3, 1, 1)).flatten()
        tensor([1.0000, 0.8905, 0.6936])
        >>> K.color.sepia(torch.ones(3, 1, 1), rescale=False).flatten()
        tensor([1.3510, 1.2030, 0.9370])
    """
    _check.channels("sepia", "input", input, 3)
    if 0 in input.shape[-2:]:
        raise ShapeError(f"sepia: expected input with H, W of at least 1, got {tuple(input.shape)}")
    _check.flag("sepia", "rescale", rescale)
    eps = _check.number("sepia", "eps", eps, minimum=0)
    return apply_on_batch(_sepia, floats(input), rescale, eps)


class Sepia(FunctionModule):
    """Module form of :func:`sepia`.

    Example:
        >>> import torch, kvision as K
        >>> K.color.Sepia()(torch.rand(2, 3, 4, 5)).shape
        torch.Size([2, 3, 4, 5])
    """

    def __init__(self, rescale: bool = True, eps: float = 1e-6) -> None:
        super().__init__(rescale=rescale, eps=eps)

    def forward(self, input: Tensor) -> Tensor:
        return sepia(input, self.rescale, self.eps)
