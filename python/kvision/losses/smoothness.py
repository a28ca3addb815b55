"""Smoothness losses: differences of neighboring pixels."""

from __future__ import annotations

from typing import Literal, TypeAlias, get_args

import torch
from torch import Tensor
from torch.compiler import is_compiling

from kvision import _check
from kvision._dtype import as_dtype, compute_dtype, floats
from kvision._modules import IMAGE, PLANE, FunctionModule
from kvision._ops import register, vjp
from kvision.core.exceptions import ShapeError, TypeCheckError

SumOrMean: TypeAlias = Literal["sum", "mean"]
_REDUCTIONS = get_args(SumOrMean)


def _reference(x: Tensor, along_y: float, along_x: float) -> Tensor:
    """(B, C): the weighted sums of absolute differences of neighbors along y and along x, for every plane."""
    promoted = x.to(compute_dtype(x))
    return along_y * promoted.diff(dim=-2).abs().sum((-2, -1)) + along_x * promoted.diff(dim=-1).abs().sum((-2, -1))


def _fake(x: Tensor, *_: float) -> Tensor:
    return x.new_empty(x.shape[:2], dtype=compute_dtype(x))


register(
    "total_variation_backward",
    vjp(_reference),
    fake=lambda grad, x, *_: torch.empty_like(x, memory_format=torch.contiguous_format),
    casts_outputs=True,
)
_total_variation = register(
    "total_variation", _reference, fake=_fake, gradients="input: total_variation_backward", casts_outputs=True
)


def _roughness(depth: Tensor, image: Tensor, along_y: float, along_x: float) -> Tensor:
    """(B,): weighted sums of absolute differences of neighbors in depth (B, 1, H, W), reduced at edges of the image."""
    dtype = compute_dtype(image)
    depth, image = depth.to(dtype), image.to(dtype)

    def along(axis: int) -> Tensor:
        edges = image.diff(dim=axis).abs().mean(1, keepdim=True)
        return (depth.diff(dim=axis).abs() * (-edges).exp()).sum((1, 2, 3))

    return along_y * along(2) + along_x * along(3)


def _roughness_backward_reference(
    grad: Tensor, depth: Tensor, image: Tensor, along_y: float, along_x: float, of_image: bool
) -> Tensor:
    vjp_fn = torch.func.vjp(lambda d, x: _roughness(d, x, along_y, along_x), depth, image)[1]
    return vjp_fn(grad)[of_image]


register(
    "smoothness_backward",
    _roughness_backward_reference,
    fake=lambda grad, depth, image, *plain: torch.empty_like(
        image if plain[-1] else depth, memory_format=torch.contiguous_format
    ),
    casts_outputs=True,
)


def _supports(depth: Tensor, image: Tensor, *_: float) -> str | None:
    """Depth has one channel, and images have at least one element."""
    if depth.shape[1] != 1:
        return f"there is no kernel for {depth.shape[1]} maps of depth an image, only for one"
    return None if image.numel() else "there is no kernel for images without elements"


_smoothness = register(
    "smoothness",
    _roughness,
    fake=lambda depth, *_: depth.new_empty(depth.shape[:1], dtype=compute_dtype(depth)),
    gradients="depth: smoothness_backward(of_image=False); image: smoothness_backward(of_image=True)",
    casts_outputs=True,
    supports=_supports,
)


