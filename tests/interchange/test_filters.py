"""Blurs, derivatives and morphology.

Kernels and sigmas are (y, x). `border_type` is "reflect" (without the edge), "replicate", "circular" or "constant".
"""

import numpy as np
import torch

import kvision as K
from interchange.rows import chw, hwc, noise, row, same

F = K.filters
X = noise(20, 24)
BYTES = noise(40, 48, dtype=np.uint8)


@row(
    "OpenCV",
    "`GaussianBlur`: sizes and sigmas in (x, y), `BORDER_REFLECT_101`",
    '`gaussian_blur2d(x, (ky, kx), (sy, sx))`, "reflect"',
)
def test_opencv(cv2):
    assert same(cv2.GaussianBlur(X, (7, 5), 1.2, sigmaY=0.8), F.gaussian_blur2d(chw(X), (5, 7), (0.8, 1.2)))


@row(
    "OpenCV",
    "sigma 0 is made of the size: .3 ((k - 1) / 2 - 1) + .8; up to 9 taps the weights are those of a table",
    "give sigma: sizes of 11 and more agree",
)
def test_opencv_sigma(cv2):
    def gaussian(k):
        return F.get_gaussian_kernel1d(k, 0.3 * ((k - 1) / 2 - 1) + 0.8)

    assert same(cv2.getGaussianKernel(5, 0), np.float32([1, 4, 6, 4, 1]) / 16)
    assert [same(cv2.getGaussianKernel(k, 0), gaussian(k), 1e-3) for k in (3, 5, 7, 9, 11, 13)] == [False] * 4 + [
        True
    ] * 2


@row(
    "SciPy",
    '`gaussian_filter`: radius int(4 sigma + 1/2); its "reflect" repeats the edge, "mirror" does not',
    '`gaussian_blur2d(x, 2 r + 1, sigma)` is `mode="mirror"`',
)
def test_scipy(scipy):
    import scipy.ndimage

    assert same(scipy.ndimage.gaussian_filter(X, 1.2, mode="mirror"), F.gaussian_blur2d(chw(X), 11, 1.2))
    assert not same(scipy.ndimage.gaussian_filter(X, 1.2), F.gaussian_blur2d(chw(X), 11, 1.2), 0.01)


@row(
    "scikit-image",
    "`gaussian`: radius int(4 sigma + 1/2), border replicated",
    '`gaussian_blur2d(x, 2 r + 1, sigma, "replicate")`',
)
def test_skimage(skimage):
    assert same(skimage.filters.gaussian(X, 1.2), F.gaussian_blur2d(chw(X), 11, (1.2, 1.2), "replicate"))


@row(
    "Pillow",
    "`GaussianBlur(radius)`: the radius is sigma; three box blurs",
    "`gaussian_blur2d(x, 8 sigma + 1, sigma)`, to 2 levels of noise inside of the border",
)
def test_pillow(PIL):
    from PIL import Image, ImageFilter

    theirs = np.asarray(Image.fromarray(BYTES).filter(ImageFilter.GaussianBlur(2))).astype(int)
    difference = abs(theirs - hwc(F.gaussian_blur2d(chw(BYTES), 17, 2.0))[..., 0])
    assert 0 < difference[8:-8, 8:-8].max() <= 2


@row(
    "torchvision",
    '`gaussian_blur`: "reflect"; sigma of size k by default is .15 k + .35',
    "`gaussian_blur2d(x, k, sigma)`",
)
def test_torchvision(torchvision):
    from torchvision.transforms.v2 import functional as T

    assert same(T.gaussian_blur(chw(X), [5, 5]), F.gaussian_blur2d(chw(X), 5, 1.1))


@row(
    "DALI",
    "`gaussian_blur(sigma=)`: radius ceil(3 sigma), border reflected without the edge",
    "`gaussian_blur2d(x, 2 r + 1, sigma)`",
)
def test_dali(dali):
    from interchange.pipelines import run

    assert same(run(lambda fn, x: fn.gaussian_blur(x, sigma=1.2), X[..., None]), F.gaussian_blur2d(chw(X), 9, 1.2))


@row(
    "OpenCV",
    "`GaussianBlur` of bytes computes in fixed point",
    "in float32, rounded once: a level apart in some pixels",
)
def test_opencv_bytes(cv2):
    difference = abs(
        cv2.GaussianBlur(BYTES, (5, 5), 1.5).astype(int) - hwc(F.gaussian_blur2d(chw(BYTES), 5, 1.5))[..., 0]
    )
    assert difference.max() == 1 and (difference != 0).mean() < 0.2


