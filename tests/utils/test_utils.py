"""Helpers of kvision.utils, and the names that it imports from other modules."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple, Optional

import pytest
import torch

import kvision as K
from kvision.core.exceptions import TypeCheckError, ValueCheckError


@pytest.mark.parametrize("name", K.utils.__all__)
def test_names_of_other_modules_are_the_same_objects(name):
    home = next((m for m in (K.image, K.io, K.core) if name in m.__all__), K.utils)
    assert getattr(K.utils, name) is getattr(home, name)


@pytest.mark.parametrize("batch", [0, 1, 5, 8, 9])
def test_batched_forward(batch, device):
    model = torch.nn.Linear(3, 2)
    x = torch.rand(batch, 3)
    got = K.utils.batched_forward(model, x, device, batch_size=4)
    assert got.device == x.device and got.shape == (batch, 2)
    torch.testing.assert_close(got, model.cpu()(x))


def test_batched_forward_passes_batches_and_arguments():
    class Spy(torch.nn.Module):
        sizes: ClassVar[list[int]] = []

        def forward(self, x, *, factor):
            self.sizes.append(len(x))
            return x * factor

    assert torch.equal(K.utils.batched_forward(Spy(), torch.ones(9, 1), "cpu", 4, factor=3), torch.full((9, 1), 3.0))
    assert Spy.sizes == [4, 4, 1]
    for size, error in [(0, ValueCheckError), (1.5, TypeCheckError)]:
        with pytest.raises(error, match="batched_forward: expected batch_size"):
            K.utils.batched_forward(Spy(), torch.ones(1), "cpu", size, factor=1)


def test_devices(device):
    cuda = torch.cuda.is_available()
    assert K.utils.get_cuda_device_if_available() == torch.device("cuda:0" if cuda else "cpu")
    assert K.utils.get_cuda_or_mps_device_if_available().type in (("cuda",) if cuda else ("cpu", "mps"))
    assert K.utils.get_mps_device_if_available().type in ("cpu", "mps")
    assert not K.utils.is_mps_tensor_safe(torch.zeros(1, device=device))


def test_autocast(device):
    enabled = K.utils.is_autocast_enabled
    assert not enabled() and not enabled(both=False)
    with torch.autocast(device.type, torch.bfloat16):
        assert enabled() and enabled(both=False) == (device.type == "cuda")


def test_legacy_names(tmp_path):
    x, y = torch.arange(2), torch.arange(3)
    for indexing in ("ij", "xy"):
        pairs = zip(K.utils.torch_meshgrid([x, y], indexing), torch.meshgrid(x, y, indexing=indexing), strict=True)
        assert all(torch.equal(got, want) for got, want in pairs)
    torch.save(x, tmp_path / "x.pt")
    assert torch.equal(torch.load(tmp_path / "x.pt", map_location=K.utils.map_location_to_cpu), x)


@dataclass
class Stage:
    size: int
    name: str = ""


class Pair(NamedTuple):
    a: int
    b: object


@dataclass
class Config:
    first: Stage
    rest: list[Stage] = field(default_factory=list)
    pairs: tuple[Stage, ...] = ()
    by_name: dict[str, Stage] = field(default_factory=dict)
    maybe: Optional[Stage] = None  # noqa: UP045  # typing's union; the next one is another class
    either: Stage | None = None
    free: object = None


CONFIG = Config(Stage(1, "a"), [Stage(2)], (Stage(3), Stage(4)), {"x": Stage(5)}, Stage(6), Stage(7), {"size": 8})


def test_dataclass_round_trip():
    as_dict = K.utils.dataclass_to_dict(CONFIG)
    assert as_dict["rest"] == [{"size": 2, "name": ""}] and as_dict["free"] == {"size": 8}
    assert K.utils.dict_to_dataclass(as_dict, Config) == CONFIG
    assert K.utils.dict_to_dataclass({"first": Stage(1)}, Config) == Config(Stage(1))
    assert K.utils.dict_to_dataclass({"first": {"size": 1}, "maybe": None}, Config) == Config(Stage(1))


def test_dataclass_to_dict_of_other_types():
    tensor = torch.ones(1, requires_grad=True) * 2
    assert K.utils.dataclass_to_dict(tensor) is tensor
    assert K.utils.dataclass_to_dict(Pair(1, Stage(2))) == Pair(1, {"size": 2, "name": ""})
    assert K.utils.dataclass_to_dict({"k": (Stage(1),)}) == {"k": ({"size": 1, "name": ""},)}
    assert K.utils.dataclass_to_dict(Stage) is Stage


@pytest.mark.parametrize(("source", "target"), [([1], Stage), ({}, dict), ({}, Stage(1))])
def test_dict_to_dataclass_errors(source, target):
    with pytest.raises(TypeCheckError, match="dict_to_dataclass: expected"):
        K.utils.dict_to_dataclass(source, target)
