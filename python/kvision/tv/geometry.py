"""v2's classes that move pixels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import torch

from kvision import _check
from kvision._tv_tensors import kind_of, plain, wrap
from kvision.tv import functional as F
from kvision.tv.functional.geometry import (
    PADDING_MODES,
    InterpolationMode,
    four_paddings,
    interpolation_name,
    perspective_coefficients,
)
from kvision.tv.transform import (
    RandomTransform,
    Step,
    Transform,
    checked_interpolation,
    fill_of,
    integer,
    interval,
    log_uniform,
    size_of,
    two,
    uniform,
)

Fill = float | Sequence[float] | None | dict[Any, Any]
Interpolation = InterpolationMode | str | int


class RandomHorizontalFlip(RandomTransform):
    """Mirror the columns with a probability.

    Args:
        p: the probability.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.RandomHorizontalFlip(p=1.0)(torch.zeros(1, 2, 3)).shape
        torch.Size([1, 2, 3])
    """

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        return self._call_kernel(F.horizontal_flip, inpt)

    def _step(self, dtype: torch.dtype, channels: int) -> Step | None:
        return "RandomHorizontalFlip", (("p", self.p),)


class RandomVerticalFlip(RandomTransform):
    """Mirror the rows with a probability.

    Args:
        p: the probability.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.RandomVerticalFlip(p=1.0)(torch.zeros(1, 2, 3)).shape
        torch.Size([1, 2, 3])
    """

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        return self._call_kernel(F.vertical_flip, inpt)

    def _step(self, dtype: torch.dtype, channels: int) -> Step | None:
        return "RandomVerticalFlip", (("p", self.p),)


class _Resizing(Transform):
    """Resize to the size that is drawn."""

    def __init__(self, interpolation: Interpolation, antialias: bool | None) -> None:
        super().__init__()
        self.interpolation, self.antialias = checked_interpolation(self, interpolation), antialias

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        return self._call_kernel(F.resize, inpt, **params, interpolation=self.interpolation, antialias=self.antialias)


class Resize(_Resizing):
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

    def __init__(
        self,
        size: int | Sequence[int] | None,
        interpolation: Interpolation = "bilinear",
        max_size: int | None = None,
        antialias: bool | None = True,
    ) -> None:
        super().__init__(interpolation, antialias)
        size, max_size = (_check.scalars("Resize", n, v) for n, v in (("size", size), ("max_size", max_size)))
        if size is None and not isinstance(max_size, int):
            raise ValueError(f"Resize: expected max_size to be an int where size is None, got {max_size!r}")
        if size is not None and not isinstance(size, int) and len(size) not in (1, 2):
            raise ValueError(f"Resize: expected size to be an int or one or two of them, got {size!r}")
        self.size = [size] if isinstance(size, int) else size if size is None else list(size)
        self.max_size = max_size

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        return {"size": self.size, "max_size": self.max_size}


class ScaleJitter(_Resizing):
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

    def __init__(
        self,
        target_size: tuple[int, int],
        scale_range: tuple[float, float] = (0.1, 2.0),
        interpolation: Interpolation = "bilinear",
        antialias: bool | None = True,
    ) -> None:
        super().__init__(interpolation, antialias)
        self.target_size, self.scale_range = target_size, scale_range

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        height, width = size_of(flat_inputs)
        scale = self.scale_range[0] + torch.rand(1, device="cpu") * (self.scale_range[1] - self.scale_range[0])
        r = min(self.target_size[1] / height, self.target_size[0] / width) * scale
        return {"size": (int(height * r), int(width * r))}


class RandomShortestSize(_Resizing):
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

    def __init__(
        self,
        min_size: int | Sequence[int],
        max_size: int | None = None,
        interpolation: Interpolation = "bilinear",
        antialias: bool | None = True,
    ) -> None:
        super().__init__(interpolation, antialias)
        min_size = _check.scalars("RandomShortestSize", "min_size", min_size)
        self.min_size = [min_size] if isinstance(min_size, int) else list(min_size)
        self.max_size = max_size

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        height, width = size_of(flat_inputs)
        r = self.min_size[integer(0, len(self.min_size))] / min(height, width)
        if self.max_size is not None:
            r = min(r, self.max_size / max(height, width))
        return {"size": (int(height * r), int(width * r))}


class RandomResize(_Resizing):
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

    def __init__(
        self, min_size: int, max_size: int, interpolation: Interpolation = "bilinear", antialias: bool | None = True
    ) -> None:
        super().__init__(interpolation, antialias)
        self.min_size, self.max_size = min_size, max_size

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        return {"size": [integer(self.min_size, self.max_size)]}


class CenterCrop(Transform):
    """Cut the center out; a larger size is padded with black.

    Args:
        size: height and width, an int for both.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.CenterCrop(4)(torch.zeros(3, 8, 6)).shape
        torch.Size([3, 4, 4])
    """

    def __init__(self, size: int | Sequence[int]) -> None:
        super().__init__()
        self.size = _check.ints("CenterCrop", "size", two("CenterCrop", "size", size), 2, minimum=1)

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        return self._call_kernel(F.center_crop, inpt, output_size=self.size)


class _Crops(Transform):
    def __init__(self, size: int | Sequence[int]) -> None:
        super().__init__()
        op = type(self).__name__
        self.size = _check.ints(op, "size", two(op, "size", size), 2, minimum=1)

    def check_inputs(self, flat_inputs: list[Any]) -> None:
        if any(kind_of(x) in ("boxes", "mask") for x in flat_inputs):
            raise TypeError(f"{type(self).__name__}: expected a sample without boxes and masks")


class FiveCrop(_Crops):
    """Cut out the corners and the center: a tuple of five.

    Args:
        size: height and width, an int for both.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> len(tv.FiveCrop(4)(torch.zeros(3, 8, 6)))
        5
    """

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        return self._call_kernel(F.five_crop, inpt, self.size)


class TenCrop(_Crops):
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

    def __init__(self, size: int | Sequence[int], vertical_flip: bool = False) -> None:
        super().__init__(size)
        self.vertical_flip = vertical_flip

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        return self._call_kernel(F.ten_crop, inpt, self.size, vertical_flip=self.vertical_flip)


def drawn_window(height: int, width: int, scale: Any, log_ratio: Any) -> tuple[int, int]:
    """A height and width by a share of the area and an aspect ratio (width / height), both drawn."""
    area = height * width * uniform(scale[0], scale[1])
    ratio = log_uniform(log_ratio[0], log_ratio[1])
    return round(math.sqrt(area / ratio)), round(math.sqrt(area * ratio))


class RandomResizedCrop(Transform):
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

    draws = True

    def __init__(
        self,
        size: int | Sequence[int],
        scale: tuple[float, float] = (0.08, 1.0),
        ratio: tuple[float, float] = (3.0 / 4.0, 4.0 / 3.0),
        interpolation: Interpolation = "bilinear",
        antialias: bool | None = True,
    ) -> None:
        super().__init__()
        self.size = two("RandomResizedCrop", "size", size)
        self.scale, self.ratio = (two("RandomResizedCrop", n, v, (2,)) for n, v in (("scale", scale), ("ratio", ratio)))
        self.interpolation, self.antialias = checked_interpolation(self, interpolation), antialias
        self._log_ratio = torch.log(torch.tensor(self.ratio, device="cpu")).tolist()

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        height, width = size_of(flat_inputs)
        for _ in range(10):
            h, w = drawn_window(height, width, self.scale, self._log_ratio)
            if 0 < h <= height and 0 < w <= width:
                top, left = integer(0, height - h + 1), integer(0, width - w + 1)
                return {"top": top, "left": left, "height": h, "width": w}
        h, w = height, width
        if width / height < min(self.ratio):
            h = round(w / min(self.ratio))
        elif width / height > max(self.ratio):
            w = round(h * max(self.ratio))
        return {"top": (height - h) // 2, "left": (width - w) // 2, "height": h, "width": w}

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        options = {"interpolation": self.interpolation, "antialias": self.antialias}
        return self._call_kernel(F.resized_crop, inpt, **params, size=self.size, **options)

    def _step(self, dtype: torch.dtype, channels: int) -> Step | None:
        if dtype not in (torch.uint8, torch.float32) or not self.antialias:
            return None
        if interpolation_name("RandomResizedCrop", self.interpolation) != "bilinear":
            return None
        options = (("align_corners", False), ("antialias", True))
        return "RandomResizedCrop", (("size", self.size), ("scale", self.scale), ("ratio", self.ratio), *options)


class Pad(Transform):
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

    def __init__(self, padding: int | Sequence[int], fill: Fill = 0, padding_mode: str = "constant") -> None:
        super().__init__()
        padding = _check.scalars("Pad", "padding", padding)
        four_paddings(padding)
        _check_padding_mode("Pad", padding_mode)
        self.padding = padding if isinstance(padding, int) else list(padding)
        self.fill, self.padding_mode = fill, padding_mode

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        return self._call_kernel(
            F.pad, inpt, self.padding, fill=fill_of(self.fill, inpt), padding_mode=self.padding_mode
        )


def _check_padding_mode(op: str, mode: str) -> None:
    if mode not in PADDING_MODES:
        raise ValueError(f"{op}: padding_mode must be one of {', '.join(PADDING_MODES)}; got {mode!r}")


class RandomZoomOut(RandomTransform):
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

    draws = False  # of the size

    def __init__(self, fill: Fill = 0, side_range: Sequence[float] = (1.0, 4.0), p: float = 0.5) -> None:
        super().__init__(p)
        self.side_range = two("RandomZoomOut", "side_range", side_range, (2,))
        if not 1 <= self.side_range[0] <= self.side_range[1]:
            raise ValueError(f"RandomZoomOut: expected side_range of at least 1, increasing, got {side_range}")
        self.fill = fill

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        height, width = size_of(flat_inputs)
        r = self.side_range[0] + torch.rand(1, device="cpu") * (self.side_range[1] - self.side_range[0])
        right, bottom = int(width * r) - width, int(height * r) - height
        r = torch.rand(2, device="cpu")
        left, top = int(right * r[0]), int(bottom * r[1])
        return {"padding": [left, top, right - left, bottom - top]}

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        return self._call_kernel(F.pad, inpt, **params, fill=fill_of(self.fill, inpt))


class RandomCrop(Transform):
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

    draws = True

    def __init__(
        self,
        size: int | Sequence[int],
        padding: int | Sequence[int] | None = None,
        pad_if_needed: bool = False,
        fill: Fill = 0,
        padding_mode: str = "constant",
    ) -> None:
        super().__init__()
        self.size = two("RandomCrop", "size", size)
        _check_padding_mode("RandomCrop", padding_mode)
        self.padding = four_paddings(padding) if padding else None
        self.pad_if_needed, self.fill, self.padding_mode = pad_if_needed, fill, padding_mode

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        size = size_of(flat_inputs)
        left, right, top, bottom = self.padding or (0, 0, 0, 0)
        missing = [max(c - n - p, 0) for c, n, p in zip(self.size, size, (top + bottom, left + right))]
        if any(missing):
            if not self.pad_if_needed:
                raise ValueError(f"RandomCrop: expected images of at least {self.size} with their padding, got {size}")
            top, bottom, left, right = top + missing[0], bottom + missing[0], left + missing[1], right + missing[1]
        over = size[0] + top + bottom - self.size[0], size[1] + left + right - self.size[1]
        y, x = (integer(0, n + 1) if n else 0 for n in over)
        return {"padding": [left, top, right, bottom], "top": y, "left": x, "crops": any(over)}

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        if any(params["padding"]):
            fill = fill_of(self.fill, inpt)
            inpt = self._call_kernel(F.pad, inpt, params["padding"], fill=fill, padding_mode=self.padding_mode)
        if params["crops"]:
            inpt = self._call_kernel(F.crop, inpt, params["top"], params["left"], *self.size)
        return inpt


class RandomRotation(Transform):
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

    def __init__(
        self,
        degrees: float | Sequence[float],
        interpolation: Interpolation = "nearest",
        expand: bool = False,
        center: Sequence[float] | None = None,
        fill: Fill = 0,
    ) -> None:
        super().__init__()
        self.degrees = interval("RandomRotation", "degrees", degrees)
        self.interpolation = checked_interpolation(self, interpolation)
        self.expand, self.center, self.fill = expand, center, fill
        self.draws = not expand

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        return {"angle": uniform(*self.degrees)}

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        options = {"interpolation": self.interpolation, "expand": self.expand, "center": self.center}
        return self._call_kernel(F.rotate, inpt, **params, **options, fill=fill_of(self.fill, inpt))


class RandomAffine(Transform):
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

    draws = True

    def __init__(
        self,
        degrees: float | Sequence[float],
        translate: Sequence[float] | None = None,
        scale: Sequence[float] | None = None,
        shear: float | Sequence[float] | None = None,
        interpolation: Interpolation = "nearest",
        fill: Fill = 0,
        center: Sequence[float] | None = None,
    ) -> None:
        super().__init__()
        self.degrees = interval("RandomAffine", "degrees", degrees)
        if translate is not None and not all(0 <= t <= 1 for t in two("RandomAffine", "translate", translate, (2,))):
            raise ValueError(f"RandomAffine: expected translate in [0, 1], got {translate}")
        if scale is not None and min(two("RandomAffine", "scale", scale, (2,))) <= 0:
            raise ValueError(f"RandomAffine: expected scale above 0, got {scale}")
        self.translate, self.scale = translate, scale
        self.shear = None if shear is None else interval("RandomAffine", "shear", shear, (2, 4))
        self.interpolation, self.fill, self.center = checked_interpolation(self, interpolation), fill, center

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        height, width = size_of(flat_inputs)
        angle, translate, scale, shear = uniform(*self.degrees), (0, 0), 1.0, [0.0, 0.0]
        if self.translate is not None:
            x, y = self.translate[0] * width, self.translate[1] * height
            translate = round(uniform(-x, x)), round(uniform(-y, y))
        if self.scale is not None:
            scale = uniform(*self.scale)
        for i in range(len(self.shear or ()) // 2):
            shear[i] = uniform(*self.shear[2 * i : 2 * i + 2])  # type: ignore[index]  # not None
        return {"angle": angle, "translate": translate, "scale": scale, "shear": shear}

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        options = {"interpolation": self.interpolation, "center": self.center}
        return self._call_kernel(F.affine, inpt, **params, **options, fill=fill_of(self.fill, inpt))


class RandomPerspective(RandomTransform):
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

    def __init__(
        self,
        distortion_scale: float = 0.5,
        p: float = 0.5,
        interpolation: Interpolation = "bilinear",
        fill: Fill = 0,
    ) -> None:
        super().__init__(p)
        _check.fraction("RandomPerspective", "distortion_scale", distortion_scale)
        self.interpolation = checked_interpolation(self, interpolation)
        self.distortion_scale, self.fill = distortion_scale, fill

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        height, width = size_of(flat_inputs)
        y, x = (int(self.distortion_scale * (n // 2)) + 1 for n in (height, width))
        left, right, top, bottom = (0, x), (width - x, width), (0, y), (height - y, height)
        ends = [[integer(*u), integer(*v)] for u, v in ((left, top), (right, top), (right, bottom), (left, bottom))]
        starts = [[0, 0], [width - 1, 0], [width - 1, height - 1], [0, height - 1]]
        return {"coefficients": perspective_coefficients(starts, ends)}

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        options = {"interpolation": self.interpolation, "fill": fill_of(self.fill, inpt)}
        return self._call_kernel(F.perspective, inpt, None, None, **params, **options)


class ElasticTransform(Transform):
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

    draws = True

    def __init__(
        self,
        alpha: float | Sequence[float] = 50.0,
        sigma: float | Sequence[float] = 5.0,
        interpolation: Interpolation = "bilinear",
        fill: Fill = 0,
    ) -> None:
        super().__init__()
        self.alpha, self.sigma = two("ElasticTransform", "alpha", alpha), two("ElasticTransform", "sigma", sigma)
        self.interpolation, self.fill = checked_interpolation(self, interpolation), fill

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        size = size_of(flat_inputs)
        displacements = []
        for alpha, sigma, pixels in zip(self.alpha, self.sigma, size[::-1]):
            d = torch.rand(1, 1, *size, device="cpu") * 2 - 1
            if sigma > 0:
                window = int(8 * sigma + 1) | 1
                d = F.gaussian_blur(d, [window, window], [float(s) for s in self.sigma])
            displacements.append(d[0] * alpha / pixels)
        return {"displacement": torch.stack(displacements, 3)}

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        options = {"interpolation": self.interpolation, "fill": fill_of(self.fill, inpt)}
        return self._call_kernel(F.elastic, inpt, **params, **options)


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

    def __init__(
        self,
        min_scale: float = 0.3,
        max_scale: float = 1.0,
        min_aspect_ratio: float = 0.5,
        max_aspect_ratio: float = 2.0,
        sampler_options: list[float] | None = None,
        trials: int = 40,
    ) -> None:
        super().__init__()
        self.min_scale, self.max_scale = min_scale, max_scale
        self.min_aspect_ratio, self.max_aspect_ratio = min_aspect_ratio, max_aspect_ratio
        self.options = [0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0] if sampler_options is None else sampler_options
        self.trials = trials

    def check_inputs(self, flat_inputs: list[Any]) -> None:
        kinds = {kind_of(x) for x in flat_inputs}
        if "boxes" not in kinds or not kinds & {"tensor", "image", "pil"}:
            raise TypeError("RandomIoUCrop: expected an image and boxes in the sample")

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        height, width = size_of(flat_inputs)
        boxes = next(x for x in flat_inputs if kind_of(x) == "boxes")
        edges = plain(F.convert_bounding_box_format(boxes, new_format="XYXY"))
        center = (edges[:, :2] + edges[:, 2:]) * 0.5
        while True:
            least = self.options[integer(0, len(self.options))]
            if least >= 1:  # leaves the sample as it is
                return {}
            for _ in range(self.trials):
                r = self.min_scale + (self.max_scale - self.min_scale) * torch.rand(2, device="cpu")
                w, h = int(width * r[0]), int(height * r[1])
                if not self.min_aspect_ratio <= w / h <= self.max_aspect_ratio:
                    continue
                r = torch.rand(2, device="cpu")
                left, top = int((width - w) * r[0]), int((height - h) * r[1])
                if w == 0 or h == 0:
                    continue
                low, high = center.new_tensor([left, top]), center.new_tensor([left + w, top + h])
                inside = ((low < center) & (center < high)).all(1)
                if not inside.any() or _overlaps(edges[inside], low, high).max() < least:
                    continue
                return {"top": top, "left": left, "height": h, "width": w, "is_within_crop_area": inside}

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        if not params:
            return inpt
        window = {name: params[name] for name in ("top", "left", "height", "width")}
        output = self._call_kernel(F.crop, inpt, **window)
        if kind_of(output) == "boxes":  # empty, for SanitizeBoundingBoxes
            output = wrap(plain(output).masked_fill(~params["is_within_crop_area"][:, None], 0), output)
        return output


def _overlaps(boxes: torch.Tensor, low: torch.Tensor, high: torch.Tensor) -> torch.Tensor:
    """Intersection over union of boxes (N, 4), by edges, with one."""
    common = (torch.minimum(boxes[:, 2:], high) - torch.maximum(boxes[:, :2], low)).clamp(min=0).prod(1)
    return common / ((boxes[:, 2:] - boxes[:, :2]).prod(1) + (high - low).prod() - common)
