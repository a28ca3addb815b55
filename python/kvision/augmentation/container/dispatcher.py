"""Containers that hand several inputs to several augmentations."""

from __future__ import annotations

from typing import Any

from torch import nn

from kvision.augmentation.engine import AugmentationBase, AugmentationSequential, ImageSequential
from kvision.core.exceptions import TypeCheckError, ValueCheckError

__all__ = ["ManyToManyAugmentationDispather", "ManyToOneAugmentationDispather"]


class ManyToManyAugmentationDispather(nn.Module):
    """Hand each input to the augmentation at its position.

    Args:
        *augmentations: one of each input; one that takes several, such as AugmentationSequential, gets a tuple or list.

    Raises:
        TypeError: one is not a module.
        ValueError: in a call, another number of inputs than of augmentations.

    Example:
        >>> import torch, kvision as K
        >>> flips = (K.augmentation.RandomHorizontalFlip(p=1.0), K.augmentation.RandomVerticalFlip(p=1.0))
        >>> both = K.augmentation.ManyToManyAugmentationDispather(*flips)
        >>> [x.flatten().tolist() for x in both(torch.tensor([[[[1.0, 2.0]]]]), torch.tensor([[[[1.0], [2.0]]]]))]
        [[2.0, 1.0], [2.0, 1.0]]
    """

    def __init__(self, *augmentations: nn.Module) -> None:
        super().__init__()
        self.augmentations = _modules(type(self).__name__, augmentations)

    def forward(self, *input: Any) -> list[Any]:
        if len(input) != len(self.augmentations):
            raise ValueCheckError(
                f"ManyToManyAugmentationDispather: expected {len(self.augmentations)} inputs, got {len(input)}"
            )
        return [_call(augment, x) for augment, x in zip(self.augmentations, input)]


class ManyToOneAugmentationDispather(nn.Module):
    """Hand all inputs to each augmentation.

    Args:
        *augmentations: AugmentationSequential containers, or augmentations of images.
        strict: containers must have the same data keys.

    Raises:
        TypeError: one is not a module.
        ValueError: data keys differ, and `strict`.

    Example:
        >>> import torch, kvision as K
        >>> flips = (K.augmentation.RandomHorizontalFlip(p=1.0), K.augmentation.RandomInvert(p=1.0))
        >>> both = K.augmentation.ManyToOneAugmentationDispather(*flips)
        >>> [x.flatten().tolist() for x in both(torch.tensor([[[[0.0, 1.0]]]]))]
        [[1.0, 0.0], [1.0, 0.0]]
    """

    def __init__(self, *augmentations: nn.Module, strict: bool = True) -> None:
        super().__init__()
        self.augmentations = _modules(type(self).__name__, augmentations)
        keys = {tuple(a.data_keys or ()) for a in augmentations if isinstance(a, AugmentationSequential)}
        if strict and len(keys) > 1:
            raise ValueCheckError(
                f"ManyToOneAugmentationDispather: expected the same data_keys everywhere, got {sorted(map(str, keys))}"
            )

    def forward(self, *input: Any) -> list[Any]:
        return [augment(*input) for augment in self.augmentations]


def _modules(op: str, augmentations: tuple[Any, ...]) -> nn.ModuleList:
    for augment in augmentations:
        if not isinstance(augment, nn.Module):
            raise TypeCheckError(f"{op}: expected augmentations to be modules, got {type(augment).__name__}")
    return nn.ModuleList(augmentations)


def _call(augment: nn.Module, x: Any) -> Any:
    """Hand an input over; one that is several inputs to what takes several. Of images, a tuple is a pair with matrices."""
    takes_one = isinstance(augment, (AugmentationBase, ImageSequential)) and not hasattr(augment, "data_keys")
    return augment(*x) if isinstance(x, (tuple, list)) and not takes_one else augment(x)
