"""Random weather."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from kvision._dtype import compute_dtype
from kvision.augmentation.corruption.layer import layered
from kvision.augmentation.corruption.layer_base import LayerAugmentation
from kvision.augmentation.corruption.rain import rain_mask
from kvision.augmentation.engine import Execution, Params, Shape
from kvision.augmentation.intensity_base import IntensityAugmentationBase2D
from kvision.augmentation.random_generator.plain import PlainUniformGenerator
from kvision.augmentation.random_generator.weather import RainGenerator
from kvision.augmentation.ranges import Numbers
from kvision.augmentation.warp_and_color import ColorStep
from kvision.core.exceptions import ShapeError
from kvision.geometry.transform.lists.arguments import sizes
from kvision.geometry.transform.lists.kept_sizes import Operation

__all__ = ["RandomRain", "RandomSnow"]


class RandomRain(LayerAugmentation, keeps_contract=True):
    """Draw lines of gray, 200 / 255, as drops of rain.

    Args:
        number_of_drops: pair of lowest and highest number, ints of at least 0.
        drop_height: pair of lowest and highest height in pixels, ints of at least 1.
        drop_width: pair of lowest and highest width in pixels, ints; negative ones lean to the left.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: a range is not an ascending pair of ints, or out of its bounds; in a call, drops as large as the
            image.

    Example:
        >>> import torch, kvision as K
        >>> rain = K.augmentation.RandomRain((1, 1), (3, 3), (0, 0), p=1.0)
        >>> (rain(torch.zeros(1, 1, 8, 8)) > 0).sum()
        tensor(3)
    """

    def __init__(
        self,
        number_of_drops: Numbers = (1000, 2000),
        drop_height: Numbers = (5, 20),
        drop_width: Numbers = (-5, 5),
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self._param_generator: RainGenerator = RainGenerator(number_of_drops, drop_height, drop_width)

    def _operation(self, like: Tensor, params: Params) -> Operation:
        return self._rain(like, params, params["coordinates_factor"], like.shape[-2:], like.shape[-2:])

    def _operation_on_list(self, images: Sequence[Tensor], like: Tensor, execution: Execution) -> Operation:
        params = self._params_on_device(like, execution, for_users=False)
        return self._rain(like, params, params["coordinates_factor"], sizes(images), like.shape[-2:])

    def _rain(
        self, like: Tensor, params: Params, positions: Tensor, sides: Sequence[int], smallest: Sequence[int]
    ) -> Operation:
        """The operator for images of one height and width, or of those of each."""
        drawn = self._param_generator
        longest = max(drawn.drop_height[1], *(abs(n) for n in drawn.drop_width))
        if drawn.drop_height[1] >= smallest[0] or max(abs(n) for n in drawn.drop_width) >= smallest[1]:
            raise ShapeError(f"RandomRain: expected images larger than drops, got {tuple(like.shape)}")
        names = ("number_of_drops_factor", "drop_height_factor", "drop_width_factor")
        drops = torch.stack([params[name].to(like.device, torch.int64) for name in names], 1)
        wet = rain_mask(drops, positions.to(like.device, torch.float32), list(sides), longest)
        return layered(wet.to(compute_dtype(like)), 1.0, -1.0, 200 / 255, 0.0)


class RandomSnow(IntensityAugmentationBase2D, keeps_contract=True):
    """Lighten the dark pixels of RGB images.

    Args:
        snow_coefficient: pair, within 0 and 1: pixels of less lightness in HLS are lightened.
        brightness: pair of factors of lightness, of at least 1.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.RandomSnow()(torch.full((1, 3, 1, 1), 0.25)).flatten()
        tensor([0.5000, 0.5000, 0.5000])
    """

    def __init__(
        self,
        snow_coefficient: Numbers = (0.5, 0.5),
        brightness: Numbers = (2, 2),
        same_on_batch: bool = False,
        p: float = 1.0,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self._param_generator = PlainUniformGenerator(
            (snow_coefficient, "snow_coefficient", None, (0.0, 1.0)),
            (brightness, "brightness", None, (1.0, float("inf"))),
            identity=[0.0, 1.0],
            op="RandomSnow",
        )

    def color_steps(self, shape: Shape, flags: dict[str, Any]) -> Sequence[ColorStep]:
        clamped = ColorStep("scale_shift", 1.0, 0.0, 1.0)
        lightened = ColorStep("lightness_raw", "snow_coefficient", "brightness")
        return [clamped, ColorStep("rgb_to_hls", 1e-8), lightened, ColorStep("hls_to_rgb"), clamped]