@row(
    "OpenCV",
    "`blur` centers even windows at k // 2; of bytes, windows of 2, 4, 8, 16 come out too bright",
    "at (k - 1) // 2: `anchor=` there; rounded half to even",
)
def test_opencv_blur(cv2):
    assert same(cv2.blur(X, (4, 4), anchor=(1, 1)), F.box_blur(chw(X), 4))
    assert cv2.blur(np.full((8, 8), 255, np.uint8), (2, 1))[4, 4] == 0
    theirs = cv2.blur(BYTES, (2, 2), anchor=(0, 0)).astype(int) - hwc(F.box_blur(chw(BYTES), 2))[..., 0]
    assert set(theirs.flatten().tolist()) == {0, 1} and 0.3 < theirs.mean() < 0.45


@row("OpenCV", "`medianBlur` replicates the border", '`median_blur(x, k, "replicate")`')
def test_opencv_median(cv2):
    assert same(cv2.medianBlur(X, 5), F.median_blur(chw(X), 5, "replicate"), 0)


@row("SciPy", '`median_filter` repeats the edge ("reflect")', '`median_blur` is `mode="mirror"`')
def test_scipy_median(scipy):
    import scipy.ndimage

    assert same(scipy.ndimage.median_filter(X, 5, mode="mirror"), F.median_blur(chw(X), 5), 0)


@row("OpenCV", "`filter2D` correlates", "`filter2d`")
def test_opencv_filter(cv2):
    kernel = noise(3, 5)
    assert same(cv2.filter2D(X, -1, kernel), F.filter2d(chw(X), torch.from_numpy(kernel)[None]))


@row(
    "SciPy",
    "`convolve` flips the kernel, `correlate` does not",
    '`filter2d` correlates; `filter2d(behaviour="conv")` flips',
)
def test_scipy_convolve(scipy):
    import scipy.ndimage

    kernel = noise(3, 5)
    assert same(
        scipy.ndimage.convolve(X, kernel, mode="mirror"),
        F.filter2d(chw(X), torch.from_numpy(kernel)[None], behaviour="conv"),
    )
    assert same(scipy.ndimage.correlate(X, kernel, mode="mirror"), F.filter2d(chw(X), torch.from_numpy(kernel)[None]))


@row(
    "OpenCV",
    "`Sobel`: whole numbers, 1 2 1 by -1 0 1",
    "`spatial_gradient(normalized=False)`; normalized by 8 by default",
)
def test_opencv_sobel(cv2):
    theirs = np.stack([cv2.Sobel(X, cv2.CV_32F, *d, borderType=cv2.BORDER_REPLICATE) for d in ((1, 0), (0, 1))])
    assert same(theirs, F.spatial_gradient(chw(X), normalized=False)) and same(theirs / 8, F.spatial_gradient(chw(X)))


@row("SciPy", "`ndimage.sobel`: whole numbers, of one axis", "`spatial_gradient(normalized=False)`")
def test_scipy_sobel(scipy):
    import scipy.ndimage

    theirs = np.stack([scipy.ndimage.sobel(X, axis, mode="nearest") for axis in (1, 0)])
    assert same(theirs, F.spatial_gradient(chw(X), normalized=False))


@row(
    "scikit-image",
    "`filters.sobel`: the magnitude over 4 and the root of 2",
    "`sobel(x, eps=0)` is half of it times the root of 2",
)
def test_skimage_sobel(skimage):
    assert same(skimage.filters.sobel(X, mode="nearest") / np.sqrt(2), F.sobel(chw(X), eps=0.0))


@row("OpenCV", "`Laplacian(ksize=1)`: the cross 1 1 -4 1 1", "`filter2d` with it; `laplacian` has ones around 1 - k k")
def test_opencv_laplacian(cv2):
    cross = torch.tensor([[[0.0, 1, 0], [1, -4, 1], [0, 1, 0]]])
    assert same(cv2.Laplacian(X, cv2.CV_32F, ksize=1), F.filter2d(chw(X), cross))


@row("OpenCV", "`dilate`, `erode` leave out pixels outside", '`dilation`, `erosion`, "geodesic"')
def test_opencv_dilate(cv2):
    kernel = np.ones((3, 5), np.uint8)
    assert same(cv2.dilate(X, kernel), K.morphology.dilation(chw(X), torch.ones(3, 5)), 0)
    assert same(cv2.erode(X, kernel), K.morphology.erosion(chw(X), torch.ones(3, 5)), 0)


@row("scikit-image", "`morphology.dilation` with a footprint of ones", "`dilation`")
def test_skimage_dilation(skimage):
    assert same(skimage.morphology.dilation(X, np.ones((3, 5))), K.morphology.dilation(chw(X), torch.ones(3, 5)), 0)


@row(
    "OpenCV",
    "`distanceTransform(DIST_L2, DIST_MASK_PRECISE)`: from the center to that of the nearest 0",
    "`distance_transform(exact=True)` of the mask of zeros",
)
def test_opencv_distance(cv2):
    mask = (X > 0.03).astype(np.uint8)
    theirs = cv2.distanceTransform(mask, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    assert same(theirs, K.contrib.distance_transform(chw(1.0 - mask).float(), exact=True), 1e-3)
