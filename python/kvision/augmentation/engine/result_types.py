"""Types of results, which do not depend on what is drawn."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from kvision.core.pixels import to_unit


def result_dtype(module: Any, dtype: torch.dtype) -> torch.dtype:
    """The type that a module gives images of a type; that of the images for modules of other libraries."""
    if not hasattr(module, "_result_dtype") or getattr(module, "p_batch", 1.0) == 0 or getattr(module, "p", 1.0) == 0:
        return dtype
    own: torch.dtype = module._result_dtype(dtype)
    return own


def common_dtype(types: Sequence[torch.dtype]) -> torch.dtype:
    """The type of a batch whose samples may have any of these types: bytes become floating point."""
    if all(dtype == types[0] for dtype in types):
        return types[0]
    return functools.reduce(torch.promote_types, (torch.float32 if t == torch.uint8 else t for t in types))


def in_wider_type(x: Tensor, dtype: torch.dtype) -> Tensor:
    """Images in a type, or in one that holds both it and theirs; bytes as numbers in [0, 1] in floating point."""
    if x.dtype == dtype or dtype == torch.uint8:
        return x
    return to_unit(x).to(dtype if x.dtype == torch.uint8 else torch.promote_types(x.dtype, dtype))
