"""Random parameters as pure functions: one operator draws those of all samples and all augmentations of a container.

A parameter is a function of a 64-bit key, the index of its sample and the index of its draw, by the counter-based generator
Philox 4x32-10 (Salmon et al., Parallel Random Numbers: As Easy as 1, 2, 3, SC 2011). Neither the batch, the device nor the
order of evaluation takes part in it. The counter of a block of four 32-bit words is

    (index of the draw, index of the block, index of the sample, position in the chain)

Draw 0 of each augmentation decides whether a sample is chosen; the others give columns of the result. A sample that is not
chosen gets the values that leave an image as it is, so that one launch serves all samples.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from kvision._limits import BATCH_SAMPLE, CHOSEN_DRAW, CROP_TRIES, DRAW_COLUMNS, DRAW_NUMBERS, GAMMA_TRIES
from kvision._limits import MAX_DRAW_NUMBERS as MAX_NUMBERS  # noqa: F401
from kvision._limits import MAX_DRAWS as MAX_DRAWS
from kvision._modes import DRAW_KIND
from kvision._ops import register
from kvision.augmentation.keys import flatten_draws

# --- kinds ----------------------------------------------------------------------------------------------------------
#
# Their numbers, and the columns of those that give several:
#
#   chosen                  1 for samples that are chosen, else 0
#   uniform                 lowest, highest, identity
#   integer                 lowest, step, count, identity: one of lowest + k step for k in 0 .. count - 1
#   exponential_of_uniform  logarithms of lowest and highest, identity
#   permutation             n; for samples not chosen: first, step of what stands instead
#   resized_crop            lowest and highest area, logarithms of both aspects, height, width: x, y, w, h
#   rectangle               lowest and highest area, lowest and highest aspect, height, width: x, y, w, h
#   beta                    alpha, beta, identity
#   normal                  mean, standard deviation, identity
#   uniform_and_affine      lowest, highest, scale, offset, identity of a real number v: v and scale * v + offset
#   uniform_of_sample       as uniform, and another one for each sample also under same_on_batch
#   rectangles              four times the most rectangles, the fewest, lowest and highest height, whether these are pixels and
#                           not fractions, the same of widths, height, width: x, y, w, h of each. Those behind a random number
#                           have no area.
#   number                  the number


class Kind(NamedTuple):
    """A kind of draw: its number in plans, how many numbers it takes and columns it gives."""

    number: int
    numbers: int
    columns: int  # 0: as many as its first number says


KINDS = {name: Kind(number, DRAW_NUMBERS[number], DRAW_COLUMNS[number]) for name, number in DRAW_KIND.items()}
_NAMES = tuple(KINDS)
SIZED = ("resized_crop", "rectangle", "rectangles")  # the last two of their numbers are the size of the image


class Draw(NamedTuple):
    """One draw of an augmentation: its kind and the numbers of the kind."""

    kind: str
    numbers: tuple[float, ...] = ()

    @property
    def columns(self) -> int:
        return KINDS[self.kind].columns or int(self.numbers[0])


def uniform(lowest: float, highest: float, identity: float = 0.0) -> Draw:
    """A real number between two bounds."""
    return Draw("uniform", (lowest, highest, identity))


def integer(lowest: int, highest: int, identity: int = 0, step: int = 1) -> Draw:
    """A multiple of `step` above `lowest`, up to `highest`."""
    return Draw("integer", (lowest, step, (highest - lowest) // step + 1, identity))


# --- the plan -------------------------------------------------------------------------------------------------------
#
# Arguments of the operator: the images, of which device and batch size are read; keys (K,) int64 on the CPU or the
# images' device; seeds (B,) int64 on the images' device, which replace the keys, or None; the plan; and the numbers. The
# plan is the number of columns, then for each request HEADER integers and the kinds of its draws. The numbers of a request
# are p, p_batch and those of its draws.

HEADER = 5  # key, position in the chain, same_on_batch, index of the first draw, number of draws


class Request(NamedTuple):
    """What one augmentation needs: its draws and the probabilities that it is applied."""

    draws: Sequence[Any]  # Draws, or what ranges.py has with the same attributes
    p: float = 1.0
    p_batch: float = 1.0
    same_on_batch: bool = False


class Plan(NamedTuple):
    """The plan of several requests; `first_columns[i]` is where the columns of request i begin."""

    plan: list[int]
    numbers: list[float]
    first_columns: list[int]


def make_plan(requests: Sequence[Request], has_seed: bool = False, position: int = 0) -> Plan:
    """Plan the draws of requests. Each has its own key, or, in a call that has a seed, its own position in the chain.

    The operator takes plans of at most MAX_DRAWS draws and MAX_NUMBERS numbers.
    """
    plan, firsts, column = [0], [], 0
    numbers: list[float] = []
    for i, (draws, p, p_batch, same_on_batch) in enumerate(requests):
        firsts.append(column)
        key, link = (0, position + i) if has_seed else (i, 0)
        plan += (key, link, int(same_on_batch), 1, len(draws))
        numbers += (p, p_batch)
        for draw in draws:
            plan.append(KINDS[draw.kind].number)
            numbers += draw.numbers
            column += draw.columns
    plan[0] = column
    return Plan(plan, numbers, firsts)


# --- Philox ---------------------------------------------------------------------------------------------------------

_MASK = 0xFFFFFFFF
_MULTIPLIERS, _KEY_STEPS = (0xD2511F53, 0xCD9E8D57), (0x9E3779B9, 0xBB67AE85)


def philox(key: Tensor | int, counter: Sequence[Tensor | int]) -> tuple[Any, Any, Any, Any]:
    """Four words of 32 bits, in int64 tensors or ints, from a key of 64 bits and a counter of four words."""
    a, b, c, d = counter
    low, high = key & _MASK, (key >> 32) & _MASK
    for _ in range(10):
        # The product of two words may be negative as int64; its bits are right.
        first, second = a * _MULTIPLIERS[0], c * _MULTIPLIERS[1]
        a, b, c, d = (
            ((second >> 32) & _MASK) ^ b ^ low,
            second & _MASK,
            ((first >> 32) & _MASK) ^ d ^ high,
            first & _MASK,
        )
        low, high = (low + _KEY_STEPS[0]) & _MASK, (high + _KEY_STEPS[1]) & _MASK
    return a, b, c, d


def mixed_words(x: Tensor) -> Tensor:
    """The lowest 32 bits of integers as others, one for each: after shifts and products every bit depends on all.

    With the numbers of C. Wellons's hash `lowbias32`.
    """
    x = x & 0xFFFFFFFF
    for shift, factor in ((16, 0x7FEB352D), (15, 0x846CA68B)):
        x = (x ^ (x >> shift)) * factor & 0xFFFFFFFF
    return x ^ (x >> 16)


def unit(word: Any) -> Any:
    """The number in [0, 1) of a word, in float64."""
    return (word.double() if isinstance(word, Tensor) else word) * 2.0**-32


def is_chosen_batch(key: int, position: int, p_batch: float) -> bool:
    """Whether a batch is augmented; for augmentations whose result has another size then."""
    if p_batch in (0.0, 1.0):
        return p_batch == 1.0
    return unit(philox(key, (CHOSEN_DRAW, 0, BATCH_SAMPLE, position))[0]) < p_batch


def are_chosen_batches(seeds: Tensor, position: int, p_batch: float) -> list[bool]:
    """What :func:`is_chosen_batch` says for each seed, by one operator."""
    plan, no_keys = make_plan([Request([Draw("chosen")], p_batch=p_batch)], True, position), seeds.new_zeros(1).cpu()
    batches = torch.empty(1, device="cpu").expand(len(seeds))
    chosen: list[float] = draw_parameters(batches, no_keys, seeds.cpu(), plan.plan, plan.numbers).flatten().tolist()
    return [one > 0.5 for one in chosen]


# --- the operator ---------------------------------------------------------------------------------------------------


def _reference(
    images: Tensor, keys: Tensor, seeds: Tensor | None, plan: Sequence[int], numbers: Sequence[float]
) -> Tensor:
    batch, device = images.shape[0], images.device
    sample = torch.arange(batch, device=device)
    keys = keys.to(device)
    columns: list[Tensor] = []
    at, number = 1, 0
    while at < len(plan):
        key, position, same, first, count = plan[at : at + HEADER]
        kinds, at = plan[at + HEADER : at + HEADER + count], at + HEADER + count
        p, p_batch = numbers[number : number + 2]
        number += 2
        # A seed is one of a sample: its index in the batch takes no part.
        of_sample = _Source(
            keys[key] if seeds is None else seeds.expand(batch),
            sample if seeds is None else torch.zeros_like(sample),
            position,
        )
        source = of_sample._replace(sample=torch.zeros_like(sample)) if same else of_sample
        whole_batch = source._replace(sample=torch.full_like(sample, BATCH_SAMPLE))
        chosen = (unit(source.words(CHOSEN_DRAW)[0]) < p) & (unit(whole_batch.words(CHOSEN_DRAW)[0]) < p_batch)
        for index, kind in enumerate(kinds, start=first):
            name = _NAMES[kind]
            rest = numbers[number : number + KINDS[name].numbers]
            number += len(rest)
            words = of_sample.words if name == "uniform_of_sample" else source.words
            for value, identity in _VALUES[name](functools.partial(words, index), rest):
                columns.append(torch.where(chosen, value, identity))
    if not columns:
        return images.new_empty(batch, 0, dtype=torch.float32)
    return torch.stack(columns, 1).float()


class _Source(NamedTuple):
    """What the words of samples depend on besides the draw."""

    key: Tensor
    sample: Tensor
    position: int

    def words(self, draw: int, block: int = 0) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        return philox(self.key, (torch.full_like(self.sample, draw), block, self.sample, self.position))


# Each of the functions below takes the words of a draw, by block, and its numbers. It gives pairs of a column, and of the
# value in it for samples that are not chosen.
_Words = Callable[..., tuple[Tensor, Tensor, Tensor, Tensor]]
_Columns = list[tuple[Tensor, float]]


def _chosen(words: _Words, numbers: Sequence[float]) -> _Columns:
    return [(torch.ones_like(unit(words()[0])), 0.0)]


def _uniform(words: _Words, numbers: Sequence[float]) -> _Columns:
    lowest, highest, identity = numbers
    return [(_between(words()[0], lowest, highest), identity)]


def _integer(words: _Words, numbers: Sequence[float]) -> _Columns:
    lowest, step, count, identity = numbers
    return [(lowest + step * _up_to(words()[0], int(count)).double(), identity)]


def _exponential_of_uniform(words: _Words, numbers: Sequence[float]) -> _Columns:
    lowest, highest, identity = numbers
    return [(_between(words()[0], lowest, highest).exp(), identity)]


def _permutation(words: _Words, numbers: Sequence[float]) -> _Columns:
    """The shuffle of Durstenfeld: entry i is swapped with one of entries i to n - 1."""
    count, first, step = numbers
    n = int(count)
    entries = torch.arange(n, device=words()[0].device).expand(len(words()[0]), n).clone()
    for i in range(n - 1):
        other = (i + _up_to(words(i // 4)[i % 4], n - i))[:, None]
        current, partner = entries[:, i : i + 1].clone(), entries.gather(1, other)
        entries = entries.scatter(1, other, current)
        entries[:, i : i + 1] = partner
    return [(entries[:, i].double(), first + step * i) for i in range(n)]


def _resized_crop(words: _Words, numbers: Sequence[float]) -> _Columns:
    """The first try that lies in the image; else the largest crop of an allowed aspect, in the center."""
    min_area, max_area, log_min, log_max, height, width = numbers
    w, h = (torch.full_like(unit(words()[0]), side) for side in _largest_crop(height, width, log_min, log_max))
    x, y = ((width - w) / 2).floor(), ((height - h) / 2).floor()
    is_drawn = torch.zeros_like(w, dtype=torch.bool)
    for attempt in range(CROP_TRIES):
        a, b, c, d = words(attempt)
        area, aspect = _between(a, min_area, max_area) * (height * width), _between(b, log_min, log_max).exp()
        new_w, new_h = (area * aspect).sqrt().round(), (area / aspect).sqrt().round()
        fits = ~is_drawn & (new_w >= 1) & (new_w <= width) & (new_h >= 1) & (new_h <= height)
        new = _offset(c, width, new_w), _offset(d, height, new_h), new_w, new_h
        x, y, w, h = (torch.where(fits, tried, kept) for tried, kept in zip(new, (x, y, w, h)))
        is_drawn = is_drawn | fits
    return [(x, 0.0), (y, 0.0), (w, width), (h, height)]


def _largest_crop(height: float, width: float, log_min: float, log_max: float) -> tuple[float, float]:
    """Width and height."""
    min_aspect, max_aspect = math.exp(log_min), math.exp(log_max)
    if width / height < min_aspect:
        return width, max(float(round(width / min_aspect)), 1.0)
    if width / height > max_aspect:
        return max(float(round(height * max_aspect)), 1.0), height
    return width, height


def _rectangle(words: _Words, numbers: Sequence[float]) -> _Columns:
    min_area, max_area, low, high, height, width = numbers
    a, b, c, d = words()
    area, u = _between(a, min_area, max_area) * (height * width), unit(b)
    if low < 1 < high:  # as often wide as high
        aspect = torch.where(u < 0.5, low + 2 * u * (1 - low), 1 + (2 * u - 1) * (high - 1))
    else:
        aspect = low + u * (high - low)
    w = (area / aspect).sqrt().round().clamp(1, width)
    h = (area * aspect).sqrt().round().clamp(1, height)
    return [(value, 0.0) for value in (_offset(c, width, w), _offset(d, height, h), w, h)]


def _rectangles(words: _Words, numbers: Sequence[float]) -> _Columns:
    columns, fewest, min_height, max_height, whole_height, min_width, max_width, whole_width, height, width = numbers
    most = int(columns) // 4
    count = fewest + _up_to(words()[0], most - int(fewest) + 1)
    values = []
    for i in range(most):
        a, b, c, d = words(1 + i)
        h, w = (
            _length(c, min_height, max_height, whole_height, height),
            _length(d, min_width, max_width, whole_width, width),
        )
        values += [torch.where(i < count, value, 0.0) for value in (_offset(a, width, w), _offset(b, height, h), w, h)]
    return [(value, 0.0) for value in values]


def _length(word: Tensor, lowest: float, highest: float, is_whole: float, size: float) -> Tensor:
    """Whole pixels, at least one where the lowest length is above 0, and at most all."""
    if is_whole:
        length = lowest + _up_to(word, int(highest - lowest) + 1).double()
    else:
        length = (_between(word, lowest, highest) * size).round()
    return length.clamp(min(1.0, size) if lowest > 0 else 0.0, size)


def _beta(words: _Words, numbers: Sequence[float]) -> _Columns:
    """The ratio of a gamma variate to the sum of two, from their logarithms."""
    alpha, beta, identity = numbers
    return [((_log_gamma_variate(words, alpha, 0) - _log_gamma_variate(words, beta, 1 << 16)).sigmoid(), identity)]


def _log_gamma_variate(words: _Words, alpha: float, block: int) -> Tensor:
    """The logarithm of a variate of the gamma distribution (Marsaglia and Tsang, ACM TOMS 26, 2000)."""
    d = (alpha + 1 if alpha < 1 else alpha) - 1 / 3
    c = 1 / math.sqrt(9 * d)
    log_v = torch.zeros_like(unit(words(block)[0]))
    is_drawn = torch.zeros_like(log_v, dtype=torch.bool)
    for attempt in range(GAMMA_TRIES):
        first, second, third, _ = words(block + attempt)
        x = _normal_variate(first, second)
        v = (1 + c * x) ** 3
        log = v.log()
        accepted = ~is_drawn & (v > 0) & (_open_unit(third).log() < 0.5 * x * x + d + d * (log - v))
        log_v = torch.where(accepted, log, log_v)
        is_drawn = is_drawn | accepted
    boost = _open_unit(words(block)[3]).log() / alpha if alpha < 1 else 0
    return log_v + math.log(d) + boost


def _normal(words: _Words, numbers: Sequence[float]) -> _Columns:
    mean, deviation, identity = numbers
    a, b, _, _ = words()
    return [(mean + deviation * _normal_variate(a, b), identity)]


def _uniform_and_affine(words: _Words, numbers: Sequence[float]) -> _Columns:
    lowest, highest, scale, offset, identity = numbers
    value = _between(words()[0], lowest, highest).float().double()  # as it is stored
    return [(value, identity), (value * scale + offset, scale * identity + offset)]


def _normal_variate(a: Tensor, b: Tensor) -> Tensor:
    """A variate of the standard normal distribution from two words, by the transform of Box and Muller."""
    return (-2 * _open_unit(a).log()).sqrt() * (2 * torch.pi * unit(b)).cos()


def _between(word: Tensor, lowest: float, highest: float) -> Tensor:
    return lowest + unit(word) * (highest - lowest)


def _up_to(word: Tensor, count: Any) -> Tensor:
    """An integer below `count`: the upper word of its product with a word."""
    return (word * count) >> 32


def _offset(word: Tensor, size: float, side: Tensor) -> Tensor:
    """The position of a window among those in [0, size): a whole number."""
    return _up_to(word, (size - side).long() + 1).double()


def _open_unit(word: Tensor) -> Tensor:
    """The number in (0, 1) of a word."""
    return unit(word) + 2.0**-33


def _number(words: _Words, numbers: Sequence[float]) -> _Columns:
    return [(torch.full_like(unit(words()[0]), numbers[0]), numbers[0])]


_VALUES: dict[str, Callable[[_Words, Sequence[float]], _Columns]] = {
    "chosen": _chosen,
    "uniform": _uniform,
    "integer": _integer,
    "exponential_of_uniform": _exponential_of_uniform,
    "permutation": _permutation,
    "resized_crop": _resized_crop,
    "rectangle": _rectangle,
    "beta": _beta,
    "normal": _normal,
    "uniform_and_affine": _uniform_and_affine,
    "uniform_of_sample": _uniform,
    "rectangles": _rectangles,
    "number": _number,
}


def _list_reference(
    images: Tensor,
    keys: Tensor,
    seeds: Tensor | None,
    plan: Sequence[int],
    numbers: Sequence[float],
    listed: Sequence[float],
    draws: Sequence[int],
) -> Tensor:
    at, rows = _numbers_of(plan, draws), []
    for b in range(images.shape[0]):
        values = list(numbers)
        for i, number in zip(at, listed[b * len(at) :]):
            values[i] = number
        rows.append(_reference(images, keys, seeds, plan, values)[b])
    return torch.stack(rows) if rows else images.new_empty(0, plan[0], dtype=torch.float32)


def _numbers_of(plan: Sequence[int], draws: Sequence[int]) -> list[int]:
    """Where the numbers of some draws are among those of a plan."""
    first, at, number = [], 1, 0
    while at < len(plan):
        kinds = plan[at + HEADER : at + HEADER + plan[at + HEADER - 1]]
        at, number = at + HEADER + len(kinds), number + 2
        for kind in kinds:
            first.append(range(number, number + DRAW_NUMBERS[kind]))
            number += DRAW_NUMBERS[kind]
    return [i for draw in draws for i in first[draw]]


_OPTIONS: dict[str, Any] = {
    "fake": lambda images, keys, seeds, plan, *_: images.new_empty(images.shape[0], plan[0], dtype=torch.float32),
    "non_differentiable": (0,),
    "bytes": True,
    "casts_outputs": True,
}
draw_parameters = register("draw_parameters", _reference, flatten=flatten_draws(keys=1), **_OPTIONS)
# With other numbers for each image: `listed` has those of some draws, for the first image, the second, ...; the last argument
# has the positions of these among all draws.
draw_list_parameters = register(
    "draw_list_parameters",
    _list_reference,
    flatten=lambda *_: None,  # `listed` is that of the images of one element of a vmap
    **_OPTIONS,
)
