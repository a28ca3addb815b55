"""Random changes by fractal maps.

Source: A. Nicolaou et al., "TorMentor: deterministic dynamic-path, data augmentations with fractals" (2022).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from torch import Tensor

from kvision._dtype import compute_dtype
from kvision.augmentation.corruption.layer import layered
from kvision.augmentation.corruption.layer_base import LayerAugmentation
from kvision.augmentation.engine import Execution, Params
from kvision.augmentation.lists.drawn_layers import plasma_of_list
from kvision.augmentation.random_generator.plasma import PlasmaGenerator
from kvision.augmentation.ranges import Numbers
from kvision.geometry.transform.lists.kept_sizes import Operation

__all__ = ["RandomPlasmaBrightness", "RandomPlasmaContrast", "RandomPlasmaShadow"]


class PlasmaAugmentation(LayerAugmentation, keeps_contract=True):
    """Base of augmentations whose layer is a fractal map, or follows from one."""

    _param_generator: PlasmaGenerator

    def _layered(self, plasma: Tensor, params: Params) -> Operation:
        """The operator for maps of the type that is computed in."""
        raise NotImplementedError(f"{type(self).__name__}._layered")

    def _operation(self, like: Tensor, params: Params) -> Operation:
        return self._layered(params["plasma"].to(like.device, compute_dtype(like)), params)

    def _operation_on_list(self, images: Sequence[Tensor], like: Tensor, execution: Execution) -> Operation:
        plasma = plasma_of_list(self, images, like, execution)
        return self._layered(plasma, self._drawn_params(like, execution))


class RandomPlasmaBrightness(PlasmaAugmentation, keeps_contract=True):
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

    def _layered(self, plasma: Tensor, params: Params) -> Operation:
        intensity = params["intensity"].to(plasma)[:, None]
        return layered(plasma, 1.0, 0.0, 2 * intensity, -intensity)


class RandomPlasmaContrast(PlasmaAugmentation, keeps_contract=True):
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

    def _layered(self, plasma: Tensor, params: Params) -> Operation:
        return layered(plasma, 0.0, 4.0, -2.0, 0.5)


class RandomPlasmaShadow(PlasmaAugmentation, keeps_contract=True):
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

    def _layered(self, plasma: Tensor, params: Params) -> Operation:
        intensity, quantity = (params[name].to(plasma)[:, None] for name in ("shade_intensity", "shade_quantity"))
        shade = (plasma < quantity[:, :, None, None]).to(plasma)
        return layered(shade, 1.0, 0.0, intensity, 0.0)
