"""Docstrings of public functions say whether the result of uint8 images is uint8."""

from __future__ import annotations

import inspect
import re

import torch
from torch import Tensor

import kvision as K
from benchmarks.sample_calls import SampleCall, Size, sample_calls

SIZE = Size(2, 3, 20, 24)
# What the entry of the images under Args says.
CLAIM = re.compile(r"or uint8\b|uint8 (gives|has|as|is rounded)\b")


def images(call: SampleCall) -> list[str]:
    """The images (..., H, W) of a call: its first tensor, and those of the same shape and type."""
    tensors = call.tensors(SIZE)
    names = [name for name in inspect.signature(call.function()).parameters if name in tensors]
    first = tensors[names[0]] if names else torch.empty(())
    if first.dim() < 3 or min(first.shape[-2:]) < 5 or not first.is_floating_point():
        return []
    return [name for name in names if tensors[name].shape == first.shape and tensors[name].is_floating_point()]


def result(call: SampleCall, dtype: torch.dtype) -> torch.dtype | None:
    """The type of the first result for images of `dtype`, None if they are refused."""
    tensors = call.tensors(SIZE)
    for name in images(call):
        tensors[name] = (255 * tensors[name].clamp(0, 1)).to(dtype)
    try:
        value = call.call(K, tensors)
    except TypeError:
        return None
    while isinstance(value, (tuple, list)):
        value = value[0]
    return value.dtype if isinstance(value, Tensor) else None


def entry(call: SampleCall) -> str:
    """The entry of the images under Args."""
    page = inspect.getdoc(call.function()) or ""
    found = re.search(
        rf"^    [\w, ]*\b{images(call)[0]}\b[\w, ]*: (.*?)(?=^    \w|^\w|\Z)", page, re.DOTALL | re.MULTILINE
    )
    return " ".join(found[1].split()) if found else ""


def is_right(call: SampleCall) -> bool:
    """Whether what the docstring says is so."""
    says = bool(CLAIM.search(entry(call)))
    if says or result(call, torch.uint8) != torch.uint8:
        return says == (result(call, torch.uint8) == torch.uint8)
    page = inspect.getdoc(call.function()) or ""
    return "uint8" in page or result(call, torch.int16) == torch.int16  # only moved or repeated, as any type is


def test_docstrings_say_whether_uint8_gives_uint8() -> None:
    calls = [call for call in sample_calls() if images(call)]
    assert len(calls) > 200
    assert not {call.name: entry(call) for call in calls if not is_right(call)}
