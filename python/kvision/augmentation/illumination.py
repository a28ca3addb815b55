"""Random light on a part of the image."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from torch import Tensor

from kvision._dtype import compute_dtype
from kvision.augmentation.corruption.layer import layered
from kvision.augmentation.corruption.layer_base import LayerAugmentation
from kvision.augmentation.engine import Execution, Params
from kvision.augmentation.lists.pixels import given_maps
from kvision.augmentation.lists.sides import sides_of_list
from kvision.augmentation.maps import as_batch
from kvision.augmentation.random_generator.illumination import (
    GaussianIlluminationGenerator,
    IlluminationGenerator,
    LinearCornerIlluminationGenerator,
    LinearIlluminationGenerator,
)
from kvision.augmentation.ranges import Numbers
from kvision.geometry.transform.lists.kept_sizes import Operation

__all__ = ["RandomGaussianIllumination", "RandomLinearCornerIllumination", "RandomLinearIllumination"]


class Illumination(LayerAugmentation, keeps_contract=True):
    """Base of augmentations that add light, of a generator of its maps, to images within 0 and 1."""

    _param_generator: IlluminationGenerator

    def _operation(self, like: Tensor, params: Params) -> Operation:
        return _added(params["gradient"].to(like.device, compute_dtype(like)))

    def _operation_on_list(self, images: Sequence[Tensor], like: Tensor, execution: Execution) -> Operation:
        if execution.params is not None:
            return _added(as_batch(given_maps(execution.params["gradient"], like.device, compute_dtype(like))))
        assert execution.columns is not None
        light = self._param_generator._light(execution.columns.values, *sides_of_list(images))
        return _added(light[:, None].to(compute_dtype(like)))


def _added(light: Tensor) -> Operation:
    return layered(light, 1.0, 0.0, 1.0, 0.0)


class RandomGaussianIllumination(Illumination, keeps_contract=True):
    """Add a patch of light or shade with the form of a Gaussian function.

    Args:
        gain: the most that is added: a number, or a pair within 0 and 1.
        center: of the patch, as fractions of width and height: a number, or a pair within 0 and 1.
        sigma: extent of the patch, as fractions of width and height: a number, or a pair within 0 and 1.
        sign: a number, or a pair within -1 and 1; numbers below 0 darken.
        p: probability that a sample is augmented.
        same_on_batch: all samples get the same parameters.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import torch, kvision as K
        >>> light = K.augmentation.RandomGaussianIllumination(0.5, 0.5, 0.2, 1.0, p=1.0)
        >>> light(torch.zeros(1, 1, 1, 3)).round(decimals=2)
        tensor([[[[0.0000, 0.5000, 0.0000]]]])
    """

    def __init__(
        self,
        gain: Numbers = (0.01, 0.15),
        center: Numbers = (0.1, 0.9),
        sigma: Numbers = (0.2, 1.0),
        sign: Numbers = (-1.0, 1.0),
        p: float = 0.5,
        same_on_batch: bool = False,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self._param_generator = GaussianIlluminationGenerator(gain, center, sigma, sign)


class RandomLinearIllumination(Illumination, keeps_contract=True):
    """Add light or shade that grows toward an edge of the image.

    Args:
        gain: the most that is added: a number, or a pair within 0 and 1.
        sign: a number, or a pair within -1 and 1; numbers below 0 darken.
        p: probability that a sample is augmented.
        same_on_batch: all samples get the same parameters.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import torch, kvision as K
        >>> light = K.augmentation.RandomLinearIllumination(0.5, 1.0, p=1.0)
        >>> light(torch.zeros(1, 1, 2, 2)).sum()
        tensor(1.)
    """

    def __init__(
        self,
        gain: Numbers = (0.01, 0.2),
        sign: Numbers = (-1.0, 1.0),
        p: float = 0.5,
        same_on_batch: bool = False,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self._param_generator = LinearIlluminationGenerator(gain, sign)


class RandomLinearCornerIllumination(Illumination, keeps_contract=True):
    """Add light or shade that grows toward a corner of the image.

    Args:
        gain: the most that is added: a number, or a pair within 0 and 1.
        sign: a number, or a pair within -1 and 1; numbers below 0 darken.
        p: probability that a sample is augmented.
        same_on_batch: all samples get the same parameters.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import torch, kvision as K
        >>> light = K.augmentation.RandomLinearCornerIllumination(0.5, 1.0, p=1.0)
        >>> light(torch.zeros(1, 1, 3, 3)).amax()
        tensor(0.5000)
    """

    def __init__(
        self,
        gain: Numbers = (0.01, 0.2),
        sign: Numbers = (-1.0, 1.0),
        p: float = 0.5,
        same_on_batch: bool = False,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self._param_generator = LinearCornerIlluminationGenerator(gain, sign)
