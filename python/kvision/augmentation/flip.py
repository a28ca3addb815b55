"""Flips, quarter turns, and the exchange of rows and columns of images."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Generator, Tensor

from kvision._constants import constant
from kvision._dtype import compute_dtype
from kvision.augmentation.columns import Columns, Span
from kvision.augmentation.draws import Draw
from kvision.augmentation.engine import Execution, Shape, matrix_type
from kvision.augmentation.geometric_base import GeometricAugmentationBase2D
from kvision.augmentation.keys import Seed
from kvision.augmentation.random_generator.base import RandomGeneratorBase
from kvision.augmentation.transforms import Transform, center_of
from kvision.geometry.transform.flip import flipped

__all__ = ["D4", "RandomHorizontalFlip", "RandomVerticalFlip", "Transpose"]


class _FlipGenerator(RandomGeneratorBase):
    """One column: -1 for samples that are flipped, else 1. It is no parameter."""

    fields, hidden = (("sign", 0),), ("sign",)
    has_names = False

    def draws(self, shape: Sequence[int]) -> Sequence[Draw]:
        return [Draw("integer", (-1, 1, 1, 1))]

    def to_columns(self, params: dict[str, Any], shape: Sequence[int]) -> Any:
        return torch.full((shape[0], 1), -1.0, device="cpu")


class _RandomFlip(GeometricAugmentationBase2D):
    moves_whole_pixels = stays_inside = permutes_pixels = True
    flips_columns: bool  # or rows

    def __init__(
        self, p: float = 0.5, p_batch: float = 1.0, same_on_batch: bool = False, keepdim: bool = False, **options: Any
    ) -> None:
        super().__init__(p=p, p_batch=p_batch, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self._param_generator = _FlipGenerator()

    def _draw_and_run(
        self, x: Tensor, seed: Seed, generator: Generator | None, flags: dict[str, Any], labels: Any = None
    ) -> tuple[Tensor, Execution]:
        """A flip of all samples draws nothing but its key, and its matrix is computed when it is read."""
        if not self._is_certain or self._is_customized():
            return super()._draw_and_run(x, seed, generator, flags, labels)
        keys = self._keys(x, seed, generator)
        columns = Columns(constant((-1.0,), x, compute_dtype(x)).expand(x.shape[0], 1), Span(0, 1, False))
        execution = Execution(tuple(x.shape), columns, redraw=(keys, 0), is_certain=True)
        execution.identity = matrix_type(x)
        self.__dict__["_execution"] = execution  # faster than Module.__setattr__, which looks for parameters
        return flipped(x, self.flips_columns, not self.flips_columns), execution


class RandomHorizontalFlip(_RandomFlip):
    """Flip images from left to right.

    Args:
        p: probability that a sample is flipped.
        p_batch: probability that a batch is augmented at all.
        same_on_batch: all samples are flipped, or none.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError: `p` or `p_batch` is not a number.
        ValueError: `p` or `p_batch` is not within 0 and 1.

    Example:
        >>> import torch, kvision as K
        >>> flip = K.augmentation.RandomHorizontalFlip(p=1.0)
        >>> flip(torch.tensor([[[[1.0, 2.0, 3.0]]]]))
        tensor([[[[3., 2., 1.]]]])
        >>> flip.transform_matrix
        tensor([[[-1.,  0.,  2.],
                 [ 0.,  1.,  0.],
                 [ 0.,  0.,  1.]]])
    """

    flips_columns = True

    def transforms(self, shape: Shape, flags: dict[str, Any]) -> Sequence[Transform]:
        return [Transform.affine(center_of(shape), scale=("sign", 1.0))]


class RandomVerticalFlip(_RandomFlip):
    """Flip images upside down.

    Args:
        p: probability that a sample is flipped.
        p_batch: probability that a batch is augmented at all.
        same_on_batch: all samples are flipped, or none.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError: `p` or `p_batch` is not a number.
        ValueError: `p` or `p_batch` is not within 0 and 1.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.RandomVerticalFlip(p=1.0)(torch.tensor([[[[1.0], [2.0]]]]))
        tensor([[[[2.],
                  [1.]]]])
    """

    flips_columns = False

    def transforms(self, shape: Shape, flags: dict[str, Any]) -> Sequence[Transform]:
        return [Transform.affine(center_of(shape), scale=(1.0, "sign"))]


class _SymmetryGenerator(RandomGeneratorBase):
    """Draws an angle and whether columns are mirrored, before the turn."""

    fields = (("angle", 0), ("mirror", 0))

    def draws(self, shape: Sequence[int]) -> Sequence[Draw]:
        turns = (0, 90, 4, 0) if shape[-2] == shape[-1] else (0, 180, 2, 0)
        return [Draw("integer", turns), Draw("integer", (-1, 2, 2, 1))]


class D4(GeometricAugmentationBase2D):
    """Turn and mirror images by one of the eight symmetries of the square, as Albumentations' `D4`.

    Images that are not square get one of the four that keep their size: none, a half turn, and both mirror images.

    Args:
        same_on_batch: all samples get the same symmetry.
        p: probability that a sample is augmented; each symmetry, with the one that changes nothing, is as likely as another.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        ValueError: `p` is not within 0 and 1.

    Example:
        >>> import torch, kvision as K
        >>> d4 = K.augmentation.D4()
        >>> x = torch.tensor([[[[1.0, 2.0], [3.0, 4.0]]]]).expand(64, -1, -1, -1)
        >>> d4(x).flatten(1).unique(dim=0).shape
        torch.Size([8, 4])
    """

    moves_whole_pixels = stays_inside = permutes_pixels = True

    def __init__(self, same_on_batch: bool = False, p: float = 1.0, keepdim: bool = False, **options: Any) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self._param_generator = _SymmetryGenerator()

    def transforms(self, shape: Shape, flags: dict[str, Any]) -> Sequence[Transform]:
        return [Transform.affine(center_of(shape), angle="angle", scale=("mirror", 1.0))]


class Transpose(GeometricAugmentationBase2D):
    """Exchange rows and columns of images: (B, C, H, W) becomes (B, C, W, H).

    Args:
        p: probability that a batch is transposed; :class:`D4` chooses for each sample.
        keepdim: an image (C, H, W) gives an image (C, W, H) instead of a batch of one.

    Raises:
        ValueError: `p` is not within 0 and 1.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.Transpose(p=1.0)(torch.tensor([[[[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]]]))
        tensor([[[[1., 4.],
                  [2., 5.],
                  [3., 6.]]]])
    """

    whole_batch = moves_whole_pixels = stays_inside = permutes_pixels = True

    def __init__(self, p: float = 0.5, keepdim: bool = False, **options: Any) -> None:
        super().__init__(p=1.0, p_batch=p, same_on_batch=True, keepdim=keepdim, **options)

    def output_size(self, shape: Shape, flags: dict[str, Any]) -> tuple[int, int]:
        return shape[-1], shape[-2]

    def transforms(self, shape: Shape, flags: dict[str, Any]) -> Sequence[Transform]:
        return [Transform.constant([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])]
