"""Noise of a list of images that one operator draws and changes: what the steps make of it one after the other."""

from __future__ import annotations

import pytest

from augmentation.test_lists import pictures
from kvision import augmentation as A
from kvision.augmentation.lists import drawn_layers
from op_tests import assert_close

SIZES = ((16, 20), (24, 31), (40, 18))


@pytest.mark.parametrize(
    ("augment", "operator"),
    [
        (A.Spatter(p=1.0), "spatter_layers"),
        (A.Spatter(mode="mud", p=1.0), "spatter_layers"),
        (A.CommonCorruption("spatter", 2), "spatter_layers"),
        (A.CommonCorruption("spatter", 5), "spatter_layers"),
        (A.CommonCorruption("elastic_transform", 3), "blurred_maps"),
    ],
    ids=["rain", "mud", "corruption by rain", "corruption by mud", "maps"],
)
def test_one_operator_makes_what_steps_make(augment, operator, device, monkeypatch):
    images = pictures(device, SIZES)
    results, refused = augment(images, seed=5), []
    monkeypatch.setattr(getattr(drawn_layers, f"_{operator}"), "serves", lambda x: bool(refused.append(x)))
    expected = augment(images, seed=5)
    assert len(refused) == 1
    for y, e in zip(results, expected, strict=True):
        assert_close(y, e, 0.0, 0.0 if device.type == "cpu" else 1e-5)
