"""Generators of changes of single pixels and of channels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision.augmentation import ranges
from kvision.augmentation.draws import Draw
from kvision.augmentation.random_generator.base import RandomGeneratorBase, Shape
from kvision.augmentation.ranges import Numbers
from kvision.core.exceptions import TypeCheckError, ValueCheckError

__all__ = [
    "ChannelDropoutGenerator",
    "ChannelShuffleGenerator",
    "PlanckianJitterGenerator",
    "PosterizeGenerator",
]


class ScaledGenerator(RandomGeneratorBase):
    """Draws one factor, and for the kernels scale * factor + offset, by another name."""

    def __init__(
        self, op: str, name: str, value: Any, bounds: tuple[float, float], scaled: str, scale: float, offset: float
    ) -> None:
        super().__init__()
        (value,) = ranges.keep_parameters(self, **{name: value})
        self._range = ranges.parse(op, name, value, bounds=bounds)
        self.fields, self.hidden = ((f"{name}_factor", 0), (scaled, 0)), (scaled,)
        self._scale, self._offset = scale, offset

    def draws(self, shape: Shape) -> Sequence[Any]:
        return [self._range.uniform_and_affine(self._scale, self._offset, -self._offset / self._scale)]

    def to_columns(self, params: dict[str, Any], shape: Shape) -> Tensor:
        (factor, _), (scaled, _) = self.fields
        return super().to_columns({**params, scaled: ranges.affine(params[factor], self._scale, self._offset)}, shape)


class PosterizeGenerator(RandomGeneratorBase):
    """Draws the parameters of :class:`RandomPosterize`.

    Args:
        bits: a number b for b to 8, or a pair, of whole numbers within 0 and 8.

    Returns:
        bits_factor (B,), int32.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import kvision as K
        >>> K.augmentation.random_generator.PosterizeGenerator((3, 3))((2, 3, 8, 8))
        {'bits_factor': tensor([3, 3], dtype=torch.int32)}
    """

    fields = (("bits_factor", 0),)

    def __init__(self, bits: Numbers) -> None:
        super().__init__()
        if not isinstance(bits, (Sequence, Tensor)):
            bits = (bits, 8)
        elif isinstance(bits, Tensor) and bits.dim() == 0:
            bits = (bits.item(), 8)
        self._bits = ranges.parse("RandomPosterize", "bits", bits, bounds=(0.0, 8.0))

    def draws(self, shape: Shape) -> Sequence[Draw]:
        low, high = math.floor(self._bits.low), math.floor(self._bits.high)
        return [Draw("integer", (low, 1, high - low + 1, 8))]

    def to_params(self, columns: Tensor, shape: Shape) -> dict[str, Tensor]:
        return {"bits_factor": columns[:, 0].int()}

    def to_columns(self, params: dict[str, Any], shape: Shape) -> Tensor:
        return super().to_columns(params, shape).float()


class ChannelShuffleGenerator(RandomGeneratorBase):
    """Draws the parameters of :class:`RandomChannelShuffle`.

    Returns:
        channels (B, C), int64: which channel of the image each channel of the result is.

    Example:
        >>> import kvision as K
        >>> K.augmentation.random_generator.ChannelShuffleGenerator()((2, 3, 8, 8))["channels"].sum(1)
        tensor([3, 3])
    """

    draws_channels = True

    def draws(self, shape: Shape) -> Sequence[Draw]:
        return [Draw("permutation", (shape[1], 0, 1))]

    def to_params(self, columns: Tensor, shape: Shape) -> dict[str, Tensor]:
        return {"channels": columns.long()}

    def to_columns(self, params: dict[str, Any], shape: Shape) -> Tensor:
        return params["channels"].float()


class ChannelDropoutGenerator(RandomGeneratorBase):
    """Draws the parameters of :class:`RandomChannelDropout`.

    Args:
        num_drop_channels: how many channels of each image are dropped.

    Returns:
        batch_idx and channel_idx (B, num_drop_channels), int64.

    Raises:
        TypeError: `num_drop_channels` is not an int.
        ValueError: it is below 1, or above the number of channels.

    Example:
        >>> import kvision as K
        >>> K.augmentation.random_generator.ChannelDropoutGenerator(3)((1, 3, 8, 8))["channel_idx"].sort().values
        tensor([[0, 1, 2]])
    """

    draws_channels = True

    def __init__(self, num_drop_channels: int) -> None:
        super().__init__()
        num_drop_channels = _check.scalar("RandomChannelDropout", "num_drop_channels", num_drop_channels)
        if type(num_drop_channels) is not int:
            raise TypeCheckError(
                f"RandomChannelDropout: expected num_drop_channels to be an int, got {num_drop_channels!r}"
            )
        if num_drop_channels < 1:
            raise ValueCheckError(
                f"RandomChannelDropout: expected num_drop_channels of at least 1, got {num_drop_channels}"
            )
        self.num_drop_channels = num_drop_channels

    def draws(self, shape: Shape) -> Sequence[Draw]:
        if self.num_drop_channels > shape[1]:
            raise ValueCheckError(
                f"RandomChannelDropout: expected at least {self.num_drop_channels} channels, got {tuple(shape)}"
            )
        return [Draw("permutation", (shape[1], 0, 1))]

    def to_params(self, columns: Tensor, shape: Shape) -> dict[str, Tensor]:
        dropped = columns[:, : self.num_drop_channels].long()
        batch = torch.arange(shape[0], device=columns.device)[:, None].expand_as(dropped)
        return {"batch_idx": batch, "channel_idx": dropped}


class PlanckianJitterGenerator(RandomGeneratorBase):
    """Draws the parameters of :class:`RandomPlanckianJitter`.

    Args:
        domain: lowest row of the table, and the end of the range of rows.

    Returns:
        idx (B,), int64.

    Raises:
        ValueError: an empty range.

    Example:
        >>> import kvision as K
        >>> K.augmentation.random_generator.PlanckianJitterGenerator([3, 4])((2, 3, 8, 8))
        {'idx': tensor([3, 3])}
    """

    def __init__(self, domain: Any) -> None:
        super().__init__()
        low, end = (int(x) for x in domain)
        if not 0 <= low < end:
            raise ValueCheckError(f"RandomPlanckianJitter: expected domain in ascending order, got {domain!r}")
        self._domain = low, end

    def draws(self, shape: Shape) -> Sequence[Draw]:
        low, end = self._domain
        return [Draw("integer", (low, 1, end - low, low))]

    def to_params(self, columns: Tensor, shape: Shape) -> dict[str, Tensor]:
        return {"idx": columns[:, 0].long()}

    def to_columns(self, params: dict[str, Any], shape: Shape) -> Tensor:
        return params["idx"][:, None].float()
