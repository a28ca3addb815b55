"""Operators with numbers that a graph keeps symbolic: those of sizes that change, and arguments such as a sigma.

torch compiles a graph again for every value of a `float` in an operator's schema, and after eight it refuses or runs eagerly.
In a graph whose numbers are symbolic stands `kvision::<name>_of_tensors` instead, which takes them as float64 tensors of the CPU.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor

from kvision._torch_compat import below_autograd, full, has_static_value, kernel_caller, schema_of

_LIKE: dict[str, Any] = {"dtype": torch.float64, "device": torch.device("cpu")}


def are_symbolic(numbers: Sequence[Any]) -> bool:
    """Whether one of some floats and lists of floats is symbolic."""
    for value in numbers:
        for number in value if isinstance(value, (list, tuple)) else (value,):
            if not has_static_value(number):
                return True
    return False


def kernel_of_tensors(
    library: torch.library.Library, name: str, kernel: Any, floats: Sequence[int], fake: Callable[..., Any]
) -> Callable[..., Any]:
    """A function that calls `kernel` with symbolic numbers at the positions `floats`, by an operator that it defines."""
    schema = str(schema_of(kernel)).removeprefix(f"kvision::{name}")
    schema = re.sub(r"\bint\b", "SymInt", re.sub(r"\bfloat(\[\])?", "Tensor", schema))
    library.define(f"{name}_of_tensors{schema}")
    run: Any = kernel_caller(kernel)

    def with_numbers(*args: Any) -> Any:
        return run(*(a.tolist() if i in floats else a for i, a in enumerate(args)))

    library.impl(f"{name}_of_tensors", with_numbers, "CompositeExplicitAutograd")
    torch.library.register_fake(f"kvision::{name}_of_tensors", fake, lib=library)
    of_tensors = getattr(torch.ops.kvision, f"{name}_of_tensors")

    def call(*args: Any) -> Any:
        with below_autograd():
            return of_tensors(*(_as_tensor(a) if i in floats else a for i, a in enumerate(args)))

    return call


def _as_tensor(numbers: Any) -> Tensor:
    """Numbers, some of which are symbolic, as a tensor."""
    if not isinstance(numbers, (list, tuple)):
        return full((), numbers, **_LIKE)
    parts: list[Tensor] = []
    for is_static, group in itertools.groupby(numbers, has_static_value):
        adjacent = list(group)
        parts += [torch.tensor(adjacent, **_LIKE)] if is_static else [full((1,), x, **_LIKE) for x in adjacent]
    return torch.cat(parts)
