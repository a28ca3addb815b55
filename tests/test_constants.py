"""Numbers that are known before a call, as tensors that are copied to a device once."""

from __future__ import annotations

import pytest
import torch
from torch._subclasses.fake_tensor import FakeTensor, FakeTensorMode

import kvision as K
from kvision import _constants
from kvision._constants import constant

ROWS = ((1.0, 2.0), (3.0, 4.0))


def test_is_copied_once_per_device_and_type(device: torch.device) -> None:
    x = torch.rand(2, device=device)
    kept = constant(ROWS, x)
    assert kept.device == x.device and kept.tolist() == [[1, 2], [3, 4]]
    assert constant(ROWS, x) is kept
    assert constant(ROWS, x.double()).dtype == torch.float64
    assert constant((1, 2), x, torch.int64).dtype == torch.int64


def test_what_a_mode_makes_is_not_kept(device: torch.device) -> None:
    values = (0.25, 0.125)
    with FakeTensorMode():
        assert isinstance(constant(values, torch.rand(2, device=device)), FakeTensor)
    x = torch.rand(2, device=device)
    torch.func.vmap(lambda x: x * constant(values, x))(x[:, None])
    with torch.inference_mode():
        kept = constant(values, torch.rand(2, device=device))
    x.requires_grad_()
    (x * constant(values, x)).sum().backward()
    assert not kept.is_inference() and x.grad is not None and x.grad.tolist() == list(values)


def test_a_bounded_number_is_kept(device: torch.device) -> None:
    x = torch.rand(2, device=device)
    before = len(_constants._in_graphs)
    for i in range(3000):
        constant((float(i), 0.5), x)
    information = _constants._kept.cache_info()
    assert information.maxsize is not None and information.currsize <= information.maxsize
    assert len(_constants._in_graphs) == before


def test_a_graph_reads_it_at_every_replay(device: torch.device) -> None:
    if device.type != "cuda":
        return
    x = torch.rand(3, device=device)
    constant((5.0, 6.0, 7.0), x)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        y = x + constant((5.0, 6.0, 7.0), x)
    for i in range(3000):  # which replace all constants but those that a graph reads
        constant((float(i), 7.0, 8.0), x)
    torch.full((1 << 16, 3), -1.0, device=device)
    x.zero_()
    graph.replay()
    assert y.tolist() == [5, 6, 7]


# --- of modules ---

CONSTANTS = {
    "enhance.Normalize": lambda: K.enhance.Normalize((0.4, 0.5, 0.6), (0.2, 0.3, 0.4)),
    "augmentation.Normalize": lambda: K.augmentation.Normalize([0.4, 0.5, 0.6], [0.2, 0.3, 0.4]),
    "RandomTransplantation": lambda: K.augmentation.RandomTransplantation(excluded_labels=[1]),
    "ApplyColorMap": lambda: K.color.ApplyColorMap(K.color.ColorMap("jet")),
    "MKDDescriptor": lambda: K.feature.MKDDescriptor(32, whitening=None),
    "GaussianBlur2d": lambda: K.filters.GaussianBlur2d(3, torch.full((1, 2), 0.7, device="cpu")),
}


@pytest.mark.parametrize("name", CONSTANTS)
def test_modules_made_on_meta_keep_their_constants(name: str) -> None:
    """to_empty moves no values, and a state dict lacks them."""
    module = CONSTANTS[name]()
    with torch.device("meta"):
        made = CONSTANTS[name]()
    made.to_empty(device="cpu").load_state_dict(module.state_dict())
    x = torch.rand(2, 1, 32, 32) if name in ("ApplyColorMap", "MKDDescriptor") else torch.rand(2, 3, 32, 32)
    inputs = (x, torch.randint(3, (2, 32, 32))) if name == "RandomTransplantation" else (x,)
    options = {"seed": 3} if name == "RandomTransplantation" else {}
    actual, expected = made(*inputs, **options), module(*inputs, **options)
    assert all(map(torch.equal, actual, expected))


def test_constants_without_values_are_refused() -> None:
    with torch.device("meta"):
        blur = K.filters.GaussianBlur2d(3, torch.rand(1, 2))
    with pytest.raises(RuntimeError, match="GaussianBlur2d: sigma was made on 'meta', has no values"):
        blur.to_empty(device="cpu")
