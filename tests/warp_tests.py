"""Base classes for tests of warps and resizes, and their matrices."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from op_tests import OpTests, recorded

# Sampling coordinates are float32 numbers of some tens, and adjacent pixels of noise differ by up to 1.
FLOAT_COORDS = {torch.float32: (2e-5, 2e-5), torch.uint8: (0, 1)}


def affine(x: Tensor) -> Tensor:
    """Affine maps (B, 2, 3) from source to result, with a small rotation and shift that differ by sample."""
    moves = torch.tensor([[0.9137, 0.2341, 1.3717], [-0.1309, 1.0739, -1.6133]], dtype=torch.float64)
    return moves + 0.0317 * torch.arange(len(x))[:, None, None]


def homography(x: Tensor) -> Tensor:
    last = torch.tensor([[[0.0071, -0.0113, 1.09]]], dtype=torch.float64)
    return torch.cat([affine(x), last.expand(len(x), 1, 3)], 1)


def one(matrix):
    """Matrices (1, ., .) of the first sample, for all samples."""
    return lambda x: matrix(x[:1])


def degrees(x: Tensor) -> Tensor:
    return 23.7 + 11.3 * torch.arange(len(x), dtype=torch.float64)


def point(x: Tensor) -> Tensor:
    return torch.tensor([[5.31, 3.17]], dtype=torch.float64) + torch.arange(len(x))[:, None]


def middle(x: Tensor) -> Tensor:
    return torch.tensor([[2.31, 1.17, 0.61]], dtype=torch.float64)


@pytest.mark.native
class WarpTests(OpTests):
    bytes = True
    tolerances = FLOAT_COORDS

    @pytest.fixture(autouse=True)
    def same_bits_where_asked(self, device, request):
        """On CUDA some image gradients are sums by atomics, unless torch is set to deterministic algorithms."""
        asks = request.function.__name__ in ("test_threads_and_runs_give_the_same_bits", "test_gradcheck")
        torch.use_deterministic_algorithms(device.type == "cuda" and asks, warn_only=True)
        yield
        torch.use_deterministic_algorithms(False)

    def test_operators_refuse_bad_arguments(self, device, backend, monkeypatch):
        """An image and its result may differ in size, so that a cropped tensor is valid."""
        import raw_calls

        every = raw_calls.wrong_calls
        monkeypatch.setattr(raw_calls, "wrong_calls", lambda *a: [c for c in every(*a) if " cut along " not in c[0]])
        super().test_operators_refuse_bad_arguments(device, backend)


class FormulaWarpTests(WarpTests):
    @pytest.mark.tracing
    def test_opcheck(self, device, backend):
        """Check the operator alone; the operators of its gradient have separate tests."""
        self.needs_native(backend)
        x, kwargs = self.setup(self.variants[0], device, torch.float32)
        with recorded() as calls:
            self.call(x, kwargs)
        for name, args in calls:
            torch.library.opcheck(getattr(torch.ops.kvision, name).default, (args[0].requires_grad_(), *args[1:]))


class ResizeTests(OpTests):
    operators = ("resize", "resize_backward")
    bytes = True
    # Weights are fractions of small integers, so many means are halfway between two bytes.
    tolerances = {torch.uint8: (0, 1)}

    def test_operators_refuse_bad_arguments(self, device, backend, monkeypatch):
        """An image and its result may differ in size, and only pyramids have a border."""
        import raw_calls

        every, fine = raw_calls.wrong_calls, (" cut along ", " around a pixel")
        monkeypatch.setattr(
            raw_calls, "wrong_calls", lambda *a: [c for c in every(*a) if not any(f in c[0] for f in fine)]
        )
        super().test_operators_refuse_bad_arguments(device, backend)
