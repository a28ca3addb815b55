"""Detectors with descriptors, and matches of their features."""

from __future__ import annotations

import pytest
import torch
from torch import nn

import fresh
import kvision as K
from feature_images import photo
from op_tests import assert_close

F = K.feature
LAFS = torch.tensor([[[[12.0, 0, 50], [0, 12, 60]], [[3, 8, 70], [-8, 3, 40]], [[0, 0, 0], [0, 0, 0]]]])


@pytest.fixture
def without_weights(monkeypatch: pytest.MonkeyPatch) -> None:
    """Networks keep their random weights, whatever `pretrained` says."""
    for module in ("affnet", "hardnet", "keynet", "orinet"):
        monkeypatch.setattr(f"kvision.feature.{module}.load_weights", lambda *args: None)


def test_descriptors_are_those_of_patches(device):
    image, sift = photo().to(device), F.SIFTDescriptor(32)
    lafs = LAFS.to(device, torch.float64)
    descriptors = F.get_laf_descriptors(image, lafs, sift)
    patches = F.extract_patches_from_pyramid(image, lafs, 32)
    assert_close(descriptors[:, :2], sift(patches[0])[None, :2])
    assert (descriptors[:, 2] == 0).all()
    color = image.expand(1, 3, -1, -1)
    assert_close(F.LAFDescriptor(sift)(color, lafs), descriptors, 1e-6, 1e-6)


@pytest.mark.parametrize("shape", [(1, 0), (0, 3)], ids=str)
def test_no_frames_give_no_descriptors(shape, device):
    image = torch.rand(shape[0], 1, 40, 40, device=device, requires_grad=True)
    descriptors = F.LAFDescriptor(F.SIFTDescriptor(32))(image, torch.zeros(*shape, 2, 3, device=device))
    assert descriptors.shape == (*shape, 128)
    (grad,) = torch.autograd.grad(descriptors.sum(), image)
    assert (grad == 0).all()


def test_descriptors_run_in_evaluation_mode():
    network = nn.Sequential(nn.Flatten(), nn.Dropout(0.5), nn.Linear(64, 4)).train()
    image = torch.rand(1, 1, 128, 128)
    first, second = (F.get_laf_descriptors(image, LAFS, network, 8) for _ in range(2))
    assert torch.equal(first, second) and network.training and network[1].training
    assert F.get_laf_descriptors(image.double(), LAFS, network, 8).dtype == torch.float64


@pytest.mark.programs
@pytest.mark.parametrize("backend", ["patch", "pyramid"])
@pytest.mark.parametrize("name", ["SIFTFeature", "SIFTFeatureScaleSpace"])
def test_sift_features(name, backend, device):
    """An image and its half turn have the same features, turned; samples do not depend on each other."""
    image = photo(112, 120).float().to(device)
    feature = getattr(F, name)(40, device=device, descriptor_backend=backend)
    lafs, responses, descriptors = feature(torch.cat([image, image.flip(2, 3)]))
    assert lafs.shape == (2, 40, 2, 3) and descriptors.shape == (2, 40, 128)
    one = feature(image)
    assert_close(lafs[:1], one[0], 1e-4, 1e-2)
    assert_close(responses[:1], one[1], 1e-4, 1e-5)
    _, index = F.match_smnn(descriptors[0], descriptors[1], 0.9)
    assert len(index) >= 20
    a, b = (F.get_laf_center(lafs[i : i + 1])[0, index[:, i]] for i in range(2))
    error = (a + b - torch.tensor([119.0, 111.0], device=device)).norm(dim=1)
    assert (error < 1).float().mean() > 0.8
    layout = getattr(F, name)(40, device=device, descriptor_backend=backend, descriptor_layout="opencv")(image)[2]
    assert_close(layout, F.convert_sift_descriptor_layout(one[2], "kornia", "opencv"), 1e-4, 1e-4)
    assert_close(feature(image.expand(1, 3, -1, -1))[1], one[1], 1e-4, 1e-5)


