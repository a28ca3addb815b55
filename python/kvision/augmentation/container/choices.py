"""Containers that choose the children of each sample: one of them, some of them, all in random order, or all or none."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from itertools import accumulate, chain, groupby
from typing import Any

from torch import Generator

from kvision import _check
from kvision.augmentation.draws import Draw, uniform
from kvision.augmentation.engine import AugmentationBase, Child, ChoiceBase, Turn, joins, positional
from kvision.core.exceptions import ValueCheckError

__all__ = ["OneOf", "RandomApply", "RandomOrder", "SomeOf"]


class OneOf(ChoiceBase):
    """Run one child for each sample, drawn by the probabilities of the children.

    The `p` of a child, times its `p_batch`, is its weight; a child without one has the weight 1. The child that a sample gets
    augments it for certain; if all weights are 0, no sample gets one. Samples with the same child are one batch, and a child that
    no sample gets does not run.

    Args:
        *children: augmentations, other containers, or any modules of images that do not mix samples; or one list of them, which
            `p` may follow.
        p: probability that a sample gets a child.
        same_on_batch: all samples get the same child and parameters.
        keepdim: if not None, that of all children.
        generator: draws the keys of each call; default: torch's generator.
        return_transform: calls return the image and the product of the matrices.

    Raises:
        TypeError: a child is not a module.
        ValueError: there is no child; one mixes samples; `p` is not within 0 and 1; in a call, samples have several sizes in the
            end.

    Example:
        >>> import torch, kvision as K
        >>> flip, invert = K.augmentation.RandomHorizontalFlip(), K.augmentation.RandomInvert()
        >>> one = K.augmentation.OneOf(flip, invert)
        >>> one(torch.tensor([[[[0.0, 0.25]]]]).expand(3, 1, 1, 2), seed=0).flatten(1)
        tensor([[0.2500, 0.0000],
                [1.0000, 0.7500],
                [1.0000, 0.7500]])
    """

    children_are_certain = True

    def _draws(self) -> list[Draw]:
        return [uniform(0.0, 1.0)]

    def _sequences_of(self, drawn: Sequence[Sequence[float]]) -> list[tuple[int, ...]]:
        sums = self._sums_of_weights()
        total = sums[-1]
        if total == 0:
            return [()] * len(drawn)
        last = bisect_left(sums, total)  # a number may be rounded to 1
        children, ends = [(number,) for number in range(last + 1)], sums[:last]
        return [children[bisect_right(ends, u * total)] for _, u in drawn]

    def _joined(self, turns: list[Turn], shape: tuple[int, ...], position: int) -> list[Turn]:
        groups, joined = self._groups(shape), []
        together: dict[int, dict[str, Sequence[int]]] = {}
        for turn in turns:
            group = groups.get(turn.children[0].name)
            if group is None:
                joined.append(turn)
            else:
                together.setdefault(group, {})[turn.children[0].name] = turn.samples
        for group, parts in together.items():
            children = [Child(name, module) for name, module in self.named_children() if groups.get(name) == group]
            samples = [parts.get(child.name, ()) for child in children]
            joined.append(Turn(children, sorted(chain(*samples)), position + group, samples))
        return joined

    def _groups(self, shape: tuple[int, ...]) -> dict[str, int]:
        """Of each child that is one pass with others for images of a shape, the number of the first of them."""
        key = ("groups", shape[1:])
        groups: dict[str, int] | None = self._plans.get(key)
        if groups is None:
            kinds = {name: joins(module, shape) for name, module in self.named_children()}
            readings = [kind for kind in kinds.values() if kind not in (None, True, "colors")]
            kinds = {name: readings[0] if kind is True and readings else kind for name, kind in kinds.items()}
            listed = list(kinds.values())
            groups = {
                name: listed.index(kind) for name, kind in kinds.items() if kind is not None and listed.count(kind) > 1
            }
            self._plans.keep(key, groups)
        return groups

    def _sums_of_weights(self) -> list[float]:
        """The sums of the weights up to each child."""
        sums: list[float] | None = self._plans.get("weights")
        if sums is None:
            sums = list(accumulate(map(_weight, self.children())))
            self._plans.keep("weights", sums)
        return sums


class SomeOf(ChoiceBase):
    """Run some of the children for each sample, all with the same probability, each with its own `p`.

    Args:
        *children: augmentations, other containers, or any modules of images that do not mix samples; or one list of them, which
            `n`, `replace` and `p` may follow.
        n: how many children a sample gets, or the lowest and the highest number of them; at most as many as there are, unless
            `replace`.
        replace: a sample may get a child several times.
        order: run them in the order of the arguments; False: in the order in which they are drawn.
        p: probability that a sample gets children.
        same_on_batch: all samples get the same children and parameters.
        keepdim: if not None, that of all children.
        generator: draws the keys of each call; default: torch's generator.
        return_transform: calls return the image and the product of the matrices.

    Raises:
        TypeError: a child is not a module; `n` is neither an int nor two.
        ValueError: there is no child; one mixes samples; `n` is below 0, or above the number of children; `p` is not within 0
            and 1; in a call, samples have several sizes in the end.

    Example:
        >>> import torch, kvision as K
        >>> children = [K.augmentation.RandomHorizontalFlip(p=1.0), K.augmentation.RandomInvert(p=1.0)]
        >>> K.augmentation.SomeOf(children, n=2)(torch.tensor([[[[0.0, 0.25]]]]))
        tensor([[[[0.7500, 1.0000]]]])
    """

    _positional = ("n", "replace", "p")

    def __init__(
        self,
        *children: Any,
        n: int | Sequence[int] = 1,
        replace: bool = False,
        order: bool = True,
        p: float = 1.0,
        same_on_batch: bool | None = None,
        keepdim: bool | None = None,
        generator: Generator | None = None,
        return_transform: bool | None = None,
    ) -> None:
        own: dict[str, Any] = {"n": n, "replace": replace, "p": p}
        modules = positional("SomeOf", children, self._positional, own)
        options: dict[str, Any] = {
            "same_on_batch": same_on_batch,
            "keepdim": keepdim,
            "return_transform": return_transform,
            "generator": generator,
        }
        super().__init__(*modules, p=own["p"], **options)
        low, high = _check.ints("SomeOf", "n", own["n"], 2, minimum=0)
        self.replace, self.order = (
            _check.switch("SomeOf", "replace", own["replace"]),
            _check.switch("SomeOf", "order", order),
        )
        if low > high or not (self.replace or high <= len(self)):
            bound = "" if self.replace else f", at most {len(self)}, the number of children"
            raise ValueCheckError(
                f"SomeOf: expected n to be a number or the lowest and the highest{bound}, got {own['n']}"
            )
        self.n = (low, high)
        self._keep_arguments(**own, order=order, **options)

    def extra_repr(self) -> str:
        return f"n={self.n}, replace={self.replace}, order={self.order}, p={self.p}"

    def _draws(self) -> list[Draw]:
        low, high = self.n
        count = Draw("integer", (low, 1, high - low + 1, low))
        if self.replace:
            return [count, *[Draw("integer", (0, 1, len(self), 0))] * high]
        return [count, Draw("permutation", (len(self), 0, 1))]

    def _sequences_of(self, drawn: Sequence[Sequence[float]]) -> list[tuple[int, ...]]:
        numbers = [tuple(map(int, own[2 : 2 + int(own[1])])) for own in drawn]
        return [tuple(sorted(own)) for own in numbers] if self.order else numbers


class RandomOrder(ChoiceBase):
    """Run all children for each sample in a random order, each with its own `p`.

    Args:
        *children: augmentations, other containers, or any modules of images that do not mix samples; or one list of them.
        p: probability that a sample gets them.
        same_on_batch: all samples get the same order and parameters.
        keepdim: if not None, that of all children.
        generator: draws the keys of each call; default: torch's generator.
        return_transform: calls return the image and the product of the matrices.

    Raises:
        TypeError: a child is not a module.
        ValueError: there is no child; one mixes samples; `p` is not within 0 and 1; in a call, samples have several sizes in the
            end.

    Example:
        >>> import torch, kvision as K
        >>> children = K.augmentation.RandomInvert(p=1.0), K.augmentation.RandomBrightness((0.5, 0.5), p=1.0)
        >>> K.augmentation.RandomOrder(*children)(torch.ones(4, 1, 1, 1), seed=0).flatten()
        tensor([0.0000, 0.5000, 0.5000, 0.0000])
    """

    _positional = ()

    def _draws(self) -> list[Draw]:
        return [Draw("permutation", (len(self), 0, 1))]

    def _sequences_of(self, drawn: Sequence[Sequence[float]]) -> list[tuple[int, ...]]:
        return [tuple(map(int, own[1:])) for own in drawn]


class RandomApply(ChoiceBase):
    """Run all children in order for a random part of the samples, each child with its own `p`.

    Args:
        *children: augmentations, other containers, or any modules of images that do not mix samples; or one list of them, which
            `p` may follow.
        p: probability that a sample gets them.
        same_on_batch: all samples get them with the same parameters, or none.
        keepdim: if not None, that of all children.
        generator: draws the keys of each call; default: torch's generator.
        return_transform: calls return the image and the product of the matrices.

    Raises:
        TypeError: a child is not a module.
        ValueError: there is no child; one mixes samples; `p` is not within 0 and 1; in a call, samples have several sizes in the
            end.

    Example:
        >>> import torch, kvision as K
        >>> children = [K.augmentation.RandomInvert(p=1.0), K.augmentation.RandomBrightness((0.5, 0.5), p=1.0)]
        >>> K.augmentation.RandomApply(children, p=0.5)(torch.ones(4, 1, 1, 1), seed=0).flatten()
        tensor([0., 0., 1., 0.])
    """

    def __init__(
        self,
        *children: Any,
        p: float = 0.5,
        same_on_batch: bool | None = None,
        keepdim: bool | None = None,
        generator: Generator | None = None,
        return_transform: bool | None = None,
    ) -> None:
        super().__init__(
            *children,
            p=p,
            same_on_batch=same_on_batch,
            keepdim=keepdim,
            generator=generator,
            return_transform=return_transform,
        )

    def _sequences_of(self, drawn: Sequence[Sequence[float]]) -> list[tuple[int, ...]]:
        return [(0,)] * len(drawn)

    def _units(self, children: Sequence[Child]) -> list[Sequence[Child]]:
        """All of them; of the parameters of a list those of each part, which has samples of its own."""
        return [list(own) for _, own in groupby(children, key=lambda child: child.samples)]


def _weight(child: Any) -> float:
    """The probability of a child, 1 where it has none."""
    if isinstance(child, AugmentationBase):
        return child.p * child.p_batch
    return float(child.p) if isinstance(child, ChoiceBase) else 1.0
