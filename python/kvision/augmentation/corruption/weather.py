"""Fog, frost and spatter."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, TypeAlias, get_args

import torch
from torch import Tensor

from kvision import _check
from kvision._constants import constant
from kvision._dtype import compute_dtype
from kvision.augmentation import ranges
from kvision.augmentation.corruption.drops import drop_depths, drop_reliefs, mark_stains
from kvision.augmentation.corruption.fog import Fog
from kvision.augmentation.corruption.glass import reach_of
from kvision.augmentation.corruption.layer import layered
from kvision.augmentation.corruption.layer_base import LayerAugmentation
from kvision.augmentation.engine import Execution, Params
from kvision.augmentation.lists import filter_lists, statistics_lists
from kvision.augmentation.lists.brightest import brightest
from kvision.augmentation.lists.drawn_layers import plasma_of_list, spatter_layers
from kvision.augmentation.lists.pixels import given_maps
from kvision.augmentation.lists.sides import rows_on_device, sides_of_list
from kvision.augmentation.maps import as_batch
from kvision.augmentation.random_generator.mapped import MappedGenerator, NoiseMap, NoiseOfList
from kvision.augmentation.random_generator.plasma import PlasmaGenerator
from kvision.augmentation.ranges import Numbers
from kvision.core.exceptions import ShapeError, TypeCheckError
from kvision.filters.smoothing.gaussian import blur_arguments
from kvision.geometry.transform.lists.arguments import largest_shape
from kvision.geometry.transform.lists.kept_sizes import Operation

SpatterMode: TypeAlias = Literal["rain", "mud"]
_COLORS = {"rain": (175 / 255, 238 / 255, 238 / 255), "mud": (63 / 255, 42 / 255, 20 / 255)}


def fogged(plasma: Tensor, amount: Tensor, images: Sequence[Tensor] | None = None) -> Fog:
    """What puts images under clouds (B, 1, H, W), stretched to [0, 1], of amounts (B,); the brightest value stays as it is.

    The clouds of a list are as large as the largest image.
    """
    if images is None:
        low, high = torch.aminmax(plasma.flatten(1), dim=1)
    else:
        down, right = sides_of_list(images)
        beyond = ~(down.inside(plasma)[:, None, :, None] & right.inside(plasma)[:, None, None])
        low = plasma.masked_fill(beyond, torch.inf).amin((1, 2, 3))
        high = plasma.masked_fill(beyond, -torch.inf).amax((1, 2, 3))
    return Fog(plasma, torch.stack(torch.broadcast_tensors(amount, low, high), 1))


class RandomFog(LayerAugmentation, keeps_contract=True):
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

    _param_generator: PlasmaGenerator

    def _operation(self, like: Tensor, params: Params) -> Any:
        plasma, amount = (params[name].to(like.device, compute_dtype(like)) for name in ("plasma", "intensity"))
        return fogged(plasma, amount)

    def _operation_on_list(self, images: Sequence[Tensor], like: Tensor, execution: Execution) -> Any:
        plasma = plasma_of_list(self, images, like, execution)
        return fogged(plasma, self._drawn_params(like, execution)["intensity"].to(plasma), images)


def as_textures(op: str, texture: Any) -> Tensor:
    """Textures (N, C, h, w), floating point in [0, 1], from one or several, also of bytes."""
    if not isinstance(texture, Tensor):
        raise TypeCheckError(f"{op}: expected texture to be a Tensor, got {type(texture).__name__}")
    _check.floating_or_bytes(op, "texture", texture)
    textures = texture[None] if texture.dim() == 3 else texture
    if textures.dim() != 4 or textures.shape[1] not in (1, 3) or 0 in textures.shape:
        raise ShapeError(f"{op}: expected texture of shape (N, 3, H, W) or (3, H, W), got {tuple(texture.shape)}")
    return textures.float() / 255 if textures.dtype == torch.uint8 else textures.detach()


def frosted(
    module: Any,
    params: Params,
    x: Tensor,
    of_image: Tensor | float,
    of_frost: Tensor | float,
    images: Sequence[Tensor] | None = None,
) -> Operation:
    """Images, and of the textures of a module a window for each, by weights: uniform numbers `texture`, `top`, `left` choose it.

    Images of other than 3 channels get the mean of a texture. Textures move to the device of the first images. Those of a list
    are like a batch `x`.
    """
    if module.texture.device != x.device:
        module.texture = module.texture.to(x.device)
    op, textures = type(module).__name__, module.texture
    count, _, tall, wide = textures.shape
    height, width = x.shape[-2:] if images is None else largest_shape(images)[-2:]
    if tall < height or wide < width:
        raise ShapeError(f"{op}: expected texture of at least {height} x {width} pixels, got {tall} x {wide}")
    u = torch.stack([params[name].to(x.device, torch.float64) for name in ("texture", "top", "left")], 1)
    # Numbers below 1 may have been rounded to it, which the operator clamps.
    if images is None:
        places = constant((count, tall - height + 1, wide - width + 1), u)
    else:
        of_each = ((count, tall - x.shape[-2] + 1, wide - x.shape[-1] + 1) for x in images)
        places = rows_on_device(torch.tensor(list(of_each), dtype=torch.float64, device="cpu"), u)
    own = textures if x.shape[1] == textures.shape[1] else textures.mean(1, keepdim=True)
    return layered(own.to(compute_dtype(x)), of_image, 0.0, of_frost, 0.0, windows=(u * places).long())


WINDOW = [((0.0, 1.0), name, None, None) for name in ("texture", "top", "left")]  # what `frosted` takes


class RandomFrost(LayerAugmentation, keeps_contract=True):
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

    def _operation(self, like: Tensor, params: Params, images: Sequence[Tensor] | None = None) -> Operation:
        names = ("image_weight", "frost_weight")
        of_image, of_frost = (params[name].to(like.device, compute_dtype(like))[:, None] for name in names)
        return frosted(self, params, like, of_image, of_frost, images)

    def _operation_on_list(self, images: Sequence[Tensor], like: Tensor, execution: Execution) -> Operation:
        return self._operation(like, self._params_on_device(like, execution, for_users=False), images)


class Spatter(LayerAugmentation, keeps_contract=True):
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

    _param_generator: MappedGenerator

    def _operation(self, like: Tensor, params: Params) -> Operation:
        own, noise = compute_dtype(like), params["noise"]
        mean, std, threshold, intensity, sigma = (
            params[name].to(like.device, own)
            for name in ("mean", "std", "cutout_threshold", "intensity", "gauss_sigma")
        )
        if isinstance(noise, Tensor):
            noise = noise.to(like.device, own)
        smoothing = _smoothing(like, sigma[:, None].expand(-1, 2), self._reaches[0])
        parameters = torch.stack([mean, std, threshold], 1).detach()
        if self.mode == "rain":
            return rainy(like, noise, smoothing, parameters, intensity, self.color)
        softening = _smoothing(like, intensity[:, None].expand(-1, 2), self._reaches[1])
        return muddy(like, noise, smoothing, parameters, softening, self.color)

    def _operation_on_list(self, images: Sequence[Tensor], like: Tensor, execution: Execution) -> Operation:
        params = self._drawn_params(like, execution)
        if execution.params is not None:
            noise: Any = given_maps(execution.params["noise"], like.device, compute_dtype(like))
        else:
            source = self._pixel_noise(execution, execution.redraw, like.device)
            noise = NoiseOfList(self._param_generator.maps["noise"], source, images)
        return self._operation(like, {**params, "noise": noise})


Layers: TypeAlias = Tensor | Sequence[Tensor]  # (B, 1, H, W), or (1, H, W) of each image of a list
Noise: TypeAlias = Layers | NoiseOfList  # of as many layers


def on_layers(operation: Operation, layers: Layers) -> Layers:
    """What an operator makes of layers."""
    return operation(layers) if isinstance(layers, Tensor) else operation.on_list(layers)


def _smoothing(like: Tensor, deviations: Any, reach: int) -> Operation:
    """A Gaussian blur of the layers of images like a batch."""
    arguments = blur_arguments("gaussian_blur2d", like, (2 * reach + 1,) * 2, deviations, "replicate")
    return Operation(filter_lists.gaussian_blur2d, arguments[1:])


def spattered(
    like: Tensor,
    noise: Noise,
    mean: float,
    deviation: float,
    smooth: float,
    threshold: float,
    intensity: float,
    mode: SpatterMode,
) -> Operation:
    """What puts images like a batch behind rain or mud of standard normal noise."""
    own = compute_dtype(like)
    smoothing = _smoothing(like, (smooth, smooth), reach_of(smooth))
    parameters = constant(((mean, deviation, threshold),), like, own)
    if mode == "rain":
        return rainy(like, noise, smoothing, parameters, constant((intensity,), like, own))
    softening = _smoothing(like, (intensity, intensity), reach_of(intensity))
    return muddy(like, noise, smoothing, parameters, softening)


def _layers(
    noise: Noise, smoothing: Operation, parameters: Tensor, softening: Operation | None
) -> tuple[Tensor, Tensor | None]:
    """The layers (B, 1, H, W) of stains, or without `softening` of drops, whose largest values (B,) follow them.

    Those of lists may be packed (N,), as :func:`layered` takes them.
    """
    if (
        isinstance(noise, NoiseOfList)
        and (fused := spatter_layers(noise, smoothing, parameters, softening)) is not None
    ):
        return fused
    smoothed = on_layers(smoothing, noise.each(parameters.dtype) if isinstance(noise, NoiseOfList) else noise)
    if softening is not None:
        return _as_batch(on_layers(softening, on_layers(Operation(mark_stains, (parameters,)), smoothed))), None
    depths = on_layers(Operation(drop_depths, (parameters,)), smoothed)
    equalized = on_layers(Operation(statistics_lists.equalize, (True,)), depths)
    reliefs = on_layers(Operation(drop_reliefs, (parameters, equalized)), smoothed)
    return _as_batch(reliefs), reliefs.amax((1, 2, 3)) if isinstance(reliefs, Tensor) else brightest(reliefs)


def _as_batch(layers: Layers) -> Tensor:
    return layers if isinstance(layers, Tensor) else as_batch(layers)


def _colored(color: tuple[float, ...], x: Tensor, like: Tensor) -> Tensor:
    """A color (1, C) for the channels of images, gray (1, 1) where these are not RGB."""
    own = constant((color,), like)
    return own if x.shape[1] == 3 else own.mean(1, keepdim=True)


def muddy(
    like: Tensor,
    noise: Noise,
    smoothing: Operation,
    parameters: Tensor,
    softening: Operation,
    color: tuple[float, ...] = _COLORS["mud"],
) -> Operation:
    """What puts images behind stains, whose edges are softened, where smoothed noise is above a threshold.

    Parameters (B or 1, 3) are mean and deviation of the noise, and the threshold.
    """
    stains, _ = _layers(noise, smoothing, parameters, softening)
    return layered(torch.nn.functional.threshold(stains, 0.8, 0), 1.0, -1.0, _colored(color, like, stains), 0.0)


def rainy(
    like: Tensor,
    noise: Noise,
    smoothing: Operation,
    parameters: Tensor,
    intensity: Tensor,
    color: tuple[float, ...] = _COLORS["rain"],
) -> Operation:
    """What brightens images by drops of intensities (B or 1,) where smoothed noise is above a threshold, as :func:`muddy` has it.

    A drop is a relief of its levels, lit from a corner: that of the distance from the outlines of drops.
    """
    reliefs, most = _layers(noise, smoothing, parameters, None)
    assert most is not None
    strength = (intensity / most.clamp(min=1))[:, None]
    return layered(reliefs, 1.0, 0.0, strength * _colored(color, like, strength), 0.0)
