"""The same values and gradients as Kornia 0.9; docs/differences.md lists where not."""

from __future__ import annotations

import pytest
import torch

import kvision as K
from op_tests import assert_close

kornia = pytest.importorskip("kornia.losses")
L = K.losses


def rand(*shape: int) -> torch.Tensor:
    return torch.rand(shape, dtype=torch.float64)


LABELS = torch.randint(0, 4, (2, 6, 7), generator=torch.Generator().manual_seed(3))
SOME_IGNORED = LABELS.where(LABELS.roll(1, 1) != 2, -100)
WEIGHT = torch.tensor([0.2, 1.0, 3.0, 0.7], dtype=torch.float64)
LOGITS = 4 * rand(2, 4, 6, 7) - 2
MASK = torch.arange(40) % 7 < 5


def compare(name: str, *args, **kwargs):
    """Values, and gradients to all floating-point tensors."""
    results = []
    for module in (L, kornia):
        leaves = [a.clone().requires_grad_() if torch.is_tensor(a) and a.is_floating_point() else a for a in args]
        mapped = {k: getattr(module.MIKernel, v.name) if isinstance(v, L.MIKernel) else v for k, v in kwargs.items()}
        y = getattr(module, name)(*leaves, **mapped)
        weights = torch.linspace(0.5, 1.5, y.numel(), dtype=torch.float64).view(y.shape)
        gradients = torch.autograd.grad(
            (y * weights).sum(), [a for a in leaves if torch.is_tensor(a) and a.requires_grad]
        )
        results.append((y.detach(), *gradients))
    for ours, theirs in zip(*results):
        assert_close(ours, theirs, 1e-7, 1e-9)


@pytest.mark.parametrize("reduction", ["none", "mean", "sum"])
@pytest.mark.parametrize("options", [{}, {"gamma": 0.5}, {"weight": WEIGHT}, {"ignore_index": None}], ids=str)
@pytest.mark.parametrize("alpha", [None, 0.3])
def test_focal(alpha, options, reduction):
    target = LABELS if "ignore_index" in options else SOME_IGNORED
    compare("focal_loss", LOGITS, target, alpha, reduction=reduction, **options)
    compare("focal_loss", LOGITS[..., 0, 0], target[..., 0, 0], alpha, reduction=reduction, **options)


@pytest.mark.parametrize("reduction", ["none", "mean", "sum"])
@pytest.mark.parametrize("options", [{}, {"gamma": 0.5}, {"weight": WEIGHT, "pos_weight": WEIGHT.flip(0)}], ids=str)
def test_binary_focal(options, reduction):
    target = (rand(2, 4, 6, 7) > 0.5).double()
    target[0, 0] = -100
    compare("binary_focal_loss_with_logits", LOGITS, target.long(), reduction=reduction, **options)


@pytest.mark.parametrize("average", ["micro", "macro"])
@pytest.mark.parametrize("weight", [None, WEIGHT])
def test_dice(average, weight):
    compare("dice_loss", LOGITS, SOME_IGNORED, average, weight=weight)
    compare("dice_loss", LOGITS, LABELS.clamp(max=1), average, weight=weight)  # classes that no pixel has


def test_overlap():
    compare("tversky_loss", LOGITS, SOME_IGNORED, 0.3, 0.7)
    compare("tversky_loss", LOGITS, LABELS.clamp(max=1), 0.3, 0.7)
    compare("lovasz_softmax_loss", LOGITS, LABELS)
    compare("lovasz_softmax_loss", LOGITS, LABELS, WEIGHT)
    compare("lovasz_hinge_loss", LOGITS[:, :1], LABELS.clamp(max=1))


@pytest.mark.parametrize("reduction", ["none", "mean", "sum"])
@pytest.mark.parametrize("name", ["charbonnier_loss", "welsch_loss", "cauchy_loss", "geman_mcclure_loss"])
def test_robust(name, reduction):
    compare(name, 5 * rand(2, 3, 4), 5 * rand(2, 3, 4), reduction)


@pytest.mark.parametrize("name", ["charbonnier_loss", "welsch_loss", "cauchy_loss", "geman_mcclure_loss"])
def test_robust_without_a_reduction(name):
    """None is 'none', as Kornia has it for some of them."""
    a, b = 5 * rand(2, 3, 4), 5 * rand(2, 3, 4)
    loss = getattr(L, name)
    assert torch.equal(loss(a, b, None), loss(a, b, "none"))


