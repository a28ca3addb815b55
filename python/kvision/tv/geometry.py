"""v2's classes that move pixels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from kvision import _check
from kvision._tv_tensors import kind_of, plain, wrap
from kvision.metrics import mean_iou_bbox
from kvision.tv import argument, draw
from kvision.tv import functional as F
from kvision.tv.functional.geometry import InterpolationMode, four_paddings, interpolation_name, windows_of
from kvision.tv.inputs import PIXELS
from kvision.tv.transform import Call, Chance, RandomTransform, Step, Transform, size_of

__all__ = [
    "CenterCrop", "ElasticTransform", "FiveCrop", "Pad", "RandomAffine", "RandomCrop", "RandomHorizontalFlip",
    "RandomIoUCrop", "RandomPerspective", "RandomResize", "RandomResizedCrop", "RandomRotation",
    "RandomShortestSize", "RandomVerticalFlip", "RandomZoomOut", "Resize", "ScaleJitter", "TenCrop",
]  # fmt: skip

Fill = float | Sequence[float] | None | dict[Any, Any]
Interpolation = InterpolationMode | str | int


class _Flip(RandomTransform):
    def _step(self, dtype: torch.dtype, channels: int) -> Step | None:
        return type(self).__name__, (("p", self.p),)


class RandomHorizontalFlip(_Flip, function=F.horizontal_flip):
    """Mirror the columns with a probability.

    Args:
        p: the probability.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.RandomHorizontalFlip(p=1.0)(torch.zeros(1, 2, 3)).shape
        torch.Size([1, 2, 3])
    """


class RandomVerticalFlip(_Flip, function=F.vertical_flip):
    """Mirror the rows with a probability.

    Args:
        p: the probability.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.RandomVerticalFlip(p=1.0)(torch.zeros(1, 2, 3)).shape
        torch.Size([1, 2, 3])
    """


class Resize(Transform, function=F.resize):
    """Resize to a height and width, or by the shorter or the longer side.

    Args:
        size: height and width; an int for the shorter side; None where max_size has the longer one.
        interpolation: 'nearest', 'nearest-exact', 'bilinear', 'bicubic' or 'lanczos', also as InterpolationMode or
            PIL's integer.
        max_size: the longest that the longer side may become where size is an int.
        antialias: where the image becomes smaller, average the pixels that a pixel of the result covers.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.Resize(4)(torch.zeros(3, 8, 6)).shape
        torch.Size([3, 5, 4])
    """

    size: int | Sequence[int] | None
    interpolation: Interpolation = "bilinear"
    max_size: int | None = None
    antialias: bool | None = True

    checks = {"size": argument.optional(argument.where(argument.several, lambda v: len(v) < 3, "one or two ints"))}

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.size is None:
            (self.max_size,) = _check.ints("Resize", "max_size where size is None", self.max_size, 1)


class ScaleJitter(Transform, function=F.resize):
    """Resize by a random factor of the largest size that fits into a target.

    Args:
        target_size: height and width of the target.
        scale_range: least and largest factor.
        interpolation: 'nearest', 'nearest-exact', 'bilinear', 'bicubic' or 'lanczos', also as InterpolationMode or
            PIL's integer.
        antialias: where the image becomes smaller, average the pixels that a pixel of the result covers.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.ScaleJitter((16, 16), (1.0, 1.0))(torch.zeros(3, 8, 6)).shape
        torch.Size([3, 16, 12])
    """

    target_size: tuple[int, int]
    scale_range: tuple[float, float] = (0.1, 2.0)
    interpolation: Interpolation = "bilinear"
    antialias: bool | None = True

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        height, width = size_of(flat_inputs)
        r = min(self.target_size[1] / height, self.target_size[0] / width) * draw.between(self.scale_range)
        return {"size": (int(height * r), int(width * r))}


class RandomShortestSize(Transform, function=F.resize):
    """Resize the shorter side to a random one of some sizes.

    Args:
        min_size: sizes of the shorter side, or one.
        max_size: the longest that the longer side may become.
        interpolation: 'nearest', 'nearest-exact', 'bilinear', 'bicubic' or 'lanczos', also as InterpolationMode or
            PIL's integer.
        antialias: where the image becomes smaller, average the pixels that a pixel of the result covers.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.RandomShortestSize([3])(torch.zeros(3, 8, 6)).shape
        torch.Size([3, 4, 3])
    """

    min_size: int | Sequence[int]
    max_size: int | None = None
    interpolation: Interpolation = "bilinear"
    antialias: bool | None = True

    checks = {"min_size": argument.several}

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        height, width = size_of(flat_inputs)
        sizes: Any = self.min_size
        r = sizes[draw.integer(0, len(sizes))] / min(height, width)
        r = r if self.max_size is None else min(r, self.max_size / max(height, width))
        return {"size": (int(height * r), int(width * r)), "max_size": None}


class RandomResize(Transform, function=F.resize):
    """Resize the shorter side to a random size.

    Args:
        min_size: the least size.
        max_size: a size above all others.
        interpolation: 'nearest', 'nearest-exact', 'bilinear', 'bicubic' or 'lanczos', also as InterpolationMode or
            PIL's integer.
        antialias: where the image becomes smaller, average the pixels that a pixel of the result covers.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.RandomResize(3, 4)(torch.zeros(3, 8, 6)).shape
        torch.Size([3, 4, 3])
    """

    min_size: int
    max_size: int
    interpolation: Interpolation = "bilinear"
    antialias: bool | None = True

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        return {"size": [draw.integer(self.min_size, self.max_size)], "max_size": None}


class CenterCrop(Transform, function=F.center_crop, renamed={"size": "output_size"}):
    """Cut the center out; a larger size is padded with black.

    Args:
        size: height and width, an int for both.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.CenterCrop(4)(torch.zeros(3, 8, 6)).shape
        torch.Size([3, 4, 4])
    """

    size: int | Sequence[int]


class FiveCrop(Transform, function=F.five_crop, refused={"boxes", "mask"}):
    """Cut out the corners and the center: a tuple of five.

    Args:
        size: height and width, an int for both.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> len(tv.FiveCrop(4)(torch.zeros(3, 8, 6)))
        5
    """

    size: int | Sequence[int]


class TenCrop(Transform, function=F.ten_crop, refused={"boxes", "mask"}):
    """Cut out the corners and the center, and those of the mirrored image: a tuple of ten.

    Args:
        size: height and width, an int for both.
        vertical_flip: mirror the rows, not the columns.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> len(tv.TenCrop(4)(torch.zeros(3, 8, 6)))
        10
    """

    size: int | Sequence[int]
    vertical_flip: bool = False


def drawn_window(height: int, width: int, scale: Any, ratio: Any) -> tuple[int, int]:
    """A height and width by a share of the area and an aspect ratio (width / height), both drawn."""
    area, aspect = height * width * draw.uniform(scale), draw.log_uniform(ratio)
    return round(math.sqrt(area / aspect)), round(math.sqrt(area * aspect))


class RandomResizedCrop(Transform, function=F.resized_crop, draws=True):
    """Cut out a random window and resize it.

    Args:
        size: height and width, an int for both.
        scale: least and largest share of the image's area.
        ratio: least and largest width over height.
        interpolation: 'nearest', 'nearest-exact', 'bilinear', 'bicubic' or 'lanczos', also as InterpolationMode or
            PIL's integer.
        antialias: where the image becomes smaller, average the pixels that a pixel of the result covers.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.RandomResizedCrop(4)(torch.zeros(3, 8, 6)).shape
        torch.Size([3, 4, 4])
    """

    size: int | Sequence[int]
    scale: Sequence[float] = (0.08, 1.0)
    ratio: Sequence[float] = (3.0 / 4.0, 4.0 / 3.0)
    interpolation: Interpolation = "bilinear"
    antialias: bool | None = True

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        height, width = size_of(flat_inputs)
        for _ in range(10):
            h, w = drawn_window(height, width, self.scale, self.ratio)
            if 0 < h <= height and 0 < w <= width:
                top, left = draw.integer(0, height - h + 1), draw.integer(0, width - w + 1)
                return {"top": top, "left": left, "height": h, "width": w}
        h = min(height, round(width / min(self.ratio)))
        w = min(width, round(height * max(self.ratio)))
        return {"top": (height - h) // 2, "left": (width - w) // 2, "height": h, "width": w}

    def _step(self, dtype: torch.dtype, channels: int) -> Step | None:
        is_bilinear = interpolation_name("RandomResizedCrop", self.interpolation) == "bilinear"
        if dtype not in (torch.uint8, torch.float32) or not (self.antialias and is_bilinear):
            return None
        options = (("align_corners", False), ("antialias", True))
        return "RandomResizedCrop", (("size", self.size), ("scale", self.scale), ("ratio", self.ratio), *options)


class Pad(Transform, function=F.pad):
    """Add pixels at the borders.

    Args:
        padding: how many: an int; x and y; or left, top, right and bottom.
        fill: color of new pixels: a number, one of each channel, or a dict of them by class of input, with "others"
            for the rest.
        padding_mode: 'constant', 'edge', 'reflect' or 'symmetric'.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.Pad([1, 2])(torch.zeros(3, 8, 6)).shape
        torch.Size([3, 12, 8])
    """

    padding: int | Sequence[int]
    fill: Fill = 0
    padding_mode: str = "constant"


class RandomZoomOut(Chance, function=F.pad, draws=False):
    """Place the image at random on a larger canvas, with a probability.

    Args:
        fill: color of new pixels: a number, one of each channel, or a dict of them by class of input, with "others"
            for the rest.
        side_range: least and largest side of the canvas in those of the image.
        p: the probability.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.RandomZoomOut(side_range=(2.0, 2.0), p=1.0)(torch.zeros(3, 8, 6)).shape
        torch.Size([3, 16, 12])
    """

    fill: Fill = 0
    side_range: Sequence[float] = (1.0, 4.0)
    p: float = 0.5

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        height, width = size_of(flat_inputs)
        r = draw.between(self.side_range)
        right, bottom = int(width * r) - width, int(height * r) - height
        r = torch.rand(2, device="cpu")
        left, top = int(right * r[0]), int(bottom * r[1])
        return {"padding": [left, top, right - left, bottom - top]}


class RandomCrop(Transform, function=F.pad, draws=True):
    """Cut out a random window.

    Args:
        size: height and width, an int for both.
        padding: pixels added before, as in :class:`Pad`.
        pad_if_needed: add the pixels that a smaller image lacks, on both sides.
        fill: color of new pixels: a number, one of each channel, or a dict of them by class of input, with "others"
            for the rest.
        padding_mode: 'constant', 'edge', 'reflect' or 'symmetric'.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.RandomCrop(4)(torch.zeros(3, 8, 6)).shape
        torch.Size([3, 4, 4])
    """

    size: int | Sequence[int]
    padding: int | Sequence[int] | None = None
    pad_if_needed: bool = False
    fill: Fill = 0
    padding_mode: str = "constant"

    checks = {"padding": argument.optional(argument.padding)}

    def _room(self, size: tuple[int, int]) -> tuple[list[int], tuple[int, int]]:
        """The padding, and how many rows and columns the padded image has more than the window."""
        crop: Any = self.size
        left, right, top, bottom = four_paddings(self.padding or 0)
        missing = [max(c - n - p, 0) for c, n, p in zip(crop, size, (top + bottom, left + right))]
        if any(missing) and not self.pad_if_needed:
            raise ValueError(f"RandomCrop: expected images of at least {crop} with their padding, got {size}")
        top, bottom, left, right = top + missing[0], bottom + missing[0], left + missing[1], right + missing[1]
        over = size[0] + top + bottom - crop[0], size[1] + left + right - crop[1]
        return [left, top, right, bottom], over

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        padding, over = self._room(size_of(flat_inputs))
        y, x = (draw.integer(0, n + 1) if n else 0 for n in over)
        return {"padding": padding, "top": y, "left": x, "crops": any(over)}

    def _each(self, flat: list[Any], needed: list[bool], samples: int) -> list[Any]:
        """As of the base, by arrays of what samples draw, which takes the host less than a tenth."""
        images = [x for x, is_needed in zip(flat, needed) if is_needed]
        padding, over = self._room(size_of(images))
        if not (self._applies_functions and any(over) and all(kind_of(x) in PIXELS for x in images)):
            return super()._each(flat, needed, samples)
        moved = np.flatnonzero(over)
        corners = np.zeros((samples, 2), np.int64)
        with draw.together():
            corners[:, moved] = draw.units(samples * len(moved)).reshape(samples, -1) * (np.array(over)[moved] + 1)
        outputs = list(flat)
        for i, x in enumerate(flat):
            if needed[i]:
                padded = F.pad(x, **{**self._options_for(x), "padding": padding}) if any(padding) else x
                outputs[i] = wrap(windows_of(plain(padded), corners, *self.size), x)  # type: ignore[misc]  # both by now
        return outputs

    def _calls(self, options: dict[str, Any], params: dict[str, Any]) -> list[Call]:
        height, width = self.size  # type: ignore[misc]  # both by now
        window = {"top": params["top"], "left": params["left"], "height": height, "width": width}
        pad: list[Call] = [(F.pad, {**options, "padding": params["padding"]})] if any(params["padding"]) else []
        return [*pad, (F.crop, window)] if params["crops"] else pad


class RandomRotation(Transform, function=F.rotate):
    """Rotate by a random angle, counterclockwise.

    Args:
        degrees: least and largest angle in degrees, or a for [-a, a].
        interpolation: 'nearest' or 'bilinear', also as InterpolationMode or PIL's integer.
        expand: enlarge the result to hold the rotated image; a batch then draws once.
        center: x and y to rotate around, None for the center.
        fill: color of new pixels: a number, one of each channel, or a dict of them by class of input, with "others"
            for the rest.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.RandomRotation(30)(torch.zeros(3, 8, 6)).shape
        torch.Size([3, 8, 6])
    """

    degrees: float | Sequence[float]
    interpolation: Interpolation = "nearest"
    expand: bool = False
    center: Sequence[float] | None = None
    fill: Fill = 0

    @property
    def draws(self) -> bool:  # type: ignore[override]  # depends on the size of results
        return not self.expand

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        return {"angle": draw.uniform(self.degrees)}


class RandomAffine(Transform, function=F.affine, draws=True):
    """Warp by a random rotation, translation, scale and shear.

    Args:
        degrees: least and largest angle in degrees, or a for [-a, a].
        translate: largest shift in x and y, in shares of width and height.
        scale: least and largest factor.
        shear: least and largest angle in x, or four numbers for x and y; a for [-a, a] in x.
        interpolation: 'nearest' or 'bilinear', also as InterpolationMode or PIL's integer.
        fill: color of new pixels: a number, one of each channel, or a dict of them by class of input, with "others"
            for the rest.
        center: x and y of what stays, None for the center.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.RandomAffine(10, translate=(0.1, 0.1))(torch.zeros(3, 8, 6)).shape
        torch.Size([3, 8, 6])
    """

    degrees: float | Sequence[float]
    translate: Sequence[float] | None = None
    scale: Sequence[float] | None = None
    shear: float | Sequence[float] | None = None
    interpolation: Interpolation = "nearest"
    fill: Fill = 0
    center: Sequence[float] | None = None

    checks = {"scale": argument.optional(argument.above_0), "shear": argument.optional(argument.interval)}

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        (height, width), shear = size_of(flat_inputs), [0.0, 0.0]
        angles: Any = self.shear or ()
        angle = draw.uniform(self.degrees)
        most = [t * n for t, n in zip(self.translate or (0, 0), (width, height))]
        shift = [round(draw.uniform((-n, n))) for n in most] if self.translate else most
        scale = draw.uniform(self.scale) if self.scale else 1.0
        for i in range(len(angles) // 2):
            shear[i] = draw.uniform(angles[2 * i : 2 * i + 2])
        return {"angle": angle, "translate": shift, "scale": scale, "shear": shear}


class RandomPerspective(Chance, function=F.perspective):
    """Move the corners at random, with a probability.

    Args:
        distortion_scale: how far, in shares of half the image.
        p: the probability.
        interpolation: 'nearest' or 'bilinear', also as InterpolationMode or PIL's integer.
        fill: color of new pixels: a number, one of each channel, or a dict of them by class of input, with "others"
            for the rest.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.RandomPerspective(p=1.0)(torch.zeros(3, 8, 6)).shape
        torch.Size([3, 8, 6])
    """

    distortion_scale: float = 0.5
    p: float = 0.5
    interpolation: Interpolation = "bilinear"
    fill: Fill = 0

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        height, width = size_of(flat_inputs)
        y, x = (int(self.distortion_scale * (n // 2)) + 1 for n in (height, width))
        left, right, top, bottom = (0, x), (width - x, width), (0, y), (height - y, height)
        corners = (left, top), (right, top), (right, bottom), (left, bottom)
        ends = [[draw.integer(*u), draw.integer(*v)] for u, v in corners]
        starts = [[0, 0], [width - 1, 0], [width - 1, height - 1], [0, height - 1]]
        return {"startpoints": starts, "endpoints": ends}


class ElasticTransform(Transform, function=F.elastic, draws=True):
    """Move the pixels by smooth random displacements.

    Args:
        alpha: largest displacement before the smoothing, in pixels, or two for x and y.
        sigma: standard deviation of the smoothing, or two.
        interpolation: 'nearest' or 'bilinear', also as InterpolationMode or PIL's integer.
        fill: color of new pixels: a number, one of each channel, or a dict of them by class of input, with "others"
            for the rest.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.ElasticTransform(sigma=0.5)(torch.zeros(3, 8, 6)).shape
        torch.Size([3, 8, 6])
    """

    alpha: float | Sequence[float] = 50.0
    sigma: float | Sequence[float] = 5.0
    interpolation: Interpolation = "bilinear"
    fill: Fill = 0

    checks = dict.fromkeys(("alpha", "sigma"), argument.two_numbers)

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        size, displacements = size_of(flat_inputs), []
        for alpha, sigma, pixels in zip(self.alpha, self.sigma, size[::-1]):  # type: ignore[arg-type]  # two by now
            d = torch.rand(1, 1, *size, device="cpu") * 2 - 1
            if sigma > 0:
                d = F.gaussian_blur(d, [int(8 * sigma + 1) | 1] * 2, self.sigma)
            displacements.append(d[0] * alpha / pixels)
        return {"displacement": torch.stack(displacements, 3)}


class RandomIoUCrop(Transform):
    """Cut out a random window that overlaps a box by at least a random share.

    Args:
        min_scale: least share of height and width.
        max_scale: largest share.
        min_aspect_ratio: least width over height.
        max_aspect_ratio: largest width over height.
        sampler_options: least overlaps (intersection over union) to choose from; 1 or more leaves the image.
        trials: how many windows are tried before another overlap is chosen.

    Example:
        >>> from kvision import tv
        >>> tv.RandomIoUCrop(trials=10).trials
        10
    """

    min_scale: float = 0.3
    max_scale: float = 1.0
    min_aspect_ratio: float = 0.5
    max_aspect_ratio: float = 2.0
    sampler_options: list[float] | None = None
    trials: int = 40

    def check_inputs(self, flat_inputs: list[Any]) -> None:
        kinds = {kind_of(x) for x in flat_inputs}
        if "boxes" not in kinds or not kinds & {"tensor", "image", "pil"}:
            raise TypeError("RandomIoUCrop: expected an image and boxes in the sample")

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any] | None:
        height, width = size_of(flat_inputs)
        boxes = next(x for x in flat_inputs if kind_of(x) == "boxes")
        edges = plain(F.convert_bounding_box_format(boxes, new_format="XYXY"))
        center = (edges[:, :2] + edges[:, 2:]) * 0.5
        options = self.sampler_options or (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0)
        while (least := options[draw.integer(0, len(options))]) < 1:  # which leaves the sample as it is
            for _ in range(self.trials):
                r = draw.between((self.min_scale, self.max_scale), 2)
                w, h = int(width * r[0]), int(height * r[1])
                if not self.min_aspect_ratio <= w / h <= self.max_aspect_ratio:
                    continue
                r = torch.rand(2, device="cpu")
                left, top = int((width - w) * r[0]), int((height - h) * r[1])
                window = edges.new_tensor([left, top, left + w, top + h])
                inside = ((window[:2] < center) & (center < window[2:])).all(1)
                if not (w and h and inside.any()):
                    continue
                if mean_iou_bbox(edges[inside], window[None]).nan_to_num().max() >= least:
                    return {"top": top, "left": left, "height": h, "width": w, "is_within_crop_area": inside}
        return None

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        *window, inside = params.values()
        output = self._call_kernel(F.crop, inpt, *window)
        if kind_of(output) != "boxes":
            return output
        return wrap(plain(output).masked_fill(~inside[:, None], 0), output)  # empty, for SanitizeBoundingBoxes
