"""Maxima over position and scale."""

from __future__ import annotations

import pytest
import torch

import kvision as K
from feature_images import blobs, photo
from op_tests import assert_close, does_not_wait

F = K.feature


@pytest.mark.parametrize("both_signs", [False, True])
@pytest.mark.parametrize("response", ["BlobHessian", "BlobDoG", "CornerGFTT"])
def test_features_are_those_of_kornia(response, both_signs, device):
    theirs = pytest.importorskip("kornia").feature
    options = {"minima_are_also_good": both_signs, "scale_space_response": response == "BlobDoG"}
    image = photo()
    lafs, responses = F.ScaleSpaceDetector(60, resp_module=getattr(F, response)(), **options)(image.to(device))
    # Kornia leaves slots empty where a strong candidate is too near to the border, unless there are slots for all.
    more = theirs.ScaleSpaceDetector(2000, resp_module=getattr(theirs, response)(), **options)(image)
    assert (more[1] != 0).sum() > 20
    assert_close(responses.cpu(), more[1][:, :60], 1e-4, 1e-7)
    assert_close(lafs.cpu(), more[0][:, :60], 0, 2e-2)


@pytest.mark.parametrize("binary", [False, True])
def test_masks_are_those_of_kornia(binary, device):
    theirs = pytest.importorskip("kornia").feature
    image, mask = photo(), torch.ones(1, 1, 120, 150)
    mask[..., 40:60, :] = 0
    if not binary:
        mask[..., 70:] *= 0.3
    mask = mask.bool() if binary else mask
    lafs, responses = F.ScaleSpaceDetector(50)(image.to(device), mask.to(device))
    more = theirs.ScaleSpaceDetector(2000)(image, mask)
    assert_close(responses.cpu(), more[1][:, :50], 1e-4, 1e-7)
    assert_close(lafs.cpu(), more[0][:, :50], 0, 2e-2)
    y = lafs[0, F.laf_is_filled(lafs)[0], 1, 2]
    assert ((y < 40) | (y > 59)).all()


def test_blobs_are_detected_at_their_centers(device):
    """A blob of sigma s has its Hessian's maximum at scale s; the detector also sees the assumed blur of the image."""
    centers = torch.tensor([[30.25, 40.75], [90.5, 60.0]], dtype=torch.float64)
    detector = F.ScaleSpaceDetector(2, mr_size=1.0, scale_pyr_module=K.ScalePyramid(3, 1.6, 16, double_image=True))
    lafs, _ = detector(blobs(centers, 4.0, 128).to(device))
    result = F.get_laf_center(lafs)[0].cpu()
    result = result[result[:, 0].argsort()]
    assert (result - centers).abs().max() < 0.06  # a pixel of the octave has a width of 2
    assert (F.get_laf_scale(lafs) - 4).abs().max() < 0.4


@pytest.mark.native  # torch's convolutions round by the size of the batch
def test_samples_do_not_depend_on_each_other(device):
    image = torch.cat([photo(96, 100), photo(96, 100).flip(-1), torch.zeros(1, 1, 96, 100)]).float().to(device)
    detector = F.ScaleSpaceDetector(40, resp_module=F.BlobDoG(), scale_space_response=True, minima_are_also_good=True)
    lafs, responses = detector(image)
    for i in range(3):
        one = detector(image[i : i + 1])
        assert_close(lafs[i : i + 1], one[0], 1e-5, 1e-4)
        assert_close(responses[i : i + 1], one[1], 1e-5, 1e-6)
    assert (lafs[2] == 0).all() and (responses[2] == 0).all()


@pytest.mark.parametrize("shape", [(1, 1, 1, 1), (2, 1, 5, 40), (1, 1, 16, 16), (0, 1, 40, 40)], ids=str)
def test_small_images_give_empty_slots_and_zero_gradients(shape, device):
    image = torch.rand(shape, device=device, requires_grad=True)
    lafs, responses = F.ScaleSpaceDetector(7)(image)
    assert lafs.shape == (shape[0], 7, 2, 3) and responses.shape == (shape[0], 7)
    (grad,) = torch.autograd.grad(lafs.sum() + responses.sum(), image)
    assert (lafs == 0).all() and (responses == 0).all() and (grad == 0).all()


@pytest.mark.native  # the gradient of the reference divides 0 by 0
@pytest.mark.parametrize("response", ["BlobHessian", "CornerGFTT", "CornerHarris"])
def test_constant_images_give_empty_slots_and_zero_gradients(response, device):
    image = torch.full((1, 1, 64, 64), 0.5, device=device, requires_grad=True)
    module = F.CornerHarris(0.04) if response == "CornerHarris" else getattr(F, response)()
    lafs, responses = F.ScaleSpaceDetector(7, resp_module=module.to(device))(image)
    (grad,) = torch.autograd.grad(lafs.sum() + responses.sum(), image)
    assert (lafs == 0).all() and (responses == 0).all() and (grad == 0).all()


