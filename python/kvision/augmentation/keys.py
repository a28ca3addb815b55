"""The 64-bit keys of random parameters, from seeds and generators."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple
from weakref import WeakValueDictionary

import torch
from torch import Generator, Tensor
from torch.compiler import is_compiling
from torch.utils.data import get_worker_info

from kvision import _check
from kvision._constants import on_device
from kvision._ops import flatten_batches, register_random
from kvision._torch_compat import has_static_value, in_function_transform, is_mapped
from kvision.core.exceptions import ShapeError, TypeCheckError

Seed = int | Tensor | None


class Keys(NamedTuple):
    """Keys of the augmentations of one call.

    `keys` (K,) has one for each of them, on the CPU unless a CUDA generator drew them. A call that `has_seed` has one key for
    all, and the position of an augmentation in the chain tells them apart. `seeds` (B,) replaces the keys by one a sample.
    """

    keys: Tensor
    seeds: Tensor | None = None
    has_seed: bool = False
    number: int | None = None  # the one key, where the host knows it

    def seeds_on(self, device: torch.device) -> Tensor | None:
        """The seeds for an operator on this device, without waiting for it."""
        return None if self.seeds is None else on_device(self.seeds, device)

    def cpu(self) -> Keys:
        """The same on the CPU; waits for those that are on another device."""
        return self._replace(keys=self.keys.cpu(), seeds=None if self.seeds is None else self.seeds.cpu())

    def on_host(self, op: str) -> list[int]:
        """The keys as numbers, for decisions about sizes and modules."""
        if self.number is not None:
            return [self.number]
        refuse_graphs(op)
        keys = self.keys if self.seeds is None or not len(self.seeds) else self.seeds[:1]
        if keys.is_cuda:
            refuse_capture(op)
        refuse_mapped(op, keys)
        return [int(k) for k in keys.tolist()]


def refuse_graphs(op: str) -> None:
    """Raise while torch.compile traces, whose graph has no choices of the host; without fullgraph=True it calls eagerly then."""
    if is_compiling():
        raise RuntimeError(
            f"{op}: a random choice that changes sizes or modules is made on the host and has no graph; use p=0 or 1, one size "
            "of a kernel, and no choice of children, or torch.compile without fullgraph=True"
        )


def refuse_transformed_graphs() -> None:
    """Raise while torch.compile traces inside of torch.func: what a module keeps of its call would leave the transform."""
    if is_compiling():
        raise RuntimeError(
            "kvision.augmentation: an augmentation inside of torch.func's transforms has no graph; call it outside of them, or use "
            "torch.compile without fullgraph=True"
        )


def refuse_capture(op: str) -> None:
    """Raise while a CUDA graph is captured, whose replays would repeat a choice of the host."""
    if torch.cuda.is_initialized() and torch.cuda.is_current_stream_capturing():
        raise RuntimeError(
            f"{op}: a random choice that changes sizes or modules cannot be captured in a CUDA graph; use p=0 or 1, one size "
            "of a kernel, and no choice of children"
        )


def refuse_mapped(op: str, drawn: Tensor) -> None:
    """Raise where torch.func.vmap hides what each of its elements has drawn for a choice of the host."""
    if in_function_transform() and is_mapped(drawn):
        raise RuntimeError(
            f"{op}: a random choice that changes sizes or modules cannot differ between the elements of torch.func.vmap; use "
            "randomness='same', or an int as seed"
        )


def draw_keys(op: str, count: int, device: torch.device, seed: Seed, generator: Generator | None) -> Keys:
    """Keys for `count` augmentations of a batch on `device`: from a seed, a generator, or torch's default generator.

    While a CUDA graph is captured, torch's default generator of the device draws them, so that each replay has new ones. Under
    torch.func.vmap its `randomness` says whether the elements share them.
    """
    if seed is not None:
        return _from_seed(op, seed)
    if generator is None and not (is_compiling() or in_function_transform() or _captures(device)):
        return Keys(_words(count))  # most calls
    keys = _drawn_keys(op, count, device, generator)
    return Keys(keys if generator is None else keys ^ _word_of_worker())


def _word_of_worker() -> int:
    """What tells the draws of a generator in a data loader's worker from those of its copies in other workers and epochs.

    torch's default generator has the seed of the worker itself.
    """
    worker = get_worker_info()
    return 0 if worker is None else _as_int64(worker.seed * _SEED_INCREMENT)


def _drawn_keys(op: str, count: int, device: torch.device, generator: Generator | None) -> Tensor:
    """int64 (count,) of a generator, None for torch's default one."""
    compiles = is_compiling()
    if generator is None and (compiles or not _captures(device)):
        return _random_keys(count) if compiles and not in_function_transform() else _random_words(count)
    where = device if generator is None else generator.device
    if compiles:
        return _random_words(count, generator, where)
    if where.type == "cpu":
        if _captures(device):
            raise RuntimeError(
                f"{op}: a generator of the CPU cannot draw for a CUDA graph; use one of the GPU, registered with it"
            )
        return _random_words(count, generator)
    # A CUDA generator gives other numbers for several in one call than for several calls.
    each = [_random_words(1, generator, where) for _ in range(count)]
    return torch.cat(each) if each else torch.empty(0, dtype=torch.int64, device="cpu")


_LOWEST = -(2**63)
_CPU = torch.device("cpu")


