"""Intensity augmentations: pixels keep their positions, so masks, boxes and points stay as they are."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import torch
from torch import Tensor

from kvision import _check
from kvision.augmentation.draws import Draw, Request
from kvision.augmentation.engine import (
    Colors,
    Contribution,
    Execution,
    Params,
    RigidAffineAugmentationBase2D,
    RigidAffineAugmentationBase3D,
    Shape,
)
from kvision.augmentation.lists.pixels import PixelRow
from kvision.augmentation.lists.replays import replay_pixels
from kvision.augmentation.warp_and_color import ColorStep, make_pass
from kvision.color.scale_shift import bytes_of_floats, floats_of_bytes
from kvision.color.steps import STEPS

__all__ = ["IntensityAugmentationBase2D", "IntensityAugmentationBase3D"]


_OF_COLORS = ("hue", "saturation", "saturation_gray")
_NOTHING = ColorStep("scale_shift", 1.0)


class IntensityAugmentationBase2D(RigidAffineAugmentationBase2D, keeps_contract=True):
    """Base of augmentations that change values and no positions; the matrix is the identity.

    A subclass declares a part of a color program, `color_steps`, or overrides `apply_transform`. One that gives each slice of
    a volume (B, C, D, H, W) its own result says `takes_volumes`; color programs take volumes, too.

    Args:
        p: probability that a sample is augmented.
        p_batch: probability that a batch is.
        same_on_batch: all samples get the same parameters.
        keepdim: an image (C, H, W) gives an image (C, h, w) instead of a batch of one.
        generator: draws the key of each call; default: torch's generator.
        return_transform: calls return the image and its matrix.

    Raises:
        TypeError: `p` or `p_batch` is not a number.
        ValueError: `p` or `p_batch` is not within 0 and 1.

    Example:
        >>> import torch, kvision as K
        >>> class Negative(K.augmentation.IntensityAugmentationBase2D):
        ...     def apply_transform(self, input, params, flags, transform=None):
        ...         return 1 - input
        >>> Negative(p=1.0)(torch.zeros(1, 1, 1, 2))
        tensor([[[[1., 1.]]]])
    """

    keeps_positions = True
    takes_volumes = False
    order_of_steps: ClassVar[str | None] = None  # the field with numbers of steps in their order; None: as listed
    _is_by_pixel = False  # whether `apply_transform` draws nothing and computes each pixel from its channels alone
    _of_pixels: Sequence[str] = ()  # the parameters of each pixel, where these alone say what it becomes

    def color_steps(self, shape: Shape, flags: dict[str, Any]) -> Sequence[ColorStep] | None:
        """The steps, whose parameters are numbers or names of fields; None if `apply_transform` is overridden instead."""
        return None

    def _steps(self, shape: Shape, flags: dict[str, Any]) -> Sequence[ColorStep] | None:
        """The steps for images of a shape: those that change colors change nothing where there are none."""
        steps = self.color_steps(shape, flags)
        if steps is None or shape[1] == 3:
            return steps
        served = [_NOTHING if step.name in _OF_COLORS else step for step in steps]
        if any(STEPS[step.name].domain == "rgb" for step in served):
            _check.rgb(type(self).__name__, shape)
        return served

    def _declared(self, shape: Shape, flags: dict[str, Any]) -> Contribution:
        steps = self._steps(shape, flags)
        if steps is None:
            return Contribution(takes_volumes=self.takes_volumes)
        return Contribution(None, Colors(steps, self.order_of_steps), takes_volumes=True)

    def _request(self, shape: Shape, is_certain: bool = False, has_chosen: bool = False) -> Request | None:
        request = super()._request(shape, is_certain, has_chosen)
        steps = self.color_steps(shape, self.flags)
        if request is None or steps is None or self.order_of_steps or request.draws[0].kind != "chosen":
            return request
        # Samples that are not chosen have an order without steps.
        order = [Draw("integer", (i, 1, 1, -1)) for i in range(len(steps))]
        return request._replace(draws=[*request.draws, *order])

    def _executes_columns(self, shape: Shape) -> bool:
        return self.color_steps(shape, self.flags) is not None

    def _further_columns(self, shape: Shape, values: Tensor, chosen: Tensor | None) -> list[Tensor]:
        steps = self.color_steps(shape, self.flags)
        if steps is None or self.order_of_steps or chosen is None:
            return []
        order = torch.arange(len(steps), device=values.device, dtype=values.dtype)
        return [torch.where(chosen[:, None], order, -1)]

    def _run(self, x: Tensor, execution: Execution, flags: dict[str, Any]) -> Tensor:
        if not execution.applied:
            return x
        columns = execution.columns
        by_name = columns is None and execution.params is not None
        image_pass = None if by_name else self._kept_pass(x.dtype, execution, flags)
        if image_pass is None:
            return super()._run(x, execution, flags)
        return image_pass.run(x, None if columns is None else columns.drawn)[0]

    def _operates_on(self, dtype: torch.dtype) -> bool:
        return not self._is_customized() if self._is_by_pixel else super()._operates_on(dtype)

    def _run_list(self, images: Sequence[Tensor], execution: Execution) -> list[Tensor]:
        if self._is_by_pixel:
            return self._run_pixels(images, execution.chosen)
        if execution.params is None or not self._of_pixels:
            return super()._run_list(images, execution)
        return replay_pixels(self, images, execution, self._of_pixels)

    def _run_pixels(self, images: Sequence[Tensor], chosen: Tensor | None) -> list[Tensor]:
        """Execute on all pixels of a list at once."""
        row, result = PixelRow(images), self._result_dtype(images[0].dtype)
        x = row.by_channel()
        x = floats_of_bytes(x) if x.dtype == torch.uint8 else x
        y = self.apply_transform(x, {}, self.flags)
        y = y if chosen is None else torch.where(row.of_pixels(chosen), y, x)
        return row.split_channels(bytes_of_floats(y) if result == torch.uint8 else y.to(result))

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        colors = self._declared(tuple(input.shape), flags).colors
        if colors is None:
            raise NotImplementedError(f"{type(self).__name__}.apply_transform")
        columns = None
        if self._param_generator is not None:
            columns = self._param_generator.to_columns(params, tuple(input.shape)).to(input.device)
        return make_pass(None, parts=[self._color_part(colors, None)]).run(input, columns)[0]


class IntensityAugmentationBase3D(RigidAffineAugmentationBase3D):
    """Base of augmentations of volumes that change values and no positions.

    Args:
        p: probability that a sample is augmented.
        p_batch: probability that a batch is.
        same_on_batch: all samples get the same parameters.
        keepdim: an image (C, H, W) gives an image (C, h, w) instead of a batch of one.
        generator: draws the key of each call; default: torch's generator.
        return_transform: calls return the image and its matrix.

    Example:
        >>> import torch, kvision as K
        >>> class Negative(K.augmentation.IntensityAugmentationBase3D):
        ...     def apply_transform(self, input, params, flags, transform=None):
        ...         return 1 - input
        >>> Negative(p=1.0)(torch.zeros(1, 1, 1, 1, 2))
        tensor([[[[[1., 1.]]]]])
    """

    keeps_positions = True
