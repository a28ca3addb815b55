"""Tests of every loss, and known values."""

from __future__ import annotations

import math

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

import kvision as K
from composition_tests import Case, CompositionTests, on
from op_tests import OpTests, assert_close, does_not_wait

L = K.losses
IMAGE, LOGITS = (2, 3, 9, 8), (2, 3, 6, 5)
LABELS = torch.randint(0, 3, (2, 6, 5), generator=torch.Generator().manual_seed(0))


def with_labels(loss, *args, **kwargs):
    """A loss of logits alone: its labels are those of one sample, whatever the batch."""

    def call(pred):
        labels = on(pred.device, LABELS)[:1].expand(pred.shape[0], -1, -1)
        return loss(pred, labels, *args, **kwargs)

    return call


def fixed_noise(x, axes=4):
    """In [0, 1), in the shape of the last axes of x, the same for all of that shape."""
    return torch.rand(x.shape[-axes:], dtype=torch.float64, generator=torch.Generator().manual_seed(7)).to(x.device)


class TestMaps(CompositionTests):
    """Losses without reduction."""

    cases = {
        "binary_focal": Case(lambda x, t: L.binary_focal_loss_with_logits(x, t), (LOGITS, LOGITS)),
        "cauchy": Case(L.cauchy_loss, (IMAGE, IMAGE)),
        "charbonnier": Case(L.charbonnier_loss, (IMAGE, IMAGE)),
        "focal": Case(with_labels(L.focal_loss), (LOGITS,)),
        "geman_mcclure": Case(L.geman_mcclure_loss, (IMAGE, IMAGE)),
        "js_div": Case(lambda p, q: L.js_div_loss_2d(p, q, "none"), (IMAGE, IMAGE)),
        "kl_div": Case(lambda p, q: L.kl_div_loss_2d(p, q, "none"), (IMAGE, IMAGE)),
        "mutual_information": Case(lambda x, y: L.mutual_information_loss_2d(x, y, num_bins=5), (IMAGE, IMAGE)),
        "ssim": Case(lambda x, y: L.ssim_loss(x, y, 5, reduction="none"), (IMAGE, IMAGE)),
        "ssim3d": Case(lambda x, y: L.ssim3d_loss(x, y, 3, reduction="none", padding="valid"), ((2, 1, 4, 5, 6),) * 2),
        "total_variation": Case(L.total_variation, (IMAGE,)),
        "welsch": Case(L.welsch_loss, (IMAGE, IMAGE)),
    }
    compiled = ("focal", "ssim", "total_variation")


NUMBERS = {
    "dice": with_labels(L.dice_loss),
    "dice macro": with_labels(L.dice_loss, "macro"),
    "focal": with_labels(L.focal_loss, reduction="mean"),
    "hausdorff": lambda pred: L.HausdorffERLoss(k=2)(pred, LABELS[:, None].to(pred.device)),
    "lovasz": with_labels(L.lovasz_softmax_loss),
    "lovasz hinge": lambda pred: L.lovasz_hinge_loss(pred[:, :1], LABELS.to(pred.device) > 0),
    "psnr": lambda x: L.psnr_loss(x, torch.full_like(x, 0.5)),
    "smoothness": lambda x: L.inverse_depth_smoothness_loss(x[:, :1], x),
    "tversky": with_labels(L.tversky_loss),
}


@pytest.mark.parametrize("name", NUMBERS)
def test_numbers(name, device):
    """Derivatives, transforms, half types and autocast of the losses that are one number."""
    loss = NUMBERS[name]
    x = (3 * torch.rand(LOGITS, dtype=torch.float64, device=device)).requires_grad_()
    assert torch.autograd.gradcheck(loss, x, check_forward_ad=True, fast_mode=True)
    assert torch.autograd.gradgradcheck(loss, x, fast_mode=True)
    assert_close(torch.func.vmap(loss)(torch.stack([x, x]))[1], loss(x))
    half = x.detach().half()
    assert_close(loss(half), loss(half.float()).half())
    single = x.detach().float()
    with torch.autocast(device.type, dtype=torch.bfloat16):
        assert_close(loss(single), loss(single.double()).float())
    compiled = torch.compile(loss, fullgraph=True, backend="aot_eager")
    assert_close(compiled(single), loss(single))


