"""Chromatic aberration."""

from __future__ import annotations

from typing import Any, Literal, TypeAlias, get_args

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import compute_dtype
from kvision.augmentation import maps
from kvision.augmentation.distortion.displacement_map import MapFormula
from kvision.augmentation.engine import Params
from kvision.augmentation.intensity_base import IntensityAugmentationBase2D
from kvision.augmentation.random_generator.mapped import MappedGenerator
from kvision.augmentation.ranges import Numbers
from kvision.augmentation.warp_and_color import Resampling
from kvision.constants import AnyResample, Resample
from kvision.core.exceptions import ShapeError

ChromaticMode: TypeAlias = Literal["green_purple", "red_blue", "random"]


class ChromaticAberration(IntensityAugmentationBase2D, keeps_contract=True):
    """Deform the red and the blue channel of RGB images as lenses do, and leave green and labels in place.

    The model is that by Brown and Conrady, of a camera whose focal lengths are width and height.

    Args:
        primary_distortion_range: pair of the lowest and the highest coefficient k1.
        secondary_distortion_range: the same of k2, which gets the sign of k1.
        mode: 'green_purple' gives red and blue the same sign, 'red_blue' opposite ones, 'random' any.
        resample: 'nearest', 'bilinear' or 'bicubic'.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: an argument does not have the form in Args; in a call, images of other channels.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.rand(1, 3, 8, 8)
        >>> torch.equal(K.augmentation.ChromaticAberration(p=1.0)(x)[:, 1], x[:, 1])
        True
    """

    def __init__(
        self,
        primary_distortion_range: Numbers = (-0.02, 0.02),
        secondary_distortion_range: Numbers = (-0.05, 0.05),
        mode: ChromaticMode = "green_purple",
        resample: AnyResample = Resample.BILINEAR.name,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        _check.choice("ChromaticAberration", "mode", mode, get_args(ChromaticMode))
        self.mode = mode
        self.flags = {"resample": Resample.get(resample)}
        primary, secondary = primary_distortion_range, secondary_distortion_range
        self._param_generator = MappedGenerator(
            (primary, "primary_red", None, None),
            (secondary, "secondary_red", None, None),
            (primary, "primary_blue", None, None),
            (secondary, "secondary_blue", None, None),
            op="ChromaticAberration",
        )

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        if input.shape[1] != 3:
            raise ShapeError(
                f"ChromaticAberration: expected images with 3 channels, got {tuple(input.shape)}"
                f"{_check.channels_advice(input.shape)}"
            )
        like = input.new_empty(0, dtype=compute_dtype(input))
        names = ("primary_red", "secondary_red", "primary_blue", "secondary_blue")
        red, more_red, blue, more_blue = (params[name].to(like) for name in names)
        if self.mode != "random":
            blue = blue.abs().copysign(red if self.mode == "green_purple" else -red)
        still = torch.zeros_like(red)  # green
        first = torch.stack([red, still, blue], 1).flatten()
        second = torch.stack([more_red, still, more_blue], 1).flatten().abs().copysign(first)
        moved = MapFormula("camera", torch.stack([first, second], 1)).map(input.shape[-2:])
        resampling = Resampling(Resample.get(flags["resample"]).name.lower(), "border", True)
        return maps.read_displaced(input.reshape(-1, 1, *input.shape[-2:]), moved, resampling).view(input.shape)
