"""What the tests of kernels that draw parameters and use them at once have in common."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import Any

import pytest
import torch
from torch import Tensor

import kvision
from kvision import _backend

UNSERVED = ("gradient", "reference", "vmap", "float64", "no samples")  # calls of `call_unserved`


def record_kernel(monkeypatch: pytest.MonkeyPatch, module: ModuleType, name: str) -> tuple[list[Any], list[bool]]:
    """The calls of a module's FastPath from now on, and a list whose last entry says whether it may serve."""
    calls: list[Any] = []
    serves = [True]
    fast_path = getattr(module, name)

    class Recorder:
        def serves(self, x: Tensor) -> bool:
            return serves[-1] and fast_path.serves(x)

        def kernel(self, *args: Any) -> Any:
            calls.append(args)
            return fast_path.kernel(*args)

    monkeypatch.setattr(module, name, Recorder())
    return calls, serves


def random_images(shape: tuple[int, ...], device: torch.device, dtype: torch.dtype) -> Tensor:
    x = torch.rand(shape, generator=torch.Generator().manual_seed(3))
    return (x * 255).to(device, dtype) if dtype == torch.uint8 else x.to(device, dtype)


def has_kernels(device: torch.device, backend: str) -> bool:
    return backend != "reference" and device.type not in _backend.unserved


def assert_equal_params(actual: Any, expected: Any) -> None:
    """The same bits in the parameters of two calls."""
    flat, expected_flat = (torch.utils._pytree.tree_leaves(p) for p in (actual, expected))
    assert len(flat) == len(expected_flat)
    for a, e in zip(flat, expected_flat):
        assert torch.equal(e, a) if isinstance(e, Tensor) else e == a


def call_unserved(case: str, augment: Callable[..., Any], x: Tensor) -> None:
    """A call of an augmentation that its kernel does not serve."""
    if case == "gradient":
        assert augment(x.clone().requires_grad_()).requires_grad
    elif case == "reference":
        with kvision.backend("reference"):
            augment(x)
    elif case == "vmap":
        torch.func.vmap(lambda one: augment(one[None], seed=1))(x)
    elif case == "float64":
        assert augment(x.double()).dtype == torch.float64
    else:
        assert augment(x[:0]).shape == x[:0].shape
