"""Fog, frost and spatter."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, TypeAlias, get_args

import torch
import torch.nn.functional as F
from torch import Tensor

from kvision import _check
from kvision._clamp import clamp
from kvision._constants import constant
from kvision._dtype import compute_dtype
from kvision.augmentation import maps, ranges
from kvision.augmentation.corruption.blurs import reach_of
from kvision.augmentation.corruption.noises import params_in_type_of
from kvision.augmentation.engine import Params
from kvision.augmentation.intensity_base import IntensityAugmentationBase2D
from kvision.augmentation.random_generator.mapped import MappedGenerator, NoiseMap
from kvision.augmentation.random_generator.plasma import PlasmaGenerator
from kvision.augmentation.ranges import Numbers
from kvision.augmentation.warp_and_color import Resampling
from kvision.core.exceptions import ShapeError, TypeCheckError
from kvision.enhance.equalize import equalize
from kvision.filters.filter2d import filter2d
from kvision.filters.smoothing.gaussian import gaussian_blur2d

SpatterMode: TypeAlias = Literal["rain", "mud"]
_COLORS = {"rain": (175 / 255, 238 / 255, 238 / 255), "mud": (63 / 255, 42 / 255, 20 / 255)}
_FAR = 20  # pixels from the outline of a drop, from which on its relief is flat


def fogged(x: Tensor, plasma: Tensor, amount: Tensor) -> Tensor:
    """Images under clouds (B, 1, H, W), stretched to [0, 1], of amounts (B, 1, 1, 1); the brightest value stays as it is."""
    low, high = plasma.amin((2, 3), keepdim=True), plasma.amax((2, 3), keepdim=True)
    brightest = x.amax((1, 2, 3), keepdim=True)
    darker = brightest / (brightest + amount).clamp(min=1e-12)
    clouds = (plasma - low) * (darker * amount / (high - low).clamp(min=1e-12))
    return clamp(torch.addcmul(clouds, x, darker), 0, 1)


class RandomFog(IntensityAugmentationBase2D, keeps_contract=True):
    """Add fractal clouds to images, and darken them so that the brightest value stays, as in ImageNet-C.

    Args:
        intensity: pair of the lowest and the highest amount of fog, of at least 0.
        roughness: pair, within 0 and 1: the weight of fine structure.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.full((1, 1, 4, 4), 0.5)
        >>> torch.allclose(K.augmentation.RandomFog((0.0, 0.0), p=1.0)(x), x)
        True
    """

    accepts_bytes = False

    def __init__(
        self,
        intensity: Numbers = (1.5, 3.0),
        roughness: Numbers = (0.25, 0.5),
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        bounds = (0.0, float("inf"))
        self._param_generator = PlasmaGenerator(
            "RandomFog", roughness, (intensity, "intensity", None, bounds), one_channel=True
        )

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        plasma, amount = params_in_type_of(params, input, "plasma", "intensity")
        return fogged(clamp(input, 0, 1), plasma, amount)


def as_textures(op: str, texture: Any) -> Tensor:
    """Textures (N, C, h, w), floating point in [0, 1], from one or several, also of bytes."""
    if not isinstance(texture, Tensor):
        raise TypeCheckError(f"{op}: expected texture to be a Tensor, got {type(texture).__name__}")
    _check.floating_or_bytes(op, "texture", texture)
    textures = texture[None] if texture.dim() == 3 else texture
    if textures.dim() != 4 or textures.shape[1] not in (1, 3) or 0 in textures.shape:
        raise ShapeError(f"{op}: expected texture of shape (N, 3, H, W) or (3, H, W), got {tuple(texture.shape)}")
    return textures.float() / 255 if textures.dtype == torch.uint8 else textures.detach()


def cut_textures(module: Any, params: Params, x: Tensor) -> Tensor:
    """A window of the textures of a module for each image, by uniform numbers `texture`, `top` and `left`.

    Images of other than 3 channels get its mean. Textures move to the device of the first images.
    """
    if module.texture.device != x.device:
        module.texture = module.texture.to(x.device)
    op, textures = type(module).__name__, module.texture
    (count, _, tall, wide), (height, width) = textures.shape, x.shape[-2:]
    if tall < height or wide < width:
        raise ShapeError(f"{op}: expected texture of at least {height} x {width} pixels, got {tall} x {wide}")
    u, down, right = (params[name].to(x.device, torch.float64)[:, None, None] for name in ("texture", "top", "left"))
    # Numbers below 1 may have been rounded to it.
    index = (u * count).long().clamp(max=count - 1)
    first_row = (down * (tall - height + 1)).long().clamp(max=tall - height)
    first_column = (right * (wide - width + 1)).long().clamp(max=wide - width)
    textures = textures.to(compute_dtype(x))
    if count == 1:  # in one launch, without a map of indices
        one, zero = torch.ones_like(down), torch.zeros_like(down)
        rows = ((one, zero, first_column), (zero, one, first_row), (zero, zero, one))
        matrix = torch.cat([torch.cat(row, 2) for row in rows], 1)
        windows = maps.warp(textures.expand(len(x), -1, -1, -1), matrix, (height, width), _PIXELS, inverse=False)
    else:
        at_rows = first_row + torch.arange(height, device=x.device)[:, None]
        at_columns = first_column + torch.arange(width, device=x.device)
        windows = textures[index, :, at_rows, at_columns].movedim(-1, 1)
    return windows if x.shape[1] == 3 else windows.mean(1, keepdim=True)


_PIXELS = Resampling("nearest", "border", True)
WINDOW = [((0.0, 1.0), name, None, None) for name in ("texture", "top", "left")]  # what `cut_textures` takes


class RandomFrost(IntensityAugmentationBase2D, keeps_contract=True):
    """Add windows of pictures of frost, which the user has, to darkened images.

    Args:
        texture: pictures (N, 3, h, w) or one (3, h, w), in [0, 1] or uint8, at least as large as images.
        image_weight_range: pair of the lowest and the highest factor of images.
        frost_weight_range: the same of pictures.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: an argument does not have the form in Args; in a call, images larger than the pictures.

    Example:
        >>> import torch, kvision as K
        >>> frost = K.augmentation.RandomFrost(torch.ones(3, 8, 8), (0.5, 0.5), (0.25, 0.25), p=1.0)
        >>> frost(torch.ones(1, 1, 4, 4)).mean()
        tensor(0.7500)
    """

    accepts_bytes = False
    texture: Tensor

    def __init__(
        self,
        texture: Tensor,
        image_weight_range: Numbers = (0.6, 1.0),
        frost_weight_range: Numbers = (0.4, 0.75),
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self.register_buffer("texture", as_textures("RandomFrost", texture), persistent=False)
        self._param_generator = MappedGenerator(
            (image_weight_range, "image_weight", None, (0.0, float("inf"))),
            (frost_weight_range, "frost_weight", None, (0.0, float("inf"))),
            *WINDOW,
            identity=[1.0, 0.0, 0.0, 0.0, 0.0],
            op="RandomFrost",
        )

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        of_image, of_frost = params_in_type_of(params, input, "image_weight", "frost_weight")
        return clamp(torch.addcmul(of_frost * cut_textures(self, params, input), of_image, input), 0, 1)


class Spatter(IntensityAugmentationBase2D, keeps_contract=True):
    """Throw rain or mud at the lens: where smooth noise is above a threshold drops brighten images, or stains hide them.

    These are the modes of Albumentations' `Spatter` and of ImageNet-C. Images of other than 3 channels get the gray of the color.

    Args:
        mean_range: pair of the lowest and the highest mean of the noise.
        std_range: the same of its standard deviation.
        gauss_sigma_range: the same of the deviation of the Gaussian that smooths it, in pixels, above 0.
        cutout_threshold_range: the same of the threshold.
        intensity_range: the same of the brightness of drops, or of the deviation of the Gaussian that softens the edges of mud,
            above 0.
        mode: 'rain' or 'mud'.
        color: red, green and blue, within 0 and 1; default: pale turquoise of rain, brown of mud.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: an argument does not have the form in Args, or is out of bounds.

    Example:
        >>> import torch, kvision as K
        >>> mud = K.augmentation.Spatter(mean_range=(0.9, 0.9), mode="mud", color=(0.5, 0.5, 0.5), p=1.0)
        >>> mud(torch.ones(1, 3, 32, 32)).amin()
        tensor(0.5000)
    """

    accepts_bytes = False

    def __init__(
        self,
        mean_range: Numbers = (0.65, 0.65),
        std_range: Numbers = (0.3, 0.3),
        gauss_sigma_range: Numbers = (2.0, 2.0),
        cutout_threshold_range: Numbers = (0.68, 0.68),
        intensity_range: Numbers = (0.6, 0.6),
        mode: SpatterMode = "rain",
        color: Sequence[float] | None = None,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        op, any_number, positive = "Spatter", None, (1e-3, float("inf"))
        _check.choice(op, "mode", mode, get_args(SpatterMode))
        parsed = ranges.fill_value(op, "color", _COLORS[mode] if color is None else color)
        if not isinstance(parsed, list) or len(parsed) != 3:
            raise TypeCheckError(f"{op}: expected color to be three numbers, got {color!r}")
        self.mode, self.color = mode, tuple(parsed)
        generator = MappedGenerator(
            (mean_range, "mean", None, any_number),
            (std_range, "std", None, (0.0, float("inf"))),
            (gauss_sigma_range, "gauss_sigma", None, positive),
            (cutout_threshold_range, "cutout_threshold", None, any_number),
            (intensity_range, "intensity", None, positive),
            maps={"noise": NoiseMap(True, (1, None, None))},
            identity=[0.0, 0.0, 1.0, 1.0, 1.0],
            op=op,
        )
        self._reaches = reach_of(generator._ranges[2].high), reach_of(generator._ranges[4].high)
        self._param_generator = generator

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        names = ("mean", "std", "cutout_threshold", "intensity", "noise")
        mean, std, threshold, intensity, noise = params_in_type_of(params, input, *names)
        smooth, soft = (params[name].to(noise)[:, None].expand(-1, 2) for name in ("gauss_sigma", "intensity"))
        layer = _smooth(mean + std * noise, smooth, self._reaches[0])
        if self.mode == "rain":
            return rainy(input, layer, threshold, intensity, self.color)
        return muddy(input, layer, threshold, soft, self._reaches[1], self.color)


def _smooth(x: Tensor, deviations: Any, reach: int) -> Tensor:
    y: Tensor = gaussian_blur2d(x, (2 * reach + 1,) * 2, deviations, "replicate")
    return y


def spattered(x: Tensor, noise: Tensor, smooth: float, threshold: float, intensity: float, mode: SpatterMode) -> Tensor:
    """Images behind rain or mud of noise (B, 1, H, W)."""
    layer = _smooth(noise, (smooth, smooth), reach_of(smooth))
    if mode == "rain":
        return rainy(x, layer, threshold, intensity)
    return muddy(x, layer, threshold, (intensity, intensity), reach_of(intensity))


def _colored(x: Tensor, color: tuple[float, ...]) -> Tensor:
    """A color that broadcasts with images, gray where these are not RGB."""
    own = constant(color, x)[:, None, None]
    return own if x.shape[1] == 3 else own.mean()


def muddy(
    x: Tensor,
    layer: Tensor,
    threshold: Tensor | float,
    soft: Any,
    reach: int,
    color: tuple[float, ...] = _COLORS["mud"],
) -> Tensor:
    """Images behind stains where smooth noise (B, 1, H, W) is above a threshold; their edges have a Gaussian of so many taps."""
    stains = _smooth((layer > threshold).to(layer), soft, reach)
    stains = torch.where(stains < 0.8, 0, stains)
    return clamp(x * (1 - stains) + _colored(stains.expand_as(x), color) * stains, 0, 1)


def rainy(
    x: Tensor,
    layer: Tensor,
    threshold: Tensor | float,
    intensity: Tensor | float,
    color: tuple[float, ...] = _COLORS["rain"],
) -> Tensor:
    """Images brightened by drops where smooth noise (B, 1, H, W) is above a threshold.

    A drop is a relief of its levels, lit from a corner: that of the distance from the outlines of drops.
    """
    levels = torch.where(layer < threshold, 0, layer).clamp(0, 1).mul(255).floor()
    inside = (levels > 0).to(levels)
    least = torch.minimum(*(-F.max_pool2d(-inside, k, 1, (k[0] // 2, k[1] // 2)) for k in ((3, 1), (1, 3))))
    distance = _distances(inside > least)
    spread = equalize(_mean_of_nine(distance).floor().to(torch.uint8), opencv=True).to(levels)
    light = constant(((-2.0, -1.0, 0.0), (-1.0, 1.0, 1.0), (0.0, 1.0, 2.0)), levels)[None]
    relief = _mean_of_nine(filter2d(spread, light).round().clamp(0, 255)).round() * levels
    drops = relief / relief.amax((2, 3), keepdim=True).clamp(min=1) * intensity
    return clamp(x + drops * _colored(x, color), 0, 1)


def _mean_of_nine(x: Tensor) -> Tensor:
    y: Tensor = filter2d(x, constant(((1 / 9,) * 3,) * 3, x)[None])
    return y


def _distances(is_marked: Tensor) -> Tensor:
    """The Euclidean distances (B, 1, H, W) to the nearest marked pixel, at most `_FAR`: along rows, and then along columns."""
    squares = (~is_marked).float() * _FAR**2
    for pad in ((_FAR, _FAR), (0, 0, _FAR, _FAR)):
        padded, axis = F.pad(squares, pad, value=float(_FAR**2)), 3 if len(pad) == 2 else 2
        for moved in range(-_FAR + 1, _FAR):
            near = padded.narrow(axis, _FAR + moved, squares.shape[axis])
            squares = torch.minimum(squares, near + moved * moved)
    return squares.sqrt()
