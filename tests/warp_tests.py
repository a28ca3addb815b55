"""What tests of warps share: matrices, and what the suite cannot know about them."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from op_tests import OpTests

# Places are float32 numbers of some tens: neighbouring pixels of noise differ by 1.
FLOAT_PLACES = {torch.float32: (2e-5, 2e-5), torch.uint8: (0, 1)}


def affine(x: Tensor) -> Tensor:
    """Maps of source to result, (B, 2, 3), a little turned and shifted, another one for each sample."""
    moves = torch.tensor([[0.9137, 0.2341, 1.3717], [-0.1309, 1.0739, -1.6133]], dtype=torch.float64)
    return moves + 0.0317 * torch.arange(len(x))[:, None, None]


def homography(x: Tensor) -> Tensor:
    last = torch.tensor([[[0.0071, -0.0113, 1.09]]], dtype=torch.float64)
    return torch.cat([affine(x), last.expand(len(x), 1, 3)], 1)


def one(matrix):
    """One for all samples."""
    return lambda x: matrix(x[:1])


class WarpTests(OpTests):
    bytes = True
    tolerances = FLOAT_PLACES

    @pytest.fixture(autouse=True)
    def same_bits_where_asked(self, device, request):
        """On CUDA some gradients to images are sums by atomics, unless torch is asked for the same bits every run."""
        asks = request.function.__name__ in ("test_threads_and_runs_give_the_same_bits", "test_gradcheck")
        torch.use_deterministic_algorithms(device.type == "cuda" and asks, warn_only=True)
        yield
        torch.use_deterministic_algorithms(False)

    def test_operators_refuse_bad_arguments(self, device, backend, monkeypatch):
        """An image may have any size beside its result's, so that neither is wrong when it is cut."""
        import raw_calls

        every = raw_calls.wrong_calls
        monkeypatch.setattr(raw_calls, "wrong_calls", lambda *a: [c for c in every(*a) if " cut along " not in c[0]])
        super().test_operators_refuse_bad_arguments(device, backend)
