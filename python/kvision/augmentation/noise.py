"""Noise of images as a function of keys, samples and pixels. Kernels draw it where they use it, with the same values everywhere.

The words of a pixel are those of the draw's block at `c * ceil(H * W / 4) + (y * W + x) // 4`, by the generator of
`draws`; c is 0 where all channels share the words of a pixel.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import torch
from torch import Tensor

from kvision._clamp import clamp
from kvision._constants import constant
from kvision._dtype import compute_dtype
from kvision._limits import NOISE_BY_CHANNEL as BY_CHANNEL
from kvision._limits import NOISE_CLAMP as CLAMP
from kvision._limits import NOISE_MULTIPLY as MULTIPLY
from kvision._limits import NOISE_RANDOM as RANDOM
from kvision._limits import NOISE_SHARED as SHARED
from kvision._limits import NOISE_UNIT as UNIT
from kvision._list_ops import ListOperator
from kvision._ops import Operator, match_layout, register, saturate_to_byte
from kvision.augmentation.draws import MAX_DRAWS, philox, unit
from kvision.augmentation.keys import Keys, flatten_draws
from kvision.augmentation.lists.pixels import PixelRow, unpacked_maps
from kvision.augmentation.lists.sides import rows_on_device
from kvision.geometry.transform.lists.arguments import fake_results, row, sizes
from kvision.geometry.transform.lists.kept_sizes import Operation, register_list

# Arguments of the operators: images (B, C, H, W); parameters (B, 2) of the type that is computed in, for images in [0, 1]
# (bytes have 255 times their noise); keys (K,) int64 on the CPU or the images' device; seeds (B,) int64, which replace the
# keys, or None; chosen (B,) float32, 0 for samples that stay as they are, or None; and the plan: index of the key, position
# in the chain, index of the draw, same_on_batch and, where they are not 0, the form, a sum of flags (csrc/augmentation/noise.h),
# and the number of the first sample, of some of those of a call.
NO_KEY = torch.zeros(1, dtype=torch.int64, device="cpu")  # of operators that are given their noise
_FLATTEN = flatten_draws(keys=2)
# Flags. Of normal and uniform noise: MULTIPLY, images are multiplied by it; CLAMP, results are clamped to [0, 1]; SHARED, all
# channels share it; UNIT, uniform noise is in [0, 1] in place of [-1, 1]. Of pixels that are hit: BY_CHANNEL, those of each
# channel; RANDOM, they get uniform noise, that of the next draw, in place of salt and pepper.


def _form(plan: Sequence[int]) -> int:
    return plan[4] if len(plan) > 4 else 0


def _first_sample(plan: Sequence[int]) -> int:
    return plan[5] if len(plan) > 5 else 0


def _words(
    images: Tensor, planes: int, keys: Tensor, seeds: Tensor | None, plan: Sequence[int]
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """The four words (B, planes, n) of each block of four pixels."""
    batch, device = images.shape[0], images.device
    index, position, draw, same = plan[:4]
    key = keys.to(device)[index].expand(batch) if seeds is None else seeds.expand(batch)
    sample = _first_sample(plan) + torch.arange(batch, device=device)
    sample = torch.zeros_like(sample) if same or seeds is not None else sample
    blocks = (images.shape[2] * images.shape[3] + 3) // 4
    block = torch.arange(planes * blocks, device=device)
    words = philox(key[:, None], (torch.full_like(block, draw), block, sample[:, None], position))
    first, second, third, fourth = (word.expand(batch, -1).view(batch, planes, blocks) for word in words)
    return first, second, third, fourth


def _by_pixel(four: Sequence[Tensor], images: Tensor) -> Tensor:
    """The values (B, planes, H, W) of pixels, from those of the four pixels of each block."""
    height, width = images.shape[2:]
    return torch.stack(tuple(four), -1).flatten(2)[..., : height * width].unflatten(-1, (height, width))


def words_of_pixels(images: Tensor, planes: int, keys: Tensor, seeds: Tensor | None, plan: Sequence[int]) -> Tensor:
    """The words (B, planes, H, W) of the pixels of images."""
    return _by_pixel(_words(images, planes, keys, seeds, plan), images)


def normals_of_pixels(images: Tensor, planes: int, keys: Tensor, seeds: Tensor | None, plan: Sequence[int]) -> Tensor:
    """The normal variates (B, planes, H, W) of the pixels of images, float64."""
    first, second, third, fourth = _words(images, planes, keys, seeds, plan)
    return _by_pixel((*_normals(first, second), *_normals(third, fourth)), images)


def _normals(a: Tensor, b: Tensor) -> tuple[Tensor, Tensor]:
    """Two variates of the standard normal distribution in float64, by the transform of Box and Muller.

    The first word, by its upper 31 bits in float32, gives the radius. The upper two bits of the second one are a quarter of
    a turn, the others the angle in it.
    """
    u = (a >> 1).float() * 2.0**-31 + 2.0**-32
    rest = (b << 2) & 0xFFFFFFFF
    rest = torch.where(rest < 2**31, rest, rest - 2**32)
    angle = 2 * torch.pi * ((b >> 30).double() * 0.25 + rest.double() * 2.0**-34)
    radius = (-2 * u.double().log()).sqrt()
    return radius * angle.cos(), radius * angle.sin()


def is_chosen(chosen: Tensor | None, images: Tensor) -> Tensor:
    """Which samples are chosen, bool (B, 1, 1, 1), or () for all."""
    if chosen is None:
        return torch.ones((), dtype=torch.bool, device=images.device)
    return chosen[:, None, None, None] != 0


def _stored(noisy: Tensor, images: Tensor, chosen: Tensor | None) -> Tensor:
    y = saturate_to_byte(noisy) if images.dtype == torch.uint8 else noisy.to(images.dtype)
    return match_layout(torch.where(is_chosen(chosen, images), y, images), images)


def _full_range(images: Tensor) -> float:
    return 255.0 if images.dtype == torch.uint8 else 1.0


def _computed(images: Tensor) -> Tensor:
    return images if images.dtype == torch.float64 else images.float()


def _gaussian_reference(
    images: Tensor,
    parameters: Tensor,
    keys: Tensor,
    seeds: Tensor | None,
    chosen: Tensor | None,
    plan: Sequence[int],
) -> Tensor:
    normals = normals_of_pixels(images, _planes(images, plan), keys, seeds, plan)
    return _added(normals, images, parameters, chosen, _form(plan))


def _uniform_reference(
    images: Tensor,
    parameters: Tensor,
    keys: Tensor,
    seeds: Tensor | None,
    chosen: Tensor | None,
    plan: Sequence[int],
) -> Tensor:
    """Words as signed numbers, in units of 2^31; the same numbers in [0, 1]."""
    words = words_of_pixels(images, _planes(images, plan), keys, seeds, plan)
    if _form(plan) & UNIT:
        return _added(unit(words ^ 2**31), images, parameters, chosen, _form(plan))
    signed = torch.where(words < 2**31, words, words - 2**32)
    return _added(signed.to(parameters.dtype) * 2.0**-31, images, parameters, chosen, _form(plan))


def _planes(images: Tensor, plan: Sequence[int]) -> int:
    return 1 if _form(plan) & SHARED else images.shape[1]


def _added(noise: Tensor, images: Tensor, parameters: Tensor, chosen: Tensor | None, form: int) -> Tensor:
    """Images with noise of a mean, the first parameter, times the second one."""
    most, x = _full_range(images), _computed(images)
    factor = 1 if form & MULTIPLY else most
    mean, scale = (factor * parameters[:, :, None, None, None]).unbind(1)
    noise = scale * noise.to(parameters.dtype) + mean
    y = x * noise if form & MULTIPLY else x + noise
    return _stored(clamp(y, 0, most) if form & CLAMP else y, images, chosen)


def _noise_backward(
    operator: str,
    needs: Sequence[bool],
    grad: Tensor,
    images: Tensor,
    parameters: Tensor,
    keys: Tensor,
    seeds: Tensor | None,
    chosen: Tensor | None,
    plan: Sequence[int],
) -> list[Tensor | None]:
    form = _form(plan)
    if not needs[1] and not form & (MULTIPLY | CLAMP):
        return [grad, None]
    grads, x, chooses = _computed(grad), _computed(images), is_chosen(chosen, images)
    noise = _ADDED[operator](torch.zeros_like(grads), *_noise_alone(parameters, keys, seeds, chosen, plan))
    mean, scale = parameters[:, :, None, None, None].unbind(1)
    to_images, to_term = _gradients_of_added(grads, x, mean + scale * noise, chooses, form)
    to_images = to_images.to(grad.dtype) if form & (MULTIPLY | CLAMP) else grad
    if not needs[1]:
        return [to_images, None]
    to_each = torch.stack([to_term.sum((1, 2, 3)), (to_term * noise).sum((1, 2, 3))], 1)
    return [to_images, to_each.sum_to_size(parameters.shape)]


def _noise_alone(
    parameters: Tensor, keys: Tensor, seeds: Tensor | None, chosen: Tensor | None, plan: Sequence[int]
) -> tuple[Any, ...]:
    """The arguments of noise of mean 0 and scale 1, which only factors, clamped results and ranges with gradients need."""
    own = [*plan[:4], _form(plan) & (SHARED | UNIT), _first_sample(plan)]
    return constant(((0.0, 1.0),), parameters), keys, seeds, chosen, own


def _gradients_of_added(grads: Tensor, x: Tensor, term: Tensor, chooses: Tensor, form: int) -> tuple[Tensor, Tensor]:
    """The gradients of images x, and of `term`, which is added or a factor, where `chooses`."""
    to_result = torch.where(chooses, grads, 0.0)
    if form & CLAMP:
        y = x * term if form & MULTIPLY else x + term
        to_result = torch.where((y < 0) | (y > 1), 0.0, to_result)
    if not form & MULTIPLY:
        return torch.where(chooses, to_result, grads), to_result
    return torch.where(chooses, to_result * term, grads), to_result * x


def _register_added(name: str, reference: Callable[..., Tensor]) -> Operator:
    backward = partial(_noise_backward, name)
    return register(name, reference, backward=backward, bytes=True, casts_outputs=True, flatten=_FLATTEN)


gaussian_noise = _register_added("gaussian_noise", _gaussian_reference)
uniform_noise = _register_added("uniform_noise", _uniform_reference)
_ADDED = {"gaussian_noise": gaussian_noise, "uniform_noise": uniform_noise}


def poisson_quantile(u: Tensor, rate: Tensor) -> Tensor:
    """The least count whose cumulative probability is at least `u`, uniform in [0, 1), so that counts have the distribution.

    The expansion of Cornish and Fisher is at most one off from rates of .1 on, below which hardly a count is above 2. The
    distribution itself, a function of the incomplete gamma function, says which way.
    """
    z = torch.special.ndtri(u.clamp(1e-7, 1 - 1e-7))
    count = (rate + rate.sqrt() * z + (z * z - 1) / 6).floor().clamp(min=0)
    count = torch.where(rate < 0.1, count.clamp(max=1), count)
    probability = (count * rate.clamp(min=1e-30).log() - rate - torch.lgamma(count + 1)).exp()
    cumulative = torch.special.gammaincc(count + 1, rate)
    is_above = (count > 0) & (cumulative - probability >= u)
    return count + (cumulative < u).to(count) - is_above.to(count)


def _shot_reference(
    images: Tensor,
    parameters: Tensor,
    keys: Tensor,
    seeds: Tensor | None,
    chosen: Tensor | None,
    uniform: Tensor | None,
    plan: Sequence[int],
) -> Tensor:
    """Light, images to the power of the second parameter, as multiples of a step, the first one: Poisson variates of its mean.

    They are quantiles of the words, or of given numbers `uniform` in [0, 1], float32 of the shape of images. Kernels sum
    probabilities up to a mean of 64, and use an expansion above, which is one off with a probability of at most 1e-4.
    """
    if uniform is None:
        uniform = unit(words_of_pixels(images, images.shape[1], keys, seeds, plan) ^ 2**31).float()
    step, power = parameters[:, :, None, None, None].unbind(1)
    counts = poisson_quantile(
        uniform.to(parameters.dtype), (_computed(images) / _full_range(images)).clamp(0, 1) ** power / step
    )
    return _stored(_full_range(images) * (counts * step).clamp(0, 1) ** (1 / power), images, chosen)


shot_noise = register(
    "shot_noise", _shot_reference, non_differentiable=(0,), bytes=True, casts_outputs=True, flatten=_FLATTEN
)


def _hits(
    images: Tensor, parameters: Tensor, keys: Tensor, seeds: Tensor | None, plan: Sequence[int]
) -> tuple[Tensor, Tensor]:
    """Which pixels (B, 1, H, W), or (B, C, H, W) by channel, are hit, and which of them by salt."""
    planes = images.shape[1] if _form(plan) & BY_CHANNEL else 1
    words = unit(words_of_pixels(images, planes, keys, seeds, plan))
    amount, salt = parameters.double()[:, :, None, None, None].unbind(1)
    return words < amount, words < amount * salt


def _salt_and_pepper_reference(
    images: Tensor,
    parameters: Tensor,
    keys: Tensor,
    seeds: Tensor | None,
    chosen: Tensor | None,
    plan: Sequence[int],
) -> Tensor:
    """Pixels are hit with the probability of the first parameter; those hit are salt with the probability of the second."""
    hit, salt = _hits(images, parameters, keys, seeds, plan)
    x, most = _computed(images), _full_range(images)
    fill = salt.to(x.dtype)
    if _form(plan) & RANDOM:
        index, position, draw, *rest = plan
        words = words_of_pixels(images, images.shape[1], keys, seeds, [index, position, draw + 1, *rest])
        fill = (words >> 8).to(x.dtype) * 2.0**-24
    return _stored(torch.where(hit, fill * most, x), images, chosen)


def _salt_and_pepper_backward_reference(
    grad: Tensor,
    parameters: Tensor,
    keys: Tensor,
    seeds: Tensor | None,
    chosen: Tensor | None,
    plan: Sequence[int],
) -> Tensor:
    hit, _ = _hits(grad, parameters, keys, seeds, plan)
    return _stored(torch.where(hit, 0.0, _computed(grad)), grad, chosen)


_salt_and_pepper_backward: Operator = register(
    "salt_and_pepper_backward",
    _salt_and_pepper_backward_reference,
    gradients="grad: salt_and_pepper_backward(grad=grad_grad)",
    linear=True,
    casts_outputs=True,
    flatten=_FLATTEN,
)
salt_and_pepper = register(
    "salt_and_pepper",
    _salt_and_pepper_reference,
    gradients="images: salt_and_pepper_backward",
    bytes=True,
    casts_outputs=True,
    flatten=_FLATTEN,
)


# --- lists ----------------------------------------------------------------------------------------------------------


def of_sample_of_list(
    b: int, parameters: Tensor, keys: Tensor, seeds: Tensor | None, chosen: Tensor | None, plan: Sequence[int]
) -> tuple[Any, ...]:
    """The arguments of an image of a list, by its number."""
    own = [*plan[:4], _form(plan), _first_sample(plan) + b]
    return row(parameters, b), keys, row(seeds, b), row(chosen, b), own


# Operators that may be given their numbers take those of a list as `packed_maps` gives them.


def of_sample_with_maps(
    b: int,
    parameters: Tensor,
    keys: Tensor,
    seeds: Tensor | None,
    chosen: Tensor | None,
    maps: Sequence[Tensor | None],
    plan: Sequence[int],
) -> tuple[Any, ...]:
    """The same with maps of each image."""
    *own, own_plan = of_sample_of_list(b, parameters, keys, seeds, chosen, plan)
    return *own, maps[b], own_plan


def with_maps_of_each(images: Sequence[Tensor], *args: Any, planes: int | None = None) -> tuple[Any, ...]:
    """The arguments of a list with the maps of each image, of so many planes, default: its channels, in place of packed ones."""
    *others, maps, plan = args
    return *others, unpacked_maps(maps, images, planes or images[0].shape[0]), plan


def keeping_unchosen(
    chosen: Tensor, parameters: Tensor, keys: Tensor, seeds: Tensor | None, _: Any, *rest: Any
) -> tuple[Any, ...]:
    """The arguments of noise that leaves images of a list which are not `chosen`, (B,), as they are."""
    return parameters, keys, seeds, chosen, *rest


def _salt_and_pepper_gradients(needs: Sequence[bool], grad: Tensor, images: Tensor, *args: Any) -> list[Tensor | None]:
    return [_salt_and_pepper_backward(grad, *args)]


def _all_pepper(grads: Sequence[Tensor], images: Sequence[Tensor], parameters: Tensor, *rest: Any) -> Sequence[Tensor]:
    """Gradients are 0 where pixels are hit, as images are where nothing is salt."""
    *others, plan = rest
    index, position, draw, same, *_ = plan
    own = [index, position, draw, same, _form(plan) & ~RANDOM, _first_sample(plan)]
    return _salt_and_pepper_list(grads, parameters * constant((1.0, 0.0), parameters), *others, own)


def _register_list(name: str, operator: str) -> None:
    def of_images(grads: Sequence[Tensor], images: Sequence[Tensor], parameters: Tensor, *rest: Any) -> list[Tensor]:
        *_, chosen, plan = rest
        form = _form(plan)
        if not form & (MULTIPLY | CLAMP):
            return list(grads)
        row, dtype = PixelRow(images), compute_dtype(grads[0])
        own_grads, own_images = row.of(grads).to(dtype), row.of(images).to(dtype)
        noise = of_list(row.split(torch.zeros_like(own_grads)), *_noise_alone(parameters, *rest))
        mean, scale = parameters.unbind(1)
        term = row.of_images(mean) + row.of_images(scale) * row.of(noise)
        chooses = constant((1.0,), parameters) if chosen is None else row.of_images(chosen)
        of_row, _ = _gradients_of_added(own_grads, own_images, term, chooses != 0, form)
        return row.split(of_row.to(grads[0].dtype))

    of_list = register_list(
        name, _ADDED[operator], of_sample_of_list, partial(_noise_backward, operator), of_images=of_images
    )


_register_list("gaussian_noise_list", "gaussian_noise")
_register_list("uniform_noise_list", "uniform_noise")
_salt_and_pepper_list = register_list(
    "salt_and_pepper_list", salt_and_pepper, of_sample_of_list, _salt_and_pepper_gradients, of_images=_all_pepper
)
register_list("shot_noise_list", shot_noise, of_sample_with_maps, kept=keeping_unchosen, by_image=with_maps_of_each)


# Values (C,), or (1,), of pixels that are hit, in the units of the images, in place of salt and pepper.


def _filled_reference(
    images: Sequence[Tensor], parameters: Tensor, values: Tensor, keys: Tensor, *rest: Any
) -> list[Tensor]:
    results = []
    for b, x in enumerate(images):
        columns, own_keys, seeds, chosen, plan = of_sample_of_list(b, parameters, keys, *rest)
        hit, _ = _hits(x[None], columns, own_keys, seeds, plan)
        own = saturate_to_byte(values) if x.dtype == torch.uint8 else values.to(x.dtype)
        filled = torch.where(hit, own[:, None, None], x)
        results.append(match_layout(torch.where(is_chosen(chosen, x[None]), filled, x), x[None])[0])
    return results


def _filled_gradients(
    needs: Sequence[bool], grads: Sequence[Tensor], images: Sequence[Tensor], parameters: Tensor, _: Tensor, *rest: Any
) -> list[Any]:
    return [_all_pepper(grads, images, parameters, *rest), *(None,) * (len(needs) - 1)]


fill_pixels_list = ListOperator(
    "fill_pixels_list",
    salt_and_pepper,
    _filled_reference,
    fake=lambda images, *args: fake_results(images, sizes(images)),
    backward=_filled_gradients,
)


def on_numbers(operation: Operation, shape: Sequence[int], value: float, like: Tensor) -> Any:
    """What an operator makes of images of one value, of a shape (B, C, H, W), or, with height and width of each, of a list."""
    _, channels, *sides = shape
    if len(sides) == 2:
        return operation(like.new_full(tuple(shape), value))
    counts = [channels * h * w for h, w in zip(sides[::2], sides[1::2])]
    each = like.new_full((sum(counts),), value).split(counts)
    return operation.on_list([x.view(channels, h, w) for x, h, w in zip(each, sides[::2], sides[1::2])])


# --- the source of an augmentation ----------------------------------------------------------------------------------


def noise_plan(number: int, has_seed: bool, same_on_batch: bool, map: int = 0) -> tuple[int, int, int, int]:
    """The plan of the noise of an augmentation, by its number as draw_columns counts."""
    key, position = (0, number) if has_seed else (number, 0)
    draw = MAX_DRAWS + 1 + map  # draws of parameters have the numbers up to MAX_DRAWS
    return key, position, draw, int(same_on_batch)


class PixelNoise(NamedTuple):
    """The source of the noise of one augmentation in one call: its key, which gives any number of independent maps."""

    keys: Keys
    number: int  # of the augmentation, as draw_columns counts
    same_on_batch: bool
    device: torch.device
    chosen: Tensor | None = None  # (B,), as the operators take it
    first: int = 0  # the number of the first sample

    def arguments(self, map: int = 0, form: int = 0) -> tuple[Tensor, Tensor | None, Tensor | None, tuple[int, ...]]:
        """The arguments of the operators after the parameters."""
        plan = noise_plan(self.number, self.keys.has_seed, self.same_on_batch, map)
        rest = (form, self.first) if self.first else (form,) if form else ()
        return self.keys.keys, self.keys.seeds_on(self.device), self.chosen, (*plan, *rest)

    def uniform(self, shape: Sequence[int], map: int = 0, dtype: torch.dtype = torch.float32) -> Tensor:
        """Uniform noise (B, C, H, W) in [0, 1]."""
        return self._between(shape, dtype, map, UNIT)

    def uniform_list(self, shapes: Sequence[Sequence[int]], map: int = 0) -> list[Tensor]:
        """The same of the samples of a list, of a shape (C, H, W) each."""
        return self._of_list(uniform_noise, shapes, map, UNIT)

    def normal_list(self, shapes: Sequence[Sequence[int]], map: int = 0) -> list[Tensor]:
        """Standard normal noise of the samples of a list, of a shape (C, H, W) each, float32."""
        return self._of_list(gaussian_noise, shapes, map, 0)

    def symmetric_list(self, shapes: Sequence[Sequence[int]], scales: Sequence[float], map: int = 0) -> list[Tensor]:
        """Uniform noise between the scale of each sample of a list and minus that, of a shape (C, H, W) each, float32."""
        return self._of_list(uniform_noise, shapes, map, 0, scales)

    def _of_list(
        self,
        operator: Operator,
        shapes: Sequence[Sequence[int]],
        map: int,
        form: int,
        scales: Sequence[float] | None = None,
    ) -> list[Tensor]:
        counts = [math.prod(shape) for shape in shapes]
        zero = torch.zeros(sum(counts), dtype=torch.float32, device=self.device)
        zeros = [part.view(*shape) for part, shape in zip(zero.split(counts), shapes)]
        parameters = constant(((0.0, 1.0),), zero)
        if scales is not None:
            rows = torch.tensor([(0.0, scale) for scale in scales], device="cpu")
            parameters = rows_on_device(rows, zero, torch.float32)
        return Operation(operator, (parameters, *self.arguments(map, form))).on_list(zeros)

    def symmetric(self, shape: Sequence[int], map: int = 0, scale: float = 1.0) -> Tensor:
        """Uniform noise (B, C, H, W) between a scale and minus that, float32."""
        return self._between(shape, torch.float32, map, 0, scale)

    def _between(self, shape: Sequence[int], dtype: torch.dtype, map: int, form: int, scale: float = 1.0) -> Tensor:
        zero = torch.zeros(tuple(shape), dtype=dtype, device=self.device)
        noise: Tensor = uniform_noise(zero, constant(((0.0, scale),), zero), *self.arguments(map, form))
        return noise

    def normal(self, shape: Sequence[int], map: int = 0) -> Tensor:
        """Standard normal noise (B, C, H, W), float32."""
        zero = torch.zeros(tuple(shape), dtype=torch.float32, device=self.device)
        noise: Tensor = gaussian_noise(zero, constant(((0.0, 1.0),), zero), *self.arguments(map))
        return noise
