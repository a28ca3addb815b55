"""Random changes of whole channels, and of the color of light."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, Literal, NamedTuple, TypeAlias

import torch
from torch import Tensor

from kvision import _check
from kvision._constants import constant
from kvision._dtype import compute_dtype
from kvision.augmentation.columns import Column
from kvision.augmentation.engine import Execution, Params
from kvision.augmentation.intensity_base import IntensityAugmentationBase2D
from kvision.augmentation.lists.pixels import PixelRow
from kvision.augmentation.lists.shuffle_channels import shuffle_channels_list
from kvision.augmentation.random_generator.color import (
    ChannelDropoutGenerator,
    ChannelShuffleGenerator,
    PlanckianJitterGenerator,
)
from kvision.augmentation.random_generator.planckian_data import BLACKBODY, CIED
from kvision.augmentation.warp_and_color import ColorPart, ColorStep, Pass, make_pass
from kvision.augmentation.warp_and_color_list import warp_and_color_to_list
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError
from kvision.geometry.transform.lists.arguments import like_batch

__all__ = ["RandomChannelDropout", "RandomChannelShuffle", "RandomPlanckianJitter"]

Illuminants: TypeAlias = Literal["blackbody", "CIED"]


class _Channels(IntensityAugmentationBase2D, keeps_contract=True):
    """Base of changes of channels."""

    def _operates_on(self, dtype: torch.dtype) -> bool:
        return not self._is_customized()


class Scaling(NamedTuple):
    """Images times factors and plus offsets, by a color program: (B, 1) for all channels, or (B, 3) for three."""

    factors: Tensor
    offsets: Tensor
    clips: bool  # the results to [0, 1]

    def __call__(self, images: Tensor) -> Tensor:
        program, columns = self._program(None)
        return program.run(images, columns)[0]

    def on_list(self, images: Sequence[Tensor], chosen: Tensor | None) -> list[Tensor]:
        """The results of images (C, H, W) of different sizes. Those that are not `chosen`, (B,), stay as they are; None for all."""
        program, columns = self._program(chosen)
        columns_of_all, fill, _, *rest = program.arguments(like_batch(images), columns)
        return list(warp_and_color_to_list(images, columns_of_all, fill, False, [], *rest)[: len(images)])

    def _program(self, chosen: Tensor | None) -> tuple[Pass, Tensor]:
        columns, count = [self.factors, self.offsets], 2 * self.factors.shape[1]
        if chosen is not None:  # samples that are not have an order without steps: 0.0 or -1.0, in one launch
            columns.append(chosen[:, None] + -1.0)
        name = "scale_shift" if count == 2 else "scale_shift_rgb"
        step = ColorStep(name, *map(Column, range(count)), float(self.clips))
        part = ColorPart([step], None if chosen is None else [count])
        return make_pass(None, parts=[part]), torch.cat(columns, 1)


class _ScaledChannels(_Channels, keeps_contract=True):
    """Base of what scales each channel of an image and adds to it: three by a color program, others by torch."""

    clips: ClassVar[bool]  # the results to [0, 1]

    def _run_list(self, images: Sequence[Tensor], execution: Execution) -> list[Tensor]:
        like, chosen = like_batch(images), execution.chosen
        params = self._params_on_device(like, execution, for_users=False)
        if like.shape[1] != 3:
            return self._list_by_torch(images, params, chosen)
        return self._scaling(like, params).on_list(images, chosen)

    def _factors_and_offsets(self, like: Tensor, params: Params) -> tuple[Tensor, Tensor]:
        """Numbers (B, C) of the channels of images like a batch."""
        raise NotImplementedError(f"{type(self).__name__}._factors_and_offsets")

    def _scaling(self, like: Tensor, params: Params) -> Scaling:
        return Scaling(*self._factors_and_offsets(like, params), self.clips)

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        if input.dim() != 4 or input.shape[1] != 3:
            return self._by_torch(input, params)
        return self._scaling(input, params)(input)

    def _by_torch(self, input: Tensor, params: Params) -> Tensor:
        raise NotImplementedError(f"{type(self).__name__}._by_torch")

    def _list_by_torch(self, images: Sequence[Tensor], params: Params, chosen: Tensor | None) -> list[Tensor]:
        raise NotImplementedError(f"{type(self).__name__}._list_by_torch")


class RandomChannelShuffle(_Channels, keeps_contract=True):
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

    def _run_list(self, images: Sequence[Tensor], execution: Execution) -> list[Tensor]:
        like, chosen = like_batch(images), execution.chosen
        if not like.shape[1]:  # nothing is drawn
            return list(images)
        orders = self._params_on_device(like, execution, for_users=False)["channels"]
        if chosen is not None:
            orders = torch.where(chosen[:, None], orders, torch.arange(like.shape[1], device=like.device))
        return list(shuffle_channels_list(images, orders))


class RandomChannelDropout(_ScaledChannels, keeps_contract=True):
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

    takes_volumes, clips = True, False

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

    def _factors_and_offsets(self, like: Tensor, params: Params) -> tuple[Tensor, Tensor]:
        kept = torch.ones(like.shape[:2], dtype=compute_dtype(like), device=like.device)
        kept = kept.scatter(1, params["channel_idx"], 0.0)
        is_bytes = like.dtype == torch.uint8
        return kept, (1 - kept) * (round(255 * self.fill_value) / 255 if is_bytes else self.fill_value)

    def _by_torch(self, input: Tensor, params: Params) -> Tensor:
        dropped = _planes(input, params["channel_idx"])
        return input.flatten(0, 1).index_fill(0, dropped, self._value(input.dtype)).view(input.shape)

    def _value(self, dtype: torch.dtype) -> float:
        """The value in the units of images."""
        return round(255 * self.fill_value) if dtype == torch.uint8 else self.fill_value

    def _list_by_torch(self, images: Sequence[Tensor], params: Params, chosen: Tensor | None) -> list[Tensor]:
        row, channels = PixelRow(images), params["channel_idx"]
        dropped = torch.zeros(len(images), images[0].shape[0], dtype=torch.bool, device=channels.device)
        dropped = dropped.scatter(1, channels, True)
        dropped = dropped if chosen is None else dropped & chosen[:, None]
        return row.split(row.of(images).masked_fill(row.of_channels(dropped), self._value(images[0].dtype)))


def _planes(images: Tensor, channels: Tensor) -> Tensor:
    """The indices among all planes of channels (B, n) of images (B, C, H, W)."""
    count = images.shape[1]
    return (channels + count * torch.arange(images.shape[0], device=images.device)[:, None]).flatten()


class _UnknownModeError(ValueCheckError, RuntimeError):
    """Kornia raises a RuntimeError."""


class RandomPlanckianJitter(_ScaledChannels, keeps_contract=True):
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

    clips = True

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

    def _factors_and_offsets(self, like: Tensor, params: Params) -> tuple[Tensor, Tensor]:
        gains = constant(self._gains, like, compute_dtype(like))[params["idx"]]
        return gains, torch.zeros_like(gains)

    def _by_torch(self, input: Tensor, params: Params) -> Tensor:
        raise ShapeError(
            f"RandomPlanckianJitter: expected images with 3 channels, got {tuple(input.shape)}"
            f"{_check.channels_advice(input.shape)}"
        )

    def _list_by_torch(self, images: Sequence[Tensor], params: Params, chosen: Tensor | None) -> list[Tensor]:
        return list(self._by_torch(like_batch(images), params))
