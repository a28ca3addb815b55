"""Maxima of a response on images of several sizes."""

from __future__ import annotations

import pytest
import torch
from torch import nn

import kvision as K
from feature_images import blobs, photo
from op_tests import assert_close, does_not_wait
from point_op_tests import Call, PointOpTests, near

F = K.feature
TOP = torch.tensor([0.2, 0.7, 0.1, 0.5, 1.6, 0.6, 0.1, 0.5, 0.2], dtype=torch.float64)
SLOPE = torch.arange(9, dtype=torch.float64)


class TestPeakOperators(PointOpTests):
    calls = {"quadratic_peak2d": [Call((near(TOP),)), Call((near(SLOPE),))]}


class Magnitude(nn.Module):
    """The size of the difference of two Gaussians, of either library."""

    def __init__(self, module: nn.Module) -> None:
        super().__init__()
        self.module = module

    def forward(self, x):
        return self.module(x).abs()


@pytest.mark.parametrize("masked", [False, True])
def test_features_are_those_of_kornia_to_a_pixel(masked, device):
    """Responses are equal; frames are refined, and pixels of a level have the image's edges, not its first center."""
    theirs = pytest.importorskip("kornia").feature
    image, mask = photo(), None
    if masked:
        mask = torch.ones(1, 1, 120, 150)
        mask[..., 50:80] = 0
        mask[..., 80:] = 0.5
    ours = F.MultiResolutionDetector(Magnitude(F.BlobDoGSingle()), 60)
    lafs, responses = ours(image.to(device), None if mask is None else mask.to(device))
    expected = theirs.MultiResolutionDetector(Magnitude(theirs.BlobDoGSingle()), 60)(image, mask)
    assert (responses > 0).sum() > 20
    assert_close(responses.cpu(), expected[1], 1e-6, 1e-9)
    assert_close(lafs.cpu()[..., :2], expected[0][..., :2], 1e-6, 1e-6)
    assert (lafs.cpu() - expected[0]).abs().max() < 8


def test_levels_do_not_shift_positions(device):
    """Blobs are found where they are on larger, equal and smaller images."""
    # No center is halfway between two pixels of a level: neither would be larger than the other.
    centers = torch.tensor([[40.25, 70.75], [100.4, 60.2]], dtype=torch.float64)
    image = blobs(centers, 3.0, 160).to(device)
    for levels in ({"up_levels": 1}, {"up_levels": 0}, {"up_levels": 0, "pyramid_levels": 2}):
        config = {**F.get_default_detector_config(), "pyramid_levels": 0, **levels}
        detector = F.MultiResolutionDetector(Magnitude(F.BlobDoGSingle(1.6, 2.6)), 12, config)
        lafs, responses = detector(image)
        result = F.get_laf_center(lafs)[0][responses[0] > 0.3 * responses[0, 0]].cpu()
        assert len(result) >= 2
        assert torch.cdist(result, centers).amin(1).max() < 0.1


def test_samples_do_not_depend_on_each_other(device):
    image = torch.cat([photo(96, 100), photo(96, 100).flip(-1), torch.zeros(1, 1, 96, 100)]).float().to(device)
    detector = F.MultiResolutionDetector(F.BlobHessian(), 30)
    lafs, responses = detector(image)
    for i in range(3):
        one = detector(image[i : i + 1])
        assert_close(lafs[i : i + 1], one[0], 1e-5, 1e-3)
        assert_close(responses[i : i + 1], one[1], 1e-5, 1e-6)
    assert (lafs[2] == 0).all() and (responses[2] == 0).all()


