"""Containers of transforms, as v2's."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor, nn

from kvision._tv_tensors import kind_of, plain, wrap
from kvision.tv import draw
from kvision.tv.transform import ONCE, Step, Transform, at, count_samples, flatten, join, split, unflatten

__all__ = ["Compose", "RandomApply", "RandomChoice", "RandomOrder", "SameOnBatch"]


def _children(op: str, name: str, value: Any) -> Any:
    if not isinstance(value, (Sequence, nn.ModuleList)) or isinstance(value, (str, bytes)):
        raise TypeError(f"{op}: expected a sequence of transforms, got {type(value).__name__}")
    if not len(value):
        raise ValueError(f"{op}: expected at least one transform")
    return value


class _Container(Transform):
    transforms: Sequence[Callable[..., Any]] | nn.ModuleList

    checks = {"transforms": _children}

    @property
    def draws(self) -> bool:  # type: ignore[override]
        """Whether samples of a batch choose by themselves: not where a child mixes them, or is a function of your own."""
        return all(isinstance(t, Transform) and not mixes(t) for t in self.transforms)

    def forward(self, *inputs: Any) -> Any:
        flat, spec = flatten(inputs)
        needed = self._needed(flat)
        samples = count_samples(flat, needed) if self.draws else 0
        if not samples:
            return self._run(self._choice(), inputs)
        by_choice: dict[tuple[int, ...], list[int]] = {}
        for i in range(samples):
            by_choice.setdefault(tuple(self._choice()), []).append(i)
        if len(by_choice) == 1:
            return self._run(next(iter(by_choice)), inputs)
        parts: list[Any] = [None] * samples
        for choice, chosen in by_choice.items():
            part = unflatten([at(x, chosen) if is_needed else x for x, is_needed in zip(flat, needed)], spec)
            outputs, _ = flatten((self._run(choice, part if len(inputs) > 1 else (part,)),))
            for sample, i in zip(split(outputs, needed, len(chosen)), chosen):
                parts[i] = sample
        return unflatten(join(parts, flat, needed), spec)

    def _choice(self) -> Sequence[int]:
        """The transforms that are applied, in turn."""
        raise NotImplementedError

    def _run(self, choice: Sequence[int], inputs: tuple[Any, ...]) -> Any:
        return apply_all([self.transforms[i] for i in choice], inputs)

    def extra_repr(self) -> str:
        return "\n".join(f"    {t}" for t in self.transforms)


def mixes(transform: Any) -> bool:
    children = getattr(transform, "transforms", ())
    return getattr(transform, "mixes_samples", False) or any(map(mixes, children))


def apply_all(transforms: Any, inputs: tuple[Any, ...]) -> Any:
    for t in transforms:
        output = t(*inputs)
        inputs = output if len(inputs) > 1 else (output,)
    return inputs if len(inputs) > 1 else inputs[0]


class Compose(_Container):
    """Apply transforms one after the other.

    Args:
        transforms: the transforms, of kvision.tv or any functions.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> augment = tv.Compose([tv.RandomResizedCrop(8), tv.RandomHorizontalFlip(), tv.ToDtype(torch.float32, scale=True)])
        >>> augment(torch.zeros(3, 16, 20, dtype=torch.uint8)).shape
        torch.Size([3, 8, 8])
    """

    def forward(self, *inputs: Any) -> Any:
        transforms: list[Any] = list(self.transforms)
        while transforms and (image := self._batch(inputs)) is not None:
            if len(steps := self._steps(transforms, image)) > 1:
                transforms[: len(steps)] = [_pass_of(tuple(steps))]
            output = transforms.pop(0)(*inputs)
            inputs = output if len(inputs) > 1 else (output,)
        return apply_all(transforms, inputs)

    def _batch(self, inputs: tuple[Any, ...]) -> Tensor | None:
        """The images of a sample that is a batch of them, without anything that moves with them."""
        flat, _ = flatten(inputs)
        needed = self._needed(flat)
        if sum(needed) != 1 or not count_samples(flat, needed):
            return None
        image = flat[needed.index(True)]
        return image if kind_of(image) in ("tensor", "image") and image.dim() == 4 else None

    def _steps(self, transforms: list[Any], image: Tensor) -> list[Step]:
        """The steps of one pass over images that the first transforms are."""
        steps: list[Step] = []
        dtype = image.dtype
        for t in transforms:
            step = t._step(dtype, image.shape[1]) if type(t).__module__.startswith("kvision.tv.") else None
            if step is None:
                break
            steps.append(step)
            dtype = step[1] if step[0] == "dtype" else dtype
        return steps


class _Pass(Transform):
    """Transforms of a batch of images in one launch, by the steps of kvision.augmentation that they are."""

    def __init__(self, steps: tuple[Step, ...]) -> None:
        from kvision import augmentation

        super().__init__()
        modules = [getattr(augmentation, name)(**dict(arguments)) for name, arguments in steps if name != "dtype"]
        dtypes = [value for name, value in steps if name == "dtype"]
        self.augmentations = augmentation.AugmentationSequential(*modules, output_dtype=dtypes[-1] if dtypes else None)

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        return wrap(self.augmentations(plain(inpt)), inpt)


_pass_of = functools.lru_cache(64)(_Pass)


class SameOnBatch(_Container):
    """Apply transforms that draw once a call, for all samples of a batch, as v2's do.

    Args:
        transforms: the transforms.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> x = tv.SameOnBatch([tv.RandomCrop(2)])(torch.arange(12.0).reshape(1, 1, 3, 4).expand(5, -1, -1, -1))
        >>> bool((x == x[:1]).all())
        True
    """

    def forward(self, *inputs: Any) -> Any:
        with draw.setting(ONCE, True):
            return apply_all(self.transforms, inputs)


class RandomApply(_Container):
    """Apply all transforms or none, samples of a batch by themselves.

    Args:
        transforms: the transforms.
        p: the probability to apply them.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.RandomApply([tv.RandomInvert(p=1.0)], p=1.0)(torch.zeros(1, 1, 1))
        tensor([[[1.]]])
    """

    p: float = 0.5

    def _choice(self) -> Sequence[int]:
        return () if draw.unit() >= self.p else range(len(self.transforms))


class RandomChoice(_Container):
    """Apply one of the transforms, samples of a batch by themselves unless one of them is MixUp or CutMix.

    Args:
        transforms: the transforms.
        p: a weight of each, None for equal ones.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.RandomChoice([tv.RandomInvert(p=1.0), tv.Identity()], p=[1.0, 0.0])(torch.zeros(1, 1, 1))
        tensor([[[1.]]])
    """

    p: list[float] | None = None

    checks = {"transforms": _children, "p": lambda op, name, value: value}

    def __post_init__(self) -> None:
        super().__post_init__()
        weights = [1.0] * len(self.transforms) if self.p is None else list(self.p)
        if len(weights) != len(self.transforms):
            raise ValueError(f"RandomChoice: expected {len(self.transforms)} weights, got {len(weights)}")
        self.p = [weight / sum(weights) for weight in weights]

    def _choice(self) -> Sequence[int]:
        return [int(torch.multinomial(torch.tensor(self.p, device="cpu"), 1))]


class RandomOrder(_Container):
    """Apply all transforms in a random order, samples of a batch in orders of their own.

    Args:
        transforms: the transforms.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.RandomOrder([tv.RandomInvert(p=1.0), tv.RandomInvert(p=1.0)])(torch.zeros(1, 1, 1))
        tensor([[[0.]]])
    """

    def _choice(self) -> Sequence[int]:
        return draw.permutation(len(self.transforms))