@pytest.mark.native
@pytest.mark.parametrize("backend", ["patch", "pyramid"])
@pytest.mark.parametrize("size", [(77, 101), (96, 128)], ids=str)
def test_samples_are_the_same_bits_alone_and_in_a_batch(size, backend, device):
    """Neither how many samples there are nor how many threads has an effect."""
    if device.type != "cpu":
        pytest.skip("torch's matrix products on CUDA depend on the size of the batch")
    whole = photo(160, 160).float()
    h, w = size
    images = torch.cat([whole[..., y : y + h, x : x + w] for y, x in ((0, 0), (60, 30), (23, 11))])
    feature = F.SIFTFeature(20, descriptor_backend=backend)
    batch, threads = feature(images), torch.get_num_threads()
    for i in range(3):
        torch.set_num_threads(1 + i)
        try:
            alone = feature(images[i : i + 1])
        finally:
            torch.set_num_threads(threads)
        assert all(torch.equal(a[0], b[i]) for a, b in zip(alone, batch))


DETECTORS = {
    "Hessian with shapes": lambda: F.ScaleSpaceDetector(
        20, ori_module=F.LAFOrienter(19), aff_module=F.LAFAffineShapeEstimator(19)
    ),
    "soft maxima": lambda: F.ScaleSpaceDetector(
        20, subpix_module=K.geometry.ConvSoftArgmax3d((3, 3, 3), (1, 1, 1), (1, 1, 1), normalized_coordinates=False)
    ),
    "Harris": lambda: F.ScaleSpaceDetector(20, resp_module=F.CornerHarris(0.04)),
    "copies": lambda: F.MultiResolutionDetector(F.CornerGFTT(), 20),
    "SIFTFeature": lambda: F.SIFTFeature(20),
    "SIFTFeature of copies": lambda: F.SIFTFeature(20, config=F.get_default_detector_config()),
    "SIFTFeature from a pyramid": lambda: F.SIFTFeature(20, descriptor_backend="pyramid"),
    "SIFTFeatureScaleSpace": lambda: F.SIFTFeatureScaleSpace(20),
}


@pytest.mark.parametrize("backend", ["auto", pytest.param("reference", marks=pytest.mark.slow)])
@pytest.mark.parametrize("detector", DETECTORS)
def test_results_and_gradients_are_finite_whatever_the_image_is(detector, backend, device):
    """A NaN pixel leaves features and gradients where it is not read; where all are NaN or equal there are none."""
    photograph = photo(80, 90).float().to(device)
    step = torch.zeros_like(photograph)
    step[..., 45:] = 1
    module = DETECTORS[detector]().to(device)
    for value in (torch.nan, torch.inf):
        for bad in (photograph.clone(), torch.full_like(photograph, value), step):
            if bad is not step:
                bad[0, 0, 40, 41] = value
            image = bad.requires_grad_()
            with K.backend(backend):
                results = module(image)
                (grad,) = torch.autograd.grad(sum(x.sum() for x in results), image)
            assert all(x.isfinite().all() for x in results) and grad.isfinite().all()
            assert [x.shape[:2] for x in results] == len(results) * [(1, 20)]
    with K.backend(backend):
        image = torch.full_like(photograph, 0.5, requires_grad=True)
        results = module(image)
        (grad,) = torch.autograd.grad(sum(x.sum() for x in results), image)
    assert all((x == 0).all() for x in results) and (grad == 0).all()


@pytest.mark.parametrize("detector", [*DETECTORS, "SIFTFeature as OpenCV's"])
def test_runs_give_the_same_bits(detector, device):
    module = DETECTORS.get(detector, lambda: F.SIFTFeature(20, opencv=True))().to(device)
    image = photo(80, 90).float().to(device)
    image = torch.cat([image, image.flip(-1)])
    with torch.no_grad():
        first, second = module(image), module(image)
    assert all(torch.equal(x, y) for x, y in zip(first, second))


@pytest.mark.parametrize("detector", ["Hessian with shapes", "SIFTFeature"])
def test_nan_pixel_keeps_the_other_gradients(detector, device):
    image = photo(120, 150).float().to(device)
    image[0, 0, 3, 3] = torch.nan
    image.requires_grad_()
    lafs, responses, *_ = DETECTORS[detector]().to(device)(image)
    (grad,) = torch.autograd.grad(responses.sum() + F.get_laf_center(lafs).sum(), image)
    assert (responses > 0).sum() == 20 and grad.abs().amax() > 0


def test_functions_of_detectors_transform(device):
    detector = F.ScaleSpaceDetector(5)
    image = photo(48, 52).to(device)

    def strength(x):
        return detector(x)[1].sum()

    leaf = image.clone().requires_grad_()
    (expected,) = torch.autograd.grad(strength(leaf), leaf)
    assert_close(torch.func.grad(strength)(image), expected)