def test_samples_of_a_network_are_the_same_within_rounding(device):
    """torch's convolutions may add up in another order: responses within 1e-3, positions within .01 pixels.

    cuDNN's TF32, torch's default, keeps 10 bits of the mantissa; what it gives depends on the batch by far more.
    """
    torch.manual_seed(1)
    detector = F.KeyNetDetector(False, 30).eval().to(device)
    torch.nn.init.ones_(detector.model.last_conv[0].bias)
    image = torch.cat([photo(96, 100), photo(96, 100).flip(-1)]).float().to(device)
    with torch.no_grad(), torch.backends.cudnn.flags(allow_tf32=False):
        lafs, responses = detector(image)
        for i in range(2):
            one = detector(image[i : i + 1])
            assert_close(responses[i : i + 1], one[1], 0.0, 1e-3 * float(responses.max()))
            assert_close(F.get_laf_center(lafs[i : i + 1]), F.get_laf_center(one[0]), 0.0, 1e-2)


@pytest.mark.parametrize("shape", [(1, 1, 1, 1), (2, 1, 5, 40), (1, 1, 16, 16), (0, 1, 40, 40)], ids=str)
def test_small_images_give_empty_slots_and_zero_gradients(shape, device):
    image = torch.rand(shape, device=device, requires_grad=True)
    lafs, responses = F.MultiResolutionDetector(F.BlobHessian(), 7)(image)
    assert lafs.shape == (shape[0], 7, 2, 3) and responses.shape == (shape[0], 7)
    (grad,) = torch.autograd.grad(lafs.sum() + responses.sum(), image)
    assert (lafs == 0).all() and (responses == 0).all() and (grad == 0).all()


def test_threshold_and_borders(device):
    image = photo().to(device)
    every = F.MultiResolutionDetector(F.BlobHessian(), 40)
    _, responses = every(image)
    threshold = responses[0, 5].item()
    _, few = F.MultiResolutionDetector(F.BlobHessian(), 40, score_threshold=threshold)(image)
    assert (few > 0).sum() == 5
    inner = every.remove_borders(torch.ones(1, 1, 40, 50), 15)
    assert inner.sum() == 10 * 20 and inner[0, 0, 15, 15] == 1


def test_positions_have_a_gradient(device):
    image = photo(48, 52).to(device).requires_grad_()
    detector = F.MultiResolutionDetector(F.BlobHessian(), 1)
    (grad,) = torch.autograd.grad(F.get_laf_center(detector(image)[0]).sum(), image)
    step = 1e-6 * torch.rand_like(image)
    with torch.no_grad():
        change = F.get_laf_center(detector(image + step)[0]) - F.get_laf_center(detector(image - step)[0])
    assert_close(change.sum() / 2, (grad * step).sum(), 1e-3, 1e-10)


def test_does_not_synchronize_with_the_gpu(device):
    image, mask = photo(64, 70).float().to(device), torch.ones(1, 1, 64, 70, device=device)
    detector = F.MultiResolutionDetector(F.BlobHessian(), 10)
    does_not_wait(device, [lambda: detector(image), lambda: detector(image), lambda: detector(image, mask)])


BAD = [
    (lambda: F.MultiResolutionDetector(F.BlobHessian(), 0), ValueError, "num_features"),
    (lambda: F.MultiResolutionDetector(F.BlobHessian(), score_threshold=-1.0), ValueError, "score_threshold"),
    (lambda: F.MultiResolutionDetector(F.BlobHessian(), config={"nms_size": 5}), ValueError, "expected config with"),
    (lambda: F.MultiResolutionDetector(F.BlobHessian())([1]), TypeError, "expected img to be a Tensor, got list"),
    (lambda: F.MultiResolutionDetector(None), TypeError, "MultiResolutionDetector: expected model to be .*, got None"),
    (lambda: F.MultiResolutionDetector(F.BlobHessian(), config=3), TypeError, "expected config to be a dict, got 3"),
    (
        lambda: F.MultiResolutionDetector(F.BlobHessian(), ori_module=3),
        TypeError,
        "expected ori_module to be .*, got 3",
    ),
    (
        lambda: F.MultiResolutionDetector(F.BlobHessian(), aff_module=3),
        TypeError,
        "expected aff_module to be .*, got 3",
    ),
    (lambda: F.MultiResolutionDetector(F.BlobHessian())(torch.rand(1, 3, 40, 40)), ValueError, "one response"),
]


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()