def test_focal_without_focus_is_cross_entropy(device):
    pred = 10 * torch.randn(2, 5, 4, 4, device=device)
    target = torch.randint(0, 5, (2, 4, 4), device=device)
    target[0, 0] = -100
    assert_close(L.focal_loss(pred, target, None, 0.0, "sum"), F.cross_entropy(pred, target, reduction="sum"))
    expected = F.binary_cross_entropy_with_logits(pred, pred.sigmoid().round())
    assert_close(L.binary_focal_loss_with_logits(pred, pred.sigmoid().round(), None, 0.0, "mean"), expected)


@pytest.mark.parametrize("name", ["dice", "dice macro", "focal", "lovasz", "lovasz hinge", "tversky"])
def test_extreme_logits(name, device):
    for scale in (100.0, 1e4):
        x = (scale * torch.randn(LOGITS, device=device)).requires_grad_()
        loss = NUMBERS[name](x)
        loss.backward()
        assert loss.isfinite() and x.grad.isfinite().all()


def test_gamma_between_0_and_1_has_finite_gradients():
    x = torch.tensor([[100.0, -100.0]], requires_grad=True)
    L.focal_loss(x, torch.tensor([0]), None, 0.5, "sum").backward()
    assert x.grad.isfinite().all()


@pytest.mark.parametrize("loss", [L.focal_loss, L.dice_loss, L.tversky_loss])
def test_labels(loss, device):
    """Ignored pixels do not change the loss, and a label that is no class makes it NaN."""
    pred, target = torch.rand(LOGITS, device=device), LABELS.to(device).clone()
    target[:, 0] = -100
    other = pred.clone()
    other[:, :, 0] = torch.nan
    other.requires_grad_()
    value = loss(other, target).sum()
    assert_close(value.detach(), loss(pred, target).sum())
    (gradient,) = torch.autograd.grad(value, other)
    assert gradient.isfinite().all() and (gradient[:, :, 0] == 0).all()
    target[1, 1, 1] = 3
    assert loss(pred, target).sum().isnan()


def test_perfect_and_absent_classes(device):
    target = torch.zeros(1, 4, 4, dtype=torch.int64, device=device)
    pred = torch.full((1, 3, 4, 4), -50.0, device=device)
    pred[:, 0] = 50
    for loss in (L.dice_loss, L.tversky_loss, L.lovasz_softmax_loss):
        assert_close(loss(pred, target), torch.zeros((), device=device))
    nothing = torch.full_like(target, -100)
    assert L.dice_loss(pred, nothing) == L.dice_loss(pred, nothing, "macro") == L.tversky_loss(pred, nothing) == 1


@pytest.mark.parametrize("padding", ["same", "valid"])
def test_ssim_is_at_most_one(padding, device):
    for low, high in ((0.0, 0.0), (0.6, 0.6), (0.6, 0.6 + 1e-7), (255.0, 255.0)):
        x, y = (torch.full((1, 1, 12, 12), v, device=device) for v in (low, high))
        similarity = K.metrics.ssim(x, y, 11, padding=padding)
        assert (similarity <= 1).all() and (similarity > 1 - 1e-6).all()
    x = torch.rand(1, 3, 16, 16, device=device)
    assert (K.metrics.ssim(x, x, 11) == 1).all() and L.ssim_loss(x, x, 11) == 0


def test_ssim_is_scikit_images(device):
    metrics = pytest.importorskip("skimage.metrics")
    x, y = torch.rand(2, 1, 1, 31, 29, dtype=torch.float64, device=device)
    options = {
        "gaussian_weights": True,
        "sigma": 1.5,
        "use_sample_covariance": False,
        "data_range": 1.0,
        "win_size": 11,
    }
    _, expected = metrics.structural_similarity(x[0, 0].cpu().numpy(), y[0, 0].cpu().numpy(), full=True, **options)
    actual = K.metrics.ssim(x, y, 11, padding="valid")[0, 0].cpu()
    assert_close(actual, torch.from_numpy(expected)[5:-5, 5:-5], 4e-7, 4e-7)


def test_ms_ssim_of_a_negative_is_finite(device):
    x = torch.rand(1, 3, 32, 32, device=device, requires_grad=True)
    loss = L.MS_SSIMLoss()(x, 1 - x)
    loss.backward()
    assert loss.isfinite() and x.grad.isfinite().all()


def test_psnr_of_equal_images():
    x = torch.rand(2, 3, requires_grad=True)
    loss = L.psnr_loss(x, x.detach())
    loss.backward()
    assert loss == -math.inf and (x.grad == 0).all() and K.metrics.psnr(x, x, 1.0) == math.inf


