"""The base of containers: children in order, with what they share."""

from __future__ import annotations

import copy
from typing import Any

import torch
from torch import Generator, Tensor, nn

from kvision._modules import give_own_forward
from kvision.augmentation.engine.configuration import Plans, portable, settings_changed
from kvision.augmentation.engine.declaration import KeepsArguments
from kvision.augmentation.engine.record import Record
from kvision.core.exceptions import TypeCheckError


class ImageSequentialBase(KeepsArguments, nn.Sequential):
    """Base of the containers: children in order, with what they share.

    Args:
        *args: augmentations, other containers, or any modules of images.
        same_on_batch: if not None, that of all children.
        keepdim: if not None, that of all children, and of the container.

    Raises:
        TypeError: a child is not a module.

    Example:
        >>> import kvision as K
        >>> len(K.augmentation.container.ImageSequentialBase(K.augmentation.RandomHorizontalFlip()))
        1
    """

    _record: Record = Record()  # of the last call; nothing else of a call is kept
    generator: Generator | None = None

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        give_own_forward(cls)

    def __init__(self, *args: nn.Module, same_on_batch: bool | None = None, keepdim: bool | None = None) -> None:
        op = type(self).__name__
        for module in args:
            if not isinstance(module, nn.Module):
                raise TypeCheckError(f"{op}: expected children to be modules, got {type(module).__name__}")
        super().__init__()
        for i, module in enumerate(args):
            name = f"{type(module).__name__}_{i}"
            # A module that the chain has twice has two states.
            known = any(module is other for other in self.children())
            self.add_module(name, copy.deepcopy(module) if known else module)
        self._same_on_batch, self._keepdim = same_on_batch, keepdim
        self._plans = Plans()
        self._set_options_of_children()

    def __setattr__(self, name: str, value: Any) -> None:
        settings_changed()
        super().__setattr__(name, value)

    def __getstate__(self) -> dict[str, Any]:
        # Copies and pickles have the settings, not the last call.
        state = {name: value for name, value in self.__dict__.items() if name != "_record"}
        return portable({**state, "_arguments": self._portable_arguments()})

    def _set_options_of_children(self) -> None:
        for child in self.children():
            for name in ("same_on_batch", "keepdim"):
                value = getattr(self, f"_{name}")
                if value is not None and hasattr(child, name):
                    setattr(child, name, value)

    @property
    def same_on_batch(self) -> bool | None:
        """Whether all samples get the same parameters; None leaves it to the children."""
        return self._same_on_batch

    @same_on_batch.setter
    def same_on_batch(self, value: bool | None) -> None:
        self._same_on_batch = value
        self._set_options_of_children()

    @property
    def keepdim(self) -> bool | None:
        """Whether results have the number of axes of the input; None leaves it to the children."""
        return self._keepdim

    @keepdim.setter
    def keepdim(self, value: bool | None) -> None:
        self._keepdim = value
        self._set_options_of_children()

    def clear_state(self) -> None:
        """Forget the last call."""
        self.__dict__.pop("_record", None)

    def _keep(self, record: Record) -> None:
        self.__dict__["_record"] = record  # Module.__setattr__ is slow, because it looks for parameters

    def identity_matrix(self, input: Tensor) -> Tensor:
        """An identity matrix (3, 3) for each sample."""
        return torch.eye(3, device=input.device).expand(input.shape[0], 3, 3)