def _captures(device: torch.device) -> bool:
    """Whether a CUDA graph is captured on a device."""
    return device != _CPU and device.type == "cuda" and torch.cuda.is_current_stream_capturing()


def _random_words(count: int, generator: Generator | None = None, device: torch.device = _CPU) -> Tensor:
    """int64 (count,) of a generator."""
    if is_compiling() or in_function_transform():
        # Compilers know no random_ of a generator, and vmap only maps a function that makes a tensor. The lowest number is added to
        # the words of a range, as random_ does not.
        return torch.randint(_LOWEST, 2**63 - 1, (count,), generator=generator, device=device) ^ _LOWEST
    return _words(count, generator, device)


def _words(count: int, generator: Generator | None = None, device: torch.device = _CPU) -> Tensor:
    return torch.empty(count, dtype=torch.int64, device=device).random_(_LOWEST, None, generator=generator)


# In a graph torch's own functions draw from generators that inductor seeds in its way. This one gives what eager calls draw.
_random_keys = register_random(
    "random_keys",
    "(SymInt count) -> Tensor",
    lambda count: _random_words(count),
    lambda count: torch.empty(count, dtype=torch.int64, device="cpu"),
)

# Between the seeds of neighboring frames, and of workers: 2^64 over the golden ratio, as an int64.
_SEED_INCREMENT = -0x61C8864680B583EB


class PortableGenerator:
    """Stands for a generator in the state of a module. Copies and pickles of it are generators again.

    torch's own pickle of a generator does not reach processes that are spawned (2.13): its state is a temporary tensor, whose
    shared memory is gone when they open it.
    """

    _made: WeakValueDictionary[int, PortableGenerator] = (
        WeakValueDictionary()
    )  # by the generator: modules may share one

    def __init__(self, generator: Generator) -> None:
        self.generator = generator

    @classmethod
    def of(cls, generator: Any) -> Any:
        """What stands for a generator; None for None."""
        if generator is None:
            return None
        return cls._made.setdefault(id(generator), cls(generator))

    def __reduce__(self) -> Any:
        return restored_generator, (str(self.generator.device), self.generator.get_state().numpy().tobytes())


def restored_generator(device: str, state: bytes) -> Generator:
    generator = Generator(device)
    generator.set_state(torch.frombuffer(bytearray(state), dtype=torch.uint8))
    return generator


def flatten_draws(keys: int) -> Callable[[int, tuple[Any, ...], tuple[Any, ...]], list[Any] | None]:
    """The `flatten` of operators with keys, or None, as argument number `keys` and seeds behind it.

    A sample draws by its index, or by its seed alone: without seeds a call for each element, which counts its own samples.
    """

    def flatten(n: int, in_dims: tuple[Any, ...], args: tuple[Any, ...]) -> list[Any] | None:
        return None if args[keys] is not None and args[keys + 1] is None else flatten_batches(n, in_dims, args)

    return flatten


def check_seeds(op: str, keys: Keys, samples: int) -> None:
    """Raise unless there is a seed of each sample, if there are seeds of samples."""
    if keys.seeds is not None and keys.seeds.shape[0] != samples:
        raise ShapeError(f"{op}: expected seeds of {samples} samples, got {keys.seeds.shape[0]}")


def frame_seeds(seeds: Tensor, frames: int) -> Tensor:
    """Seeds (B T,) of the frames of videos with seeds (B,): the first frame has that of its video."""
    return (seeds[:, None] + _SEED_INCREMENT * torch.arange(frames, device=seeds.device)).flatten()


_MIX = ((30, -0x40A7B892E31B1A47), (27, -0x6B2FB644ECCEEE15))  # shifts, and factors as int64


def seeds_of_samples(key: Tensor, samples: Tensor) -> Tensor:
    """Seeds that follow from a key and the numbers of samples.

    By SplitMix64 (Steele, Lea, Flood: Fast Splittable Pseudorandom Number Generators, OOPSLA 2014).
    """
    x = key + (samples + 1) * _SEED_INCREMENT
    for shift, factor in _MIX:
        x = (x ^ ((x >> shift) & ((1 << (64 - shift)) - 1))) * factor
    return x ^ ((x >> 31) & ((1 << 33) - 1))


def _from_seed(op: str, seed: int | Tensor) -> Keys:
    if isinstance(seed, Tensor):
        if seed.dtype != torch.int64:
            raise TypeCheckError(f"{op}: expected seed to be an int or an int64 tensor, got {seed.dtype}")
        if seed.dim() == 0:
            return Keys(seed[None], None, True)
        if seed.dim() != 1:
            raise ShapeError(f"{op}: expected seed of shape (B,), got {tuple(seed.shape)}")
        return Keys(torch.zeros(1, dtype=torch.int64, device="cpu"), seed, True)
    seed = _check.scalar(op, "seed", seed)
    if not isinstance(seed, int) or isinstance(seed, bool):
        raise TypeCheckError(f"{op}: expected seed to be an int or an int64 tensor, got {type(seed).__name__}")
    if not has_static_value(seed):  # an int64, whose value the graph does not know
        return Keys(torch.tensor([seed], device="cpu"), None, True)
    number = _as_int64(seed)
    return Keys(torch.tensor([number], device="cpu"), None, True, number)


def _as_int64(number: int) -> int:
    """The int64 with the same lowest 64 bits."""
    number &= 2**64 - 1
    return number - 2**64 if number >= 2**63 else number