def test_sift_features_have_up_to_two_orientations(device):
    """Both of a position have its response and size, and stand one after the other; upright features have none."""
    image = photo().float().to(device)
    lafs, responses, _ = F.SIFTFeature(200, device=device)(image)
    centers, filled = F.get_laf_center(lafs)[0], F.laf_is_filled(lafs)[0]
    twice = (centers[1:] == centers[:-1]).all(1) & filled[1:]
    assert 3 < twice.sum() < 0.4 * filled.sum()
    assert not (twice[1:] & twice[:-1]).any()
    assert (responses[0, 1:] == responses[0, :-1])[twice].all()
    scale, turn = F.get_laf_scale(lafs).flatten(), F.get_laf_orientation(lafs).flatten().diff().abs()
    assert_close(scale[1:][twice], scale[:-1][twice], 1e-4, 1e-4)
    assert (turn[twice] > 10).all()
    upright = F.SIFTFeature(200, upright=True, device=device)(image)[0]
    assert (F.get_laf_orientation(upright) == 0).all()


@pytest.mark.programs
def test_sift_features_match_as_well_as_those_of_opencv(device):
    """A turned and smaller photograph: as many right matches, of which as many are right, of as many features."""
    cv2 = pytest.importorskip("cv2")
    image = photo(250, 300).float().to(device)
    center, angle = torch.tensor([[150.0, 125]], device=device), torch.tensor([25.0], device=device)
    matrix = K.geometry.get_rotation_matrix2d(center, angle, torch.full((1, 2), 0.8, device=device))
    turned = K.geometry.warp_affine(image, matrix, (250, 300), padding_mode="reflection")
    feature, sift = F.SIFTFeature(300, device=device), cv2.SIFT_create(300)
    ours, theirs = [], []
    for x in (image, turned):
        lafs, _, descriptors = feature(x)
        filled = F.laf_is_filled(lafs)[0]
        ours.append((F.get_laf_center(lafs)[0][filled], descriptors[0][filled]))
        points, descriptors = sift.detectAndCompute((255 * x[0, 0]).round().byte().cpu().numpy(), None)
        theirs.append((torch.tensor([p.pt for p in points], device=device), torch.tensor(descriptors, device=device)))
    right, accuracy = [], []
    for (p, a), (q, b) in (ours, theirs):
        _, index = F.match_smnn(a, b, 0.9)
        moved = p[index[:, 0]] @ matrix[0, :, :2].T + matrix[0, :, 2]
        is_right = (moved - q[index[:, 1]]).norm(dim=1) < 3
        right.append(int(is_right.sum()))
        accuracy.append(float(is_right.float().mean()))
    assert right[0] >= right[1] > 30 and accuracy[0] >= accuracy[1] - 0.01


@pytest.mark.programs
@pytest.mark.parametrize("config", [None, F.get_default_detector_config()], ids=["scale space", "copies"])
def test_score_thresholds_of_sift_features(config, device):
    image = photo().float().to(device)
    responses = F.SIFTFeature(60, upright=True, config=config, device=device)(image)[1]
    feature = F.SIFTFeature(60, upright=True, config=config, score_threshold=responses[0, 9].item(), device=device)
    assert (feature(image)[1] > 0).sum() == 9


@pytest.mark.parametrize("name", ["SIFTFeature", "SIFTFeatureScaleSpace"])
def test_small_and_constant_images_give_empty_slots(name, device):
    feature = getattr(F, name)(5, device=device)
    for image in (torch.rand(1, 1, 9, 12, device=device), torch.full((1, 1, 70, 70), 0.5, device=device)):
        image.requires_grad_()
        results = feature(image)
        (grad,) = torch.autograd.grad(sum(x.sum() for x in results), image)
        assert all((x == 0).all() for x in results) and (grad == 0).all()


