"""Containers of transforms, as v2's."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import nn

from kvision._torch_compat import tree_flatten, tree_unflatten
from kvision.tv.transform import Transform, count_samples, draws_once, join, probability, split


class _Container(Transform):
    def __init__(self, transforms: Sequence[Callable[..., Any]] | nn.ModuleList) -> None:
        super().__init__()
        if not isinstance(transforms, (Sequence, nn.ModuleList)) or isinstance(transforms, (str, bytes)):
            raise TypeError(
                f"{type(self).__name__}: expected a sequence of transforms, got {type(transforms).__name__}"
            )
        if not len(transforms):
            raise ValueError(f"{type(self).__name__}: expected at least one transform")
        self.transforms = transforms

    @property
    def draws(self) -> bool:  # type: ignore[override]
        """Whether samples of a batch choose by themselves: not where a child mixes them, or is a function of your own."""
        return all(isinstance(t, Transform) and not mixes(t) for t in self.transforms)

    def forward(self, *inputs: Any) -> Any:
        sample = inputs if len(inputs) > 1 else inputs[0]
        flat, spec = tree_flatten(sample)
        needed = self._needed(flat)
        samples = count_samples(flat, needed) if self.draws else 0
        if not samples:
            return self._choose(*inputs)
        results = []
        for part in split(flat, needed, samples):
            nested = tree_unflatten(part, spec)
            results.append(tree_flatten(self._choose(*nested) if len(inputs) > 1 else self._choose(nested))[0])
        return tree_unflatten(join(results, flat, needed), spec)

    def _choose(self, *inputs: Any) -> Any:
        """Choose and apply the transforms of a sample."""
        raise NotImplementedError

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
        return apply_all(self.transforms, inputs)


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
        with draws_once():
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

    def __init__(self, transforms: Sequence[Callable[..., Any]] | nn.ModuleList, p: float = 0.5) -> None:
        super().__init__(transforms)
        self.p = probability("RandomApply", p)

    def _choose(self, *inputs: Any) -> Any:
        return apply_all(() if torch.rand(1, device="cpu").item() >= self.p else self.transforms, inputs)


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

    def __init__(self, transforms: Sequence[Callable[..., Any]], p: list[float] | None = None) -> None:
        super().__init__(transforms)
        weights = [1.0] * len(transforms) if p is None else list(p)
        if len(weights) != len(transforms):
            raise ValueError(f"RandomChoice: expected {len(transforms)} weights, got {len(weights)}")
        self.p = [weight / sum(weights) for weight in weights]

    def _choose(self, *inputs: Any) -> Any:
        return self.transforms[int(torch.multinomial(torch.tensor(self.p, device="cpu"), 1))](*inputs)


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

    def _choose(self, *inputs: Any) -> Any:
        order = torch.randperm(len(self.transforms), device="cpu").tolist()
        return apply_all([self.transforms[i] for i in order], inputs)