def total_variation(img: Tensor, reduction: SumOrMean = "sum") -> Tensor:
    """Compute the total variation of every plane: the sum of absolute differences of pixels adjacent along x or y.

    Args:
        img: (*, H, W); integers are computed in float32.
        reduction: 'sum', or 'mean' for the mean difference along x plus that along y.

    Returns:
        (*), a number for each plane.

    Raises:
        TypeCheckError: img is not a real tensor.
        ShapeError: img has less than two axes.
        ValueCheckError: an unknown reduction, which is a NotImplementedError, too.

    Example:
        >>> import torch, kvision as K
        >>> K.losses.total_variation(torch.tensor([[[0.0, 1.0], [0.0, 3.0]]]))
        tensor([6.])
    """
    _check.numbers("total_variation", "img", img)
    if img.dim() < 2:
        raise ShapeError(
            f"total_variation: expected img of shape (*, H, W), got {tuple(img.shape)}", actual_shape=img.shape
        )
    _check.reduction("total_variation", reduction, _REDUCTIONS)
    x = floats(img)
    h, w = x.shape[-2:]
    if h == 0 or w == 0:
        return x.sum((-2, -1))
    weights = (1.0, 1.0)
    if reduction == "mean":  # 0 if there are no differences
        weights = 1 / max(1, (h - 1) * w), 1 / max(1, h * (w - 1))
    if x.dim() == 4:
        sums = _total_variation(x, *weights)
    else:
        sums = _total_variation(x.reshape(1, -1, h, w), *weights).reshape(x.shape[:-2])
    return as_dtype(sums, x.dtype)


def inverse_depth_smoothness_loss(idepth: Tensor, image: Tensor) -> Tensor:
    """Compute the edge-aware smoothness loss of inverse depth maps: their gradients count less where the image has edges.

    It is the mean of abs(dx d) exp(-mean_c abs(dx I)), plus the same along y, with differences of neighbors.

    Args:
        idepth: inverse depth d (B, 1, H, W).
        image: image I (B, C, H, W), of the same type.

    Returns:
        A number.

    Raises:
        TypeCheckError: not two floating-point tensors of one type.
        ShapeError: not (B, C, H, W), or different B, H or W.
        DeviceError: the tensors are on different devices.

    Source: C. Godard et al., "Unsupervised monocular depth estimation with left-right consistency" (2017).

    Example:
        >>> import torch, kvision as K
        >>> d = torch.tensor([[[[0.0, 1.0, 2.0]]]])
        >>> K.losses.inverse_depth_smoothness_loss(d, torch.tensor([[[[0.0, 0.0, 100.0]]]]))
        tensor(0.5000)
    """
    op = "inverse_depth_smoothness_loss"
    for name, x in (("idepth", idepth), ("image", image)):
        _check.shape(op, name, x, "B", "C", "H", "W")
        _check.floating(op, name, x)
    if idepth.shape[0] != image.shape[0] or idepth.shape[2:] != image.shape[2:]:
        raise ShapeError(
            f"{op}: expected idepth with the B, H, W of image {tuple(image.shape)}, got {tuple(idepth.shape)}",
            actual_shape=idepth.shape,
        )
    if idepth.dtype != image.dtype:
        raise TypeCheckError(f"{op}: expected idepth and image of one type, got {idepth.dtype} and {image.dtype}")
    _check.same_device(op, idepth=idepth, image=image)
    b, maps, h, w = idepth.shape
    along_y, along_x = 1 / max(1, b * maps * (h - 1) * w), 1 / max(1, b * maps * h * (w - 1))
    if is_compiling():  # numbers of operators are constants of a program, and these depend on symbolic sizes
        sum_y, sum_x = (_smoothness(idepth, image, *weights).sum() for weights in ((1.0, 0.0), (0.0, 1.0)))
        return as_dtype(sum_y * along_y + sum_x * along_x, idepth.dtype)
    return as_dtype(_smoothness(idepth, image, along_y, along_x).sum(), idepth.dtype)


class TotalVariation(FunctionModule):
    """Module form of :func:`total_variation`.

    Example:
        >>> import torch, kvision as K
        >>> K.losses.TotalVariation()(torch.ones(2, 3, 4, 4)).shape
        torch.Size([2, 3])
    """

    def forward(self, img: Tensor) -> Tensor:
        return total_variation(img)


class InverseDepthSmoothnessLoss(FunctionModule):
    """Module form of :func:`inverse_depth_smoothness_loss`.

    Example:
        >>> import torch, kvision as K
        >>> K.losses.InverseDepthSmoothnessLoss()(torch.ones(1, 1, 4, 4), torch.rand(1, 3, 4, 4))
        tensor(0.)
    """

    samples = PLANE, IMAGE

    def forward(self, idepth: Tensor, image: Tensor) -> Tensor:
        return inverse_depth_smoothness_loss(idepth, image)
