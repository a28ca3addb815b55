"""Random changes by fractal maps.

Source: A. Nicolaou et al., "TorMentor: deterministic dynamic-path, data augmentations with fractals" (2022).
"""

from __future__ import annotations

from typing import Any

from torch import Tensor

from kvision._clamp import clamp
from kvision.augmentation.engine import Params
from kvision.augmentation.intensity_base import IntensityAugmentationBase2D
from kvision.augmentation.random_generator.plasma import PlasmaGenerator
from kvision.augmentation.ranges import Numbers

__all__ = ["RandomPlasmaBrightness", "RandomPlasmaContrast", "RandomPlasmaShadow"]


class RandomPlasmaBrightness(IntensityAugmentationBase2D, keeps_contract=True):
    """Add a fractal map to images.

    Args:
        roughness: pair, within 0 and 1: the weight of fine structure.
        intensity: pair: the map times this is added, from minus the intensity to the intensity.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.RandomPlasmaBrightness(intensity=(0.0, 0.0), p=1.0)(torch.ones(1, 1, 1, 2))
        tensor([[[[1., 1.]]]])
    """

    accepts_bytes = False

    def __init__(
        self,
        roughness: Numbers = (0.1, 0.7),
        intensity: Numbers = (0.0, 1.0),
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self._param_generator = PlasmaGenerator(
            "RandomPlasmaBrightness", roughness, (intensity, "intensity", None, None)
        )

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        change = (2 * params["plasma"] - 1) * params["intensity"][:, None, None, None]
        return clamp(clamp(input, 0, 1) + change, 0, 1)


class RandomPlasmaContrast(IntensityAugmentationBase2D, keeps_contract=True):
    """Multiply the contrast of images by four times a fractal map.

    Args:
        roughness: pair, within 0 and 1: the weight of fine structure.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.RandomPlasmaContrast(p=1.0)(torch.full((1, 1, 1, 2), 0.5))
        tensor([[[[0.5000, 0.5000]]]])
    """

    accepts_bytes = False

    def __init__(
        self,
        roughness: Numbers = (0.1, 0.7),
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self._param_generator = PlasmaGenerator("RandomPlasmaContrast", roughness)

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        return clamp((clamp(input, 0, 1) - 0.5) * (4 * params["plasma"]) + 0.5, 0, 1)


class RandomPlasmaShadow(IntensityAugmentationBase2D, keeps_contract=True):
    """Shade images where a fractal map is low, equally in all channels.

    Args:
        roughness: pair, within 0 and 1: the weight of fine structure.
        shade_intensity: pair: what is added in the shade.
        shade_quantity: pair: the map is shade below this.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import torch, kvision as K
        >>> shade = K.augmentation.RandomPlasmaShadow((0.5, 0.5), (-0.5, -0.5), (2.0, 2.0), p=1.0)
        >>> shade(torch.ones(1, 1, 1, 2))
        tensor([[[[0.5000, 0.5000]]]])
    """

    accepts_bytes = False

    def __init__(
        self,
        roughness: Numbers = (0.1, 0.7),
        shade_intensity: Numbers = (-1.0, 0.0),
        shade_quantity: Numbers = (0.0, 1.0),
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self._param_generator = PlasmaGenerator(
            "RandomPlasmaShadow",
            roughness,
            (shade_intensity, "shade_intensity", None, None),
            (shade_quantity, "shade_quantity", None, None),
            one_channel=True,
        )

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        intensity, quantity = (params[name][:, None, None, None] for name in ("shade_intensity", "shade_quantity"))
        shade = (params["plasma"] < quantity) * intensity
        return clamp(clamp(input, 0, 1) + shade, 0, 1)
