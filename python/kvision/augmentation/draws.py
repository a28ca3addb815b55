"""Random parameters as pure functions: one operator draws those of all samples and all augmentations of a container.

A parameter is a function of a 64-bit key, the index of its sample and the index of its draw, by the counter-based generator
Philox 4x32-10 (Salmon et al., Parallel Random Numbers: As Easy as 1, 2, 3, SC 2011). Neither the batch, the device nor the
order of evaluation takes part in it. The counter of a block of four 32-bit words is

    (index of the draw, index of the block, index of the sample, position in the chain)

Draw 0 of each augmentation decides whether a sample is chosen; the others give columns of the result. A sample that is not
chosen gets the values that leave an image as it is, so that one launch serves chosen and other samples alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from kvision._ops import register

# --- kinds ----------------------------------------------------------------------------------------------------------


class Kind(NamedTuple):
    """A kind of draw: its number in plans (csrc/augmentation/draws.h), how many numbers it takes and columns it gives."""

    number: int
    numbers: int
    columns: int  # 0: as many as its first number says


KINDS = {
    "chosen": Kind(0, 0, 1),  # 1 for samples that are chosen, else 0
    "uniform": Kind(1, 3, 1),  # lowest, highest, identity
    "integer": Kind(2, 4, 1),  # lowest, step, count, identity: one of lowest + k step for k in 0 .. count - 1
    "exponential_of_uniform": Kind(3, 3, 1),  # logarithms of lowest and highest, identity
    "permutation": Kind(4, 3, 0),  # n; for samples not chosen: first, step of what stands instead
    "resized_crop": Kind(5, 6, 4),  # lowest and highest area, logarithms of both aspects, height, width: x, y, w, h
    "rectangle": Kind(6, 6, 4),  # lowest and highest area, lowest and highest aspect, height, width: x, y, w, h
    "beta": Kind(7, 3, 1),  # alpha, beta, identity
    "normal": Kind(8, 3, 1),  # mean, standard deviation, identity
}
MAX_DRAWS, MAX_NUMBERS = 64, 256  # of a launch: kMaxDraws and kMaxDrawNumbers of draws.h
CHOSEN, BATCH_SAMPLE = 0, 0xFFFFFFFF  # the draw that decides about p; the sample that decides about p_batch
TRIES = 10  # for a crop that lies in the image


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
# images' device; seeds (B,) int64, which replace the keys, or None; the plan; and the numbers. The plan is the number of
# columns, then FIELDS integers for each draw. The numbers of a draw begin with p and p_batch.

FIELDS = 7  # key, position in the chain, index of the draw, kind, first column, first number, same_on_batch


class Request(NamedTuple):
    """What one augmentation asks for: its draws and the probabilities that it is applied."""

    draws: Sequence[Draw]
    p: float = 1.0
    p_batch: float = 1.0
    same_on_batch: bool = False


class Plan(NamedTuple):
    """The plan of several requests; `first_columns[i]` is where the columns of request i begin."""

    plan: list[int]
    numbers: list[float]
    first_columns: list[int]


def make_plan(requests: Sequence[Request], one_key: bool = False, position: int = 0) -> Plan:
    """Plan the draws of requests, of which each has its own key, or its own position in the chain under one key."""
    plan, numbers, firsts, column = [0], [], [], 0
    for i, request in enumerate(requests):
        firsts.append(column)
        key, place = (0, position + i) if one_key else (i, 0)
        for index, draw in enumerate(request.draws, start=1):
            kind = KINDS[draw.kind]
            plan += [key, place, index, kind.number, column, len(numbers), int(request.same_on_batch)]
            numbers += [request.p, request.p_batch, *draw.numbers]
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


def unit(word: Any) -> Any:
    """The number in [0, 1) of a word, in float64."""
    return (word.double() if isinstance(word, Tensor) else word) * 2.0**-32


def is_chosen_batch(key: int, position: int, p_batch: float) -> bool:
    """Whether a batch is augmented; for augmentations whose result has another size then."""
    if p_batch in (0.0, 1.0):
        return p_batch == 1.0
    return unit(philox(key, (CHOSEN, 0, BATCH_SAMPLE, position))[0]) < p_batch


# --- the operator ---------------------------------------------------------------------------------------------------


def _reference(images: Tensor, keys: Tensor, seeds: Tensor | None, plan: Sequence[int], numbers: Sequence[float]) -> Tensor:
    batch, device = images.shape[0], images.device
    sample = torch.arange(batch, device=device)
    keys = keys.to(device)
    columns: list[Tensor] = []
    for i in range(1, len(plan), FIELDS):
        key, position, index, kind, _, number, same = plan[i : i + FIELDS]
        p, p_batch, *rest = numbers[number:]
        key = keys[key] if seeds is None else seeds.to(device)
        # A seed is one of a sample: its index in the batch takes no part.
        at = torch.zeros_like(sample) if same or seeds is not None else sample

        def words(draw: int, block: int, at: Tensor | int = at, key: Any = key, position: int = position) -> Any:
            return philox(key, (torch.full_like(sample, draw), block, at, position))

        chosen = (unit(words(CHOSEN, 0)[0]) < p) & (unit(words(CHOSEN, 0, BATCH_SAMPLE)[0]) < p_batch)
        evaluate = _EVALUATIONS[kind]
        for value, identity in evaluate(lambda block, index=index, words=words: words(index, block), rest):
            columns.append(torch.where(chosen, value, identity))
    if not columns:
        return images.new_empty(batch, 0, dtype=torch.float32)
    return torch.stack(torch.broadcast_tensors(*columns), 1).float()


def _uniform(word: Tensor, lowest: float, highest: float) -> Tensor:
    return lowest + unit(word) * (highest - lowest)


def _up_to(word: Tensor, count: Any) -> Tensor:
    """An integer below `count`: the upper word of its product with a word."""
    return (word * count) >> 32


def _evaluate_chosen(words, numbers):
    return [(torch.ones_like(words(0)[0], dtype=torch.float64), 0.0)]


def _evaluate_uniform(words, numbers):
    lowest, highest, identity = numbers[:3]
    return [(_uniform(words(0)[0], lowest, highest), identity)]


def _evaluate_integer(words, numbers):
    lowest, step, count, identity = numbers[:4]
    return [(lowest + step * _up_to(words(0)[0], int(count)).double(), identity)]


def _evaluate_exponential_of_uniform(words, numbers):
    lowest, highest, identity = numbers[:3]
    return [(_uniform(words(0)[0], lowest, highest).exp(), identity)]


def _evaluate_permutation(words, numbers):
    """The shuffle of Durstenfeld: entry i trades places with one of entries i to n - 1."""
    count, first, step = numbers[:3]
    n = int(count)
    entries = torch.arange(n, device=words(0)[0].device).expand(len(words(0)[0]), n).clone()
    for i in range(n - 1):
        other = (i + _up_to(words(i // 4)[i % 4], n - i))[:, None]
        mine, theirs = entries[:, i : i + 1].clone(), entries.gather(1, other)
        entries = entries.scatter(1, other, mine)
        entries[:, i : i + 1] = theirs
    return [(entries[:, i].double(), first + step * i) for i in range(n)]


def _evaluate_resized_crop(words, numbers):
    least, most, log_least, log_most, height, width = numbers[:6]
    w, h, ratio = _largest_crop(height, width, log_least, log_most)
    sides = torch.full_like(unit(words(0)[0]), w), torch.full_like(unit(words(0)[0]), h)
    position, found = words(0)[2:], torch.zeros_like(words(0)[0], dtype=torch.bool)
    for block in range(TRIES):
        a, b, *at = words(block)
        area, aspect = _uniform(a, least, most) * (height * width), _uniform(b, log_least, log_most).exp()
        new = (area * aspect).sqrt().round(), (area / aspect).sqrt().round()
        fits = ~found & (new[0] >= 1) & (new[0] <= width) & (new[1] >= 1) & (new[1] <= height)
        sides = tuple(torch.where(fits, x, y) for x, y in zip(new, sides))
        position = tuple(torch.where(fits, x, y) for x, y in zip(at, position))
        found = found | fits
    corner = (
        torch.where(found, _up_to(word, (size - side).long() + 1).double(), ((size - side) / 2).floor())
        for word, size, side in zip(position, (width, height), sides)
    )
    return list(zip((*corner, *sides), (0.0, 0.0, width, height)))


def _largest_crop(height: float, width: float, log_least: float, log_most: float) -> tuple[float, float, float]:
    """Width, height and aspect of the largest crop of an allowed aspect, where no try has given one that fits."""
    least, most = torch.tensor([log_least, log_most], dtype=torch.float64).exp().tolist()
    aspect = min(max(width / height, least), most)
    if width / height < least:
        return width, max(float(round(width / least)), 1.0), aspect
    if width / height > most:
        return max(float(round(height * most)), 1.0), height, aspect
    return width, height, aspect


def _evaluate_rectangle(words, numbers):
    least, most, low, high, height, width = numbers[:6]
    a, b, x, y = words(0)
    area = _uniform(a, least, most) * (height * width)
    u = unit(b)
    if low < 1 < high:  # as often wide as high
        aspect = torch.where(u < 0.5, low + 2 * u * (1 - low), 1 + (2 * u - 1) * (high - 1))
    else:
        aspect = low + u * (high - low)
    w = (area / aspect).sqrt().round().clamp(1, width)
    h = (area * aspect).sqrt().round().clamp(1, height)
    corner = (_up_to(x, (width - w).long() + 1).double(), _up_to(y, (height - h).long() + 1).double())
    return [(value, 0.0) for value in (*corner, w, h)]


def _evaluate_beta(words, numbers):
    """The ratio of a gamma variate to the sum of two, from their logarithms."""
    alpha, beta, identity = numbers[:3]
    first, second = _log_gamma_variate(words, alpha, 0), _log_gamma_variate(words, beta, 1 << 16)
    return [((first - second).sigmoid(), identity)]


def _log_gamma_variate(words, alpha: float, block: int) -> Tensor:
    """The logarithm of a variate of the gamma distribution (Marsaglia and Tsang, ACM TOMS 26, 2000)."""
    boosted = alpha + 1 if alpha < 1 else alpha
    d = boosted - 1 / 3
    c = 1 / (9 * d) ** 0.5
    log, found = None, None
    for k in range(GAMMA_TRIES):
        a, b, e, f = words(block + k)
        x = _normal(a, b)
        v = (1 + c * x).clamp(min=0) ** 3
        u = unit(e) + 2.0**-33
        new = v.log()
        accepted = (v > 0) & (u.log() < 0.5 * x * x + d - d * v + d * new)
        log = torch.where(found, log, torch.where(accepted, new, 0)) if k else torch.where(accepted, new, 0)
        found = found | accepted if k else accepted
        if k == 0 and alpha < 1:
            boost = (unit(f) + 2.0**-33).log() / alpha
    return log + torch.log(torch.tensor(d, dtype=torch.float64)).item() + (boost if alpha < 1 else 0)


GAMMA_TRIES = 8  # each is accepted with a probability above .95


def _normal(a: Tensor, b: Tensor) -> Tensor:
    """A variate of the standard normal distribution from two words, by the transform of Box and Muller."""
    radius = (-2 * (unit(a) + 2.0**-33).log()).sqrt()
    return radius * (2 * torch.pi * unit(b)).cos()


def _evaluate_normal(words, numbers):
    mean, deviation, identity = numbers[:3]
    a, b, _, _ = words(0)
    return [(mean + deviation * _normal(a, b), identity)]


_EVALUATIONS = (
    _evaluate_chosen,
    _evaluate_uniform,
    _evaluate_integer,
    _evaluate_exponential_of_uniform,
    _evaluate_permutation,
    _evaluate_resized_crop,
    _evaluate_rectangle,
    _evaluate_beta,
    _evaluate_normal,
)

draw_parameters = register(
    "draw_parameters",
    _reference,
    fake=lambda images, keys, seeds, plan, numbers: images.new_empty(images.shape[0], plan[0], dtype=torch.float32),
    non_differentiable=(0,),
    bytes=True,
    casts_outputs=True,
)