def test_not_a_number_is_no_feature(device):
    image = photo(96, 100).float().to(device).clone()
    image[..., :50] = torch.nan
    lafs, responses = F.ScaleSpaceDetector(20)(image)
    assert lafs.isfinite().all() and responses.isfinite().all() and (responses > 0).any()


def test_one_feature_and_its_gradient(device):
    image = photo(48, 52).to(device).requires_grad_()
    detector = F.ScaleSpaceDetector(1)
    lafs, responses = detector(image)
    assert lafs.shape == (1, 1, 2, 3) and responses.item() > 0
    (grad,) = torch.autograd.grad(F.get_laf_center(lafs).sum(), image)
    step = 1e-5 * torch.rand_like(image)
    with torch.no_grad():
        change = F.get_laf_center(detector(image + step)[0]) - F.get_laf_center(detector(image - step)[0])
    assert_close(change.sum() / 2, (grad * step).sum(), 1e-3, 1e-9)


def test_refinement_by_soft_argmax(device):
    subpix = K.geometry.ConvSoftArgmax3d(
        (3, 3, 3), (1, 1, 1), (1, 1, 1), normalized_coordinates=False, output_value=True
    )
    for name in ("subpix_module", "nms_module"):
        lafs, responses = F.ScaleSpaceDetector(20, **{name: subpix})(photo(64, 70).to(device))
        assert (responses > 0).sum() > 5 and lafs.isfinite().all()


def test_thresholds(device):
    """A blob is round; a bar, which has one at its end, bends along one direction only."""
    grid = torch.arange(80, dtype=torch.float64, device=device)
    bar = torch.exp(-((grid - 40.3) ** 2) / 18) * (0.8 + 0.05 * torch.sin(grid[:, None] / 6))
    image = bar[None, None] + blobs(torch.tensor([[14.3, 40.2]], dtype=torch.float64), 3.0, 80).to(device)
    options = {"resp_module": F.BlobDoG(), "scale_space_response": True, "minima_are_also_good": True}
    both, blob = (F.ScaleSpaceDetector(20, edge_threshold=ratio, **options)(image) for ratio in (None, 10.0))
    at_blob, on_bar = ((both[0][0, :, 0, 2] - x).abs() < 6 for x in (14.3, 40.3))
    assert at_blob.any() and on_bar.any()
    strong = blob[1][0] > 0.3 * blob[1][0, 0]
    assert ((blob[0][0, :, 0, 2] - 14.3).abs() < 6)[strong].all()
    threshold = both[1][0, 2].item()
    few = F.ScaleSpaceDetector(20, score_threshold=threshold, **options)(image)[1]
    assert (few > 0).sum() == 2 and torch.equal(few[:, :2], both[1][:, :2])


def test_does_not_synchronize_with_the_gpu(device):
    image, mask = photo(64, 70).float().to(device), torch.ones(1, 1, 64, 70, device=device)
    detector = F.ScaleSpaceDetector(10, minima_are_also_good=True)
    does_not_wait(device, [lambda: detector(image), lambda: detector(image), lambda: detector(image, mask)])


def test_half_images_have_frames_of_float32(device):
    lafs, responses = F.ScaleSpaceDetector(10)(photo(64, 70).to(device, torch.bfloat16))
    assert lafs.dtype == torch.float32 and responses.dtype == torch.bfloat16


BAD = [
    (lambda: F.ScaleSpaceDetector(0), ValueError, "num_features"),
    (lambda: F.ScaleSpaceDetector(edge_threshold=0.5), ValueError, "edge_threshold"),
    (lambda: F.ScaleSpaceDetector(score_threshold="low"), TypeError, "score_threshold"),
    (lambda: F.ScaleSpaceDetector(compile_modules=["x"]), ValueError, "compile_modules must be of scale_pyr"),
    (lambda: F.ScaleSpaceDetector(resp_module=3), TypeError, "ScaleSpaceDetector: expected resp_module to be .*, got 3"),
    (lambda: F.ScaleSpaceDetector(ori_module="x"), TypeError, "expected ori_module to be a module or function, got 'x'"),
    (lambda: F.ScaleSpaceDetector()([1]), TypeError, "expected img to be a Tensor, got list"),
    (lambda: F.ScaleSpaceDetector()(torch.rand(40, 40)), ValueError, r"expected img of shape \(B, C, H, W\)"),
    (lambda: F.ScaleSpaceDetector()(torch.rand(1, 3, 40, 40)), ValueError, "one response for each image"),
    (lambda: F.ScaleSpaceDetector()(torch.rand(1, 1, 40, 40), torch.ones(1, 1, 40, 41)), ValueError, "expected mask"),
    (lambda: F.ScaleSpaceDetector()(torch.rand(1, 1, 40, 40), torch.ones(2, 1, 40, 40)), ValueError, "a batch of 1 or 1"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()
