"""Random perspective transforms of images."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from torch import Tensor

from kvision.augmentation.engine import Shape
from kvision.augmentation.geometric_base import AntialiasedByMatrix
from kvision.augmentation.random_generator.perspective import PerspectiveGenerator, SamplingMethod, corners
from kvision.augmentation.transforms import Transform
from kvision.constants import AnyResample, Resample

__all__ = ["RandomPerspective"]


class RandomPerspective(AntialiasedByMatrix):
    """Move the corners of images, which changes the perspective; pixels outside of the image are 0.

    Args:
        distortion_scale: how far a corner moves at most, as a fraction of half of width and height.
        resample: 'nearest', 'bilinear' or 'bicubic'.
        same_on_batch: all samples get the same parameters.
        align_corners: accepted for code written for Kornia.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.
        sampling_method: 'basic' moves corners inward, 'area_preserving' inward or outward.
        antialias: where images become smaller, average the pixels that a pixel of the result covers, as
            :func:`~kvision.geometry.warp_affine` does. Only with 'bilinear'.

    Raises:
        TypeError: `distortion_scale` is not a number.
        ValueError: `distortion_scale` is not within 0 and 1; `sampling_method` is unknown; `antialias`
            with another `resample` than 'bilinear'.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.RandomPerspective(0.0, p=1.0)(torch.tensor([[[[1.0, 2.0], [3.0, 4.0]]]]))
        tensor([[[[1., 2.],
                  [3., 4.]]]])
    """

    def __init__(
        self,
        distortion_scale: float | Tensor = 0.5,
        resample: AnyResample = Resample.BILINEAR.name,
        same_on_batch: bool = False,
        align_corners: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        sampling_method: SamplingMethod = "basic",
        *,
        antialias: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self._param_generator = PerspectiveGenerator(distortion_scale, sampling_method)
        self.flags = {"align_corners": align_corners, "resample": Resample.get(resample)}
        self._set_antialias(antialias)

    def matrix_transforms(self, shape: Shape, flags: dict[str, Any]) -> Sequence[Transform]:
        start = [coordinate for corner in corners(shape) for coordinate in corner]
        return [Transform("perspective", *start, "end_points")]
