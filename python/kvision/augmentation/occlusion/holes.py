"""Rectangles and stripes that are dropped from images."""

from __future__ import annotations

from typing import Any, Literal

import torch
from torch import Tensor

from kvision.augmentation import ranges
from kvision.augmentation.engine import Params
from kvision.augmentation.erase import erase_rectangles
from kvision.augmentation.occlusion.dropout_base import ErasingDropout
from kvision.augmentation.random_generator.occlusion import Holes, HolesGenerator, Lengths
from kvision.augmentation.ranges import Numbers
from kvision.core.exceptions import ValueCheckError


class HoleDropout(ErasingDropout, keeps_contract=True):
    """A class whose parameter `holes` (B, N, 4) has the x, y, width and height of rectangles."""

    eraser = erase_rectangles

    def _parts(self, params: Params, shape: tuple[int, ...], device: torch.device) -> Tensor:
        drawn: Tensor = params["holes"].to(device, torch.float32)
        return drawn


class CoarseDropout(HoleDropout, keeps_contract=True):
    """Fill a random number of rectangles of each image with a value, and of its masks.

    Args:
        num_holes_range: pair of the lowest and the highest number of holes, of at least 1.
        hole_height_range: pair of lowest and highest height: floats are fractions of the image's, ints are pixels.
        hole_width_range: the same of the width.
        fill: the fill value, within 0 and 1: a number, one of each channel, or 'random' for uniform noise.
        fill_mask: the value of masks in holes; None leaves masks as they are.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import torch, kvision as K
        >>> drop = K.augmentation.CoarseDropout((1, 1), (2, 2), (3, 3), p=1.0)
        >>> drop(torch.ones(1, 1, 8, 8)).sum()
        tensor(58.)
    """

    keeps_unchosen = True

    def __init__(
        self,
        num_holes_range: tuple[int, int] = (1, 2),
        hole_height_range: Numbers = (0.1, 0.2),
        hole_width_range: Numbers = (0.1, 0.2),
        fill: Numbers | Literal["random"] = 0.0,
        fill_mask: float | None = 0.0,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(fill, fill_mask, p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        op = "CoarseDropout"
        holes = Holes(
            ranges.parse_integers(op, "num_holes_range", num_holes_range, 1),
            Lengths.parse(op, "hole_height_range", hole_height_range),
            Lengths.parse(op, "hole_width_range", hole_width_range),
        )
        self._param_generator = HolesGenerator(op, [holes], self.fill)


class XYMasking(HoleDropout, keeps_contract=True):
    """Fill stripes of images, such as spectrograms, with a value: some along x, which are as high as the image, some along y.

    Args:
        num_masks_x_range: pair of the lowest and the highest number of stripes along x.
        num_masks_y_range: the same along y.
        mask_x_length_range: pair of the lowest and the highest width of stripes along x: floats are fractions of the image's, ints
            are pixels.
        mask_y_length_range: the same of the height of stripes along y.
        fill: the fill value, within 0 and 1: a number, one of each channel, or 'random' for uniform noise.
        fill_mask: the value of masks in stripes; None leaves masks as they are.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds; there are no stripes.

    Example:
        >>> import torch, kvision as K
        >>> mask = K.augmentation.XYMasking((1, 1), (1, 1), (2, 2), (3, 3), p=1.0)
        >>> mask(torch.ones(1, 1, 8, 8)).sum()
        tensor(30.)
    """

    keeps_unchosen = True

    def __init__(
        self,
        num_masks_x_range: tuple[int, int] = (0, 0),
        num_masks_y_range: tuple[int, int] = (0, 0),
        mask_x_length_range: Numbers = (0, 0),
        mask_y_length_range: Numbers = (0, 0),
        fill: Numbers | Literal["random"] = 0.0,
        fill_mask: float | None = 0.0,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(fill, fill_mask, p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        op = type(self).__name__
        along_x = Holes(
            ranges.parse_integers(op, "num_masks_x_range", num_masks_x_range, 0),
            widths=Lengths.parse(op, "mask_x_length_range", mask_x_length_range),
        )
        along_y = Holes(
            ranges.parse_integers(op, "num_masks_y_range", num_masks_y_range, 0),
            Lengths.parse(op, "mask_y_length_range", mask_y_length_range),
        )
        if along_x.number[1] == along_y.number[1] == 0:
            raise ValueCheckError(
                f"{op}: expected num_masks_x_range or num_masks_y_range with more than 0 stripes, got none"
            )
        self._param_generator = HolesGenerator(op, [along_x, along_y], self.fill)


class TimeMasking(XYMasking, keeps_contract=True):
    """Set a random interval of time, the last axis of a spectrogram (C, F, T), to 0.

    Source: Park and others, SpecAugment, Interspeech 2019.

    Args:
        time_mask_param: the longest interval, in pixels.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: `time_mask_param` is not a positive int.

    Example:
        >>> import torch, kvision as K
        >>> masked = K.augmentation.TimeMasking(4, p=1.0)(torch.ones(1, 1, 8, 16))
        >>> bool((masked == masked[:, :, :1]).all())
        True
    """

    def __init__(
        self,
        time_mask_param: int = 40,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        (_, longest) = ranges.parse_integers("TimeMasking", "time_mask_param", (1, time_mask_param))
        super().__init__((1, 1), (0, 0), (0, longest), same_on_batch=same_on_batch, p=p, keepdim=keepdim, **options)


class FrequencyMasking(XYMasking, keeps_contract=True):
    """Set a random band of frequencies, the second axis of a spectrogram (C, F, T), to 0.

    Source: Park and others, SpecAugment, Interspeech 2019.

    Args:
        freq_mask_param: the widest band, in pixels.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: `freq_mask_param` is not a positive int.

    Example:
        >>> import torch, kvision as K
        >>> masked = K.augmentation.FrequencyMasking(4, p=1.0)(torch.ones(1, 1, 8, 16))
        >>> bool((masked == masked[..., :1]).all())
        True
    """

    def __init__(
        self,
        freq_mask_param: int = 30,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        (_, widest) = ranges.parse_integers("FrequencyMasking", "freq_mask_param", (1, freq_mask_param))
        super().__init__(
            (0, 0), (1, 1), (0, 0), (0, widest), same_on_batch=same_on_batch, p=p, keepdim=keepdim, **options
        )
