"""RangeWarning: once in a process, for images of floats whose values are those of bytes."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import torch
from torch import Tensor

import kvision as K
import kvision.augmentation as A
from kvision import _backend, _hints
from kvision._ops import Operator, all_operators

pytestmark = pytest.mark.interface

IMAGE = 255 * torch.rand(1, 3, 8, 8, generator=torch.Generator().manual_seed(1))


@pytest.fixture(autouse=True)
def first_calls(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """As in a new process whose kernels serve."""
    if "cpu" in _backend.unserved:
        pytest.skip("pure Python")
    monkeypatch.setattr(_hints._Hints, "are_on", True)
    for operator in all_operators().values():
        if operator._clamps is not None:
            monkeypatch.setattr(operator, "_call_kernel", operator._first_call)
    with K.backend("auto"):
        yield


def warned(call: Callable[..., Any], *args: Any) -> list[warnings.WarningMessage]:
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        call(*args)
    return [w for w in found if w.category is K.RangeWarning]


CALLS: list[Callable[[Tensor], Any]] = [
    K.enhance.equalize,
    K.enhance.equalize_clahe,
    lambda x: K.enhance.sharpness(x, 0.5),
    lambda x: K.enhance.jpeg_codec_differentiable(x, torch.tensor([50.0])),
    lambda x: K.enhance.ColorProgram(("brightness", 0.5))(x),
    lambda x: A.ImageSequential(A.RandomAffine(10.0), A.ColorJitter(0.1, 0.1, 0.1, 0.1, p=1.0))(x),
    lambda x: A.RandomBrightness((0.5, 1.5), p=1.0)(x.requires_grad_()),
]


@pytest.mark.parametrize("call", CALLS, ids=range(len(CALLS)))
def test_values_of_bytes_are_named_once_with_the_line_of_the_call(call: Callable[[Tensor], Any]) -> None:
    (warning,) = warned(call, IMAGE.clone())
    assert warning.filename == __file__
    assert str(warning.message).endswith(f"got values up to {IMAGE.max():g}: divide by 255, or pass uint8")
    assert not warned(K.enhance.equalize_clahe, IMAGE)


@pytest.mark.parametrize(
    "call",
    [
        lambda: K.enhance.ColorProgram(("normalize", (1.0, 1.0, 1.0), (1.0, 1.0, 1.0)))(IMAGE),
        lambda: K.enhance.ColorProgram(("denormalize", (1.0, 1.0, 1.0), (1.0, 1.0, 1.0)))(IMAGE),
        lambda: K.filters.gaussian_blur2d(IMAGE, 3, 1.0),
        lambda: A.RandomAffine(10.0, p=1.0)(IMAGE),
        lambda: K.enhance.equalize(IMAGE / 255),
        lambda: K.enhance.equalize(IMAGE / 130),
        lambda: K.enhance.equalize(IMAGE * 2),
        lambda: K.enhance.equalize(IMAGE.byte()),
        lambda: K.enhance.equalize(IMAGE[:0]),
        lambda: K.enhance.equalize(IMAGE.new_full((1, 1, 1025, 1024), 9.0)),
        lambda: torch.vmap(lambda x: K.enhance.adjust_gamma(x, 2.0))(IMAGE),
        lambda: torch.vmap(torch.func.grad(lambda x: K.enhance.adjust_saturation(x, 2.0).sum()))(IMAGE),
    ],
)
def test_other_images_and_operators_are_not(call: Callable[[], Any]) -> None:
    assert not warned(call)


def test_only_first_calls_are_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    assert not warned(K.enhance.equalize, IMAGE / 255) and not warned(K.enhance.equalize, IMAGE)
    operator: Operator = all_operators()["equalize"]
    assert operator._call_kernel != operator._first_call
    monkeypatch.setattr(_hints._Hints, "are_on", False)  # KVISION_HINTS=0
    assert not warned(K.enhance.equalize_clahe, IMAGE)
