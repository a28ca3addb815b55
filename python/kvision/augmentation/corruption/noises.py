"""Noise that depends on the image: of photons, of sensors, and factors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision._clamp import clamp
from kvision._dtype import compute_dtype
from kvision._ops import Operator, match_layout, register, vjp
from kvision.augmentation import ranges
from kvision.augmentation.channels import Scaling
from kvision.augmentation.draws import unit
from kvision.augmentation.engine import Execution, Params
from kvision.augmentation.intensity_base import IntensityAugmentationBase2D
from kvision.augmentation.keys import flatten_draws
from kvision.augmentation.lists.pixels import PixelRow, packed_maps
from kvision.augmentation.lists.replays import replay_pixels
from kvision.augmentation.noise import (
    CLAMP,
    NO_KEY,
    PixelNoise,
    is_chosen,
    keeping_unchosen,
    normals_of_pixels,
    of_sample_with_maps,
    poisson_quantile,
    shot_noise,
    with_maps_of_each,
    words_of_pixels,
)
from kvision.augmentation.random_generator.mapped import FactorsGenerator, MappedGenerator, NoiseMap
from kvision.augmentation.ranges import Numbers
from kvision.augmentation.samples import per_sample
from kvision.color.hls import hls_to_rgb, rgb_to_hls
from kvision.geometry.transform.lists.arguments import halves, like_batch
from kvision.geometry.transform.lists.kept_sizes import Operation, register_list, register_list_backward

_GAMMA = 2.2  # of the encoding that shot noise undoes


def params_in_type_of(params: Params, x: Tensor, *names: str) -> list[Tensor]:
    """Parameters in the type that `x` computes in; vectors (B,) broadcast with images."""
    own = (params[name].to(x.device, compute_dtype(x)) for name in names)
    return [per_sample(value, x) if value.dim() == 1 else value for value in own]


def in_units(x: Tensor) -> Tensor:
    """Images of any type in [0, 1], in the type that is computed in."""
    return x.float() / 255 if x.dtype == torch.uint8 else x.to(compute_dtype(x))


def as_stored(y: Tensor, like: Tensor) -> Tensor:
    """Values clamped to [0, 1] in the type of images, bytes in theirs."""
    y = clamp(y, 0, 1)
    return (255 * y).round().to(torch.uint8) if like.dtype == torch.uint8 else y.to(like.dtype)


def drawing(operator: Operator, like: Tensor, parameters: Tensor, noise: PixelNoise | Tensor) -> Operation:
    """An operator that draws the numbers of pixels from a source of noise, or is given maps of them, packed ones of a list."""
    own = parameters.to(like.device, compute_dtype(like))
    if isinstance(noise, Tensor):
        return Operation(operator, (own, NO_KEY, None, None, noise.to(like.device, torch.float32), (0, 0, 1, 0)))
    keys, seeds, chosen, plan = noise.arguments()
    return Operation(operator, (own, keys, seeds, chosen, None, plan))


class ShotNoise(IntensityAugmentationBase2D, keeps_contract=True):
    """Count photons: linear light becomes multiples of a step, Poisson variates of the image. Values are clamped to [0, 1].

    Args:
        scale_range: pair of the lowest and the highest step, above 0: white is 1 / step photons on average.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import torch, kvision as K
        >>> noisy = K.augmentation.ShotNoise((0.1, 0.1), p=1.0)(torch.full((1, 1, 64, 64), 0.5))
        >>> abs((noisy**2.2).mean() - 0.5**2.2) < 0.02
        tensor(True)
    """

    fuses_noise = True
    _param_generator: MappedGenerator

    def __init__(
        self,
        scale_range: Numbers = (0.1, 0.3),
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        # Columns as the operator takes them: the step and the power of light.
        self._param_generator = MappedGenerator(
            (scale_range, "scale", None, (1e-6, float("inf"))),
            ((_GAMMA, _GAMMA), "power", None, None),
            maps={"noise": NoiseMap()},
            identity=[1.0, 1.0],
            op="ShotNoise",
        )
        self._param_generator.hidden = ("power",)

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        if "_noise" in params:
            columns, noise = params["_noise"]
            if not columns.requires_grad:
                return self._operation(input, params)(input.detach())
            params = {**params, **self._param_generator.pixel_params(columns, tuple(input.shape), noise)}
        if not params["scale"].requires_grad:
            return self._operation(input, params)(input.detach())
        scale, u = params_in_type_of(params, input, "scale", "noise")
        light = clamp(in_units(input), 0, 1).to(scale.dtype) ** _GAMMA
        counts = poisson_quantile(u, light.detach() / scale)
        return as_stored(clamp(counts * scale, 0, 1) ** (1 / _GAMMA), input)

    def _operation(self, like: Tensor, params: Params) -> Operation:
        if "_noise" in params:
            return drawing(shot_noise, like, *params["_noise"])
        step, noise = params["scale"], params["noise"]
        noise = noise.expand(like.shape) if noise.dim() == 4 else noise  # of one channel; those of a list are packed
        return drawing(shot_noise, like, torch.stack([step, torch.full_like(step, _GAMMA)], 1), noise)

    def _operation_on_list(self, images: Sequence[Tensor], like: Tensor, execution: Execution) -> Operation:
        params = self._params_on_device(like, execution, for_users=False)
        if "_noise" not in params:
            params["noise"] = packed_maps(params["noise"], images)
        return self._operation(like, params)

    def _run_list(self, images: Sequence[Tensor], execution: Execution) -> list[Tensor]:
        given = execution.params
        if given is not None and given["scale"].requires_grad:  # for which there is no operator
            return replay_pixels(self, images, execution, ["noise"], ["scale"])
        return super()._run_list(images, execution)


def _iso_reference(
    images: Tensor,
    parameters: Tensor,
    keys: Tensor,
    seeds: Tensor | None,
    chosen: Tensor | None,
    maps: Tensor | None,
    plan: Sequence[int],
) -> Tensor:
    """RGB images whose hue gets normal noise, and whose lightness grows by Poisson counts of its own deviation.

    Parameters (B, 2) are the deviation of hue as a fraction of a turn and the intensity. `maps` (B, 2, H, W) float32, of uniform
    and of normal numbers, take the place of those of the draw and of the next one.
    """
    x = in_units(images)
    if maps is None:
        index, position, draw, *rest = plan
        u = unit(words_of_pixels(images, 1, keys, seeds, plan) ^ 2**31).float()
        normal = normals_of_pixels(images, 1, keys, seeds, [index, position, draw + 1, *rest])
    else:
        u, normal = maps.split(1, 1)
    shift, intensity = parameters[:, :, None, None, None].unbind(1)
    hue, lightness, saturation = rgb_to_hls(clamp(x, 0, 1)).split(1, 1)
    mean = lightness.detach().mean((1, 2, 3), keepdim=True)
    deviation = (lightness.detach() - mean).square().mean((1, 2, 3), keepdim=True).sqrt()
    counts = poisson_quantile(u.to(x.dtype), (deviation * intensity).expand_as(lightness))
    hue = hue + math.tau * shift * intensity * normal.to(x.dtype)
    lightness = clamp(lightness + counts * intensity * (1 - lightness), 0, 1)
    y = as_stored(hls_to_rgb(torch.cat([hue.remainder(math.tau), lightness, saturation], 1)), images)
    return match_layout(torch.where(is_chosen(chosen, images), y, images), images)


iso_noise = register(
    "iso_noise",
    _iso_reference,
    gradients="images: iso_noise_backward; parameters: reference",
    bytes=True,
    casts_outputs=True,
    flatten=flatten_draws(keys=2),
)
_iso_noise_backward = register(
    "iso_noise_backward", vjp(_iso_reference), layout_of=1, casts_outputs=True, flatten=flatten_draws(keys=3)
)


_with_maps_of_iso = partial(with_maps_of_each, planes=2)


def _iso_gradients_of_list(images_and_grads: Sequence[Tensor], *args: Any) -> list[Tensor]:
    images, grads = halves(images_and_grads)
    args = _with_maps_of_iso(images, *args)
    return [
        _iso_noise_backward.reference(g[None], x[None], *of_sample_with_maps(b, *args))[0]
        for b, (x, g) in enumerate(zip(images, grads))
    ]


_iso_noise_list_backward = register_list_backward(
    "iso_noise_list_backward", _iso_noise_backward, _iso_gradients_of_list
)
register_list(
    "iso_noise_list",
    iso_noise,
    of_sample_with_maps,
    kept=keeping_unchosen,
    of_images=lambda grads, images, *args: _iso_noise_list_backward([*images, *grads], *args),
    by_image=_with_maps_of_iso,
)


class ISONoise(IntensityAugmentationBase2D, keeps_contract=True):
    """Add the noise of a sensitive sensor to RGB images: counts to lightness, more where it varies, and normal noise to hue.

    Args:
        color_shift_range: pair of the lowest and the highest deviation of hue at intensity 1, as fractions of a turn.
        intensity_range: pair of the lowest and the highest strength, of at least 0.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds; in a call, images of other channels.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.ISONoise(p=1.0)(torch.full((1, 3, 1, 1), 0.5)).flatten()
        tensor([0.5000, 0.5000, 0.5000])
    """

    fuses_noise = True

    def __init__(
        self,
        color_shift_range: Numbers = (0.01, 0.05),
        intensity_range: Numbers = (0.1, 0.5),
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        plane = (1, None, None)
        self._param_generator = MappedGenerator(
            (color_shift_range, "color_shift", None, (0.0, 1.0)),
            (intensity_range, "intensity", None, (0.0, float("inf"))),
            maps={"luminance_noise": NoiseMap(size=plane), "color_noise": NoiseMap(True, plane)},
            op="ISONoise",
        )

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        return self._operation(input, params)(input)

    def _operation(self, like: Tensor, params: Params) -> Operation:
        _check.rgb("ISONoise", like.shape)
        if "_noise" in params:
            return drawing(iso_noise, like, *params["_noise"])
        maps = torch.cat([params["luminance_noise"], params["color_noise"]], 1)
        return drawing(iso_noise, like, torch.stack([params["color_shift"], params["intensity"]], 1), maps)

    def _operation_on_list(self, images: Sequence[Tensor], like: Tensor, execution: Execution) -> Operation:
        params = self._params_on_device(like, execution, for_users=False)
        if "_noise" in params:
            return self._operation(like, params)
        _check.rgb("ISONoise", like.shape)
        each = [plane for both in zip(params["luminance_noise"], params["color_noise"]) for plane in both]
        maps = packed_maps(each, [x for x in images for _ in range(2)], 1)
        return drawing(iso_noise, like, torch.stack([params["color_shift"], params["intensity"]], 1), maps)


def multiplication(generator: FactorsGenerator, like: Tensor, params: Params) -> Operation:
    """The operator that draws the factors where it multiplies by them."""
    columns, noise = params["_noise"]
    return Operation(generator.draw, (columns.to(compute_dtype(like)), *noise.arguments(form=generator.form | CLAMP)))


def multiplied(generator: FactorsGenerator, x: Tensor, params: Params) -> Tensor:
    """Images times the factors of a generator, clamped to their range."""
    if "_noise" in params:
        return multiplication(generator, x, params)(x)
    factors = params["factors"].to(x.device, compute_dtype(x))
    if x.dtype == torch.uint8:
        return (x.float() * factors).round().clamp(0, 255).to(torch.uint8)
    return clamp(x * factors, 0, 1).to(x.dtype)


class MultiplicativeNoise(IntensityAugmentationBase2D, keeps_contract=True):
    """Multiply images by random factors, and clamp them to [0, 1].

    Args:
        multiplier: pair of the lowest and the highest factor.
        per_channel: channels have factors of their own.
        elementwise: pixels have factors of their own.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: a range does not have the form in Args.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.MultiplicativeNoise((0.5, 0.5), p=1.0)(torch.ones(1, 1, 1, 2))
        tensor([[[[0.5000, 0.5000]]]])
    """

    _param_generator: FactorsGenerator

    def __init__(
        self,
        multiplier: Numbers = (0.9, 1.1),
        per_channel: bool = False,
        elementwise: bool = False,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        op = "MultiplicativeNoise"
        channels = None if _check.switch(op, "per_channel", per_channel) else 1
        self.fuses_noise = _check.switch(op, "elementwise", elementwise)
        self._of_pixels = ("factors",) if elementwise else ()
        side = None if elementwise else 1
        between = ranges.parse(op, "multiplier", multiplier, bounds=(0.0, float("inf")))
        self._param_generator = FactorsGenerator(op, between, (channels, side, side))

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        scaling = None if self.fuses_noise else self._scaling(input, params)
        return multiplied(self._param_generator, input, params) if scaling is None else scaling(input)

    def _scaling(self, like: Tensor, params: Params) -> Scaling | None:
        """The program for factors of images or of one or three channels; None for others."""
        factors = params["factors"].to(like.device, compute_dtype(like))
        if factors.shape[1] not in (1, 3) or factors.shape[2:] != (1, 1):
            return None
        factors = factors.flatten(1)
        return Scaling(factors, torch.zeros_like(factors), True)

    def _operation(self, like: Tensor, params: Params) -> Operation:
        return multiplication(self._param_generator, like, params)

    def _operates_on(self, dtype: torch.dtype) -> bool:
        return super()._operates_on(dtype) if self.fuses_noise else not self._is_customized()

    def _run_list(self, images: Sequence[Tensor], execution: Execution) -> list[Tensor]:
        if self.fuses_noise:
            return super()._run_list(images, execution)
        like, chosen = like_batch(images), execution.chosen
        params = self._params_on_device(like, execution, for_users=False)
        scaling = self._scaling(like, params)
        if scaling is not None:
            return scaling.on_list(images, chosen)
        row = PixelRow(images)
        x, factors = row.of(images), row.of_channels(params["factors"].flatten(1))
        y = multiplied(self._param_generator, x, {"factors": factors})
        return row.split(y if chosen is None else torch.where(row.of_images(chosen), y, x))


class SpeckleNoise(IntensityAugmentationBase2D, keeps_contract=True):
    """Add normal noise in proportion to the values of images, as coherent light has, and clamp them to [0, 1].

    Args:
        std_range: pair of the lowest and the highest standard deviation at white.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.SpeckleNoise((0.5, 0.5), p=1.0)(torch.zeros(1, 1, 1, 2))
        tensor([[[[0., 0.]]]])
    """

    fuses_noise = True
    _of_pixels = ("factors",)
    _param_generator: FactorsGenerator

    def __init__(
        self,
        std_range: Numbers = (0.1, 0.4),
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self._param_generator = FactorsGenerator("SpeckleNoise", ("std", std_range))

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        return multiplied(self._param_generator, input, params)

    def _operation(self, like: Tensor, params: Params) -> Operation:
        return multiplication(self._param_generator, like, params)