def test_small_and_large_differences():
    d = torch.tensor([1e-6, 1e10], dtype=torch.float64)
    zero = torch.zeros_like(d)
    assert_close(L.charbonnier_loss(d, zero), torch.tensor([5e-13, 1e10 - 1], dtype=torch.float64), 1e-12, 0)
    assert_close(L.geman_mcclure_loss(d.float() * 1e20, zero.float())[1], torch.tensor(2.0))


def test_total_variation(device):
    x = torch.rand(2, 3, 7, 8, device=device)
    expected = (x[..., 1:, :] - x[..., :-1, :]).abs().sum((2, 3)) + (x[..., 1:] - x[..., :-1]).abs().sum((2, 3))
    assert_close(L.total_variation(x), expected, 1e-5, 1e-5)
    assert_close(L.total_variation(torch.tensor([[255, 0]], dtype=torch.uint8)), torch.tensor(255.0))
    assert (L.total_variation(torch.ones(2, 1, 1), "mean") == 0).all()


class TestTotalVariation(OpTests):
    function = staticmethod(L.total_variation)
    module = L.TotalVariation
    operators = ("total_variation", "total_variation_backward")
    variants = [{}]
    errors = [({"reduction": "none"}, NotImplementedError, "reduction must be")]
    mixed = ("input", "grad")  # the sums of half types are float32

    def input(self, shape, dtype, device):
        return (
            (super().input(shape, dtype, device) * 8).round() / 8
            if dtype.is_floating_point
            else super().input(shape, dtype, device)
        )

    def test_wrong_kinds(self, variant, device):
        for wrong, error in ((None, TypeError), (torch.rand(3).to(device), ValueError)):
            with pytest.raises(error, match="^total_variation: "):
                self.call(wrong, {})

    @pytest.mark.derivatives
    def test_gradcheck(self, variant, device):
        x = torch.rand(self.small, dtype=torch.float64, device=device, requires_grad=True)  # no two neighbors are equal
        assert torch.autograd.gradcheck(L.total_variation, x) and torch.autograd.gradgradcheck(L.total_variation, x)


class TestSmoothness(OpTests):
    @staticmethod
    def function(depth, image):
        return L.inverse_depth_smoothness_loss(depth, image.to(depth.dtype))

    operators = ("smoothness", "smoothness_backward")
    variants = [{"image": lambda x: torch.rand(x.shape[0], 3, *x.shape[2:])}]
    channels = 1
    shape = (2, 1, 13, 18)
    small = (2, 1, 4, 5)
    mixed = ("grad",)  # the sums of half types are float32

    test_wrong_kinds = test_other_integers_become_float32 = test_value_of_bytes = None  # of floating-point depth only
    test_nan_stays_in_its_window = None  # a number has no window

    @pytest.mark.parametrize("dtype", [torch.float64, torch.float32, torch.float16, torch.bfloat16], ids=str)
    @pytest.mark.parametrize("width", [44, 45])
    @pytest.mark.parametrize("channels", [1, 3, 4])
    def test_rows_and_channels(self, channels, width, dtype, device):
        """On CUDA three channels have kernels of their own, which process aligned rows by vectors."""
        inputs = [torch.rand(2, c, 37, width, device=device).to(dtype) for c in (1, channels)]

        def loss_and_gradients(inputs):
            leaves = [x.detach().requires_grad_() for x in inputs]
            loss = L.inverse_depth_smoothness_loss(*leaves)
            return loss, *torch.autograd.grad(loss, leaves)

        with K.backend("reference"):
            expected = loss_and_gradients([x.double() for x in inputs])
        tolerance = 4 * torch.finfo(dtype).eps if dtype.itemsize == 2 else 1e-5
        for y, z in zip(loss_and_gradients(inputs), expected, strict=True):
            assert_close(y.double(), z, 0, tolerance * z.abs().max().item())


def test_divergence_of_empty_pixels():
    p = torch.tensor([[[[0.0, 1.0]]]], requires_grad=True)
    q = torch.tensor([[[[0.0, 1.0]]]], requires_grad=True)
    for loss in (L.kl_div_loss_2d, L.js_div_loss_2d):
        value = loss(p, q)
        assert value == 0 and all(g.isfinite().all() for g in torch.autograd.grad(value, (p, q)))


