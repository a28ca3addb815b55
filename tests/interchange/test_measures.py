"""Definitions of measures."""

import numpy as np
import torch

import kvision as K
from interchange.rows import chw, noise, row, same

M = K.metrics
X = noise(32, 40)
Y = np.clip(X + 0.1 * np.random.default_rng(1).standard_normal(X.shape), 0, 1).astype(np.float32)


@row(
    "scikit-image",
    "`structural_similarity`: uniform window of 7, sample covariances, mean without the border",
    "`gaussian_weights=True, sigma=1.5, use_sample_covariance=False` there is the mean of `ssim(x, y, 11)` without 5 pixels",
)
def test_skimage_ssim(skimage):
    options = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False, "data_range": 1.0}
    ours = M.ssim(chw(X), chw(Y), 11)[..., 5:-5, 5:-5].mean()
    assert same(skimage.metrics.structural_similarity(X, Y, **options), ours)
    assert not same(skimage.metrics.structural_similarity(X, Y, data_range=1.0), ours, 1e-3)


@row(
    "torchmetrics",
    "`structural_similarity_index_measure`: Gaussian of 11 and 1.5, the border mirrored and counted",
    "`ssim(x, y, 11).mean()`",
)
def test_torchmetrics_ssim(torchmetrics):
    theirs = torchmetrics.functional.image.structural_similarity_index_measure(chw(X), chw(Y), data_range=1.0)
    assert same(theirs, M.ssim(chw(X), chw(Y), 11).mean())


@row(
    "piq",
    "`ssim`: Gaussian of 11 and 1.5 without the border; larger images are halved first unless `downsample=False`",
    '`ssim(x, y, 11, padding="valid").mean()`',
)
def test_piq_ssim(piq):
    assert same(piq.ssim(chw(X), chw(Y), downsample=False), M.ssim(chw(X), chw(Y), 11, padding="valid").mean())


@row("Kornia", "`ssim_loss`: (1 - SSIM) / 2, the border mirrored and counted", "`ssim_loss`")
def test_kornia_ssim(kornia):
    assert same(kornia.losses.ssim_loss(chw(X), chw(Y), 11), K.losses.ssim_loss(chw(X), chw(Y), 11), 1e-6)
    assert same(K.losses.ssim_loss(chw(X), chw(Y), 11), (1 - M.ssim(chw(X), chw(Y), 11).mean()) / 2, 1e-6)


@row("scikit-image", "`peak_signal_noise_ratio(data_range=1)`", "`psnr(x, y, 1.)`")
def test_skimage_psnr(skimage):
    assert same(skimage.metrics.peak_signal_noise_ratio(X, Y, data_range=1), M.psnr(chw(X), chw(Y), 1.0), 1e-4)


@row("OpenCV", "`PSNR` takes 255 for the peak, of floats too", "`psnr(x, y, 255.)`")
def test_opencv_psnr(cv2):
    assert same(cv2.PSNR(X, Y), M.psnr(chw(X), chw(Y), 255.0), 1e-3)


@row("torchmetrics", "`peak_signal_noise_ratio` takes a `data_range`", "`psnr(x, y, data_range)`")
def test_torchmetrics_psnr(torchmetrics):
    assert same(
        torchmetrics.functional.image.peak_signal_noise_ratio(chw(X), chw(Y), data_range=1.0),
        M.psnr(chw(X), chw(Y), 1.0),
        1e-4,
    )


@row("torchmetrics", "`total_variation`: the sum of absolute differences", "`total_variation`")
def test_torchmetrics_total_variation(torchmetrics):
    assert same(torchmetrics.functional.image.total_variation(chw(X)), K.losses.total_variation(chw(X)), 1e-2)


@row(
    "torchmetrics",
    "`confusion_matrix(target, prediction)`: a row a target",
    "`confusion_matrix(prediction, target, n)`: a row a target",
)
def test_torchmetrics_confusion(torchmetrics):
    target, prediction = torch.tensor([[0, 0, 1, 2]]), torch.tensor([[0, 1, 1, 1]])
    theirs = torchmetrics.functional.confusion_matrix(prediction, target, task="multiclass", num_classes=3)
    assert same(theirs, M.confusion_matrix(prediction, target, 3))


@row(
    "SciPy",
    "`directed_hausdorff`, `distance.cdist`: Euclidean distances",
    "`match_nn` of descriptors: the same distances",
)
def test_scipy_distances(scipy):
    import scipy.spatial

    a, b = noise(5, 8), noise(7, 8)[::-1].copy()
    distances, _ = K.feature.match_nn(torch.from_numpy(a), torch.from_numpy(b))
    assert same(scipy.spatial.distance.cdist(a, b).min(1), distances)
