"""Rotation, translation, scale and shear of images."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor
from torch.compiler import is_compiling

from kvision import _check
from kvision._choices import Interpolation, PaddingOrFill
from kvision._dtype import compute_dtype
from kvision._modes import INTERPOLATION, WARP_FORMULA
from kvision._modules import FunctionModule
from kvision.core.exceptions import ShapeError, TypeCheckError
from kvision.geometry.transform import sampling
from kvision.geometry.transform.antialiased.warp_antialiased import check_antialias, warp_antialiased_by_formula
from kvision.geometry.transform.nearest import as_values, of_values

__all__ = ["Affine", "Rotate", "Scale", "Shear", "Translate", "affine", "rotate", "scale", "shear", "translate"]


def affine(
    tensor: Tensor,
    matrix: Tensor,
    mode: Interpolation = "bilinear",
    padding_mode: PaddingOrFill = "zeros",
    align_corners: bool = True,
) -> Tensor:
    """Warp images by affine maps, keeping their size.

    Args:
        tensor: images (B, C, H, W) or (C, H, W), floating point or uint8. Other integers are computed in float32,
            but nearest modes keep them.
        matrix: (B, 2, 3), or (1, 2, 3) for all images: image pixels (x, y) to result pixels. One image serves many matrices.
        mode: 'bilinear', 'nearest' or 'bicubic'.
        padding_mode: 'zeros', 'border' or 'reflection'.
        align_corners: mirror at the centers of the outermost pixels, not at their edges. Only 'reflection' uses it.

    Returns:
        Images of the shape and dtype of `tensor`, one for each matrix.

    Raises:
        TypeError: `tensor` or `matrix` is not a tensor of real numbers; `align_corners` is not a bool.
        ValueError: `tensor` is not (B, C, H, W) or (C, H, W), or H or W is 0; `matrix` is not (B, 2, 3) or (1, 2, 3);
            `mode` or `padding_mode` is unknown; the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> right = torch.tensor([[[1.0, 0, 1], [0, 1, 0]]])
        >>> K.geometry.affine(torch.arange(3.0).reshape(1, 1, 3), right)
        tensor([[[0., 0., 1.]]])
    """
    images = _images("affine", tensor)
    _check.shape("affine", "matrix", matrix, "B", 2, 3)
    sampling.check_options("affine", mode, padding_mode, align_corners)
    matrix = sampling.cast_to_image("affine", images, "matrix", matrix, sampling.count_samples(images, matrix))
    padding, _ = sampling.padding_and_fill("affine", images, padding_mode, None)
    options = (list(images.shape[2:]), INTERPOLATION[mode], padding, align_corners, True, False)
    result = of_values(sampling.warp(as_values(images, mode), matrix, None, None, *options), images, mode)
    return result[0] if tensor.dim() == 3 and matrix.shape[0] == 1 else result


def rotate(
    tensor: Tensor,
    angle: Tensor | float,
    center: Tensor | Sequence[float] | None = None,
    mode: Interpolation = "bilinear",
    padding_mode: PaddingOrFill = "zeros",
    align_corners: bool = True,
    antialias: bool = False,
) -> Tensor:
    """Rotate images counter-clockwise as displayed, keeping their size.

    Args:
        tensor: images (B, C, H, W) or (C, H, W), floating point or uint8. Other integers are computed in float32,
            but nearest modes keep them.
        angle: degrees, (B,), or a number, also (1,) or (), for all images. Multiples of 90 degrees are exact.
        center: (B, 2) or (1, 2) as (x, y), or two numbers; None for the center of the image.
        mode: 'bilinear', 'nearest' or 'bicubic'.
        padding_mode: 'zeros', 'border' or 'reflection'.
        align_corners: mirror at the centers of the outermost pixels, not at their edges. Only 'reflection' uses it.
        antialias: where the image becomes smaller, average the pixels that a pixel of the result covers, as `resize` does with
            `antialias`; see :doc:`/conventions`. Only with 'bilinear'.

    Returns:
        Images of the shape and dtype of `tensor`.

    Raises:
        TypeError: `tensor`, `angle` or `center` is not a tensor of real numbers, nor numbers; `align_corners`
            or `antialias` is not a bool.
        ValueError: `tensor` is not (B, C, H, W) or (C, H, W), or H or W is 0; `angle` is not (B,), (1,) or (); `center`
            is not (B, 2) or (1, 2); `mode` or `padding_mode` is unknown; `antialias` with another mode than 'bilinear'; the
            tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.rotate(torch.tensor([[[1.0, 2], [3, 4]]]), 90.0)
        tensor([[[2., 4.],
                 [1., 3.]]])
    """
    images = _images("rotate", tensor)
    angle = _vector("rotate", images, "angle", angle)
    middle, x, y = _center("rotate", images, center)
    inputs = (angle, None, None, None, None, middle)
    return _by_formula(
        "rotate",
        tensor,
        images,
        mode,
        padding_mode,
        align_corners,
        "affine_matrix2d",
        [1.0, x, y],
        *inputs,
        antialias=antialias,
    )


def translate(
    tensor: Tensor,
    translation: Tensor | Sequence[float],
    mode: Interpolation = "bilinear",
    padding_mode: PaddingOrFill = "zeros",
    align_corners: bool = True,
) -> Tensor:
    """Translate images by pixels, keeping their size.

    Args:
        tensor: images (B, C, H, W) or (C, H, W), floating point or uint8. Other integers are computed in float32,
            but nearest modes keep them.
        translation: pixels to the right and down, (B, 2), or (1, 2) or two numbers for all images.
        mode: 'bilinear', 'nearest' or 'bicubic'.
        padding_mode: 'zeros', 'border' or 'reflection'.
        align_corners: mirror at the centers of the outermost pixels, not at their edges. Only 'reflection' uses it.

    Returns:
        Images of the shape and dtype of `tensor`.

    Raises:
        TypeError: `tensor` or `translation` is not a tensor of real numbers, nor numbers; `align_corners` is not a bool.
        ValueError: `tensor` is not (B, C, H, W) or (C, H, W), or H or W is 0; `translation` is not (B, 2) or (1, 2);
            `mode` or `padding_mode` is unknown; the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.translate(torch.tensor([[[1.0, 2], [3, 4]]]), (0.5, 1.0))
        tensor([[[0.0000, 0.0000],
                 [0.5000, 1.5000]]])
    """
    images = _images("translate", tensor)
    translation = _vector("translate", images, "translation", translation, 2)
    return _by_formula(
        "translate", tensor, images, mode, padding_mode, align_corners, "translation_matrix2d", [0.0, 0.0], translation
    )


def scale(
    tensor: Tensor,
    scale_factor: Tensor | Sequence[float] | float,
    center: Tensor | Sequence[float] | None = None,
    mode: Interpolation = "bilinear",
    padding_mode: PaddingOrFill = "zeros",
    align_corners: bool = True,
    antialias: bool = False,
) -> Tensor:
    """Scale images about a center, keeping their size.

    Args:
        tensor: images (B, C, H, W) or (C, H, W), floating point or uint8. Other integers are computed in float32,
            but nearest modes keep them.
        scale_factor: (B, 2) along x and y, or (B, 1) or (B,) for both; one row, two numbers or one serve all images.
        center: (B, 2) or (1, 2) as (x, y), or two numbers; None for the center of the image.
        mode: 'bilinear', 'nearest' or 'bicubic'.
        padding_mode: 'zeros', 'border' or 'reflection'.
        align_corners: mirror at the centers of the outermost pixels, not at their edges. Only 'reflection' uses it.
        antialias: where the image becomes smaller, average the pixels that a pixel of the result covers, as `resize` does with
            `antialias`; see :doc:`/conventions`. Only with 'bilinear'.

    Returns:
        Images of the shape and dtype of `tensor`.

    Raises:
        TypeError: `tensor`, `scale_factor` or `center` is not a tensor of real numbers, nor numbers; `align_corners` or
            `antialias` is not a bool.
        ValueError: `tensor` is not (B, C, H, W) or (C, H, W), or H or W is 0; `scale_factor` is not (B, 2), (B, 1) or
            (B,), with B or 1 rows; `center` is not (B, 2) or (1, 2); `mode` or `padding_mode` is unknown;
            `antialias` with another mode than 'bilinear'; the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.scale(torch.arange(5.0).reshape(1, 1, 5), torch.tensor([2.0]))
        tensor([[[1.0000, 1.5000, 2.0000, 2.5000, 3.0000]]])
    """
    images = _images("scale", tensor)
    scale_factor = _tensor("scale", "scale_factor", scale_factor, 2, one_for_both=True)
    if scale_factor.dim() < 2:
        scale_factor = scale_factor.reshape(-1, 1)
    if scale_factor.shape[-1] == 1:
        scale_factor = scale_factor.expand(*scale_factor.shape[:-1], 2)
    scale_factor = _vector("scale", images, "scale_factor", scale_factor, 2)
    middle, x, y = _center("scale", images, center)
    options = (mode, padding_mode, align_corners)
    return _by_formula(
        "scale", tensor, images, *options, "scale_matrix2d", [x, y], scale_factor, middle, antialias=antialias
    )


def shear(
    tensor: Tensor,
    shear: Tensor | Sequence[float],
    mode: Interpolation = "bilinear",
    padding_mode: PaddingOrFill = "zeros",
    align_corners: bool = False,
) -> Tensor:
    """Shear images about the center of their first pixel: (x, y) goes to (x + shear_x * y, y + shear_y * x).

    Args:
        tensor: images (B, C, H, W) or (C, H, W), floating point or uint8. Other integers are computed in float32,
            but nearest modes keep them.
        shear: (B, 2), or (1, 2) or two numbers for all images: pixels by which a row moves against the row above, and a column
            against the column to its left.
        mode: 'bilinear', 'nearest' or 'bicubic'.
        padding_mode: 'zeros', 'border' or 'reflection'.
        align_corners: mirror at the centers of the outermost pixels, not at their edges. Only 'reflection' uses it.

    Returns:
        Images of the shape and dtype of `tensor`.

    Raises:
        TypeError: `tensor` or `shear` is not a tensor of real numbers, nor numbers; `align_corners` is not a bool.
        ValueError: `tensor` is not (B, C, H, W) or (C, H, W), or H or W is 0; `shear` is not (B, 2) or (1, 2); `mode`
            or `padding_mode` is unknown; the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.shear(torch.tensor([[[1.0, 2], [3, 4]]]), torch.tensor([[1.0, 0]]))
        tensor([[[1., 2.],
                 [0., 3.]]])
    """
    images = _images("shear", tensor)
    shear = _vector("shear", images, "shear", shear, 2)
    return _by_formula("shear", tensor, images, mode, padding_mode, align_corners, "shear_factor_matrix2d", [], shear)


# --- shared by the functions ------------------------------------------------------------------------------------------


def _images(op: str, tensor: Any) -> Tensor:
    """Images (B, C, H, W) or one image (C, H, W) as (B, C, H, W)."""
    _check.numbers(op, "tensor", tensor)
    if tensor.dim() not in (3, 4) or 0 in tensor.shape[-2:]:
        raise ShapeError(f"{op}: expected tensor of shape (B, C, H, W) or (C, H, W), got {tuple(tensor.shape)}")
    return tensor[None] if tensor.dim() == 3 else tensor


def _by_formula(op, tensor, images, mode, padding_mode, align_corners, formula, numbers, *inputs, antialias=False):
    sampling.check_options(op, mode, padding_mode, align_corners)
    check_antialias(op, antialias, mode)
    padding, _ = sampling.padding_and_fill(op, images, padding_mode, None)
    six = inputs + (None,) * (6 - len(inputs))
    size = list(images.shape[2:])
    options = (padding, align_corners, True, False)
    values = as_values(images, mode)
    if antialias:
        result = warp_antialiased_by_formula(values, None, formula, (*six, *numbers), size, *options)
    else:
        options = (size, INTERPOLATION[mode], *options)
        result = sampling.warp_by_formula(values, *six, None, WARP_FORMULA[formula], numbers, *options)
    result = of_values(result, images, mode)
    return result[0] if tensor.dim() == 3 else result


def _vector(op: str, images: Tensor, name: str, x: Any, *axes: int) -> Tensor:
    """A parameter (B, *axes) in the compute dtype. A parameter of shape `axes` applies to all images."""
    x = _tensor(op, name, x, axes[0] if axes else 1)
    if x.dim() == len(axes):
        x = x[None]
    if x.shape[1:] != axes:
        _check.shape(op, name, x, "B", *axes)
    return sampling.cast_to_image(op, images, name, x)


def _tensor(op: str, name: str, x: Any, count: int = 1, one_for_both: bool = False) -> Tensor:
    """A parameter: a tensor as it is, and `count` numbers as a tensor of one row for all images."""
    if isinstance(x, Tensor):
        _check.numbers(op, name, x)
        return x
    numbers = _check.scalars(op, name, x)
    if count == 1 or (one_for_both and not isinstance(numbers, (tuple, list))):
        numbers = [numbers] * count
    if not isinstance(numbers, (tuple, list)) or len(numbers) != count or not all(map(_is_number, numbers)):
        several = "two numbers or one" if one_for_both else "two numbers" if count == 2 else "a number"
        raise TypeCheckError(
            f"{op}: expected {name} to be a Tensor, or {several}, got {_check.described(x)}", actual_type=type(x)
        )
    row = torch.tensor([_check.number(op, name, n) for n in numbers], dtype=torch.float64, device="cpu")
    return row if count == 1 else row[None]


def _is_number(x: Any) -> bool:
    return isinstance(x, (int, float)) and not isinstance(x, bool)


def _center(op: str, images: Tensor, center: Any) -> tuple[Tensor | None, float, float]:
    """Centers (B, 2) or (1, 2); the center of the image for None."""
    if center is not None:
        center = _vector(op, images, "center", center, 2)
    h, w = images.shape[2:]
    x, y = (w - 1) / 2, (h - 1) / 2
    # Numbers of operators are constants of a program, and sizes may be symbolic, which dynamo's types do not show.
    if is_compiling() or isinstance(x, torch.SymFloat) or isinstance(y, torch.SymFloat):
        return sampling.symbolic_point(images, x, y) if center is None else center, 0.0, 0.0
    return center, x, y


# --- modules --------------------------------------------------------------------------------------------------------


class Rotate(FunctionModule):
    """Module form of :func:`rotate`; an `angle` that is an nn.Parameter is learned.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.Rotate(torch.tensor([90.0]))(torch.rand(2, 3, 4, 5)).shape
        torch.Size([2, 3, 4, 5])
    """

    def __init__(
        self,
        angle: Tensor | float,
        center: Tensor | Sequence[float] | None = None,
        mode: Interpolation = "bilinear",
        padding_mode: PaddingOrFill = "zeros",
        align_corners: bool = True,
        antialias: bool = False,
    ) -> None:
        angle = _tensor("Rotate", "angle", angle, 1)
        super().__init__(
            angle=angle,
            center=center,
            mode=mode,
            padding_mode=padding_mode,
            align_corners=align_corners,
            antialias=antialias,
        )

    def forward(self, input: Tensor) -> Tensor:
        return rotate(input, self.angle, self.center, self.mode, self.padding_mode, self.align_corners, self.antialias)


class Translate(FunctionModule):
    """Module form of :func:`translate`; a `translation` that is an nn.Parameter is learned.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.Translate(torch.ones(1, 2))(torch.rand(2, 3, 4, 5)).shape
        torch.Size([2, 3, 4, 5])
    """

    def __init__(
        self,
        translation: Tensor | Sequence[float],
        mode: Interpolation = "bilinear",
        padding_mode: PaddingOrFill = "zeros",
        align_corners: bool = True,
    ) -> None:
        translation = _tensor("Translate", "translation", translation, 2)
        super().__init__(translation=translation, mode=mode, padding_mode=padding_mode, align_corners=align_corners)

    def forward(self, input: Tensor) -> Tensor:
        return translate(input, self.translation, self.mode, self.padding_mode, self.align_corners)


class Scale(FunctionModule):
    """Module form of :func:`scale`; a `scale_factor` that is an nn.Parameter is learned.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.Scale(torch.tensor([[2.0, 1]]))(torch.rand(2, 3, 4, 5)).shape
        torch.Size([2, 3, 4, 5])
    """

    def __init__(
        self,
        scale_factor: Tensor | Sequence[float] | float,
        center: Tensor | Sequence[float] | None = None,
        mode: Interpolation = "bilinear",
        padding_mode: PaddingOrFill = "zeros",
        align_corners: bool = True,
        antialias: bool = False,
    ) -> None:
        scale_factor = _tensor("Scale", "scale_factor", scale_factor, 2, one_for_both=True)
        super().__init__(
            scale_factor=scale_factor,
            center=center,
            mode=mode,
            padding_mode=padding_mode,
            align_corners=align_corners,
            antialias=antialias,
        )

    def forward(self, input: Tensor) -> Tensor:
        return scale(
            input, self.scale_factor, self.center, self.mode, self.padding_mode, self.align_corners, self.antialias
        )


class Shear(FunctionModule):
    """Module form of :func:`shear`; a `shear` that is an nn.Parameter is learned.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.Shear(torch.tensor([[0.5, 0]]))(torch.rand(2, 3, 4, 5)).shape
        torch.Size([2, 3, 4, 5])
    """

    def __init__(
        self,
        shear: Tensor | Sequence[float],
        mode: Interpolation = "bilinear",
        padding_mode: PaddingOrFill = "zeros",
        align_corners: bool = True,
    ) -> None:
        shear = _tensor("Shear", "shear", shear, 2)
        super().__init__(shear=shear, mode=mode, padding_mode=padding_mode, align_corners=align_corners)

    def forward(self, input: Tensor) -> Tensor:
        return shear(input, self.shear, self.mode, self.padding_mode, self.align_corners)


class Affine(FunctionModule):
    """Shear, scale, rotate and translate images; an argument that is an nn.Parameter is learned.

    Args:
        angle: (B,) in degrees, counter-clockwise.
        translation: (B, 2) in pixels.
        scale_factor: (B, 2).
        shear: (B, 2) in radians; see :func:`get_shear_matrix2d`.
        center: (B, 2); None for the center of the image.
        mode: 'bilinear', 'nearest' or 'bicubic'.
        padding_mode: 'zeros', 'border' or 'reflection'.
        align_corners: mirror at the centers of the outermost pixels, not at their edges. Only 'reflection' uses it.

    Raises:
        RuntimeError: none of the first four is given, or their batch sizes differ.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.Affine(angle=torch.tensor([30.0]))(torch.rand(2, 3, 4, 5)).shape
        torch.Size([2, 3, 4, 5])
    """

    def __init__(
        self,
        angle: Tensor | None = None,
        translation: Tensor | None = None,
        scale_factor: Tensor | None = None,
        shear: Tensor | None = None,
        center: Tensor | None = None,
        mode: Interpolation = "bilinear",
        padding_mode: PaddingOrFill = "zeros",
        align_corners: bool = True,
    ) -> None:
        parts = [x for x in (angle, translation, scale_factor, shear) if x is not None]
        if not parts:
            raise RuntimeError("Affine: expected at least one of angle, translation, scale_factor and shear")
        for name, x in (
            ("angle", angle),
            ("translation", translation),
            ("scale_factor", scale_factor),
            ("shear", shear),
        ):
            if x is not None:
                _check.is_tensor("Affine", name, x)
                if x.dim() == 0:
                    raise ShapeError(f"Affine: expected {name} with an axis of samples, got ()", actual_shape=x.shape)
        batches = [len(x) for x in parts]
        if len(set(batches)) > 1:
            raise RuntimeError(f"Affine: expected parameters of one batch size, got {batches}")
        super().__init__(
            angle=angle,
            translation=translation,
            scale_factor=scale_factor,
            shear=shear,
            center=center,
            mode=mode,
            padding_mode=padding_mode,
            align_corners=align_corners,
        )

    def forward(self, input: Tensor) -> Tensor:
        images = _images("Affine", input)
        vectors = {"translation": self.translation, "scale_factor": self.scale_factor, "shear": self.shear}
        translation, factor, shear = (
            None if x is None else _vector("Affine", images, name, x, 2) for name, x in vectors.items()
        )
        if self.angle is None:
            angle = torch.zeros(1, device=images.device, dtype=compute_dtype(images))
        else:
            angle = _vector("Affine", images, "angle", self.angle)
        sx, sy = (None, None) if shear is None else shear.unbind(-1)
        middle, x, y = _center("Affine", images, self.center)
        tensors = (angle, translation, factor, sx, sy, middle)
        options = (self.mode, self.padding_mode, self.align_corners)
        return _by_formula("Affine", input, images, *options, "affine_matrix2d", [1.0, x, y], *tensors)