class TestMutualInformation(OpTests):
    function = staticmethod(L.mutual_information_loss_2d)
    operators = ("mutual_information", "mutual_information_backward")
    max_size = 9
    small = (1, 2, 4, 5)
    variants = [
        {"target": lambda x: fixed_noise(x), "num_bins": 7},
        {
            "target": lambda x: fixed_noise(x),
            "input_mask": lambda x: fixed_noise(x, 2) > 0.1,
            "target_mask": lambda x: fixed_noise(x, 2).flip(0) > 0.1,
            "kernel_function": L.MIKernel.truncated_gaussian,
            "num_bins": 5,
            "window_radius": 1.7,
        },
    ]
    errors = [({"num_bins": 1}, ValueError, "expected num_bins"), ({"target": None}, TypeError, "expected target")]

    def call(self, x, kwargs):
        integers = isinstance(x, Tensor) and x.dtype in (torch.uint8, torch.int32)  # which the loss refuses
        result = self.function(x.float() if integers else x, **kwargs)
        return result if integers else result.to(x.dtype)  # not the target's

    def expected(self, x, kwargs):
        """The least that a bin counts is that of the type that computes."""
        with K.backend("reference"):
            return self.call(x if x.dtype == torch.float64 else x.float(), kwargs).to(x.dtype)

    def check_gradients(self, x, kwargs, known=None):
        """In float32 they hang on how bins are rounded that have next to nothing, as those one radius away."""
        wide = {k: v.double() if isinstance(v, Tensor) and v.is_floating_point() else v for k, v in kwargs.items()}
        super().check_gradients(x.double(), wide)


# On CUDA in shared memory, and beyond it.
@pytest.mark.native
@pytest.mark.parametrize("kernel, bins", [*((kernel, 64) for kernel in L.MIKernel), (L.MIKernel.xu, 90)])
def test_mutual_information_of_many_bins(kernel, bins, device):
    """And of flat images, which have no gradient, and equal extrema, which share theirs."""
    x, y = torch.rand(2, 2, 2, 90, 100, dtype=torch.float64, device=device)
    y, x[0, 0, 0], x[1, 1] = y + x, x.amin(), 0.3
    for normalized in (False, True):
        loss = L.normalized_mutual_information_loss_2d if normalized else L.mutual_information_loss_2d
        results = []
        for backend in ("auto", "reference"):
            with K.backend(backend):
                leaves = [x.clone().requires_grad_(), y.clone().requires_grad_()]
                value = loss(*leaves, kernel_function=kernel, num_bins=bins)
                rectangular = kernel is L.MIKernel.rectangular  # whose loss has no gradient
                results.append([value] if rectangular else [value, *torch.autograd.grad(value.square().sum(), leaves)])
        assert_close(*results, 1e-8, 1e-10)


@pytest.mark.parametrize("spoil", [torch.nan, torch.inf, None])
def test_mutual_information_of_spoilt_signals(spoil, device):
    x, y = torch.rand(2, 2, 50, device=device)
    mask = None if spoil else torch.zeros(50, dtype=torch.bool, device=device)
    if spoil:
        x[0, 3] = spoil
    result = L.mutual_information_loss(x.requires_grad_(), y, mask)
    assert result.isnan().tolist() == [True, not spoil]
    result.sum().backward()
    assert spoil is None or x.grad[1].isfinite().all()


def test_mutual_information_of_masked_nan():
    x, y = torch.rand(2, 50)
    mask = torch.ones(50, dtype=torch.bool)
    mask[3] = False
    expected = L.mutual_information_loss(x[mask], y[mask])
    x[3] = torch.nan
    assert_close(L.mutual_information_loss(x, y, mask, mask), expected)


