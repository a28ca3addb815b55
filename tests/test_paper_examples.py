"""The seven examples of Kornia's survey paper (Riba et al., 2020) with their calls as printed, and what the text says of filters.

Different are the weights of HardNet, which are random here, and the results of match_smnn, whose order is Kornia's.
"""

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

pytestmark = pytest.mark.programs


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


# -- the examples. Each begins with an image that OpenCV reads.


@pytest.fixture
def picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """picture.png in the working folder, 640x400."""
    monkeypatch.chdir(tmp_path)
    coffee = cv2.resize(skimage.data.coffee(), (640, 400))
    cv2.imwrite("picture.png", cv2.cvtColor(coffee, cv2.COLOR_RGB2BGR))


class DataAugmentationPipeline(nn.Module):
    def __init__(self, apply_color_jitter: bool = True) -> None:
        super().__init__()
        self._apply_color_jitter = apply_color_jitter
        self.transforms = nn.Sequential(
            K.augmentation.RandomVerticalFlip(p=0.5, return_transform=True),
        )
        self.jitter = K.augmentation.ColorJitter(brightness=0.2, contrast=0.2, saturation=0.2, hue=0.1)

    @torch.no_grad()
    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        x_out, trans = self.transforms(x)
        if self._apply_color_jitter:
            x_out = self.jitter(x_out)
        return x_out, trans


def test_example_1_augmentation(picture: None, device: torch.device) -> None:
    img: np.ndarray = cv2.imread("picture.png", cv2.IMREAD_COLOR)
    img_bgr: Tensor = K.image_to_tensor(img).to(device)
    img_rgb = K.bgr_to_rgb(img_bgr)
    img_rgb = K.normalize(img_rgb.float(), 0.0, 255.0)
    aug = DataAugmentationPipeline()
    img_aug, transform = aug(img_rgb)

    assert (
        transform.shape == (1, 3, 3) and img_aug.shape == (1, 3, 400, 640) and 0 <= img_aug.min() and img_aug.max() <= 1
    )
    assert not torch.equal(img_aug[0], img_rgb) and not torch.equal(img_aug[0], img_rgb.flip(1))
    upside_down = torch.tensor([[[1.0, 0, 0], [0, -1, 399], [0, 0, 1]]], device=device)
    results = [DataAugmentationPipeline(apply_color_jitter=False)(img_rgb) for _ in range(20)]
    flips = [torch.equal(matrix, upside_down) for _, matrix in results]
    assert any(flips) and not all(flips)
    for (x, matrix), flip in zip(results, flips):
        assert torch.equal(x[0], img_rgb.flip(1) if flip else img_rgb)
        assert flip or torch.equal(matrix[0], torch.eye(3, device=device))


def test_example_2_color(picture: None, device: torch.device) -> None:
    img: np.ndarray = cv2.imread("picture.png", cv2.IMREAD_COLOR)
    img_bgr: Tensor = K.image_to_tensor(img).to(device)
    img_rgb = K.bgr_to_rgb(img_bgr)
    img_rgb = K.normalize(img_rgb, 0.0, 255.0)
    img_gray = K.rgb_to_grayscale(img_rgb)

    expected = cv2.cvtColor(img.astype(np.float32) / 255, cv2.COLOR_BGR2GRAY)
    assert_close(img_gray, torch.from_numpy(expected)[None].to(device), 1e-5, 1e-5)


def test_example_3_features(picture: None, device: torch.device) -> None:
    """Two photographs of one scene, the second darker."""
    KF = K.feature
    img: np.ndarray = cv2.resize(cv2.imread("picture.png", cv2.IMREAD_GRAYSCALE), (240, 150))
    gray = K.image_to_tensor(img, keepdim=False).to(device).float() / 255
    timg_gray = torch.cat([gray, 0.6 * gray])

    PS = 32
    detector = K.ScaleSpaceDetector(
        num_features=500,  # 2000 in the paper
        resp_module=K.BlobHessian(),
        nms_module=K.ConvQuadInterp3d(10),
        scale_pyr_module=K.ScalePyramid(3, 1.6, PS, double_image=False),
        ori_module=K.LAFOrienter(19),
        aff_module=K.LAFAffineShapeEstimator(19),
        mr_size=6.0,
    ).to(device)
    descriptor = K.HardNet(pretrained=False).to(device).eval()
    with torch.no_grad():
        lafs, resps = detector(timg_gray)
        patches = K.extract_patches_from_pyramid(timg_gray, lafs, 32)
        B, N, CH, H, W = patches.size()
        descs = descriptor(patches.view(B * N, CH, H, W)).view(B, N, -1)
    scores, tentatives = K.match_smnn(descs[0], descs[1], 0.95)
    kps = KF.laf.get_laf_center(lafs)
    kps_tent1 = kps[0:1, tentatives[:, 0]]
    kps_tent2 = kps[1:2, tentatives[:, 1]]
    homography = K.find_homography_dlt_iterated(kps_tent1, kps_tent2, 1 - scores.view(1, -1))

    detected = int((resps[0] > 0).sum())
    assert (B, N, CH, H, W) == (2, 500, 1, 32, 32) and 50 < detected < 500
    assert len(tentatives) > 0.5 * detected
    assert_close(homography, torch.eye(3, device=device)[None], 0, 0.05)


