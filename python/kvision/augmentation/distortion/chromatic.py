"""Chromatic aberration."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, TypeAlias, get_args

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import compute_dtype
from kvision.augmentation import maps
from kvision.augmentation.distortion.displacement_map import MapFormula
from kvision.augmentation.engine import Execution, Params
from kvision.augmentation.intensity_base import IntensityAugmentationBase2D
from kvision.augmentation.random_generator.mapped import MappedGenerator
from kvision.augmentation.ranges import Numbers
from kvision.augmentation.warp_and_color import Resampling
from kvision.constants import AnyResample, Resample
from kvision.geometry.transform.lists.arguments import like_batch

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
        moved = self._formula(input, params).map(input.shape[-2:])
        y = maps.read_displaced(input.reshape(-1, 1, *input.shape[-2:]), moved, self._resampling(flags))
        return y.view(input.shape)

    def _formula(self, like: Tensor, params: Params) -> MapFormula:
        """The maps of the channels of images like a batch."""
        _check.rgb("ChromaticAberration", like.shape)
        names = ("primary_red", "secondary_red", "primary_blue", "secondary_blue")
        red, more_red, blue, more_blue = (params[name].to(like.device, compute_dtype(like)) for name in names)
        if self.mode != "random":
            blue = blue.abs().copysign(red if self.mode == "green_purple" else -red)
        still = torch.zeros_like(red)  # green
        first = torch.stack([red, still, blue], 1).flatten()
        second = torch.stack([more_red, still, more_blue], 1).flatten().abs().copysign(first)
        return MapFormula("camera", torch.stack([first, second], 1))

    @staticmethod
    def _resampling(flags: dict[str, Any]) -> Resampling:
        return Resampling(Resample.get(flags["resample"]).name.lower(), "border", True)

    def _operates_on(self, dtype: torch.dtype) -> bool:
        return not self._is_customized() and (dtype.is_floating_point or dtype == torch.uint8)

    def _run_list(self, images: Sequence[Tensor], execution: Execution) -> list[Tensor]:
        like, chosen = like_batch(images), execution.chosen
        formula = self._formula(like, self._params_on_device(like, execution, for_users=False))
        sides = [n for x in images for _ in range(3) for n in x.shape[-2:]]
        moved = formula.maps(sides, None if chosen is None else chosen.float().repeat_interleave(3))
        return maps.read_displaced_list(images, moved, self._resampling(self.flags), by_channel=True)