@pytest.mark.parametrize(
    "call, error, message",
    [
        (lambda: L.focal_loss([1.0], LABELS), TypeError, "focal_loss: expected pred to be a Tensor, got list"),
        (lambda: L.focal_loss(torch.rand(3), LABELS), ValueError, "focal_loss: expected pred of shape"),
        (
            lambda: L.focal_loss(torch.rand(LOGITS), LABELS.int()),
            TypeError,
            "focal_loss: expected target to hold int64",
        ),
        (lambda: L.focal_loss(torch.rand(LOGITS), LABELS[:1]), ValueError, "focal_loss: expected target of shape"),
        (
            lambda: L.focal_loss(torch.rand(LOGITS), LABELS, reduction="avg"),
            NotImplementedError,
            "focal_loss: reduction",
        ),
        (lambda: L.focal_loss(torch.rand(LOGITS), LABELS, gamma=-1.0), ValueError, "focal_loss: expected gamma"),
        (
            lambda: L.focal_loss(torch.rand(LOGITS), LABELS, weight=torch.ones(2)),
            ValueError,
            "focal_loss: expected weight",
        ),
        (lambda: L.dice_loss(torch.rand(LOGITS), LABELS, "all"), ValueError, "dice_loss: average"),
        (lambda: L.dice_loss(torch.rand(2, 3), LABELS), ValueError, "dice_loss: expected pred of shape"),
        (lambda: L.tversky_loss(torch.rand(LOGITS), LABELS, "a"), TypeError, "tversky_loss: expected alpha"),
        (lambda: L.lovasz_softmax_loss(torch.rand(2, 1, 6, 5), LABELS), ValueError, "at least 2 classes"),
        (
            lambda: L.ssim_loss(torch.rand(IMAGE), torch.rand(IMAGE), 4),
            ValueError,
            "ssim_loss: expected window_size to be odd",
        ),
        (lambda: L.ssim_loss(torch.rand(IMAGE), torch.rand(IMAGE), 21), ValueError, "ssim_loss: expected input larger"),
        (
            lambda: L.ssim_loss(torch.rand(IMAGE), torch.rand(2, 3, 9, 9), 3),
            ValueError,
            "ssim_loss: expected tensors of one",
        ),
        (lambda: L.ssim_loss(torch.rand(IMAGE), None, 3), TypeError, "ssim_loss: expected img2 to be a Tensor"),
        (lambda: L.psnr_loss(torch.rand(2), torch.rand(3)), TypeError, "psnr_loss: expected target of shape"),
        (lambda: L.psnr_loss(torch.rand(2), torch.rand(2), 0.0), ValueError, "psnr_loss: expected max_val above 0"),
        (lambda: L.welsch_loss(torch.rand(2), torch.rand(3)), ValueError, "welsch_loss: expected tensors of one shape"),
        (lambda: L.total_variation(torch.rand(3)), ValueError, "total_variation: expected img of shape"),
        (lambda: L.kl_div_loss_2d(torch.rand(3), torch.rand(3)), ValueError, "kl_div_loss_2d: expected pred of shape"),
        (
            lambda: L.HausdorffERLoss()(torch.rand(LOGITS), LABELS[:, None].int()),
            ValueError,
            "HausdorffERLoss: expected target",
        ),
        (lambda: L.HausdorffERLoss(k=0), ValueError, "HausdorffERLoss: expected k"),
        (lambda: L.MS_SSIMLoss(()), ValueError, "MS_SSIMLoss: expected sigmas"),
        (
            lambda: L.one_hot(LABELS.float(), 3, torch.device("cpu"), torch.float32),
            TypeError,
            "one_hot: expected labels of int64",
        ),
        (
            lambda: L.mutual_information_loss(torch.rand(9), torch.rand(8)),
            ValueError,
            "mutual_information_loss: expected tensors",
        ),
        (lambda: L.MILossFromRef(torch.rand(9), num_bins=1), ValueError, "MILossFromRef: expected num_bins"),
    ],
)
def test_errors(call, error, message):
    with pytest.raises(error, match=message) as caught:
        call()
    assert isinstance(caught.value, K.core.exceptions.BaseError)


@pytest.mark.parametrize(
    "module, function, inputs",
    [
        (L.FocalLoss(0.3, 1.0, "sum"), lambda x, t: L.focal_loss(x, t, 0.3, 1.0, "sum"), (LOGITS, LABELS)),
        (L.DiceLoss("macro"), lambda x, t: L.dice_loss(x, t, "macro"), (LOGITS, LABELS)),
        (L.TverskyLoss(0.3, 0.7), lambda x, t: L.tversky_loss(x, t, 0.3, 0.7), (LOGITS, LABELS)),
        (L.LovaszSoftmaxLoss(torch.ones(3)), L.lovasz_softmax_loss, (LOGITS, LABELS)),
        (L.SSIMLoss(5, padding="valid"), lambda x, y: L.ssim_loss(x, y, 5, padding="valid"), (IMAGE, IMAGE)),
        (L.PSNRLoss(2.0), lambda x, y: L.psnr_loss(x, y, 2.0), (IMAGE, IMAGE)),
    ],
    ids=lambda value: type(value).__name__,
)
def test_modules(module, function, inputs):
    x, y = (torch.rand(i) if isinstance(i, tuple) else i for i in inputs)
    assert_close(module(x, y), function(x, y))
    assert type(module).__name__ in repr(module) and not module.state_dict()