@pytest.mark.parametrize(
    "name",
    ["GFTTAffNetHardNet", "HesAffNetHardNet", "DoGHardNet", "DoGAffNetHardNet", "KeyNetHardNet", "KeyNetAffNetHardNet"],
)
@pytest.mark.programs
@pytest.mark.parametrize("upright", [False, True])
def test_combinations_of_networks(name, upright, without_weights, device):
    torch.manual_seed(0)
    feature = getattr(F, name)(12, upright, device)
    assert not feature.training
    image = photo(96, 100).float().to(device)
    lafs, responses, descriptors = feature(torch.cat([image, image.flip(-1)]))
    assert lafs.shape == (2, 12, 2, 3) and responses.shape == (2, 12) and descriptors.shape == (2, 12, 128)
    assert lafs.isfinite().all() and descriptors.isfinite().all()
    lengths = descriptors.norm(dim=-1)
    assert_close(lengths, F.laf_is_filled(lafs).to(lengths.dtype), 1e-4, 1e-4)


def test_gradients_from_end_to_end(device):
    # Nowhere flat, and small frames, which do not reach out of the image: the angle of a gradient of 0 has no derivative.
    noise = torch.rand(1, 1, 80, 84, dtype=torch.float64, generator=torch.Generator().manual_seed(1)).to(device)
    image = K.filters.gaussian_blur2d(noise, (9, 9), (2.0, 2.0)).requires_grad_()
    feature = F.LocalFeature(
        F.ScaleSpaceDetector(2, mr_size=1.0), F.LAFDescriptor(F.SIFTDescriptor(32, rootsift=False)), 2.0
    )
    weights = torch.linspace(-1, 1, 256, dtype=torch.float64, device=device).view(1, 2, 128)

    def total(x):
        lafs, responses, descriptors = feature(x)
        return lafs[..., 2].sum() + responses.sum() + (descriptors * weights).sum()

    (grad,) = torch.autograd.grad(total(image), image)
    step = 1e-6 * torch.rand_like(image)
    with torch.no_grad():
        change = (total(image + step) - total(image - step)) / 2
    assert_close(change, (grad * step).sum(), 2e-2, 1e-9)


@pytest.mark.programs
def test_matches_of_pairs(device):
    image = photo(112, 120).float().to(device)
    pair = {"image0": torch.cat([image, image, 0 * image]), "image1": torch.cat([image, image.flip(2, 3), image])}
    feature = F.SIFTFeature(30, device=device)
    for matcher in (F.DescriptorMatcher("smnn", 0.9), F.GeometryAwareDescriptorMatcher("fginn", {"mutual": True})):
        matches = F.LocalFeatureMatcher(feature, matcher)(pair)
        batch = matches["batch_indexes"]
        count = len(batch)
        assert set(batch.tolist()) == {0, 1}
        assert matches["lafs0"].shape == matches["lafs1"].shape == (1, count, 2, 3)
        assert matches["confidence"].shape == (count,)
        same = matches["keypoints0"] - matches["keypoints1"]
        assert (same[batch == 0].abs().amax(1) < 1e-3).float().mean() > 0.9
    none = F.LocalFeatureMatcher(feature, F.DescriptorMatcher())({"image0": 0 * image, "image1": image})
    assert none["keypoints0"].shape == (0, 2) and none["lafs1"].shape == (1, 0, 2, 3)


def test_the_example_of_the_paper(device):
    """Detection, description and matching as printed, with random weights. The order of results is Kornia's."""
    img0 = photo(112, 120).float().to(device)
    img1 = img0.flip(2, 3)
    detector = K.ScaleSpaceDetector(
        100,
        resp_module=K.BlobHessian(),
        nms_module=K.ConvQuadInterp3d(10),
        scale_pyr_module=K.ScalePyramid(3, 1.6, 32, double_image=True),
        ori_module=K.LAFOrienter(19),
        aff_module=K.LAFAffineShapeEstimator(19),
        mr_size=6.0,
    ).to(device)
    torch.manual_seed(0)
    descriptor = K.HardNet(pretrained=False).to(device).eval()
    points, descriptors = [], []
    for image in (img0, img1):
        lafs, _ = detector(image)
        patches = K.extract_patches_from_pyramid(image, lafs, 32)
        B, N, CH, H, W = patches.size()
        descriptors.append(descriptor(patches.view(B * N, CH, H, W)).view(B, N, -1)[0])
        points.append(lafs[..., 2])
    scores, tentatives = K.match_smnn(*descriptors, 0.95)
    assert len(tentatives) > 15
    results = [x[:, tentatives[:, i]] for i, x in enumerate(points)]
    homography = K.find_homography_dlt_iterated(*results, 1 - scores.view(1, -1), 3.0)
    assert homography.shape == (1, 3, 3) and homography.isfinite().all()