def test_example_4_filters(picture: None, device: torch.device) -> None:
    img: np.ndarray = cv2.imread("picture.png", cv2.IMREAD_COLOR)
    img_bgr: Tensor = K.image_to_tensor(img, keepdim=False).to(device)
    img_rgb = K.bgr_to_rgb(img_bgr).float() / 255.0
    img_gray = K.rgb_to_grayscale(img_rgb)
    img_edge = K.sobel(img_gray)
    img_blur = K.gaussian_blur2d(img_rgb, (11, 11), (10.5, 10.5))

    gray = cv2.cvtColor(img.astype(np.float32) / 255, cv2.COLOR_BGR2GRAY)
    dx, dy = (cv2.Sobel(gray, -1, *order, borderType=cv2.BORDER_REPLICATE) / 8 for order in ((1, 0), (0, 1)))
    assert_close(img_edge[0, 0], torch.from_numpy(np.hypot(dx, dy)).to(device), 0, 1e-3)  # eps below the root
    blurred = cv2.GaussianBlur(
        img[..., ::-1].astype(np.float32) / 255, (11, 11), 10.5, borderType=cv2.BORDER_REFLECT_101
    )
    assert_close(img_blur, K.image_to_tensor(blurred, keepdim=False).to(device), 1e-4, 1e-4)


def test_example_5_geometry(picture: None, device: torch.device) -> None:
    img: np.ndarray = cv2.imread("picture.png", cv2.IMREAD_COLOR)
    img_rgb = K.bgr_to_rgb(K.image_to_tensor(img, keepdim=False).to(device)).float() / 255.0
    points_src = torch.tensor([[[125.0, 150.0], [562.0, 40.0], [562.0, 282.0], [54.0, 328.0]]], device=device)
    h, w = img_rgb.shape[-2:]
    points_dst = torch.tensor([[[0.0, 0.0], [w - 1.0, 0.0], [w - 1.0, h - 1.0], [0.0, h - 1.0]]], device=device)
    M: Tensor = K.get_perspective_transform(points_src, points_dst)
    img_warp: Tensor = K.warp_perspective(img_rgb, M, dsize=(h, w))

    matrix = cv2.getPerspectiveTransform(points_src[0].cpu().numpy(), points_dst[0].cpu().numpy())
    assert_close(M[0].cpu(), torch.from_numpy(matrix).float(), 1e-3, 1e-3)
    expected = cv2.warpPerspective(img[..., ::-1].astype(np.float32) / 255, matrix, (w, h))
    assert_close(img_warp, K.image_to_tensor(expected, keepdim=False).to(device), 0, 2e-4)


def test_example_6_losses(device: torch.device) -> None:
    predictions = torch.randn(2, 4, 12, 10, device=device, requires_grad=True)
    labels = torch.randint(4, (2, 12, 10), device=device)
    img1, img2 = (torch.rand(2, 3, 16, 14, device=device, requires_grad=True) for _ in range(2))

    focal = K.focal_loss(predictions, labels)
    dice = K.dice_loss(predictions, labels)
    tversky = K.tversky_loss(predictions, labels)
    psnr = K.psnr_loss(img1, img2)
    ssim = K.ssim_loss(img1, img2, window_size=5)

    assert focal.shape == (2, 4, 12, 10) and focal.min() >= 0
    assert 0 < dice < 1 and 0 < tversky < 1
    assert_close(psnr, 10 * (img1 - img2).square().mean().log10())
    assert 0 < ssim < 1
    for loss, leaf in (
        (focal.sum(), predictions),
        (dice, predictions),
        (tversky, predictions),
        (psnr, img1),
        (ssim, img2),
    ):
        (gradient,) = torch.autograd.grad(loss, leaf, retain_graph=True)
        assert gradient.isfinite().all() and gradient.abs().sum() > 0


def test_example_7_patches(picture: None, device: torch.device) -> None:
    img: np.ndarray = cv2.imread("picture.png", cv2.IMREAD_COLOR)
    img_bgr: Tensor = K.image_to_tensor(img, keepdim=False).to(device)
    img_rgb = K.bgr_to_rgb(img_bgr)
    img_rgb = K.normalize(img_rgb.float(), 0.0, 255.0)
    patches = K.extract_tensor_patches(img_rgb, window_size=32, stride=32)

    assert patches.shape == (1, 12 * 20, 3, 32, 32)
    assert torch.equal(patches[0, 21], img_rgb[0, :, 32:64, 32:64])
