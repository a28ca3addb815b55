"""The enumerations."""

from __future__ import annotations

import math

import kornia
import pytest
import torch

from kvision import constants
from kvision.core.exceptions import TypeCheckError

ENUMS = ["BorderType", "DType", "DataKey", "Resample", "SamplePadding"]
OWN = {"DataKey": {"BBOX_XYXY_PLUS": 7}}  # members that Kornia has not


@pytest.mark.parametrize("name", ENUMS)
def test_members_are_kornias(name):
    ours, theirs = getattr(constants, name), getattr(kornia.constants, name)
    kornias = {k: v.value for k, v in theirs.__members__.items()}
    assert {k: v.value for k, v in ours.__members__.items()} == kornias | OWN.get(name, {})
    for key, member in ours.__members__.items():
        assert ours.get(key) is ours.get(key.lower()) is ours.get(member.value) is ours.get(member) is member


@pytest.mark.parametrize("name", ENUMS)
def test_unknown_values(name):
    get = getattr(constants, name).get
    for value, error in [("nothing", KeyError), ("nothing", ValueError), (99, ValueError)]:
        with pytest.raises(error) as caught:
            get(value)
        assert str(caught.value).startswith(f"{name}.get: value must be one of ")
    for value in (1.5, None, True, torch.Tensor):
        with pytest.raises(TypeCheckError, match=f"{name}.get: expected value to be"):
            get(value)


def test_dtypes():
    for dtype in (torch.int64, torch.float16, torch.float32, torch.float64, torch.bfloat16):
        member = constants.DType.get(dtype)
        assert constants.DType.to_torch(member) is dtype
        assert constants.DType.get(torch.tensor(member.value)) is member
    with pytest.raises(ValueError, match="got 'uint8'"):
        constants.DType.get(torch.uint8)


def test_pi():
    assert constants.pi.item() == pytest.approx(math.pi)
