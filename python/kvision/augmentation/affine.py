"""Random affine transforms of images."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from kvision.augmentation import transforms
from kvision.augmentation.base import Shape
from kvision.augmentation.geometric_base import GeometricAugmentationBase2D
from kvision.augmentation.random_generator.affine import AffineGenerator
from kvision.augmentation.transforms import Transform
from kvision.constants import Resample, SamplePadding

__all__ = ["RandomAffine"]


class RandomAffine(GeometricAugmentationBase2D):
    """Shear, scale, rotate and shift images about their center.

    Args:
        degrees: angle, positive counter-clockwise: a number s for -s to s, or a pair.
        translate: largest shifts along x and y, as fractions of width and height.
        scale: a pair; or four numbers, a pair for x and one for y.
        shear: degrees: a number s for -s to s along x, a pair along x, or four numbers for x and y.
        resample: 'nearest', 'bilinear' or 'bicubic'.
        same_on_batch: all samples get the same parameters.
        align_corners: mirror at the centers of the outermost pixels, not at their edges. Only 'reflection' uses it.
        padding_mode: values out of bounds: 'zeros', 'border', 'reflection', or 'fill' for `fill_value`.
        fill_value: a number, or one of each channel.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: a range of another form, or out of its bounds.

    Example:
        >>> import torch, kvision as K
        >>> augment = K.augmentation.RandomAffine(degrees=(90.0, 90.0), p=1.0)
        >>> augment(torch.tensor([[[[1.0, 2.0], [3.0, 4.0]]]]))
        tensor([[[[2., 4.],
                  [1., 3.]]]])
    """

    def __init__(
        self,
        degrees: Any,
        translate: Any = None,
        scale: Any = None,
        shear: Any = None,
        resample: str | int | Resample = Resample.BILINEAR.name,
        same_on_batch: bool = False,
        align_corners: bool = False,
        padding_mode: str | int | SamplePadding = SamplePadding.ZEROS.name,
        fill_value: Any = None,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self._param_generator: AffineGenerator = AffineGenerator(degrees, translate, scale, shear)
        self.flags = {
            "resample": Resample.get(resample),
            "padding_mode": SamplePadding.get(padding_mode),
            "align_corners": align_corners,
            "fill_value": fill_value,
        }

    def transforms(self, shape: Shape, flags: dict[str, Any]) -> Sequence[Transform]:
        height, width = shape[-2:]
        chain = transforms.affine(
            ((width - 1) / 2, (height - 1) / 2),
            angle=0,
            translation=(1, 2),
            scale=self._param_generator.scale_columns,
            shear=(5, 6),
        )
        return [chain]
