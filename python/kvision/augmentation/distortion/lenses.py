"""Maps of lenses."""

from __future__ import annotations

from typing import Any, Literal, TypeAlias, get_args

from torch import Tensor

from kvision import _check
from kvision.augmentation.distortion.displacement_map import MapFormula
from kvision.augmentation.distortion.distortion_base import DistortionBase
from kvision.augmentation.engine import Params
from kvision.augmentation.random_generator.mapped import MappedGenerator
from kvision.augmentation.ranges import Numbers
from kvision.constants import AnyResample, AnySamplePadding, Resample, SamplePadding

LensMode: TypeAlias = Literal["camera", "fisheye"]


class OpticalDistortion(DistortionBase, keeps_contract=True):
    """Deform images as a lens does, with a random coefficient.

    'camera' is the model by Brown and Conrady with k1 = k2 = k, of a camera whose focal lengths are width and height. 'fisheye' is
    that by Kannala and Brandt with k1 = k: an equidistant image whose corners are at an angle of 1 radian gets the radius
    angle (1 + k angle^2).

    Args:
        distort_range: pair of the lowest and the highest coefficient; positive ones read farther from the center.
        mode: 'camera' or 'fisheye'.
        resample: 'nearest', 'bilinear' or 'bicubic'.
        padding_mode: values out of bounds: 'zeros', 'border' or 'reflection'.
        same_on_batch: all samples get the same deformation.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: an argument does not have the form in Args.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.rand(1, 1, 6, 6)
        >>> torch.allclose(K.augmentation.OpticalDistortion((0.0, 0.0), p=1.0)(x), x, atol=1e-5)
        True
    """

    def __init__(
        self,
        distort_range: Numbers = (-0.05, 0.05),
        mode: LensMode = "camera",
        resample: AnyResample = Resample.BILINEAR.name,
        padding_mode: AnySamplePadding = SamplePadding.ZEROS.name,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(resample, padding_mode, same_on_batch=same_on_batch, p=p, keepdim=keepdim, **options)
        _check.choice("OpticalDistortion", "mode", mode, get_args(LensMode))
        self.mode = mode
        self._param_generator = MappedGenerator((distort_range, "distort", None, None), op="OpticalDistortion")

    def _formula(self, params: Params, flags: dict[str, Any], like: Tensor) -> MapFormula:
        k = params["distort"].to(like)[:, None]
        return MapFormula("camera", k.expand(-1, 2)) if self.mode == "camera" else MapFormula("fisheye_lens", k)