def test_does_not_synchronize_with_the_device(device):
    x, y = (torch.rand(2, 3, 18, 16, device=device) for _ in range(2))
    v, w = (torch.rand(1, 2, 9, 8, 8, device=device) for _ in range(2))
    labels, masks = (3 * y[:, 0]).long(), x[0, 0] > 0.2
    ms_ssim = L.MS_SSIMLoss().to(device)
    losses = (
        lambda x: L.binary_focal_loss_with_logits(x, y, reduction="mean"),
        lambda x: L.binary_focal_loss_with_logits(x, y, pos_weight=y[0, :, 0, 0], weight=y[1, :, 0, 0]),
        lambda x: L.cauchy_loss(x, y),
        lambda x: L.charbonnier_loss(x, y, "mean"),
        lambda x: L.dice_loss(x, labels, "macro", weight=y[0, :, 0, 0]),
        lambda x: L.focal_loss(x, labels, reduction="mean", ignore_index=2),
        lambda x: L.geman_mcclure_loss(x, y, "sum"),
        lambda x: L.HausdorffERLoss(k=3)(x, labels[:, None]),
        lambda x: L.HausdorffERLoss3D(k=3)(v * x.mean(), (2 * w[:, :1]).long()),
        lambda x: L.inverse_depth_smoothness_loss(x[:, :1], y),
        lambda x: L.js_div_loss_2d(x, y),
        lambda x: L.kl_div_loss_2d(x, y),
        lambda x: L.l1_ssim_loss(x, y),
        lambda x: L.lovasz_hinge_loss(x[:, :1], labels.clamp_max(1)),
        lambda x: L.lovasz_softmax_loss(x, labels, weight=y[0, :, 0, 0]),
        lambda x: ms_ssim(x, y),
        lambda x: L.mutual_information_loss_2d(x, y, input_mask=masks),
        lambda x: L.normalized_mutual_information_loss_2d(x, y),
        lambda x: L.psnr_loss(x, y),
        lambda x: L.ssim3d_loss(v * x.mean(), w, 5),
        lambda x: L.ssim_loss(x, y, 5),
        lambda x: L.ssim_loss(x, y, 13, padding="valid"),
        lambda x: L.total_variation(x),
        lambda x: L.tversky_loss(x, labels),
        lambda x: L.welsch_loss(x, y),
    )
    leaf = x.requires_grad_()
    does_not_wait(device, [lambda loss=loss: loss(leaf).sum().backward() for loss in losses])


ROBUST = ("charbonnier_loss", "welsch_loss", "cauchy_loss", "geman_mcclure_loss")


@pytest.mark.parametrize("name", ROBUST)
def test_no_reduction_by_none(name, device):
    x, y = torch.rand(2, 3, 4, device=device)
    loss = getattr(L, name)
    assert torch.equal(loss(x, y, None), loss(x, y, "none"))
    module = getattr(L, "".join(part.capitalize() for part in name.split("_")))
    assert torch.equal(module(None)(x, y), loss(x, y))


@pytest.mark.parametrize("reduction", ["none", "mean", "sum"])
@pytest.mark.parametrize(
    "shape", [(3,), (3, 1, 1), (1, 3, 1, 1), (2, 3, 1, 1), (1, 1, 1, 1), (), (1,), (9, 10), (3, 9, 10), (2, 1, 9, 10)]
)
def test_pos_weights_that_broadcast(shape, reduction, device):
    """Also of the size of a pixel or an image; a vector of C has one for each class, as in Kornia."""
    pred, target = torch.randn(2, 3, 9, 10, device=device), torch.rand(2, 3, 9, 10, device=device).round()
    weight = torch.rand(shape, device=device) + 0.5
    classes = torch.tensor([0.5, 1.0, 2.0], device=device)
    aligned = weight.reshape(3, 1, 1) if shape == (3,) else weight
    p = pred.sigmoid()
    yes = -0.25 * aligned * (1 - p) ** 2 * target * F.logsigmoid(pred)
    no = -0.75 * p**2 * (1 - target) * F.logsigmoid(-pred)
    expected = classes.reshape(3, 1, 1) * (yes + no)
    expected = expected if reduction == "none" else getattr(expected, reduction)()
    result = L.binary_focal_loss_with_logits(pred, target, 0.25, 2.0, reduction, weight, classes)
    assert_close(result, expected, 1e-5, 1e-5)


def test_pos_weights_that_do_not_broadcast():
    pred = torch.zeros(2, 3, 4, 5)
    with pytest.raises(
        ValueError, match=r"expected pos_weight of shape \(3,\), or one that broadcasts to .*got \(2,\)"
    ):
        L.binary_focal_loss_with_logits(pred, pred, pos_weight=torch.ones(2))
