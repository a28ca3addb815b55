"""SIFTFeature(opencv=True) against cv2.SIFT on photographs."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
import torch

import kvision as K
from feature_images import photo
from kvision.feature.opencv_sift import opencv_key_points

SEQUENCES = ("bikes", "boat", "graf", "leuven", "ubc", "wall")


def picture(name: str, request: pytest.FixtureRequest) -> np.ndarray:
    if name in SEQUENCES:
        path = request.getfixturevalue("data") / "homography" / name / "img1.png"
        return cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    data = pytest.importorskip("skimage.data")
    image = getattr(data, name)()
    return image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)


@pytest.mark.native  # the reference takes a minute for an image
@pytest.mark.parametrize("name", ["astronaut", "coffee", "camera", *SEQUENCES])
def test_key_points_and_descriptors_are_those_of_opencv(name, request, device):
    image, count = picture(name, request), 2000
    result, theirs = cv2.SIFT_create(count).detectAndCompute(image, None)
    theirs = torch.from_numpy(theirs)
    feature = K.feature.SIFTFeature(count, rootsift=False, device=device, descriptor_layout="opencv", opencv=True)
    with torch.no_grad():
        lafs, responses, ours = (x.cpu() for x in feature(torch.from_numpy(image)[None, None].to(device)))
    filled = responses[0] > 0
    xy, size, angle = (x[0, filled] for x in opencv_key_points(lafs))
    ours = ours[0, filled]
    assert abs(len(xy) - len(result)) <= 2  # OpenCV keeps all key points of the response of the last one
    close = torch.cdist(torch.tensor([k.pt for k in result]), xy) < 0.5
    close &= (size / torch.tensor([k.size for k in result])[:, None] - 1).abs() < 0.05
    assert close.any(1).float().mean() >= 0.99
    turn = (angle - torch.tensor([k.angle for k in result])[:, None] + 180) % 360 - 180
    same = close & (turn.abs() < 1)
    # Both round directions to bins, OpenCV after an approximation of the arc tangent.
    assert same.any(1).sum() >= 0.985 * close.any(1).sum()
    cosine = torch.nn.functional.normalize(theirs) @ torch.nn.functional.normalize(ours).T
    best = torch.where(same, cosine, -1).amax(1)[same.any(1)]
    assert best.min() > 0.99 and best.mean() > 0.999
    # Most values are OpenCV's integers.
    assert (ours == ours.round()).all() and ours.max() <= 255
    nearest = torch.where(same, cosine, -1).argmax(1)
    difference = (ours[nearest] - theirs)[same.any(1)].abs()
    assert (difference <= 1).float().mean() > 0.98


def test_layouts_and_roots(device):
    image = photo(96, 120).float().to(device)
    options = {"device": device, "opencv": True}
    plain = K.feature.SIFTFeature(500, rootsift=False, descriptor_layout="opencv", **options)(image)
    kornia = K.feature.SIFTFeature(500, rootsift=False, **options)(image)
    root = K.feature.SIFTFeature(500, descriptor_layout="opencv", **options)(image)
    assert torch.equal(plain[0], kornia[0]) and torch.equal(plain[1], root[1])
    assert torch.equal(K.feature.convert_sift_descriptor_layout(kornia[2], "kornia", "opencv"), plain[2])
    filled = plain[1][0] > 0
    assert 3 < filled.sum() < 500 and (plain[0][0, ~filled] == 0).all() and (root[2][0, ~filled] == 0).all()
    expected = torch.nn.functional.normalize(plain[2], p=1, dim=2).sqrt()[0, filled]
    assert (root[2][0, filled] - expected).abs().max() < 1e-4


def test_samples_do_not_depend_on_each_other_and_masks_hold(device):
    image = torch.cat([photo(96, 120), photo(96, 120).flip(-1), torch.zeros(1, 1, 96, 120)]).float().to(device)
    feature = K.feature.SIFTFeature(30, device=device, opencv=True)
    lafs, responses, descriptors = feature(image)
    for i in range(3):
        one = feature(image[i : i + 1])
        for actual, expected in zip((lafs, responses, descriptors), one):
            # A descriptor's integer may be rounded the other way: convolutions of a batch add up in another order.
            apart = (actual[i : i + 1] - expected).abs()
            assert apart.max() < 1e-2 and (apart > 1e-3).double().mean() < 1e-3
    assert (responses[2] == 0).all() and (lafs[2] == 0).all() and (descriptors[2] == 0).all()
    mask = torch.ones(1, 1, 96, 120, device=device)
    mask[..., :60] = 0
    masked = feature(image[:1], mask)
    x = masked[0][0, masked[1][0] > 0, 0, 2]
    assert len(x) > 2 and (x > 58).all()


@pytest.mark.parametrize("shape", [(1, 1, 3, 4), (2, 1, 5, 30), (0, 1, 40, 40)], ids=str)
def test_small_images_give_empty_slots(shape, device):
    lafs, responses, descriptors = K.feature.SIFTFeature(7, device=device, opencv=True)(
        torch.rand(shape, device=device)
    )
    assert lafs.shape == (shape[0], 7, 2, 3) and responses.shape == (shape[0], 7)
    assert descriptors.shape == (shape[0], 7, 128)
    assert (lafs == 0).all() and (responses == 0).all() and (descriptors == 0).all()


def test_gradients_reach_the_image(device):
    image = photo(64, 72).to(device).requires_grad_()
    lafs, responses, descriptors = K.feature.SIFTFeature(10, device=device, opencv=True)(image)
    for result in (lafs, responses, descriptors):
        (grad,) = torch.autograd.grad(result.sum(), image, retain_graph=True)
        assert grad.isfinite().all() and (grad != 0).any()


def test_images_that_are_not_finite_have_gradients_of_zero(device):
    image = torch.full((1, 1, 48, 48), math.nan, device=device, requires_grad=True)
    results = K.feature.SIFTFeature(5, device=device, opencv=True)(image)
    (grad,) = torch.autograd.grad(sum(x.sum() for x in results), image)
    assert all((x == 0).all() for x in (*results, grad))


def test_chunks_of_windows_do_not_matter(device, monkeypatch):
    from kvision.feature import opencv_sift

    feature, image = K.feature.SIFTFeature(60, rootsift=False, device=device, opencv=True), photo(96, 120).to(device)
    expected = feature(image)
    for samples in (1, 2**24):
        monkeypatch.setattr(opencv_sift, "_SAMPLES_IN_CACHE", samples)
        monkeypatch.setattr(opencv_sift, "_SAMPLES", samples)
        for actual, same in zip(feature(image), expected):
            assert (actual - same).abs().max() <= 1  # an integer that is rounded the other way


def test_frames_have_the_described_size(device):
    """A frame covers half of the side of the 4 x 4 cells, each 3 times the blur: a key point's size is twice the blur."""
    lafs, responses, _ = K.feature.SIFTFeature(20, device=device, opencv=True)(photo(96, 120).to(device))
    _, size, angle = opencv_key_points(lafs)
    filled = responses > 0
    scale = K.feature.get_laf_scale(lafs)[..., 0, 0]
    assert ((scale - 3 * size).abs() < 1e-3)[filled].all()
    turned = torch.deg2rad(-angle[filled])
    assert ((lafs[..., 0, 1] / scale)[filled] - turned.sin()).abs().max() < 1e-4
    assert math.isclose(float(K.feature.get_laf_center(lafs)[filled][0, 0]), float(lafs[filled][0, 0, 2]))


@pytest.mark.parametrize(
    "options, error, message",
    [
        ({"opencv": 1}, TypeError, "expected opencv"),
        ({"opencv": True, "descriptor_backend": "pyramid"}, ValueError, "opencv takes no config"),
        ({"opencv": True, "config": K.feature.get_default_detector_config()}, ValueError, "opencv takes no config"),
        ({"opencv": True, "num_features": 0}, ValueError, "num_features"),
    ],
)
def test_errors(options, error, message):
    with pytest.raises(error, match=message):
        K.feature.SIFTFeature(**options)