@pytest.mark.parametrize("reduction", ["none", "mean", "sum"])
@pytest.mark.parametrize("name", ["kl_div_loss_2d", "js_div_loss_2d"])
def test_divergences(name, reduction):
    p, q = (rand(2, 3, 4, 5).flatten(2).softmax(2).view(2, 3, 4, 5) for _ in range(2))
    q[0, 0, 0, 0] = 0
    compare(name, p, q, reduction)


def test_smoothness():
    compare("total_variation", rand(2, 3, 5, 6))
    compare("total_variation", rand(5, 6), "mean")
    compare("total_variation", rand(2, 1, 6), "mean")
    compare("inverse_depth_smoothness_loss", rand(2, 1, 5, 6), rand(2, 3, 5, 6))


@pytest.mark.parametrize("options", [{}, {"padding": "valid"}, {"reduction": "none"}, {"max_val": 3.0}], ids=str)
def test_ssim(options):
    compare("ssim_loss", rand(2, 3, 13, 14), rand(2, 3, 13, 14), 7, **options)
    compare("ssim3d_loss", rand(1, 2, 6, 7, 8), rand(1, 2, 6, 7, 8), 5, **options)


def test_psnr():
    compare("psnr_loss", rand(2, 3), rand(2, 3), 2.0)


@pytest.mark.parametrize(
    "options", [{}, {"reduction": "none"}, {"sigmas": (0.7, 1.3), "data_range": 2.0, "alpha": 0.4}], ids=str
)
def test_ms_ssim(options):
    x, y = rand(2, 3, 20, 17), rand(2, 3, 20, 17)
    theirs = kornia.MS_SSIMLoss(**options).double()
    assert_close(L.MS_SSIMLoss(**options)(x, y), theirs(x, y), 1e-5, 1e-6)  # their windows are rounded to float32
    assert_close(L.MS_SSIMLoss()(x, y[:1]), L.MS_SSIMLoss()(x, y[:1].expand(2, -1, -1, -1)))


@pytest.mark.parametrize("reduction", ["none", "mean", "sum"])
def test_hausdorff(reduction):
    pred = rand(2, 4, 6, 7)
    for options in ({}, {"k": 3, "alpha": 1.0}):
        expected = kornia.HausdorffERLoss(**options, reduction=reduction)(pred, LABELS[:, None])
        assert_close(L.HausdorffERLoss(**options, reduction=reduction)(pred, LABELS[:, None]), expected, 1e-6, 1e-6)
    volume, labels = rand(2, 3, 4, 5, 6), torch.randint(0, 3, (2, 1, 4, 5, 6))
    expected = kornia.HausdorffERLoss3D(k=2, reduction=reduction)(volume, labels)
    assert_close(L.HausdorffERLoss3D(k=2, reduction=reduction)(volume, labels), expected, 1e-6, 1e-6)


@pytest.mark.parametrize("prefix", ["", "normalized_"])
@pytest.mark.parametrize("kernel", ["xu", "truncated_gaussian"])
def test_mutual_information(prefix, kernel):
    options = {"kernel_function": getattr(L.MIKernel, kernel), "num_bins": 9, "window_radius": 1.4}
    compare(f"{prefix}mutual_information_loss", rand(2, 40), rand(2, 40), **options)
    masks = {"input_mask": MASK, "target_mask": MASK.flip(0)}
    compare(f"{prefix}mutual_information_loss", rand(2, 40), rand(2, 40), **masks, **options)
    compare(f"{prefix}mutual_information_loss_2d", rand(3, 5, 8), rand(3, 5, 8), input_mask=MASK.view(5, 8), **options)
    compare(f"{prefix}mutual_information_loss_3d", rand(2, 4, 5), rand(2, 4, 5), **options)


def test_mutual_information_with_a_reference():
    x, y = rand(2, 5, 8), rand(2, 5, 8)
    for name in ("MILossFromRef2D", "NMILossFromRef2D"):
        expected = getattr(kornia, name)(x, MASK.view(5, 8))(y)
        assert_close(getattr(L, name)(x, MASK.view(5, 8))(y), expected, 1e-9, 1e-9)


def test_one_hot():
    for eps in (0.0, 0.1):
        arguments = (LABELS, 5, torch.device("cpu"), torch.float64, eps)
        assert_close(L.one_hot(*arguments), kornia.one_hot(*arguments))
