"""Every parameter of every class has its distribution, and parameters are independent of each other and from sample to sample.

A class lists its variates: numbers that follow a distribution of their own, from the parameters by name or, where those
are made of several draws, from the columns that were drawn. The tests of distributions and of independence are the same for all.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch
from scipy import stats
from torch import Tensor

import kvision.augmentation as A
from benchmarks.sample_calls.augmentations import IMAGES, VOLUMES
from kvision.augmentation.draws import is_chosen_batch
from kvision.augmentation.engine import AugmentationBase

pytestmark = pytest.mark.interface

N = 12000
LEVEL = 1e-4 / 2000  # more than there are tests: Bonferroni
CONSTANT = {
    "batch_prob",
    "forward_input_shape",
    "center",
    "dst",
    "input_size",
    "output_size",
    "padding_size",
    "batch_idx",
}


class Uniform(NamedTuple):
    low: float
    high: float
    rounding: float = 1e-6  # how far values may be outside

    def p_value(self, values: Tensor) -> float:
        assert values.min() >= self.low - self.rounding and values.max() <= self.high + self.rounding
        return float(stats.kstest(values.numpy(), stats.uniform(self.low, self.high - self.low).cdf).pvalue)


class Normal(NamedTuple):
    mean: float
    deviation: float

    def p_value(self, values: Tensor) -> float:
        return float(stats.kstest(values.numpy(), stats.norm(self.mean, self.deviation).cdf).pvalue)


class Integers(NamedTuple):
    low: int
    high: int
    step: int = 1

    def p_value(self, values: Tensor) -> float:
        result, counts = values.unique(return_counts=True)
        assert result.tolist() == list(range(self.low, self.high + 1, self.step))
        return float(stats.chisquare(counts.numpy()).pvalue)


class Permutations(NamedTuple):
    """Numbers of permutations of n, as `code` makes them."""

    n: int

    def p_value(self, values: Tensor) -> float:
        result, counts = values.unique(return_counts=True)
        assert len(result) == math.factorial(self.n)
        return float(stats.chisquare(counts.numpy()).pvalue)


class Coin(NamedTuple):
    p: float

    def p_value(self, values: Tensor) -> float:
        return float(stats.binomtest(int(values.sum()), len(values), self.p).pvalue)


def code(orders: Tensor) -> Tensor:
    """One number for each permutation (N, n)."""
    n = orders.shape[1]
    assert torch.equal(orders.sort(1).values, torch.arange(n).expand_as(orders).to(orders))
    return (orders.double() * n ** torch.arange(n, dtype=torch.float64)).sum(1)


Variates = dict[str, tuple[Any, Any]]


class Spec(NamedTuple):
    make: Callable[[float], Any]  # of the probability
    variates: Callable[[dict[str, Tensor], Tensor], Variates]  # of the parameters by name, and of their columns
    shape: tuple[int, ...] = (3, 16, 20)
    dependent: tuple[str, ...] = ()  # variates that share a random number with others
    whole_batch: bool = False


def plain(**distributions: Any) -> Callable[[dict[str, Tensor], Tensor], Variates]:
    """Parameters that are variates themselves."""
    return lambda params, columns: {name: (params[name].reshape(N), d) for name, d in distributions.items()}


def numbered(name: str, of: Callable[[int, int], Any]) -> Callable[[dict[str, Tensor], Tensor], Variates]:
    """The coordinates of points (N, K, D), each with a distribution of its own."""

    def variates(params: dict[str, Tensor], columns: Tensor) -> Variates:
        points = params[name]
        return {
            f"{name}.{i}.{axis}": (points[:, i, axis], of(i, axis))
            for i, axis in itertools.product(range(points.shape[1]), range(points.shape[2]))
        }

    return variates


def in_columns(**distributions: Any) -> Callable[[dict[str, Tensor], Tensor], Variates]:
    """Columns in their order."""
    return lambda params, columns: {
        name: (column, d) for column, (name, d) in zip(columns.unbind(1), distributions.items()) if d is not None
    }


def jitter(params: dict[str, Tensor], columns: Tensor) -> Variates:
    factors = {name: (params[f"{name}_factor"], Uniform(0.8, 1.2)) for name in ("brightness", "contrast", "saturation")}
    return {
        **{f"{name}_factor": x for name, x in factors.items()},
        "hue_factor": (params["hue_factor"], Uniform(-0.2, 0.2)),
        "order": (code(params["order"]), Permutations(4)),
    }


def affine(params: dict[str, Tensor], columns: Tensor) -> Variates:
    return {
        "angle": (params["angle"], Uniform(-30, 30)),
        "translations.x": (params["translations"][:, 0], Uniform(-2, 2)),
        "translations.y": (params["translations"][:, 1], Uniform(-3.2, 3.2)),
        "scale.x": (params["scale"][:, 0], Uniform(0.8, 1.2)),
        "scale.y": (params["scale"][:, 1], Uniform(0.5, 0.7)),
        "shear_x": (params["shear_x"], Uniform(-10, 10)),
        "shear_y": (params["shear_y"], Uniform(5, 20)),
    }


def affine3d(params: dict[str, Tensor], columns: Tensor) -> Variates:
    shears = {name: (params[name], Uniform(-10, 10)) for name in ("sxy", "sxz", "syx", "syz", "szx", "szy")}
    ranges = {"translations": (0.8, 1.4, 0.6), "angles": (30, 30, 30)}
    pairs = {
        f"{name}.{i}": (params[name][:, i], Uniform(-most[i], most[i]))
        for name, most in ranges.items()
        for i in range(3)
    }
    return {**shears, **pairs, "scale": (params["scale"][:, 0], Uniform(0.8, 1.2))}


def resized_crop(params: dict[str, Tensor], columns: Tensor) -> Variates:
    src, side = params["src"].double(), 4096
    (x, y), (w, h) = src[:, 0].unbind(1), (src[:, 2] - src[:, 0] + 1).unbind(1)
    return {
        "src.area": (w * h / side**2, Uniform(0.25, 0.5, 1e-3)),
        "src.ratio": ((w / h).log(), Uniform(math.log(3 / 4), math.log(4 / 3), 1e-3)),
        "src.x": ((x + 0.5) / (side - w + 1), Uniform(0, 1)),
        "src.y": ((y + 0.5) / (side - h + 1), Uniform(0, 1)),
    }


def erasing(params: dict[str, Tensor], columns: Tensor) -> Variates:
    x, y, w, h = (params[name].double() for name in ("xs", "ys", "widths", "heights"))
    aspect, side = h / w, 4096
    return {
        "widths": (w * h / side**2, Uniform(0.02, 0.1, 1e-3)),
        # As often wide as high, and uniform in each half.
        "heights": (torch.where(aspect < 1, (aspect - 0.25) / 1.5, 0.5 + (aspect - 1) / 6), Uniform(0, 1, 1e-3)),
        "xs": ((x + 0.5) / (side - w + 1), Uniform(0, 1)),
        "ys": ((y + 0.5) / (side - h + 1), Uniform(0, 1)),
    }


def holes(params: dict[str, Tensor], columns: Tensor) -> Variates:
    """The first two of holes, of which there are two at least."""
    x, y, w, h = params["holes"].double()[:, :2].unbind(2)
    side = 4096
    return {
        "num_holes": ((params["holes"][..., 2] > 0).sum(1), Integers(2, 5)),
        "holes.width": (w[:, 0] / side, Uniform(0.2, 0.4, 1e-3)),
        "holes.height": (h[:, 1] / side, Uniform(0.1, 0.3, 1e-3)),
        "holes.x": ((x[:, 0] + 0.5) / (side - w[:, 0] + 1), Uniform(0, 1)),
        "holes.y": ((y[:, 1] + 0.5) / (side - h[:, 1] + 1), Uniform(0, 1)),
    }


def stripe(axis: int) -> Callable[[dict[str, Tensor], Tensor], Variates]:
    """One stripe of up to 3000 of 4096 pixels."""

    def variates(params: dict[str, Tensor], columns: Tensor) -> Variates:
        first, length = params["holes"].double()[:, 0, axis], params["holes"].double()[:, 0, axis + 2]
        return {
            "holes.length": ((length + 0.5) / 3001, Uniform(0, 1)),
            "holes.start": ((first + 0.5) / (4097 - length), Uniform(0, 1)),
        }

    return variates


def crop(params: dict[str, Tensor], columns: Tensor) -> Variates:
    return {
        f"src.{axis}": (params["src"][:, 0, i], Integers(0, last)) for i, axis, last in ((0, "x", 13), (1, "y", 11))
    }


def position(params: dict[str, Tensor], columns: Tensor) -> Variates:
    return {f"shift.{i}": (params["shift"][:, i], Integers(0, last)) for i, last in ((0, 12), (1, 8))}


def crop3d(*last: int) -> Callable[[dict[str, Tensor], Tensor], Variates]:
    """The first corner of crops, whose coordinates x, y, z go from 0 to `last`."""
    return lambda params, columns: {f"src.{i}": (params["src"][:, 0, i], Integers(0, n)) for i, n in enumerate(last)}


def pixels(name: str, of: Callable[[], Any], *positions: tuple[int, ...], **others: Any) -> Any:
    """Some positions of a map for each sample, besides plain parameters."""
    return lambda params, columns: {
        **plain(**others)(params, columns),
        **{f"{name}.{position}": (params[name][(slice(None), *position)], of()) for position in positions},
    }


def light(**distributions: Any) -> Callable[[dict[str, Tensor], Tensor], Variates]:
    """Maps of illumination are made of several columns."""
    return in_columns(**{f"gradient.{name}": d for name, d in distributions.items()})


def mixed(name: str, variates: Callable[[dict[str, Tensor], Tensor], Variates], mixes: int = 1) -> Any:
    """Partners, which are a permutation of the samples, by their distance around the batch."""

    def both(params: dict[str, Tensor], columns: Tensor) -> Variates:
        pairs = params[name].reshape(mixes, N)
        assert torch.equal(pairs.sort(1).values, torch.arange(N).expand(mixes, N))
        away = {f"{name}.{i}": (((p - torch.arange(N)) % N + 0.5) / N, Uniform(0, 1)) for i, p in enumerate(pairs)}
        return {**away, **variates(params, columns)}

    return both


def mosaic(params: dict[str, Tensor], columns: Tensor) -> Variates:
    partners = params["permutation"]
    assert torch.equal(partners[:, 0], torch.arange(N))
    return {
        "src.x": (columns[:, 0], Uniform(0.3, 0.7)),
        "src.y": (columns[:, 1], Uniform(0.3, 0.7)),
        **{f"permutation.{i}": (((partners[:, i] - torch.arange(N)) % N + 0.5) / N, Uniform(0, 1)) for i in (1, 2, 3)},
    }


def cut_mix(params: dict[str, Tensor], columns: Tensor) -> Variates:
    """The share kept is uniform; windows are made of it and of a position."""
    names = ("word", "kept", "x", "y")
    return {
        f"crop_src.{i}.{name}": (column, Uniform(0, 1))
        for (i, name), column in zip(itertools.product(range(2), names), columns.unbind(1))
        if name != "word"
    }


def corner(i: int, axis: int) -> Uniform:
    """Corners of 20 x 16 pixels, clockwise from top left, move inward by up to a quarter."""
    last, most = ((19, 5), (15, 4))[axis]
    near = (i in (0, 3)) if axis == 0 else (i in (0, 1))
    return Uniform(0, most) if near else Uniform(last - most, last)


def corner3d(i: int, axis: int) -> Uniform:
    last, most = ((7, 2), (6, 1.75), (5, 1.5))[axis]
    near = (i % 4 in (0, 3), i % 4 in (0, 1), i < 4)[axis]
    return Uniform(0, most) if near else Uniform(last - most, last)


TPS = ((-1, -1), (-1, 1), (1, -1), (1, 1), (0, 0))
SMALL, VOLUME, LARGE = (3, 4, 5), (2, 6, 7, 8), (3, 4096, 4096)

SPECS = {
    "RandomAffine": Spec(
        lambda p: A.RandomAffine(30.0, (0.1, 0.2), (0.8, 1.2, 0.5, 0.7), (-10, 10, 5, 20), p=p), affine
    ),
    "RandomHorizontalFlip": Spec(lambda p: A.RandomHorizontalFlip(p=p), plain()),
    "RandomVerticalFlip": Spec(lambda p: A.RandomVerticalFlip(p=p), plain()),
    "RandomPerspective": Spec(lambda p: A.RandomPerspective(0.5, p=p), numbered("end_points", corner)),
    "RandomRotation": Spec(lambda p: A.RandomRotation((-10.0, 40.0), p=p), plain(degrees=Uniform(-10, 40))),
    "RandomRotation90": Spec(lambda p: A.RandomRotation90((-1, 3), p=p), plain(times=Integers(-1, 3))),
    "RandomShear": Spec(
        lambda p: A.RandomShear((-10.0, 20.0, -5.0, 5.0), p=p), plain(shear_x=Uniform(-10, 20), shear_y=Uniform(-5, 5))
    ),
    "RandomTranslate": Spec(
        lambda p: A.RandomTranslate((-0.1, 0.2), (0.0, 0.25), p=p),
        plain(translate_x=Uniform(-2, 4), translate_y=Uniform(0, 4)),
    ),
    "D4": Spec(lambda p: A.D4(p=p), plain(angle=Integers(0, 180, 180), mirror=Integers(-1, 1, 2))),
    "PadIfNeeded": Spec(lambda p: A.PadIfNeeded(24, 32, position="random", p=p), position, whole_batch=True),
    "RandomCrop": Spec(lambda p: A.RandomCrop((9, 11), padding=2), crop, whole_batch=True),
    "RandomResizedCrop": Spec(
        lambda p: A.RandomResizedCrop((9, 11), (0.25, 0.5)),
        resized_crop,
        LARGE,
        dependent=("src.x", "src.y"),
        whole_batch=True,
    ),
    "RandomElasticTransform": Spec(
        lambda p: A.RandomElasticTransform(p=p),
        pixels("noise", lambda: Uniform(-1, 1), (0, 0, 0), (1, 0, 0), (0, 0, 1), (1, 3, 4)),
        SMALL,
    ),
    "RandomFisheye": Spec(
        lambda p: A.RandomFisheye((-0.2, 0.2), (-0.3, 0.1), (0.9, 1.1), p=p),
        plain(center_x=Uniform(-0.2, 0.2), center_y=Uniform(-0.3, 0.1), gamma=Uniform(0.9, 1.1)),
    ),
    "RandomThinPlateSpline": Spec(
        lambda p: A.RandomThinPlateSpline(0.2, p=p),
        numbered("dst", lambda i, axis: Uniform(TPS[i][axis] - 0.2, TPS[i][axis] + 0.2)),
    ),
    "ColorJiggle": Spec(lambda p: A.ColorJiggle(0.2, 0.2, 0.2, 0.2, p=p), jitter),
    "ColorJitter": Spec(lambda p: A.ColorJitter(0.2, 0.2, 0.2, 0.2, p=p), jitter),
    "RandomBrightness": Spec(lambda p: A.RandomBrightness((0.5, 1.4), p=p), plain(brightness_factor=Uniform(0.5, 1.4))),
    "RandomChannelDropout": Spec(lambda p: A.RandomChannelDropout(p=p), plain(channel_idx=Integers(0, 2))),
    "RandomChannelShuffle": Spec(
        lambda p: A.RandomChannelShuffle(p=p),
        lambda params, _: {"channels": (code(params["channels"]), Permutations(3))},
    ),
    "RandomClahe": Spec(lambda p: A.RandomClahe((1.0, 4.0), p=p), plain(clip_limit_factor=Uniform(1, 4))),
    "RandomContrast": Spec(lambda p: A.RandomContrast((0.5, 1.4), p=p), plain(contrast_factor=Uniform(0.5, 1.4))),
    "RandomGamma": Spec(
        lambda p: A.RandomGamma((0.5, 1.5), (0.8, 1.0), p=p),
        plain(gamma_factor=Uniform(0.5, 1.5), gain_factor=Uniform(0.8, 1)),
    ),
    "RandomGaussianBlur": Spec(lambda p: A.RandomGaussianBlur((3, 5), (0.5, 2.0), p=p), plain(sigma=Uniform(0.5, 2))),
    "RandomHue": Spec(lambda p: A.RandomHue((-0.3, 0.2), p=p), plain(hue_factor=Uniform(-0.3, 0.2))),
    "RandomJPEG": Spec(lambda p: A.RandomJPEG((20.0, 60.0), p=p), plain(jpeg_quality=Uniform(20, 60))),
    "RandomMotionBlur": Spec(
        lambda p: A.RandomMotionBlur((3, 7), 35.0, 0.5, p=p),
        # The size is one for a batch, that of its first sample.
        in_columns(ksize_factor=Integers(3, 7, 2), angle_factor=Uniform(-35, 35), direction_factor=Uniform(-0.5, 0.5)),
    ),
    "RandomPlanckianJitter": Spec(lambda p: A.RandomPlanckianJitter(p=p), plain(idx=Integers(0, 24))),
    "RandomPosterize": Spec(lambda p: A.RandomPosterize(3, p=p), plain(bits_factor=Integers(3, 8))),
    "RandomRGBShift": Spec(
        lambda p: A.RandomRGBShift(0.5, 0.4, 0.3, p=p),
        plain(r_shift=Uniform(-0.5, 0.5), g_shift=Uniform(-0.4, 0.4), b_shift=Uniform(-0.3, 0.3)),
    ),
    "RandomSaturation": Spec(lambda p: A.RandomSaturation((0.5, 1.4), p=p), plain(saturation_factor=Uniform(0.5, 1.4))),
    "RandomSharpness": Spec(lambda p: A.RandomSharpness((0.2, 1.8), p=p), plain(sharpness=Uniform(0.2, 1.8))),
    "RandomSolarize": Spec(
        lambda p: A.RandomSolarize(0.1, 0.2, p=p), plain(thresholds=Uniform(0.4, 0.6), additions=Uniform(-0.2, 0.2))
    ),
    "RandomErasing": Spec(
        lambda p: A.RandomErasing((0.02, 0.1), (0.25, 4.0), p=p), erasing, LARGE, dependent=("xs", "ys")
    ),
    "RandomGaussianIllumination": Spec(
        lambda p: A.RandomGaussianIllumination((0.01, 0.15), (0.1, 0.9), (0.2, 1.0), (-1.0, 1.0), p=p),
        light(
            gain=Uniform(0.01, 0.15),
            sign=Uniform(-1, 1),
            x=Uniform(0.1, 0.9),
            y=Uniform(0.1, 0.9),
            sigma_x=Uniform(0.2, 1),
            sigma_y=Uniform(0.2, 1),
        ),
        SMALL,
    ),
    "RandomLinearIllumination": Spec(
        lambda p: A.RandomLinearIllumination((0.01, 0.2), (-1.0, 1.0), p=p),
        light(gain=Uniform(0.01, 0.2), sign=Uniform(-1, 1), direction=Integers(0, 3)),
        SMALL,
    ),
    "RandomLinearCornerIllumination": Spec(
        lambda p: A.RandomLinearCornerIllumination((0.01, 0.2), (-1.0, 1.0), p=p),
        light(gain=Uniform(0.01, 0.2), sign=Uniform(-1, 1), direction=Integers(0, 3)),
        SMALL,
    ),
    "RandomGaussianNoise": Spec(
        lambda p: A.RandomGaussianNoise(0.1, 0.2, p=p),
        pixels("gaussian_noise", lambda: Normal(0.1, 0.2), (0, 0, 0), (1, 0, 0), (0, 0, 1), (2, 3, 4)),
        SMALL,
    ),
    "RandomSaltAndPepperNoise": Spec(
        lambda p: A.RandomSaltAndPepperNoise((0.1, 0.4), (0.4, 0.6), p=p),
        lambda params, columns: {
            **plain(amount_factor=Uniform(0.1, 0.4), salt_and_pepper_factor=Uniform(0.4, 0.6))(params, columns),
            "mask_salt": (params["mask_salt"][:, 0, 1, 2], Coin(0.125)),
            "mask_pepper": (params["mask_pepper"][:, 0, 2, 3], Coin(0.125)),
        },
        SMALL,
        dependent=("mask_salt", "mask_pepper"),
    ),
    # The map is tested in test_weather_and_plasma.py.
    "RandomPlasmaBrightness": Spec(
        lambda p: A.RandomPlasmaBrightness((0.1, 0.7), (0.1, 0.2), p=p),
        plain(roughness=Uniform(0.1, 0.7), intensity=Uniform(0.1, 0.2)),
        SMALL,
    ),
    "RandomPlasmaContrast": Spec(
        lambda p: A.RandomPlasmaContrast((0.1, 0.7), p=p), plain(roughness=Uniform(0.1, 0.7)), SMALL
    ),
    "RandomPlasmaShadow": Spec(
        lambda p: A.RandomPlasmaShadow((0.1, 0.7), (-1.0, 0.0), (0.0, 1.0), p=p),
        plain(roughness=Uniform(0.1, 0.7), shade_intensity=Uniform(-1, 0), shade_quantity=Uniform(0, 1)),
        SMALL,
    ),
    "RandomRain": Spec(
        lambda p: A.RandomRain((10, 20), (2, 4), (-3, 3), p=p),
        lambda params, columns: {
            **plain(
                number_of_drops_factor=Integers(10, 20),
                drop_height_factor=Integers(2, 4),
                drop_width_factor=Integers(-3, 3),
            )(params, columns),
            **{
                f"coordinates_factor.{i}.{axis}": (params["coordinates_factor"][:, i, axis], Uniform(0, 1))
                for i, axis in ((0, 0), (0, 1), (1, 0), (19, 1))
            },
        },
    ),
    "RandomSnow": Spec(
        lambda p: A.RandomSnow((0.3, 0.7), (1.0, 2.0), p=p),
        plain(snow_coefficient=Uniform(0.3, 0.7), brightness=Uniform(1, 2)),
    ),
    "CoarseDropout": Spec(
        lambda p: A.CoarseDropout((2, 5), (0.1, 0.3), (0.2, 0.4), p=p), holes, LARGE, ("holes.x", "holes.y")
    ),
    "FrequencyMasking": Spec(lambda p: A.FrequencyMasking(3000, p=p), stripe(1), LARGE, ("holes.start",)),
    "GridDropout": Spec(
        lambda p: A.GridDropout(unit_size_range=(4, 8), p=p),
        pixels("offsets", lambda: Uniform(0, 1), (0, 0, 0), (1, 0, 0), (0, 3, 4), unit_size=Integers(4, 8)),
    ),
    "GridMask": Spec(
        lambda p: A.GridMask((2, 5), (0.2, 0.4), (-0.5, 0.5), p=p),
        plain(
            num_grid=Integers(2, 5),
            line_width=Uniform(0.2, 0.4),
            rotation=Uniform(-0.5, 0.5),
            offset_x=Uniform(0, 1),
            offset_y=Uniform(0, 1),
        ),
    ),
    "PixelDropout": Spec(
        lambda p: A.PixelDropout((0.1, 0.4), drop_value="random", p=p),
        lambda params, columns: {
            "dropped": (params["dropped"][:, 0, 1, 2], Coin(0.25)),
            **pixels("fill", lambda: Uniform(0, 1), (0, 0, 0), (2, 1, 2))(params, columns),
            **plain(dropout_prob=Uniform(0.1, 0.4))(params, columns),
        },
        SMALL,
        dependent=("dropped",),
    ),
    "TimeMasking": Spec(lambda p: A.TimeMasking(3000, p=p), stripe(0), LARGE, ("holes.start",)),
    "XYMasking": Spec(
        lambda p: A.XYMasking((0, 2), (1, 3), (0.1, 0.3), (0.1, 0.3), p=p),
        lambda params, columns: {
            "num_masks_x": ((params["holes"][:, :2, 2] > 0).sum(1), Integers(0, 2)),
            "num_masks_y": ((params["holes"][:, 2:, 3] > 0).sum(1), Integers(1, 3)),
            "holes.length": (params["holes"][:, 2, 3].double() / 4096, Uniform(0.1, 0.3, 1e-3)),
        },
        LARGE,
    ),
    "Defocus": Spec(
        lambda p: A.Defocus((2, 6), (0.1, 0.5), p=p), plain(radius=Integers(2, 6), alias_blur=Uniform(0.1, 0.5))
    ),
    "Downscale": Spec(lambda p: A.Downscale((0.3, 0.9), p=p), plain(scale=Uniform(0.3, 0.9))),
    "GlassBlur": Spec(
        lambda p: A.GlassBlur(p=p), pixels("offsets", lambda: Uniform(0, 1), (0, 0, 0), (3, 0, 0), (2, 3, 4)), SMALL
    ),
    "ISONoise": Spec(
        lambda p: A.ISONoise((0.01, 0.05), (0.1, 0.5), p=p),
        lambda params, columns: {
            **pixels("color_noise", lambda: Normal(0, 1), (0, 0, 0), (0, 3, 4))(params, columns),
            **pixels("luminance_noise", lambda: Uniform(0, 1), (0, 0, 0), (0, 3, 4))(params, columns),
            **plain(color_shift=Uniform(0.01, 0.05), intensity=Uniform(0.1, 0.5))(params, columns),
        },
        SMALL,
    ),
    "MultiplicativeNoise": Spec(
        lambda p: A.MultiplicativeNoise((0.9, 1.1), True, True, p=p),
        pixels("factors", lambda: Uniform(0.9, 1.1), (0, 0, 0), (2, 3, 4)),
        SMALL,
    ),
    "RingingOvershoot": Spec(
        lambda p: A.RingingOvershoot((3, 9), (0.5, 1.5), p=p), plain(blur=Integers(3, 9, 2), cutoff=Uniform(0.5, 1.5))
    ),
    "ShotNoise": Spec(
        lambda p: A.ShotNoise((0.1, 0.3), p=p),
        pixels("noise", lambda: Uniform(0, 1), (0, 0, 0), (2, 3, 4), scale=Uniform(0.1, 0.3)),
        SMALL,
    ),
    "SpeckleNoise": Spec(
        lambda p: A.SpeckleNoise((0.1, 0.4), p=p),
        lambda params, columns: {
            "std": (params["std"], Uniform(0.1, 0.4)),
            "factors": ((params["factors"][:, 2, 3, 4] - 1) / params["std"], Normal(0, 1)),
        },
        SMALL,
    ),
    "ZoomBlur": Spec(
        lambda p: A.ZoomBlur((1.1, 1.3), (0.01, 0.03), p=p),
        plain(max_factor=Uniform(1.1, 1.3), step_factor=Uniform(0.01, 0.03)),
    ),
    "ChromaticAberration": Spec(
        lambda p: A.ChromaticAberration((-0.1, 0.1), (-0.2, 0.3), p=p),
        plain(
            primary_red=Uniform(-0.1, 0.1),
            secondary_red=Uniform(-0.2, 0.3),
            primary_blue=Uniform(-0.1, 0.1),
            secondary_blue=Uniform(-0.2, 0.3),
        ),
    ),
    "GridDistortion": Spec(
        lambda p: A.GridDistortion(3, p=p), pixels("steps", lambda: Uniform(0, 1), (0, 0, 0), (0, 0, 2), (1, 0, 1))
    ),
    "OpticalDistortion": Spec(lambda p: A.OpticalDistortion((-0.1, 0.2), p=p), plain(distort=Uniform(-0.1, 0.2))),
    "PiecewiseAffine": Spec(
        lambda p: A.PiecewiseAffine((0.1, 0.2), (3, 5), (2, 4), p=p),
        pixels(
            "nodes",
            lambda: Normal(0, 1),
            (0, 0, 0),
            (1, 2, 3),
            scale=Uniform(0.1, 0.2),
            rows=Integers(3, 5),
            columns=Integers(2, 4),
        ),
    ),
    "Swirl": Spec(
        lambda p: A.Swirl((-1, 2), (0.5, 1.0), (0.4, 0.7), p=p),
        plain(strength=Uniform(-1, 2), radius=Uniform(0.5, 1), center_x=Uniform(0.4, 0.7), center_y=Uniform(0.4, 0.7)),
    ),
    "CommonCorruption": Spec(
        lambda p: A.CommonCorruption("gaussian_noise", 3, p=p),
        pixels("noise", lambda: Normal(0, 1), (0, 0, 0), (2, 3, 4)),
        SMALL,
    ),
    "RandomFog": Spec(
        lambda p: A.RandomFog((1.0, 2.0), (0.2, 0.5), p=p),
        plain(roughness=Uniform(0.2, 0.5), intensity=Uniform(1, 2)),
        SMALL,
    ),
    "RandomFrost": Spec(
        lambda p: A.RandomFrost(torch.ones(2, 3, 30, 40), p=p),
        plain(
            image_weight=Uniform(0.6, 1.0),
            frost_weight=Uniform(0.4, 0.75),
            **dict.fromkeys(("texture", "top", "left"), Uniform(0, 1)),
        ),
    ),
    "Spatter": Spec(
        lambda p: A.Spatter((0.6, 0.7), (0.2, 0.4), (1.0, 2.0), (0.6, 0.7), (0.5, 1.0), p=p),
        pixels(
            "noise",
            lambda: Normal(0, 1),
            (0, 0, 0),
            (0, 3, 4),
            mean=Uniform(0.6, 0.7),
            std=Uniform(0.2, 0.4),
            gauss_sigma=Uniform(1, 2),
            cutout_threshold=Uniform(0.6, 0.7),
            intensity=Uniform(0.5, 1),
        ),
        SMALL,
    ),
    "RandomScale": Spec(lambda p: A.RandomScale((0.5, 2.0)), in_columns(scale=Uniform(0.5, 2.0)), whole_batch=True),
    "RandomAffine3D": Spec(lambda p: A.RandomAffine3D(30.0, (0.1, 0.2, 0.1), (0.8, 1.2), 10.0, p=p), affine3d, VOLUME),
    "RandomRotation3D": Spec(
        lambda p: A.RandomRotation3D((20.0, 30.0, 40.0), p=p),
        plain(yaw=Uniform(-20, 20), pitch=Uniform(-30, 30), roll=Uniform(-40, 40)),
        VOLUME,
    ),
    "RandomPerspective3D": Spec(lambda p: A.RandomPerspective3D(0.5, p=p), numbered("end_points", corner3d), VOLUME),
    "RandomCrop3D": Spec(lambda p: A.RandomCrop3D((4, 5, 5), padding=1), crop3d(5, 4, 4), VOLUME, whole_batch=True),
    "RandomResizedCrop3D": Spec(
        lambda p: A.RandomResizedCrop3D(4, (0.125, 0.125), (1.0, 1.0)), crop3d(4, 3, 3), VOLUME, whole_batch=True
    ),
    "RandomMotionBlur3D": Spec(
        lambda p: A.RandomMotionBlur3D((3, 5), (10.0, 20.0, 30.0), 0.5, p=p),
        lambda params, columns: in_columns(
            **{
                "ksize_factor": Integers(3, 5, 2),
                "angle_factor.x": Uniform(-10, 10),
                "angle_factor.y": Uniform(-20, 20),
                "angle_factor.z": Uniform(-30, 30),
                "direction_factor": Uniform(-0.5, 0.5),
            }
        )(params, columns),
        VOLUME,
    ),
    "RandomMixUpV2": Spec(
        lambda p: A.RandomMixUpV2((0.2, 0.6), p=p), mixed("mixup_pairs", plain(mixup_lambdas=Uniform(0.2, 0.6)))
    ),
    "RandomCutMixV2": Spec(
        lambda p: A.RandomCutMixV2(num_mix=2, p=p), mixed("mix_pairs", cut_mix, 2), whole_batch=True
    ),
    "PatchMix": Spec(
        lambda p: A.PatchMix(patch_size=5, p=p),
        mixed(
            "mix_pairs",
            lambda params, _: {
                "patch_coords.x": (params["patch_coords"][:, 0], Integers(0, 15)),
                "patch_coords.y": (params["patch_coords"][:, 1], Integers(0, 11)),
            },
        ),
    ),
    "RandomJigsaw": Spec(
        lambda p: A.RandomJigsaw((2, 2), ensure_perm=False, p=p),
        lambda params, _: {"permutation": (code(params["permutation"]), Permutations(4))},
    ),
    "RandomMosaic": Spec(lambda p: A.RandomMosaic(start_ratio_range=(0.3, 0.7), p=p), mosaic),
}
specs = pytest.mark.parametrize("name", SPECS)


def drawn(spec: Spec, p: float) -> tuple[dict[str, Tensor], Tensor]:
    """Parameters of N samples by name, and their columns."""
    augment, shape = spec.make(p), (N, *spec.shape)
    execution = augment._draw(torch.empty(1).expand(shape), 17, None)
    columns = torch.empty(N, 0) if execution.columns is None else execution.columns.values
    return augment._read_params(execution), columns.double()


def test_all_classes_that_draw_have_a_spec() -> None:
    fixed = {case.name for case in (*IMAGES, *VOLUMES) if case.fixed}
    # Choose among the labels or instances of masks: test_mix.py, test_copy_paste.py.
    fixed |= {"RandomCopyPaste", "RandomTransplantation", "RandomTransplantation3D"}
    # Windows that follow from labels or from the size: test_label_crops.py.
    fixed |= {"AtLeastOneBBoxRandomCrop", "CropNonEmptyMaskIfExists", "RandomSizedBBoxSafeCrop", "RandomZoomOut"}
    classes = {
        name
        for name in A.__all__
        if isinstance(value := getattr(A, name), type) and issubclass(value, AugmentationBase) and "Base" not in name
    }
    assert classes - fixed == set(SPECS)


@specs
def test_parameters_have_their_distributions(name: str) -> None:
    spec = SPECS[name]
    params, columns = drawn(spec, 1.0)
    variates = spec.variates(params, columns)
    listed = {variate.split(".")[0] for variate in variates}
    for parameter, values in params.items():  # nothing that varies is left out
        varies = values.dim() and len(values) == N and bool((values != values[:1]).any())
        assert parameter in listed | CONSTANT | {"plasma", "lam"} or not varies, parameter
    for variate, (values, distribution) in variates.items():
        assert values.shape == (N,)
        assert distribution.p_value(values.double()) > LEVEL, variate


@specs
def test_parameters_are_independent(name: str) -> None:
    """Of each other, of those of the sample before, and of those of another key."""
    spec = SPECS[name]
    variates = spec.variates(*drawn(spec, 1.0))
    ranks = {variate: stats.rankdata(values.double()) for variate, (values, _) in variates.items()}
    for first, second in itertools.combinations([v for v in variates if v not in spec.dependent], 2):
        assert stats.pearsonr(ranks[first], ranks[second]).pvalue > LEVEL, (first, second)
    for variate, of_values in ranks.items():
        assert stats.pearsonr(of_values[1:], of_values[:-1]).pvalue > LEVEL, variate
        assert stats.pearsonr(of_values, np.arange(N)).pvalue > LEVEL, variate


@specs
@pytest.mark.parametrize("p", [0.2, 0.7])
def test_samples_are_chosen_with_their_probability(name: str, p: float) -> None:
    spec = SPECS[name]
    if spec.whole_batch:
        pytest.skip("a batch is chosen as a whole")
    params, columns = drawn(spec, p)
    chosen = params["batch_prob"].double()
    assert Coin(p).p_value(chosen) > LEVEL
    assert stats.pearsonr(chosen[1:], chosen[:-1]).pvalue > LEVEL
    # Chosen samples have the distributions of all.
    if not name.startswith(
        ("RandomMixUp", "PatchMix", "RandomMosaic", "RandomJigsaw", "RandomChannelShuffle", "Color")
    ):
        at = chosen > 0.5
        for variate, (values, distribution) in spec.variates(params, columns).items():
            if variate not in spec.dependent:
                assert distribution.p_value(values[at].double()) > LEVEL, variate


@pytest.mark.parametrize("p", [0.1, 0.5])
def test_batches_are_chosen_with_their_probability(p: float) -> None:
    keys = torch.randint(-(2**63), 2**63 - 1, (N,), generator=torch.Generator().manual_seed(2)).tolist()
    for position in (0, 3):
        chosen = torch.tensor([is_chosen_batch(key, position, p) for key in keys]).double()
        assert Coin(p).p_value(chosen) > LEVEL
    sequential = torch.tensor([is_chosen_batch(key, 0, p) for key in range(N)]).double()
    assert Coin(p).p_value(sequential) > LEVEL
    assert stats.spearmanr(sequential[1:], sequential[:-1]).pvalue > LEVEL


def test_the_children_of_a_container_are_independent() -> None:
    """Equal augmentations in a chain draw other numbers, under one seed as well."""
    augment = A.ImageSequential(*[A.RandomRotation(30.0, p=0.5) for _ in range(3)])
    for options in ({"seed": 5}, {"seed": torch.arange(N)}, {}):
        torch.manual_seed(3)
        augment(torch.zeros(1, 1, 1, 1).expand(N, 1, 1, 1), **options)
        angles = [item.data["degrees"].double() for item in augment._params]
        chosen = [item.data["batch_prob"].double() for item in augment._params]
        for a, b in itertools.combinations(range(3), 2):
            assert stats.spearmanr(chosen[a], chosen[b]).pvalue > LEVEL
            both = (chosen[a] > 0) & (chosen[b] > 0)
            assert stats.spearmanr(angles[a][both], angles[b][both]).pvalue > LEVEL
        for angle, at in zip(angles, chosen):
            assert Uniform(-30, 30).p_value(angle[at > 0]) > LEVEL