def test_a_function_describes_patches(device):
    image, lafs = torch.rand(1, 1, 40, 40, device=device), LAFS.to(device)
    descriptors = F.LAFDescriptor(lambda patches: patches.flatten(1), 8)(image, lafs)
    assert torch.equal(descriptors, F.get_laf_descriptors(image, lafs, nn.Flatten(), 8))
    assert descriptors.shape == (*lafs.shape[:2], 64)


MATCHER = F.LocalFeatureMatcher(F.SIFTFeature(5), F.DescriptorMatcher("mnn"))
BAD = [
    (lambda: F.LocalFeature(nn.Identity(), nn.Identity(), 0.0), ValueError, "scaling_coef above 0"),
    (lambda: F.SIFTFeature(10, descriptor_backend="fast"), ValueError, "descriptor_backend must be one of"),
    (lambda: F.SIFTFeatureScaleSpace(10, descriptor_layout="x"), ValueError, "descriptor_layout must be one of"),
    (lambda: F.get_laf_descriptors([1], LAFS, nn.Identity()), TypeError, "expected img to be a Tensor"),
    (lambda: F.get_laf_descriptors(torch.rand(2, 1, 9, 9), LAFS, nn.Identity()), ValueError, "expected lafs of shape"),
    (lambda: F.SIFTFeature(10)([1]), TypeError, "SIFTFeature: expected img to be a Tensor"),
    (
        lambda: F.get_laf_descriptors(torch.rand(1, 1, 9, 9), LAFS, 3),
        TypeError,
        "get_laf_descriptors: expected patch_descriptor to be a module or function, got 3",
    ),
    (
        lambda: F.LAFDescriptor(3),
        TypeError,
        "LAFDescriptor: expected patch_descriptor_module to be a module or .*, got 3",
    ),
    (
        lambda: F.LAFDescriptor(nn.Identity(), -1),
        ValueError,
        "LAFDescriptor: expected patch_size .* at least 1, got -1",
    ),
    (lambda: F.LocalFeature(3, 4), TypeError, "LocalFeature: expected detector to be a module or function, got 3"),
    (lambda: F.LocalFeature(nn.Identity(), 4), TypeError, "LocalFeature: expected descriptor to be .*, got 4"),
    (lambda: F.SIFTFeature(-1), ValueError, "^SIFTFeature: expected num_features to be an int of at least 1, got -1"),
    (
        lambda: F.SIFTFeatureScaleSpace("a"),
        TypeError,
        "^SIFTFeatureScaleSpace: expected num_features to be an int, got",
    ),
    (
        lambda: F.LocalFeatureMatcher({}, nn.Identity()),
        TypeError,
        "LocalFeatureMatcher: expected local_feature to be a m",
    ),
    (lambda: F.LocalFeatureMatcher(nn.Identity(), None), TypeError, "expected matcher to be a module or .*, got None"),
    (lambda: MATCHER(3), TypeError, "LocalFeatureMatcher: expected data to be a dict, got int"),
    (lambda: MATCHER({}), ValueError, "expected data with image0, or lafs0 and descriptors0, got nothing"),
    (
        lambda: MATCHER({"image0": torch.rand(1, 1, 40, 40)}),
        ValueError,
        "LocalFeatureMatcher: expected data with image1, or lafs1 and descriptors1, got image0",
    ),
]


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()


PEAK = """
import resource, torch, kvision as K
sift, image = K.feature.SIFTFeature(500, opencv={opencv}), torch.rand(1, 1, 480, 640)
def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
with torch.no_grad():
    sift(image[..., :64, :64])
    before = peak()
    sift(image)
print((peak() - before) * 1024 / (4 * 6 * 960 * 1280 * 4 / 3))
"""


@pytest.mark.slow
@pytest.mark.native
@pytest.mark.parametrize("opencv", [False, True])
def test_memory_is_a_few_times_the_pyramid(opencv, device):
    """Octaves of six levels, of which the first has twice the size of the image."""
    pytest.importorskip("resource")
    if device.type != "cpu":
        pytest.skip("the peak is that of the process")
    result = fresh.run(PEAK.format(opencv=opencv))
    assert result.returncode == 0, result.stderr
    assert float(result.stdout) < 6
