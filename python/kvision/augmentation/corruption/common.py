"""The common corruptions of robustness benchmarks, in five severities."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, Literal, NamedTuple, TypeAlias, get_args

import torch
from torch import Tensor

from kvision import _check
from kvision._clamp import clamp
from kvision._constants import constant
from kvision._dtype import compute_dtype
from kvision._modes import BLOCK_VALUE, BORDER
from kvision.augmentation import maps
from kvision.augmentation.corruption.blurs import mean_of_enlargements
from kvision.augmentation.corruption.disk import disk_kernels
from kvision.augmentation.corruption.fog import Fog
from kvision.augmentation.corruption.glass import Moves, glass, reach_of
from kvision.augmentation.corruption.layer import layered
from kvision.augmentation.corruption.moved import sum_of_moved
from kvision.augmentation.corruption.noises import as_stored, drawing, in_units
from kvision.augmentation.corruption.pixelate import pixelate
from kvision.augmentation.corruption.snow import add_snow
from kvision.augmentation.corruption.weather import WINDOW, SpatterMode, as_textures, fogged, frosted, spattered
from kvision.augmentation.engine import Execution, Params, Shape
from kvision.augmentation.intensity_base import IntensityAugmentationBase2D
from kvision.augmentation.lists import filter_lists, statistics_lists
from kvision.augmentation.lists.conversions import run_on_list
from kvision.augmentation.lists.drawn_layers import blurred_maps
from kvision.augmentation.lists.pixels import given_maps, packed_maps
from kvision.augmentation.lists.sides import rows_on_device, sides_of, sizes_of_list
from kvision.augmentation.maps import as_batch
from kvision.augmentation.noise import (
    BY_CHANNEL,
    CLAMP,
    MULTIPLY,
    PixelNoise,
    gaussian_noise,
    on_numbers,
    salt_and_pepper,
    shot_noise,
)
from kvision.augmentation.random_generator.base import RandomGeneratorBase
from kvision.augmentation.random_generator.mapped import Map, MappedGenerator, NoiseMap, NoiseOfList
from kvision.augmentation.random_generator.plasma import PlasmaGenerator
from kvision.augmentation.warp_and_color import ColorPart, ColorStep, Pass, Resampling, make_pass
from kvision.core.exceptions import ValueCheckError
from kvision.enhance.batch import colors
from kvision.filters.filter2d import filter_arguments
from kvision.filters.smoothing.gaussian import blur_arguments, gaussian_blur2d
from kvision.geometry.transform.lists.arguments import largest_shape, sizes
from kvision.geometry.transform.lists.kept_sizes import Operation, Operations

Images: TypeAlias = Sequence[Tensor] | None

# Each of the functions below takes images in [0, 1], the noise and numbers that were drawn, in their type, and the parameters of
# a severity.


def _gaussian_noise(x: Tensor, drawn: Params, deviation: float) -> Tensor:
    return x + deviation * drawn["noise"]


def _shot_noise(x: Tensor, drawn: Params, count: float) -> Tensor:
    return _photons(x, drawn["noise"], count)(x.detach())


_NO_IMPULSE = 0.5


def _impulse_noise(x: Tensor, drawn: Params, amount: float) -> Tensor:
    impulses = drawn["noise"]
    return torch.where(impulses == _NO_IMPULSE, x, impulses)


class Impulses(NamedTuple):
    """A map like :class:`NoiseMap` of 1 and 0 where pixels of channels are hit, and between elsewhere."""

    amount: float

    def draw(self, noise: PixelNoise, shape: Sequence[int], number: int) -> Tensor:
        """The map with a number of its own among those of an augmentation, float32."""
        like = torch.empty(0, dtype=torch.float32, device=noise.device)
        return on_numbers(_impulses(like, noise, self.amount), shape, _NO_IMPULSE, like)


# The same by one operator on images of any type, which draws the noise.


def _photons(x: Tensor, noise: PixelNoise | Tensor, count: float) -> Operation:
    return drawing(shot_noise, x, _mean_photons(x, count), noise)


def _mean_photons(x: Tensor, count: float) -> Tensor:
    return constant(((1 / count, 1.0),), x, compute_dtype(x))


def _impulses(x: Tensor, noise: PixelNoise, amount: float) -> Operation:
    parameters = constant(((amount, 0.5),), x, compute_dtype(x))
    return Operation(salt_and_pepper, (parameters, *noise.arguments(form=BY_CHANNEL)))


def _normal_terms(x: Tensor, noise: PixelNoise, deviation: float) -> Operation:
    parameters = constant(((0.0, deviation),), x, compute_dtype(x))
    return Operation(gaussian_noise, (parameters, *noise.arguments(form=CLAMP)))


def _normal_factors(x: Tensor, noise: PixelNoise, deviation: float, form: int = MULTIPLY | CLAMP) -> Operation:
    parameters = constant(((1.0, deviation),), x, compute_dtype(x))
    return Operation(gaussian_noise, (parameters, *noise.arguments(form=form)))


def _speckle_noise(x: Tensor, drawn: Params, deviation: float) -> Tensor:
    return x * drawn["noise"]


class Factors(NamedTuple):
    """A map like :class:`NoiseMap` of normal factors about 1."""

    deviation: float

    def draw(self, noise: PixelNoise, shape: Sequence[int], number: int) -> Tensor:
        """The map with a number of its own among those of an augmentation, float32."""
        like = torch.empty(0, dtype=torch.float32, device=noise.device)
        return on_numbers(_normal_factors(like, noise, self.deviation, MULTIPLY), shape, 1.0, like)


# Those that take `images` are one operator, for images like a batch or, where they are given, for a list of them.


def _gaussian_blur(like: Tensor, drawn: Params, images: Images, sigma: float) -> Operation:
    window = (2 * reach_of(sigma) + 1,) * 2
    arguments = blur_arguments("gaussian_blur2d", like, window, (sigma, sigma), "replicate")
    return Operation(filter_lists.gaussian_blur2d, arguments[1:])


def _glass_blur(x: Tensor, drawn: Params, sigma: float, max_delta: int, iterations: int) -> Tensor:
    return glass(x, drawn["noise"], sigma, max_delta, iterations, "replicate")(x)


def _frosted_glass(x: Tensor, noise: PixelNoise | Tensor, sigma: float, max_delta: int, iterations: int) -> Operations:
    return glass(x, noise, sigma, max_delta, iterations, "replicate")


@functools.lru_cache
def _disk(radius: int, alias_blur: float) -> tuple[Any, ...]:
    """The taps (1, K, K) of a disk."""
    deviations = torch.tensor([alias_blur], dtype=torch.float64, device="cpu")
    disks = disk_kernels(deviations, torch.tensor([radius], device="cpu"), radius)
    return tuple(tuple(map(tuple, disk)) for disk in disks.tolist())


def _defocus_blur(like: Tensor, drawn: Params, images: Images, radius: int, alias_blur: float) -> Operation:
    disk = constant(_disk(radius, alias_blur), like, compute_dtype(like))
    reach = disk.shape[-1] // 2
    _check.reflectable("CommonCorruption", like, (reach, reach), "reflect", "choose another corruption")
    return Operation(filter_lists.filter2d, filter_arguments("CommonCorruption", like, disk)[1:])


def _motion_blur(like: Tensor, drawn: Params, images: Images, radius: int, sigma: float) -> Operation:
    """Means along a line that begins at the pixel, with the weights of half a Gaussian; borders are replicated."""
    own = drawn["angle"].dtype
    angle = drawn["angle"][:, None] * (math.pi / 180)
    steps = constant(tuple((float(i), float(i)) for i in range(2 * radius + 1)), like, own)
    weights = constant(_half_of_a_gaussian(radius, sigma), like, own)
    right, down = (steps * torch.stack([angle.cos(), angle.sin()], 2) - 0.5).ceil().unbind(2)
    height, width = sides_of(like, images)
    is_inside = (right.abs() < width) & (down.abs() < height)
    scales = constant(((1.0,),), like, own).expand_as(right)
    return Operation(sum_of_moved, (torch.stack([scales, right, down, is_inside * weights], 2),))


@functools.lru_cache
def _half_of_a_gaussian(radius: int, sigma: float) -> tuple[float, ...]:
    """The weights of the pixels 0 to 2 radius, whose sum is 1."""
    weights = [math.exp(-0.5 * (i / sigma) ** 2) for i in range(2 * radius + 1)]
    return tuple(weight / math.fsum(weights) for weight in weights)


def _zoom_blur(like: Tensor, drawn: Params, images: Images, count: int, step: float) -> Operation:
    steps = torch.full((len(like),), step, device=like.device, dtype=compute_dtype(like))
    return mean_of_enlargements(sides_of(like, images), torch.full_like(steps, torch.inf), steps, count)


def _snow(
    like: Tensor,
    drawn: Params,
    images: Images,
    mean: float,
    deviation: float,
    zoom: float,
    threshold: float,
    radius: int,
    sigma: float,
    weight: float,
) -> Operation:
    """Flakes are noise about a mean, enlarged, where it is above a threshold, and blurred along a line."""
    shrink, noise, own = 1 / zoom, drawn["noise"], compute_dtype(like)
    blur, flakes = _motion_blur(like, drawn, images, radius, sigma), _above(mean, deviation, threshold)

    def enlarging(height: int, width: int) -> tuple[float, ...]:
        return (shrink, (1 - shrink) * (width - 1) / 2, (1 - shrink) * (height - 1) / 2, 1.0)

    if images is None:
        enlarged = sum_of_moved(noise, constant(((enlarging(*like.shape[-2:]),),), like, own))
        return Operation(add_snow, (blur(flakes.run(enlarged, None)[0]), weight))
    rows = [enlarging(*x.shape[-2:]) for x in images]
    moves = rows_on_device(torch.tensor(rows, dtype=torch.float64, device="cpu"), like, own)
    layers = run_on_list(flakes, Operation(sum_of_moved, (moves[:, None],)).on_list(noise))
    return Operation(add_snow, (blur.on_list(layers), weight))


@functools.lru_cache
def _within_range() -> Pass:
    return make_pass(None, parts=[ColorPart([_CLAMPED])])


@functools.lru_cache
def _above(mean: float, deviation: float, threshold: float) -> Pass:
    """Noise times a deviation and plus a mean, within [0, 1], and 0 where it is not above a threshold."""
    scaled = ColorStep("scale_shift", deviation, mean, 0.0)
    return make_pass(None, parts=[ColorPart([scaled, ColorStep("threshold", threshold, 0.0, 0.0, 1.0, 0.0), _CLAMPED])])


def _frost(like: Tensor, drawn: Params, images: Images, of_image: float, of_frost: float) -> Operation:
    return frosted(drawn["module"], drawn, like, of_image, of_frost, images)


def _fog(like: Tensor, drawn: Params, images: Images, amount: float, roughness: float) -> Fog:
    return fogged(drawn["plasma"], constant((amount,), like, compute_dtype(like)), images)


def _contrast(like: Tensor, drawn: Params, images: Images, factor: float) -> Operation:
    return Operation(statistics_lists.channel_contrast, (factor,))


class Shifts(NamedTuple):
    """A map like :class:`NoiseMap` of numbers for x and y, between so many heights of the image and minus that."""

    most: float

    @property
    def moves_pixels(self) -> bool:
        """All channels alike."""
        return True

    def draw(self, noise: PixelNoise, shape: Sequence[int], number: int) -> Tensor:
        """The map with a number of its own among those of an augmentation, float32."""
        return noise.symmetric((shape[0], 2, *shape[2:]), number, self.most * shape[2])

    def draw_list(self, noise: PixelNoise, shapes: Sequence[Sequence[int]], number: int) -> list[Tensor]:
        """The maps of the images of a list, of a shape (C, H, W) each."""
        scales = [self.most * shape[1] for shape in shapes]
        return noise.symmetric_list([(2, *shape[1:]) for shape in shapes], scales, number)


_SHIFT, _SIGMA = 0.005, 0.01  # of the side of an image
_MIRRORED = Resampling("bilinear", "reflection", False)


class Displaced(NamedTuple):
    """What reads images by a map, or those of a list by maps as :func:`maps.read_displaced_list` takes them, as an operation."""

    displacements: Tensor

    def __call__(self, images: Tensor) -> Tensor:
        y = maps.read_displaced(images, self.displacements, _MIRRORED)
        return y if images.dtype == torch.uint8 else clamp(y, 0, 1)

    def on_list(self, images: Sequence[Tensor], chosen: Tensor | None = None) -> list[Tensor]:
        """The results of images (C, H, W) of different sizes; the maps of those that are not `chosen` are 0."""
        y = maps.read_displaced_list(images, self.displacements, _MIRRORED)
        if y[0].dtype == torch.uint8:
            return y
        if chosen is None:
            return run_on_list(_within_range(), y)
        nothing = constant(((((0.0,),),),), y[0], compute_dtype(y[0])).expand(-1, -1, *largest_shape(images)[2:])
        return layered(nothing, 1.0, 0.0, 0.0, 0.0).on_list(y, chosen)


def _elastic_transform(like: Tensor, drawn: Params, images: Images, alpha: float) -> Displaced:
    noise = drawn["noise"]
    if images is not None:
        return Displaced(_blurred_maps_of_list(noise))
    sigma = like.shape[-2] * _SIGMA, like.shape[-1] * _SIGMA
    sides = 2 * int(3 * sigma[0] + 0.5) + 1, 2 * int(3 * sigma[1] + 0.5) + 1
    return Displaced(gaussian_blur2d(noise, sides, sigma))


def _blurred_maps_of_list(noise: NoiseOfList | Sequence[Tensor]) -> Tensor:
    blur = _SIGMA, BORDER["reflect"]
    if isinstance(noise, NoiseOfList) and (fused := blurred_maps(noise, *blur)) is not None:
        return fused
    each = noise.each(compute_dtype(noise.images[0])) if isinstance(noise, NoiseOfList) else list(noise)
    (blurred,) = filter_lists.gaussian_blur2d_of_sides(each, *blur)
    return blurred.detach()


def _pixelate(like: Tensor, drawn: Params, images: Images, scale: float) -> Operation:
    if images is None:
        counts = constant((tuple(max(int(n * scale), 1) for n in like.shape[-2:]),), like, torch.float32)
    else:
        counts = (sizes_of_list(images) * scale).floor().clamp(min=1).float()
    return Operation(pixelate, (counts, BLOCK_VALUE["mean_of_whole"]))


def _hsv_steps(factors: Sequence[float], shifts: Sequence[float]) -> list[ColorStep]:
    """Scale and shift saturation and value, clamped to [0, 1]. Hue is an eighth meanwhile, which is in [0, 1], too."""
    return [
        ColorStep("rgb_to_hsv", _EPS),
        ColorStep("scale_shift_rgb", 1 / 8, *factors, 0.0, *shifts, 1.0),
        ColorStep("scale_shift_rgb", 8.0, 1.0, 1.0),
        ColorStep("hsv_to_rgb"),
        _CLAMPED,
    ]


_EPS, _CLAMPED = 1e-8, ColorStep("scale_shift", 1.0, 0.0, 1.0)


def _brightness(channels: int, change: float) -> list[ColorStep]:
    return _hsv_steps((1.0, 1.0), (0.0, change)) if channels == 3 else [ColorStep("scale_shift", 1.0, change, 1.0)]


def _saturate(channels: int, factor: float, change: float) -> list[ColorStep]:
    return _hsv_steps((factor, 1.0), (change, 0.0)) if channels == 3 else [_CLAMPED]


def _jpeg_compression(like: Tensor, drawn: Params, images: Images, quality: float) -> Operation:
    colors("CommonCorruption", "input", like)
    return Operation(statistics_lists.jpeg, (None, None, None, float(quality)))


def _spatter(
    like: Tensor,
    drawn: Params,
    images: Images,
    mean: float,
    deviation: float,
    smooth: float,
    threshold: float,
    intensity: float,
    is_mud: float,
) -> Operation:
    mode: SpatterMode = "mud" if is_mud else "rain"
    return spattered(like, drawn["noise"], mean, deviation, smooth, threshold, intensity, mode)


class Corruption(NamedTuple):
    """A corruption: its function, its parameters in five severities, and what is drawn for it."""

    apply: Callable[..., Any] | None
    severities: tuple[tuple[float, ...], ...]
    map: Map | None = None
    angle: tuple[float, float] | None = None  # degrees
    fused: Callable[..., Any] | None = None  # of images of any type, the source of noise and the parameters
    takes_bytes: bool = False  # as they are, and gives results in [0, 1]
    is_operation: bool = False  # the function, or the fused one, gives an operator that has a kernel for lists
    steps: Callable[..., list[ColorStep]] | None = None  # instead, of the number of channels and the parameters


def _each(*numbers: float) -> tuple[tuple[float, ...], ...]:
    return tuple((number,) for number in numbers)


_UNIFORM, _NORMAL, _PLANE = NoiseMap(), NoiseMap(True), (1, None, None)
# The parameters of ImageNet-C: D. Hendrycks and T. Dietterich, Benchmarking neural network robustness to common corruptions and
# perturbations, ICLR 2019, as in the package imagecorruptions 1.1.2 for images of any size. The first 15 are the benchmark, the
# others its validation set.
CorruptionName: TypeAlias = Literal[
    "gaussian_noise", "shot_noise", "impulse_noise", "defocus_blur", "glass_blur", "motion_blur", "zoom_blur", "snow",
    "frost", "fog", "brightness", "contrast", "elastic_transform", "pixelate", "jpeg_compression",
    "speckle_noise", "gaussian_blur", "spatter", "saturate",
]  # fmt: skip
CORRUPTIONS: dict[CorruptionName, Corruption] = {
    "gaussian_noise": Corruption(
        _gaussian_noise, _each(0.08, 0.12, 0.18, 0.26, 0.38), _NORMAL, fused=_normal_terms, is_operation=True
    ),
    "shot_noise": Corruption(_shot_noise, _each(60, 25, 12, 5, 3), _UNIFORM, fused=_photons, is_operation=True),
    "impulse_noise": Corruption(
        _impulse_noise, _each(0.03, 0.06, 0.09, 0.17, 0.27), fused=_impulses, is_operation=True
    ),
    "defocus_blur": Corruption(
        _defocus_blur, ((3, 0.1), (4, 0.5), (6, 0.5), (8, 0.5), (10, 0.5)), takes_bytes=True, is_operation=True
    ),
    "glass_blur": Corruption(
        _glass_blur,
        ((0.7, 1, 2), (0.9, 2, 1), (1.0, 2, 3), (1.1, 3, 2), (1.5, 4, 2)),
        fused=_frosted_glass,
        takes_bytes=True,
        is_operation=True,
    ),
    "motion_blur": Corruption(
        _motion_blur,
        ((10, 3), (15, 5), (15, 8), (15, 12), (20, 15)),
        None,
        (-45.0, 45.0),
        takes_bytes=True,
        is_operation=True,
    ),
    "zoom_blur": Corruption(
        _zoom_blur,
        ((12, 0.01), (16, 0.01), (11, 0.02), (13, 0.02), (11, 0.03)),
        takes_bytes=True,
        is_operation=True,
    ),
    "snow": Corruption(
        _snow,
        (
            (0.1, 0.3, 3, 0.5, 10, 4, 0.8),
            (0.2, 0.3, 2, 0.5, 12, 4, 0.7),
            (0.55, 0.3, 4, 0.9, 12, 8, 0.7),
            (0.55, 0.3, 4.5, 0.85, 12, 8, 0.65),
            (0.55, 0.3, 2.5, 0.85, 12, 12, 0.55),
        ),
        NoiseMap(True, _PLANE),
        (-135.0, -45.0),
        takes_bytes=True,
        is_operation=True,
    ),
    "frost": Corruption(
        _frost,
        ((1.0, 0.4), (0.8, 0.6), (0.7, 0.7), (0.65, 0.7), (0.6, 0.75)),
        takes_bytes=True,
        is_operation=True,
    ),
    # The noise of its fractal shrinks by the square of the published decay, 2, 2, 1.7, 1.5 or 1.4, from step to step.
    "fog": Corruption(
        _fog,
        ((1.5, 2**-2), (2.0, 2**-2), (2.5, 1.7**-2), (2.5, 1.5**-2), (3.0, 1.4**-2)),
        takes_bytes=True,
        is_operation=True,
    ),
    "brightness": Corruption(None, _each(0.1, 0.2, 0.3, 0.4, 0.5), steps=_brightness),
    "contrast": Corruption(_contrast, _each(0.4, 0.3, 0.2, 0.1, 0.05), takes_bytes=True, is_operation=True),
    "elastic_transform": Corruption(
        _elastic_transform,
        _each(12.5, 16.25, 21.25, 25.0, 30.0),
        takes_bytes=True,
        is_operation=True,
    ),
    "pixelate": Corruption(_pixelate, _each(0.6, 0.5, 0.4, 0.3, 0.25), takes_bytes=True, is_operation=True),
    "jpeg_compression": Corruption(_jpeg_compression, _each(25, 18, 15, 10, 7), is_operation=True),
    "speckle_noise": Corruption(
        _speckle_noise, _each(0.15, 0.2, 0.35, 0.45, 0.6), fused=_normal_factors, is_operation=True
    ),
    "gaussian_blur": Corruption(_gaussian_blur, _each(1, 2, 3, 4, 6), takes_bytes=True, is_operation=True),
    "spatter": Corruption(
        _spatter,
        (
            (0.65, 0.3, 4, 0.69, 0.6, False),
            (0.65, 0.3, 3, 0.68, 0.6, False),
            (0.65, 0.3, 2, 0.68, 0.5, False),
            (0.65, 0.3, 1, 0.65, 1.5, True),
            (0.67, 0.4, 1, 0.65, 1.5, True),
        ),
        NoiseMap(True, _PLANE),
        takes_bytes=True,
        is_operation=True,
    ),
    "saturate": Corruption(None, ((0.3, 0), (0.1, 0), (2, 0), (5, 0.1), (20, 0.2)), steps=_saturate),
}


# Whose given numbers of pixels say what becomes of each.
_BY_PIXEL = ("gaussian_noise", "impulse_noise", "speckle_noise")


class CommonCorruption(IntensityAugmentationBase2D, keeps_contract=True):
    """Corrupt images as the benchmark ImageNet-C does, by the name of the corruption and its severity.

    The parameters are those of Hendrycks and Dietterich, Benchmarking neural network robustness to common corruptions and
    perturbations, ICLR 2019, for images of any size and any number of channels. Results are clamped to [0, 1]. Labels stay as
    they are.

    Args:
        name: 'gaussian_noise', 'shot_noise', 'impulse_noise', 'defocus_blur', 'glass_blur', 'motion_blur', 'zoom_blur', 'snow',
            'frost', 'fog', 'brightness', 'contrast', 'elastic_transform', 'pixelate', 'jpeg_compression' (RGB); for validation
            'speckle_noise', 'gaussian_blur', 'spatter', 'saturate'.
        severity: 1 to 5.
        texture: for 'frost', pictures (N, 3, h, w) or one (3, h, w) of frost, in [0, 1] or uint8, at least as large as images.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: an argument does not have the form in Args; in a call, images smaller than the window of a blur.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.tensor([0.25, 0.75]).expand(1, 1, 2, 2)
        >>> K.augmentation.CommonCorruption("contrast", 3)(x)
        tensor([[[[0.4500, 0.5500],
                  [0.4500, 0.5500]]]])
    """

    NAMES: ClassVar[tuple[CorruptionName, ...]] = get_args(CorruptionName)

    texture: Tensor | None

    def __init__(
        self,
        name: CorruptionName,
        severity: int = 1,
        texture: Tensor | None = None,
        same_on_batch: bool = False,
        p: float = 1.0,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        op = "CommonCorruption"
        _check.choice(op, "name", name, self.NAMES)
        severity = _check.scalar(op, "severity", severity)
        if not _check.is_int(severity) or not 1 <= severity <= 5:
            raise ValueCheckError(f"{op}: expected severity to be 1, 2, 3, 4 or 5, got {severity!r}")
        if (name == "frost") != (texture is not None):
            raise ValueCheckError(f"{op}: expected texture for 'frost' and no other name, got {name!r}")
        self.name, self.severity = name, severity
        self.register_buffer("texture", None if texture is None else as_textures(op, texture), persistent=False)
        self.fuses_noise = CORRUPTIONS[name].fused is not None
        self.filters_chosen = CORRUPTIONS[name].is_operation and not self.fuses_noise
        self._of_pixels = ("noise",) if name in _BY_PIXEL else ()
        self.accepts_bytes = self.fuses_noise or CORRUPTIONS[name].takes_bytes
        self._param_generator = self._generator(op)

    def _generator(self, op: str) -> RandomGeneratorBase:
        _, severities, map, angle, *_ = CORRUPTIONS[self.name]
        numbers = severities[self.severity - 1]
        if self.name == "fog":
            return PlasmaGenerator(op, (numbers[1], numbers[1]), one_channel=True)
        if self.name == "glass_blur":
            map = Moves(int(numbers[2]))
        if self.name == "impulse_noise":
            map = Impulses(*numbers)
        if self.name == "elastic_transform":
            map = Shifts(numbers[0] * _SHIFT)
        if self.name == "speckle_noise":
            map = Factors(*numbers)
        samplers = WINDOW if self.name == "frost" else [] if angle is None else [(angle, "angle", None, None)]
        return MappedGenerator(*samplers, maps={} if map is None else {"noise": map}, op=op)

    def color_steps(self, shape: Shape, flags: dict[str, Any]) -> Sequence[ColorStep] | None:
        corruption = CORRUPTIONS[self.name]
        return corruption.steps and corruption.steps(shape[1], *corruption.severities[self.severity - 1])

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        corruption, numbers = self._corruption
        if corruption.apply is None:
            return super().apply_transform(input, params, flags, transform)
        if corruption.is_operation and ("_noise" in params or corruption.fused is None):
            return self._operation(input, params)(input)
        if corruption.fused is not None and "_noise" in params:
            y: Tensor = corruption.fused(input, params["_noise"][1], *numbers)
            return y
        x = input if corruption.takes_bytes else in_units(input)
        y = corruption.apply(x, self._drawn(params, x), *numbers)
        if corruption.takes_bytes:
            return y
        return as_stored(y, input) if input.dtype == torch.uint8 else clamp(y, 0, 1)

    @property
    def _corruption(self) -> tuple[Corruption, tuple[float, ...]]:
        corruption = CORRUPTIONS[self.name]
        return corruption, corruption.severities[self.severity - 1]

    def _drawn(self, params: Params, like: Tensor) -> Params:
        drawn: Params = {**params, "module": self}
        for name in ("noise", "angle", "plasma"):
            if isinstance(params.get(name), Tensor):
                drawn[name] = params[name].to(like.device, compute_dtype(like))
        return drawn

    def _operation(self, like: Tensor, params: Params, images: Images = None) -> Any:
        corruption, numbers = self._corruption
        operation: Operation | Operations | Displaced
        if corruption.fused is not None:
            noise = params["_noise"][1] if "_noise" in params else params["noise"]
            operation = corruption.fused(like, noise, *numbers)
        else:
            assert corruption.apply is not None
            operation = corruption.apply(like, self._drawn(params, like), images, *numbers)
        return operation

    def _operation_on_list(self, images: Sequence[Tensor], like: Tensor, execution: Execution) -> Any:
        generator = self._param_generator
        assert generator is not None
        if execution.params is not None:
            params = {**execution.params, **self._given_maps(images, like, execution)}
        elif self.fuses_noise or not generator.per_pixel:
            params = self._params_on_device(like, execution, for_users=False)
        else:
            assert execution.columns is not None
            values, noise = execution.columns.values, self._pixel_noise(execution, execution.redraw, like.device)
            if isinstance(generator, MappedGenerator):  # maps of each image, 0 of those that are not chosen
                chosen = None if execution.is_certain else execution.columns.chosen
                noise = noise._replace(chosen=None if chosen is None else chosen.float())
                drawn = NoiseOfList(generator.maps["noise"], noise, images)
                is_read_later = self.name in ("spatter", "elastic_transform")
                params = {
                    **self._named(values, execution),
                    "noise": drawn if is_read_later else drawn.each(compute_dtype(like)),
                }
            else:  # one as large as the largest image
                params = generator.pixel_params(values, (*like.shape[:2], *sizes(images)), noise)
        return self._operation(like, params, images)

    def _given_maps(self, images: Sequence[Tensor], like: Tensor, execution: Execution) -> Params:
        """The maps among given parameters, as operators on lists take them."""
        params: Params = execution.params or {}
        if self.name == "fog":
            return {"plasma": as_batch(given_maps(params["plasma"], like.device, compute_dtype(like)))}
        if self.name in ("shot_noise", "glass_blur"):
            planes = 2 * int(self._corruption[1][2]) if self.name == "glass_blur" else None
            return {"noise": packed_maps(params["noise"], images, planes)}
        if "noise" not in params:
            return {}
        return {"noise": given_maps(params["noise"], like.device, compute_dtype(like), execution.chosen)}

    def _operates_on(self, dtype: torch.dtype) -> bool:
        return self._corruption[0].is_operation and super()._operates_on(dtype)
