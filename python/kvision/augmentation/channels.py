"""Random changes of whole channels, and of the color of light."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, TypeAlias

import torch
from torch import Tensor

from kvision import _check
from kvision._clamp import clamp
from kvision._constants import constant
from kvision.augmentation.engine import Params
from kvision.augmentation.intensity_base import IntensityAugmentationBase2D
from kvision.augmentation.random_generator.color import (
    ChannelDropoutGenerator,
    ChannelShuffleGenerator,
    PlanckianJitterGenerator,
)
from kvision.augmentation.random_generator.planckian_data import BLACKBODY, CIED
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError

__all__ = ["RandomChannelDropout", "RandomChannelShuffle", "RandomPlanckianJitter"]

Illuminants: TypeAlias = Literal["blackbody", "CIED"]


class RandomChannelShuffle(IntensityAugmentationBase2D, keeps_contract=True):
    """Put the channels of images in a random order.

    Args:
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError: `p` is not a number.

    Example:
        >>> import torch, kvision as K
        >>> shuffled = K.augmentation.RandomChannelShuffle(p=1.0)(torch.arange(3.0).reshape(1, 3, 1, 1))
        >>> shuffled.sort(1).values.flatten()
        tensor([0., 1., 2.])
    """

    takes_volumes = True

    def __init__(
        self,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self._param_generator = ChannelShuffleGenerator()

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        planes = input.flatten(0, 1).index_select(0, _planes(input, params["channels"]))
        return planes.view(input.shape)


class RandomChannelDropout(IntensityAugmentationBase2D, keeps_contract=True):
    """Fill random channels with a value.

    Args:
        num_drop_channels: how many channels of each image.
        fill_value: the value, within 0 and 1.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: `num_drop_channels` is not an int of at least 1; `fill_value` is not within 0 and 1.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.RandomChannelDropout(3, p=1.0)(torch.ones(1, 3, 1, 1)).flatten()
        tensor([0., 0., 0.])
    """

    takes_volumes = True

    def __init__(
        self,
        num_drop_channels: int = 1,
        fill_value: float = 0.0,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self.fill_value = _check.fraction("RandomChannelDropout", "fill_value", fill_value)
        self._param_generator = ChannelDropoutGenerator(num_drop_channels)

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        value = round(255 * self.fill_value) if input.dtype == torch.uint8 else self.fill_value
        dropped = _planes(input, params["channel_idx"])
        return input.flatten(0, 1).index_fill(0, dropped, value).view(input.shape)


def _planes(images: Tensor, channels: Tensor) -> Tensor:
    """The indices among all planes of channels (B, n) of images (B, C, H, W)."""
    count = images.shape[1]
    return (channels + count * torch.arange(images.shape[0], device=images.device)[:, None]).flatten()


class _UnknownModeError(ValueCheckError, RuntimeError):
    """Kornia raises a RuntimeError."""


class RandomPlanckianJitter(IntensityAugmentationBase2D, keeps_contract=True):
    """Change the color of light to that of another temperature.

    Args:
        mode: 'blackbody' for the light of black bodies, 3000 K to 15000 K, or 'CIED' for daylight, 4000 K to 15000 K.
        select_from: rows of the table to choose from; None for all.
        same_on_batch: all samples get the same light.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        ValueError, RuntimeError: `mode` is unknown; a row is out of range.

    Example:
        >>> import torch, kvision as K
        >>> warm = K.augmentation.RandomPlanckianJitter(select_from=0, p=1.0)
        >>> red, green, blue = warm(torch.full((1, 3, 1, 1), 0.5)).flatten()
        >>> bool(red > green > blue)
        True
    """

    accepts_bytes = False

    def __init__(
        self,
        mode: Illuminants = "blackbody",
        select_from: int | Sequence[int] | None = None,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        tables = {"blackbody": BLACKBODY, "CIED": CIED}
        _check.choice("RandomPlanckianJitter", "mode", mode, tuple(tables), _UnknownModeError)
        table = tables[mode]
        select_from = _check.scalars("RandomPlanckianJitter", "select_from", select_from)
        rows = (
            range(len(table)) if select_from is None else [select_from] if isinstance(select_from, int) else select_from
        )
        if not isinstance(rows, (range, list, tuple)) or not all(map(_check.is_int, rows)):
            raise TypeCheckError(f"RandomPlanckianJitter: expected select_from to be ints, got {select_from!r}")
        if any(not 0 <= row < len(table) for row in rows):
            raise _UnknownModeError(
                f"RandomPlanckianJitter: expected select_from within 0 and {len(table) - 1}, got {select_from!r}"
            )
        self.mode = mode
        self._gains = tuple((red, 1.0, blue) for red, blue in (table[row] for row in rows))
        self._param_generator = PlanckianJitterGenerator((0, len(rows)))

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        if input.shape[1] != 3:
            raise ShapeError(
                f"RandomPlanckianJitter: expected images with 3 channels, got {tuple(input.shape)}"
                f"{_check.channels_advice(input.shape)}"
            )
        gains = constant(self._gains, input, torch.float32)[params["idx"]].to(input.dtype)
        return clamp(input * gains[..., None, None], 0, 1)
