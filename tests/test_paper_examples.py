"""The calls in Kornia's survey paper, for the modules that exist: flat names, positional arguments, OpenCV's arrays."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import skimage.data
import torch
from torch import Tensor, nn

import kvision as K
from op_tests import assert_close


@pytest.fixture
def array(tmp_path: Path) -> np.ndarray:
    """An image in the format of cv2.imread: uint8 (H, W, 3)."""
    path = str(tmp_path / "photo.png")
    cv2.imwrite(path, cv2.cvtColor(skimage.data.astronaut()[:120, :160], cv2.COLOR_RGB2BGR))
    return cv2.imread(path, cv2.IMREAD_COLOR)


@pytest.fixture
def image(array: np.ndarray, device: torch.device) -> Tensor:
    return K.image_to_tensor(array, keepdim=False).to(device).float() / 255.0


def test_array_to_tensor_and_back(array: np.ndarray) -> None:
    x = K.image_to_tensor(array, keepdim=False)
    assert x.shape == (1, 3, 120, 160) and x.dtype == torch.uint8
    assert np.array_equal(K.tensor_to_image(x), array)


def test_flat_names_and_modules(image: Tensor) -> None:
    blurred = K.gaussian_blur2d(image, (11, 11), (10.5, 10.5))
    edges = K.sobel(image)
    assert blurred.shape == edges.shape == image.shape
    assert blurred.std() < image.std()
    assert_close(K.filters.GaussianBlur2d((11, 11), (10.5, 10.5))(image), blurred)
    assert_close(K.filters.Sobel()(image), edges)


@pytest.mark.parametrize(
    "function, module, arguments",
    [
        ("box_blur", "BoxBlur", ((3, 3),)),
        ("median_blur", "MedianBlur", ((3, 3),)),
        ("gaussian_blur2d", "GaussianBlur2d", ((3, 3), (1.5, 1.5))),
        ("motion_blur", "MotionBlur", (5, 35.0, 0.5)),
        ("laplacian", "Laplacian", (5,)),
        ("sobel", "Sobel", ()),
        ("spatial_gradient", "SpatialGradient", ()),
        ("max_blur_pool2d", "MaxBlurPool2D", (3,)),
    ],
)
def test_batches(function: str, module: str, arguments: tuple, image: Tensor) -> None:
    """Function and module give the same results for a batch as for its images one by one."""
    batch = torch.cat([image, image.flip(-1), 1 - image])
    filtered = getattr(K.filters, function)(batch, *arguments)
    for x, y in zip(batch.split(1), filtered.split(1)):
        assert_close(getattr(K.filters, module)(*arguments)(x), y)


def test_any_kernel_and_volumes(image: Tensor, device: torch.device) -> None:
    identity = torch.zeros(1, 3, 3, device=device)
    identity[0, 1, 1] = 1
    assert_close(K.filters.filter2d(image, identity), image)
    assert K.filters.spatial_gradient3d(torch.rand(1, 2, 4, 5, 6, device=device)).shape == (1, 2, 3, 4, 5, 6)


def test_filters_are_layers(image: Tensor, device: torch.device) -> None:
    """Filters work between convolutions, and gradients flow through them."""
    layers = K.filters.GaussianBlur2d((5, 5), (1.0, 1.0)), nn.Conv2d(3, 2, 3), K.filters.Sobel()
    model = nn.Sequential(*layers).to(device)
    image.requires_grad_()
    model(image).mean().backward()
    assert image.grad.abs().sum() > 0 and all(p.grad is not None for p in model.parameters())


def test_features_are_matched(image: Tensor) -> None:
    """Example 3: detector, patches, HardNet with random weights, matches, and the homography of the two images."""
    detector = K.ScaleSpaceDetector(
        num_features=200,
        nms_module=K.ConvQuadInterp3d(10),
        scale_pyr_module=K.ScalePyramid(3, 1.6, 15),
        resp_module=K.BlobHessian(),
        ori_module=K.LAFOrienter(19),
        aff_module=K.LAFAffineShapeEstimator(19),
        mr_size=6.0,
    ).to(image.device)
    descriptor = K.HardNet(pretrained=False).to(image.device).eval()

    def describe(x: Tensor) -> tuple[Tensor, Tensor]:
        lafs, responses = detector(x)
        patches = K.extract_patches_from_pyramid(x, lafs, PS=32)
        b, n, c, h, w = patches.shape
        found = responses[0] > 0
        return lafs[:, found], descriptor(patches.view(b * n, c, h, w)).view(b, n, -1)[0, found]

    gray = K.rgb_to_grayscale(image)
    with torch.no_grad():
        (lafs0, d0), (lafs1, d1) = describe(gray), describe(0.5 * gray)
    ratios, tentatives = K.match_smnn(d0, d1, 0.95)  # the paper has them in the other order
    assert ratios.shape == (len(tentatives), 1) and len(tentatives) > 0.5 * len(d0)
    points = [K.feature.laf.get_laf_center(x)[:, tentatives[:, i]] for i, x in enumerate((lafs0, lafs1))]
    homography = K.find_homography_dlt_iterated(*points, 1 - ratios.view(1, -1))
    assert_close(homography, torch.eye(3, device=image.device)[None], 0, 0.05)
