"""Plans that calls with the same settings and sizes share: computed once and kept until a setting changes."""

from __future__ import annotations

import functools
from collections.abc import Callable, Hashable
from typing import Any, TypeVar

import torch
from torch.compiler import is_compiling

from kvision.augmentation.keys import PortableGenerator

Method = TypeVar("Method", bound=Callable[[Any], Any])
Plan = TypeVar("Plan")
_MOST = 512  # plans of an object: those of the samples of a batch that get one child have many sizes


class _Changes:
    count = 0  # of settings of all augmentations in the process


def settings_changed() -> None:
    """To be called when a setting of any augmentation changes: plans that were made before are not used again."""
    _Changes.count += 1


class Plans:
    """Plans of one object by what they depend on besides its settings. Copies and pickles have none.

    While torch.compile traces there are none, and none are kept: a graph holds what was planned for it.
    """

    def __init__(self) -> None:
        self._plans: dict[Hashable, Any] = {}
        self._count = _Changes.count

    def get(self, key: Hashable) -> Any:
        """The plan of a key; None if there is none, or if a setting has changed since."""
        return None if is_compiling() or self._count != _Changes.count else self._plans.get(key)

    def keep(self, key: Hashable, plan: Any) -> None:
        """Let `get` return a plan from now on."""
        if is_compiling():
            return
        if self._count != _Changes.count or len(self._plans) >= _MOST:
            self._plans, self._count = {}, _Changes.count
        self._plans[key] = plan

    def made(self, key: Hashable, make: Callable[[], Plan]) -> Plan:
        """The plan of a key, None among them, which `make` makes where there is none."""
        kept = self.get(key)
        if kept is None:
            kept = (make(),)
            self.keep(key, kept)
        plan: Plan = kept[0]
        return plan

    def __reduce__(self) -> Any:
        return Plans, ()


def kept(method: Method) -> Method:
    """A method of a module without arguments whose value is kept among its plans."""

    @functools.wraps(method)
    def value(self: Any) -> Any:
        plans: Plans = self._plans
        has_plans = not is_compiling() and plans._count == _Changes.count  # in this order: graphs guard what they read
        known = plans._plans.get(method) if has_plans else None  # in place of `get`, for its time
        return plans.made(method, lambda: method(self)) if known is None else known[0]

    return value  # type: ignore[return-value]


def _noticing(name: str) -> Any:
    method = getattr(dict, name)

    def changed(self: Flags, *args: Any, **kwargs: Any) -> Any:
        settings_changed()
        return method(self, *args, **kwargs)

    return changed


# The flags that are True or False.
SWITCHES = ("align_corners", "antialias", "crop_if_exceeds", "pad_if_needed", "scale_window")


class Flags(dict[str, Any]):
    """Settings of an augmentation by name."""

    for _name in ("__setitem__", "__delitem__", "__ior__", "clear", "pop", "popitem", "setdefault", "update"):
        locals()[_name] = _noticing(_name)
    del _name

    def __reduce__(self) -> Any:
        return Flags, (dict(self),)  # torch.load with weights_only sets no items of other dicts


class PortableFormat:
    """Stands for a memory format in the state of a module: torch.save cannot write one (torch 2.13). Copies are formats again."""

    def __init__(self, name: str) -> None:
        self.name = name

    def __reduce__(self) -> Any:
        return restored_format, (self.name,)


def restored_format(name: str) -> torch.memory_format:
    """The memory format that torch has by this name."""
    return {"contiguous_format": torch.contiguous_format, "channels_last": torch.channels_last}[name]


def portable(settings: dict[str, Any]) -> dict[str, Any]:
    """Settings by name, with what stands for those that pickles do not carry."""
    return {name: _portable(value) for name, value in settings.items()}


def _portable(value: Any) -> Any:
    if isinstance(value, torch.Generator):
        return PortableGenerator.of(value)
    return PortableFormat(str(value).removeprefix("torch.")) if isinstance(value, torch.memory_format) else value
