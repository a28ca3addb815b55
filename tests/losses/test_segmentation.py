"""Focal, Dice and Tversky losses: the kernels' tests."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

import kvision as K
from op_tests import OpTests, assert_close

L = K.losses


def labels(x: Tensor) -> Tensor:
    """A few of them ignored."""
    shape = (x.shape[0], *x.shape[2:])
    return torch.randint(-1, x.shape[1], shape, generator=torch.Generator().manual_seed(0))


class Segmentation(OpTests):
    channels = 4
    mixed = ("pred", "grad")  # labels have a type of their own
    shape = (2, 4, 13, 18)
    small = (1, 4, 3, 4)
    max_size = 9

    def input(self, shape, dtype, device):
        return (6 * torch.rand(shape, dtype=torch.float64) - 3).round(decimals=1).to(dtype).to(device)

    def call(self, x, kwargs):
        integers = isinstance(x, Tensor) and x.dtype in (torch.uint8, torch.int32)  # which the losses refuse
        return self.function(x.float() if integers else x, **kwargs)


class TestFocal(Segmentation):
    function = staticmethod(L.focal_loss)
    operators = ("focal", "focal_backward")
    variants = [
        {"target": labels, "ignore_index": -1},
        {"target": labels, "ignore_index": -1, "alpha": None, "gamma": 0.0, "reduction": "mean"},
        {"target": labels, "ignore_index": -1, "gamma": 1.5, "weight": lambda x: torch.linspace(0.5, 2, 4)},
    ]
    errors = [({"gamma": -1.0}, ValueError, "expected gamma"), ({"alpha": "a"}, TypeError, "expected alpha")]


class TestBinaryFocal(OpTests):
    function = staticmethod(L.binary_focal_loss_with_logits)
    module = L.BinaryFocalLossWithLogits
    operators = ("binary_focal", "binary_focal_backward")
    mixed = ("pred", "grad")  # the sums of half types are float32
    channels = 3
    small = (1, 3, 3, 4)
    max_size = 9
    variants = [
        {"target": lambda x: labels(x)[:, None].expand(x.shape).clamp_max(1), "ignore_index": -1, "alpha": 0.3},
        {
            "target": lambda x: torch.rand(x.shape).to(x.device),
            "pos_weight": lambda x: torch.linspace(0.5, 2, 3),
            "weight": lambda x: torch.linspace(3, 2, 3),
            "gamma": 1.5,
            "alpha": 0.25,
            "reduction": "mean",
        },
    ]
    errors = [({"gamma": -1.0}, ValueError, "expected gamma"), ({"target": None}, TypeError, "expected target")]
    forward_arguments = ("target",)

    def input(self, shape, dtype, device):
        return (8 * torch.rand(shape, dtype=torch.float64) - 4).to(dtype).to(device)

    def call(self, x, kwargs):
        integers = isinstance(x, Tensor) and x.dtype in (torch.uint8, torch.int32)  # which the loss refuses
        return self.function(x.float() if integers else x, **kwargs)


class TestTversky(Segmentation):
    function = staticmethod(L.tversky_loss)
    operators = ("overlap", "overlap_backward")
    variants = [{"target": labels, "ignore_index": -1, "alpha": 0.3, "beta": 0.7}]
    errors = [({"eps": -1.0}, ValueError, "expected eps"), ({"beta": None}, TypeError, "expected beta")]


class TestDice(Segmentation):
    function = staticmethod(L.dice_loss)
    operators = ("overlap", "overlap_backward")
    compiler = "inductor"
    variants = [
        {"target": labels, "ignore_index": -1},
        {"target": labels, "ignore_index": -1, "average": "macro", "weight": lambda x: torch.linspace(0.5, 2, 4)},
    ]
    errors = [({"average": "all"}, ValueError, "average must be"), ({"eps": -1.0}, ValueError, "expected eps")]


class TestLovasz(Segmentation):
    function = staticmethod(L.lovasz_softmax_loss)
    operators = ("lovasz", "lovasz_backward")
    mixed = ("pred", "grad")
    variants = [
        {"target": lambda x: labels(x).clamp_min(0)},
        {"target": lambda x: labels(x).clamp_min(0), "weight": lambda x: torch.linspace(0.5, 2, 4)},
    ]
    errors = [({"target": None}, TypeError, "expected target")]

    test_gradient_at_ties_and_bounds = None  # the order of errors that differ by rounding

    def input(self, shape, dtype, device):  # no two errors are equal but for how they were rounded
        return (6 * torch.rand(shape, dtype=torch.float64) - 3).to(dtype).to(device)


class TestLovaszHinge(Segmentation):
    function = staticmethod(L.lovasz_hinge_loss)
    operators = ("lovasz", "lovasz_backward")
    mixed = ("pred", "grad")
    channels = 1
    shape = (2, 1, 13, 18)
    small = (1, 1, 3, 4)
    variants = [{"target": lambda x: torch.arange(x[:, 0].numel()).reshape(x[:, 0].shape) % 3 % 2}]
    errors = [({"target": None}, TypeError, "expected target")]

    test_nan_stays_in_its_window = None  # of two channels
    test_compile = test_export = None  # as of the operator's other loss


def hausdorff(x, target, **options):
    return L.HausdorffERLoss(**options)(x, target)


hausdorff.__name__ = "HausdorffERLoss"


class TestHausdorff(Segmentation):
    function = staticmethod(hausdorff)
    operators = ("hausdorff", "hausdorff_backward")
    mixed = ("pred",)
    channels = 2
    shape = (2, 2, 13, 18)
    small = (1, 2, 3, 4)
    # Each erosion divides by the largest value that survived the one before.
    tolerances = {torch.float32: (1e-4, 1e-5)}
    variants = [
        {"target": lambda x: labels(x).clamp_min(0)[:, None], "k": 3, "reduction": "none"},
        {"target": lambda x: labels(x).clamp_min(0)[:, None], "k": 4, "alpha": 0.5},
    ]
    errors = [({"k": 0}, ValueError, "expected k"), ({"alpha": "a"}, TypeError, "expected alpha")]

    def input(self, shape, dtype, device):  # probabilities that are often wrong: much survives
        return (1.6 * torch.rand(shape, dtype=torch.float64) - 0.3).to(dtype).to(device)


@pytest.mark.parametrize("axes", [2, 3])
@pytest.mark.parametrize("reduction", ["none", "sum"])
def test_hausdorff_of_many_pixels(axes, reduction, device):
    """What one block does not hold, images and volumes, and planes that are flat or have nothing left."""
    size = (70, 131) if axes == 2 else (9, 33, 37)
    x = torch.rand(3, 2, *size, dtype=torch.float64, device=device)
    target = torch.randint(0, 2, (3, 1, *size), device=device)
    x[1], target[1] = 0.25, 0
    loss = (L.HausdorffERLoss if axes == 2 else L.HausdorffERLoss3D)(k=5, reduction=reduction)
    results = []
    for name in ("auto", "reference"):
        with K.backend(name):
            leaf = x.clone().requires_grad_()
            y = loss(leaf, target)
            weights = torch.linspace(0, 1, y.numel(), dtype=torch.float64, device=device).view(y.shape)
            results.append((y.detach(), torch.autograd.grad((y * (1 + weights)).sum(), leaf)[0]))
    for actual, expected in zip(*results):
        assert_close(actual, expected, 1e-8, 1e-8 * float(expected.abs().max()))
    target[0, 0, ..., 3] = 2
    assert loss(x, target).isnan().any()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
@pytest.mark.parametrize("labels", [torch.int64, torch.bool, torch.float32], ids=str)
def test_lovasz_of_many_pixels(dtype, labels, device):
    """What one block does not sort, with errors that are exact and often equal."""
    x = (torch.randint(-999, 999, (3, 1, 70, 131)) / 256).to(device, dtype)
    target = torch.randint(0, 2, (3, 70, 131), device=device)
    target[1] = 0
    results = []
    for name, mask in (("auto", target.to(labels)), ("reference", target)):
        with K.backend(name):
            leaf = x.clone().requires_grad_()
            y = L.lovasz_hinge_loss(leaf, mask)
            results.append((y.detach(), torch.autograd.grad(y, leaf)[0]))
    assert_close(*results, 1e-5, 1e-7)


@pytest.mark.parametrize("classes", [1, 2, 21, 100, 1500])
@pytest.mark.parametrize("size", [(1, 1), (3, 5), (70, 131)], ids=str)
def test_classes_and_chunks(classes, size, device):
    """Any number of classes, and images that one piece does not hold."""
    if classes * size[0] * size[1] > 1e6:
        pytest.skip("large")
    x = 20 * torch.rand(2, classes, *size, device=device) - 10
    target = torch.randint(0, classes, (2, *size), device=device)
    for loss in (L.dice_loss, lambda x, t: L.focal_loss(x, t, reduction="mean")):
        results = []
        for name, value in (("auto", x), ("reference", x.double())):
            with K.backend(name):
                leaf = value.clone().requires_grad_()
                y = loss(leaf, target)
                results.append((y.detach(), torch.autograd.grad(y, leaf)[0]))
        for actual, expected in zip(*results):
            assert_close(actual, expected.float(), 2e-5, 1e-6 * float(expected.abs().max()) + 1e-8)


@pytest.mark.native
@pytest.mark.parametrize("dtype", [torch.float32, torch.float16, torch.bfloat16], ids=str)
@pytest.mark.parametrize("size", [(67, 299), (64, 126), (33, 257)], ids=str)
def test_planes_that_begin_anywhere(size, dtype, device):
    """Focal losses of pixels have the same bits at any address; losses that are sums agree with the reference."""
    storage = (8 * torch.rand(2 * 5 * size[0] * size[1] + 1, dtype=torch.float64) - 4).to(device=device, dtype=dtype)
    x = storage[1:].view(2, 5, *size)
    target = torch.randint(-1, 5, (2, *size), device=device)
    weight = torch.linspace(0.5, 2, 5, device=device)
    calls = {
        "dice": lambda x: L.dice_loss(x, target, ignore_index=-1),
        "tversky": lambda x: L.tversky_loss(x, target, 0.3, 0.6, ignore_index=-1),
        "focal": lambda x: L.focal_loss(x, target, 0.5, reduction="mean", ignore_index=-1, weight=weight),
        "focal of pixels": lambda x: L.focal_loss(x, target, 0.5, ignore_index=-1, weight=weight),
    }
    for name, call in calls.items():
        results = []
        for backend, value in (("auto", x), ("reference", x.double())):
            leaf = value.detach().requires_grad_()
            with K.backend(backend):
                y = call(leaf)
                # The gradients of means are too small for float16.
                results.append((y.detach(), torch.autograd.grad(1000 * y.sum(), leaf)[0]))
        (y, gradient), (expected, expected_gradient) = results
        rtol = {torch.float32: 2e-5, torch.float16: 2e-3, torch.bfloat16: 1e-2}[dtype]
        torch.testing.assert_close(y.double(), expected, rtol=rtol, atol=1e-6, msg=name)
        scale = float(expected_gradient.abs().max())
        torch.testing.assert_close(gradient.double() / scale, expected_gradient / scale, rtol=rtol, atol=1e-4, msg=name)
    if device.type == "cuda" and size[0] * size[1] % 4 == 0:
        leaf, aligned = x.detach().requires_grad_(), x.detach().clone().requires_grad_()
        y, of_aligned = calls["focal of pixels"](leaf), calls["focal of pixels"](aligned)
        assert torch.equal(y, of_aligned)
        assert torch.equal(torch.autograd.grad(y.sum(), leaf)[0], torch.autograd.grad(of_aligned.sum(), aligned)[0])
