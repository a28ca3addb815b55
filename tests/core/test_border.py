"""Padding in the references against NumPy's."""

import numpy as np
import pytest
import torch

from kvision.core.border import pad, same_pads, windows

NUMPY_MODES = {"constant": "constant", "reflect": "reflect", "replicate": "edge", "circular": "wrap"}


@pytest.mark.parametrize("border", NUMPY_MODES)
@pytest.mark.parametrize("pads", [((1, 2), (2, 0)), ((0, 0), (3, 3)), ((0, 1), (1, 2), (3, 0))], ids=str)
def test_against_numpy(border, pads, device):
    x = torch.rand(2, 3, *(4, 5, 6)[-len(pads) :], device=device)
    expected = np.pad(x.cpu().numpy(), ((0, 0), (0, 0), *pads), mode=NUMPY_MODES[border])
    assert torch.equal(pad(x, pads, border).cpu(), torch.from_numpy(expected))


@pytest.mark.parametrize("border", NUMPY_MODES)
@pytest.mark.parametrize("shape", [(0, 3), (2, 0)], ids=["no images", "no channels"])
def test_empty(border, shape, device):
    assert pad(torch.rand(*shape, 4, 5, device=device), ((1, 1), (2, 0)), border).shape == (*shape, 6, 7)


@pytest.mark.parametrize("border", NUMPY_MODES)
def test_channels_last_is_kept(border, device):
    x = torch.rand(2, 3, 4, 5, device=device).contiguous(memory_format=torch.channels_last)
    assert pad(x, ((1, 1), (1, 1)), border).is_contiguous(memory_format=torch.channels_last)


@pytest.mark.parametrize("border", NUMPY_MODES)
def test_gradient_is_deterministic(border, device):
    x = torch.rand(1, 2, 3, 4, 5, dtype=torch.float64, device=device, requires_grad=True)
    torch.use_deterministic_algorithms(True)
    try:
        assert torch.autograd.gradcheck(lambda x: pad(x, ((1, 2), (2, 0), (0, 3)), border), x)
    finally:
        torch.use_deterministic_algorithms(False)


def test_even_kernels_reach_further_back():
    assert same_pads((1, 2, 3, 4)) == ((0, 0), (0, 1), (1, 1), (1, 2))


def test_windows_are_row_by_row(device):
    x = torch.arange(6.0, device=device).reshape(1, 1, 2, 3)
    assert windows(x, 1, 3, "replicate")[:, 0, 0, 0, 0].tolist() == [0, 0, 1]
    assert windows(x, 3, 1, "constant")[:, 0, 0, 0, 1].tolist() == [0, 1, 4]
