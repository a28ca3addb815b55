"""AutoAugment, RandAugment and TrivialAugment."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, TypeAlias

from torch import Generator

from kvision import _check
from kvision._check import UnknownChoiceError
from kvision._choices import MatrixMode
from kvision.augmentation.auto.policy_base import LEVELS, PolicyAugmentBase, check_integer, sub_policies
from kvision.core.exceptions import TypeCheckError, ValueCheckError

__all__ = ["AutoAugment", "RandAugment", "TrivialAugment"]

_AUTO_LEVELS = 9  # the highest level of an entry of AutoAugment

# Values at the lowest and the highest level (Cubuk et al., RandAugment, 2020; the AutoAugment paper has the same ranges).
_RANGES = {
    "identity": (0.0, 0.0),
    "shear_x": (0.0, 0.3),
    "shear_y": (0.0, 0.3),
    "translate_x": (0.0, 150 / 331),
    "translate_y": (0.0, 150 / 331),
    "rotate": (0.0, 30.0),
    "brightness": (1.0, 1.9),
    "color": (1.0, 1.9),
    "contrast": (1.0, 1.9),
    "sharpness": (1.0, 1.9),
    "posterize": (8.0, 4.0),
    "solarize": (1.0, 0.0),
    "auto_contrast": (0.0, 0.0),
    "equalize": (0.0, 0.0),
    "invert": (0.0, 0.0),
}
_RAND = [[(name, low, high)] for name, (low, high) in _RANGES.items() if name != "invert"]
# The wide ranges of Müller and Hutter, TrivialAugment, 2021.
_TRIVIAL = [
    [("identity", 0.0, 0.0)],
    [("shear_x", 0.0, 0.99)],
    [("shear_y", 0.0, 0.99)],
    [("translate_x_pixels", 0.0, 32.0)],
    [("translate_y_pixels", 0.0, 32.0)],
    [("rotate", 0.0, 135.0)],
    [("brightness", 1.0, 1.99)],
    [("color", 1.0, 1.99)],
    [("contrast", 1.0, 1.99)],
    [("sharpness", 1.0, 1.99)],
    [("posterize", 8.0, 2.0)],
    [("solarize", 1.0, 0.0)],
    [("auto_contrast", 0.0, 0.0)],
    [("equalize", 0.0, 0.0)],
]

# The sub-policies of Cubuk et al., AutoAugment, 2019: name, probability in tenths, level; - for operations without one.
AutoPolicy: TypeAlias = Literal["imagenet", "cifar10", "svhn"]
AUTO_POLICIES: dict[AutoPolicy, Any] = {
    "imagenet": """
        posterize 4 8, rotate 6 9
        solarize 6 5, auto_contrast 6 -
        equalize 8 -, equalize 6 -
        posterize 6 7, posterize 6 6
        equalize 4 -, solarize 2 4
        equalize 4 -, rotate 8 8
        solarize 6 3, equalize 6 -
        posterize 8 5, equalize 10 -
        rotate 2 3, solarize 6 8
        equalize 6 -, posterize 4 6
        rotate 8 8, color 4 0
        rotate 4 9, equalize 6 -
        equalize 0 -, equalize 8 -
        invert 6 -, equalize 10 -
        color 6 4, contrast 10 8
        rotate 8 8, color 10 2
        color 8 8, solarize 8 7
        sharpness 4 7, invert 6 -
        shear_x 6 5, equalize 10 -
        color 4 0, equalize 6 -
        equalize 4 -, solarize 2 4
        solarize 6 5, auto_contrast 6 -
        invert 6 -, equalize 10 -
        color 6 4, contrast 10 8
        equalize 8 -, equalize 6 -
    """,
    "cifar10": """
        invert 1 -, contrast 2 6
        rotate 7 2, translate_x 3 9
        sharpness 8 1, sharpness 9 3
        shear_y 5 8, translate_y 7 9
        auto_contrast 5 -, equalize 9 -
        shear_y 2 7, posterize 3 7
        color 4 3, brightness 6 7
        sharpness 3 9, brightness 7 9
        equalize 6 -, equalize 5 -
        contrast 6 7, sharpness 6 5
        color 7 7, translate_x 5 8
        equalize 3 -, auto_contrast 4 -
        translate_y 4 3, sharpness 2 6
        brightness 9 6, color 2 8
        solarize 5 2, invert 0 -
        equalize 2 -, auto_contrast 6 -
        equalize 2 -, equalize 6 -
        color 9 9, equalize 6 -
        auto_contrast 8 -, solarize 2 8
        brightness 1 3, color 7 0
        solarize 4 5, auto_contrast 9 -
        translate_y 9 9, translate_y 7 9
        auto_contrast 9 -, solarize 8 3
        equalize 8 -, invert 1 -
        translate_y 7 9, auto_contrast 9 -
    """,
    "svhn": """
        shear_x 9 4, invert 2 -
        shear_y 9 8, invert 7 -
        equalize 6 -, solarize 6 6
        invert 9 -, equalize 6 -
        equalize 6 -, rotate 9 3
        shear_x 9 4, auto_contrast 8 -
        shear_y 9 8, invert 4 -
        shear_y 9 5, solarize 2 6
        invert 9 -, auto_contrast 8 -
        equalize 6 -, rotate 9 3
        shear_x 9 4, solarize 3 3
        shear_y 8 8, invert 7 -
        equalize 9 -, translate_y 6 6
        invert 9 -, equalize 6 -
        contrast 3 3, rotate 8 4
        invert 8 -, translate_y 0 2
        shear_y 7 6, solarize 4 8
        invert 6 -, rotate 8 4
        shear_y 3 7, translate_x 9 3
        shear_x 1 6, invert 6 -
        solarize 7 2, translate_y 6 7
        shear_y 8 4, invert 8 -
        shear_x 7 9, translate_y 8 3
        shear_y 8 5, auto_contrast 7 -
        shear_x 7 2, invert 1 -
    """,
}


class AutoAugment(PolicyAugmentBase):
    """Give each image one of the sub-policies of AutoAugment, two operations with their probabilities.

    Magnitudes are those of the paper: level L of 9 of ranges up to a tangent of 0.3, 150/331 of a side, 30 degrees, factors
    1 - 0.9 and 1 + 0.9, 4 bits and a threshold of 0. Images are RGB in [0, 1], or uint8.

    Args:
        policy: 'imagenet', 'cifar10', 'svhn', or a list of sub-policies: lists of entries (name, probability, level), with a
            level from 0 to 9, or None for operations without a magnitude.
        transformation_matrix_mode: 'skip' for a `transform_matrix` of None; else 'silent' or 'rigid'.
        same_on_batch: all samples get the same operations and values.
        generator: draws the keys of each call; default: torch's generator.
        return_transform: calls return the images and the product of the matrices.

    Raises:
        NotImplementedError: `policy` is another name; it is a ValueError as well.
        TypeError: an entry does not have the form in Args.
        ValueError: an operation is unknown; a probability or a level is out of its bounds.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.auto.AutoAugment("cifar10")(torch.rand(4, 3, 32, 32)).shape
        torch.Size([4, 3, 32, 32])
        >>> invert = K.augmentation.auto.AutoAugment([[("invert", 1.0, None)]])
        >>> invert(torch.full((1, 3, 1, 1), 0.25)).flatten()
        tensor([0.7500, 0.7500, 0.7500])
    """

    def __init__(
        self,
        policy: AutoPolicy | Sequence[Sequence[tuple[str, float, int | None]]] = "imagenet",
        transformation_matrix_mode: MatrixMode = "silent",
        *,
        same_on_batch: bool | None = None,
        generator: Generator | None = None,
        return_transform: bool | None = None,
    ) -> None:
        if isinstance(policy, str):
            if policy not in AUTO_POLICIES:
                listed = ", ".join(AUTO_POLICIES)
                raise UnknownChoiceError(
                    f"AutoAugment: expected policy to be one of {listed} or a list, got {policy!r}"
                )
            policy = parse_policy(AUTO_POLICIES[policy])
        entries = [[_at_level(entry) for entry in part] for part in sub_policies("AutoAugment", policy)]
        options: dict[str, Any] = {"generator": generator, "return_transform": return_transform}
        super().__init__(entries, transformation_matrix_mode, same_on_batch=same_on_batch, **options)


class RandAugment(PolicyAugmentBase):
    """Give each image some random operations, all at one level of magnitude.

    Images are RGB in [0, 1], or uint8.

    Args:
        n: how many operations each image gets; an operation may come again.
        m: the level, within 0 and 30.
        policy: lists of one entry (name, low, high), the values at levels 0 and 30; None for `default_policy`, the
            operations and ranges of the paper.
        transformation_matrix_mode: 'skip' for a `transform_matrix` of None; else 'silent' or 'rigid'.
        same_on_batch: all samples get the same operations and values.
        generator: draws the keys of each call; default: torch's generator.
        return_transform: calls return the images and the product of the matrices.

    Raises:
        TypeError: an entry does not have the form in Args; `n` is not an int.
        ValueError: `n` is below 1; `m` is out of its bounds; an operation is unknown.

    Example:
        >>> import torch, kvision as K
        >>> augment = K.augmentation.auto.RandAugment(n=2, m=9)
        >>> augment(torch.rand(4, 3, 32, 32)).shape
        torch.Size([4, 3, 32, 32])
    """

    default_policy = _RAND

    def __init__(
        self,
        n: int,
        m: float,
        policy: Sequence[Sequence[tuple[str, float, float]]] | None = None,
        transformation_matrix_mode: MatrixMode = "silent",
        *,
        same_on_batch: bool | None = None,
        generator: Generator | None = None,
        return_transform: bool | None = None,
    ) -> None:
        n = check_integer("RandAugment", "n", n)
        if n < 1:
            raise ValueCheckError(f"RandAugment: expected n of at least 1, got {n}")
        m = _check.scalar("RandAugment", "m", m)
        if not 0 <= _check.number("RandAugment", "m", m) <= LEVELS:
            raise ValueCheckError(f"RandAugment: expected m within 0 and {LEVELS}, got {m}")
        entries = []
        for name, low, high in _single("RandAugment", self.default_policy if policy is None else policy):
            value = low + (high - low) * m / LEVELS
            entries.append([(name, 1.0, value, value)])
        options: dict[str, Any] = {"generator": generator, "return_transform": return_transform}
        super().__init__(entries, transformation_matrix_mode, count=n, same_on_batch=same_on_batch, **options)
        self.n, self.m = n, m
        self._check_draws("n")


class TrivialAugment(PolicyAugmentBase):
    """Give each image one random operation, at a random level of magnitude.

    Images are RGB in [0, 1], or uint8.

    Args:
        policy: lists of one entry (name, low, high), the values at levels 0 and 30; None for the wide ranges of the paper.
        transformation_matrix_mode: 'skip' for a `transform_matrix` of None; else 'silent' or 'rigid'.
        same_on_batch: all samples get the same operation and value.
        generator: draws the keys of each call; default: torch's generator.
        return_transform: calls return the images and the product of the matrices.

    Raises:
        TypeError: an entry does not have the form in Args.
        ValueError: an operation is unknown.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.auto.TrivialAugment()(torch.rand(4, 3, 32, 32)).shape
        torch.Size([4, 3, 32, 32])
    """

    def __init__(
        self,
        policy: Sequence[Sequence[tuple[str, float, float]]] | None = None,
        transformation_matrix_mode: MatrixMode = "silent",
        *,
        same_on_batch: bool | None = None,
        generator: Generator | None = None,
        return_transform: bool | None = None,
    ) -> None:
        operations = _single("TrivialAugment", _TRIVIAL if policy is None else policy)
        entries = [[(name, 1.0, low, high)] for name, low, high in operations]
        options: dict[str, Any] = {"generator": generator, "return_transform": return_transform}
        super().__init__(entries, transformation_matrix_mode, same_on_batch=same_on_batch, **options)


def parse_policy(table: str) -> list[list[tuple[str, float, int | None]]]:
    """The sub-policies of a table: one a line, entries between commas."""
    policy = []
    for line in table.strip().splitlines():
        fields = [entry.split() for entry in line.split(",")]
        policy.append([(name, int(p) / 10, None if level == "-" else int(level)) for name, p, level in fields])
    return policy


def _at_level(entry: Any) -> tuple[str, float, float, float]:
    """An entry of AutoAugment with its value, which has no range."""
    if isinstance(entry, str) or not isinstance(entry, Sequence) or len(entry) != 3:
        raise TypeCheckError(f"AutoAugment: expected entries to be (name, probability, level), got {entry!r}")
    name, probability, level = entry
    if name not in _RANGES:
        raise ValueCheckError(f"AutoAugment: expected operations to be one of {', '.join(_RANGES)}, got {name!r}")
    low, high = _RANGES[name]
    if level is None and low != high:
        raise ValueCheckError(f"AutoAugment: expected a level for {name!r}, got None")
    if level is not None and not 0 <= level <= _AUTO_LEVELS:
        raise ValueCheckError(f"AutoAugment: expected the level of {name!r} within 0 and {_AUTO_LEVELS}, got {level}")
    value = low + (high - low) * (level or 0) / _AUTO_LEVELS
    return name, probability, value, value


def _single(op: str, policy: Sequence[Any]) -> list[tuple[str, float, float]]:
    """The entries of a policy whose sub-policies have one operation each."""
    entries = []
    for part in sub_policies(op, policy):
        if len(part) != 1 or isinstance(part[0], str) or not isinstance(part[0], Sequence) or len(part[0]) != 3:
            raise TypeCheckError(f"{op}: expected sub-policies of one entry (name, low, high), got {part!r}")
        name, low, high = part[0]
        low, high = (_check.number(op, f"the values of {name!r}", value) for value in (low, high))
        entries.append((name, low, high))
    return entries
