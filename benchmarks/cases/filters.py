"""The filters module: linear filters, medians and edges, of 3 to 31 pixels. Bars are the module's targets."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

import kvision
from benchmarks.case import Bars, Case, Size, nonlinear_backward, photographs
from benchmarks.peers import optional

cv2 = optional("cv2")
kornia = optional("kornia")
ndimage = optional("scipy.ndimage")
skfeature, skfilters, skrestoration = (optional(f"skimage.{m}") for m in ("feature", "filters", "restoration"))
ImageFilter = optional("PIL.ImageFilter")
tvision = optional("torchvision.transforms.functional")

linear = partial(Bars, backward=1.3)


def case(name: str, call: Callable[..., Any], bars: Bars, peers: dict[str, Callable[..., Any]], **more: Any) -> Case:
    """A case whose `call(library, input)` is the same for kvision and Kornia."""
    return Case(name, partial(call, kvision), {"kornia": partial(call, kornia), **peers}, bars, **more)


# -- derivatives


def sobel_opencv(x, out=None, gx=None, gy=None):
    gx, gy = gradient_opencv(x, (gx, gy))
    return cv2.magnitude(gx, gy, out), gx, gy


def gradient_opencv(x, out=(None, None)):
    def along(dx, dy, out):
        return cv2.Sobel(x, cv2.CV_32F, dx, dy, out, ksize=3, scale=0.125, borderType=cv2.BORDER_REPLICATE)

    return [along(1, 0, out[0]), along(0, 1, out[1])]


def gradient_scipy(x):
    def along(axis):  # ndimage.sobel would smooth across the channels too
        edge = ndimage.correlate1d(x, (-0.125, 0, 0.125), axis, mode="nearest")
        return ndimage.correlate1d(edge, (1, 2, 1), 1 - axis, mode="nearest")

    return [along(1), along(0)]


def sobel_scipy(x):
    return np.hypot(*gradient_scipy(x))


def sobel_skimage(x):
    return np.stack([skfilters.sobel(plane, mode="nearest") for plane in np.moveaxis(x, -1, 0)], -1) * 0.5**0.5


def sobel_pil(image):
    smooth, edge = (1, 2, 1), (-1, 0, 1)
    taps_x, taps_y = [e * s for s in smooth for e in edge], [e * s for e in edge for s in smooth]
    gx, gy = (image.filter(ImageFilter.Kernel((3, 3), taps, 8, 128)) for taps in (taps_x, taps_y))
    return np.hypot(np.asarray(gx, np.float32) - 128, np.asarray(gy, np.float32) - 128) / 255


def without_eps(magnitude: Tensor) -> Tensor:
    """The magnitude of the other libraries, which have no eps under the root."""
    return (magnitude.square() - 1e-6).clamp(min=0).sqrt()


def laplacian_opencv(x, out=None):
    return cv2.filter2D(x, -1, LAPLACIAN, out, borderType=cv2.BORDER_REFLECT_101)


LAPLACIAN = np.ones((3, 3), np.float32) / 16
LAPLACIAN[1, 1] = -0.5


# -- smoothing


def box(size: int, bars: Bars) -> Case:
    peers = {
        "opencv": lambda x, out=None: cv2.blur(x, (size, size), out, borderType=cv2.BORDER_REFLECT_101),
        "scipy": lambda x: ndimage.uniform_filter(x, size, mode="mirror", axes=(0, 1)),
        "pil": lambda image: image.filter(ImageFilter.BoxBlur(size // 2)),
    }
    return case(f"box{size}", lambda K, x: K.filters.box_blur(x, size), bars, peers, border=size // 2)


def gauss(size: int, sigma: float, bars: Bars) -> Case:
    ksize, sigmas, radius = (size, size), (sigma, sigma), size // 2
    peers = {
        "torchvision": lambda x: tvision.gaussian_blur(x, list(ksize), list(sigmas)),
        "opencv": lambda x, out=None: cv2.GaussianBlur(x, ksize, sigma, out, sigma, cv2.BORDER_REFLECT_101),
        "skimage": lambda x: skfilters.gaussian(x, sigma, mode="mirror", truncate=radius / sigma, channel_axis=-1),
        "scipy": lambda x: ndimage.gaussian_filter(x, sigma, mode="mirror", radius=radius, axes=(0, 1)),
        "pil": lambda image: image.filter(ImageFilter.GaussianBlur(sigma)),
    }
    return case(f"gauss{size}", lambda K, x: K.filters.gaussian_blur2d(x, ksize, sigmas), bars, peers, border=radius)


def unsharp_opencv(x, out=None, blurred=None):
    blurred = cv2.GaussianBlur(x, (5, 5), 1.5, blurred, 1.5, cv2.BORDER_REFLECT_101)
    return cv2.addWeighted(x, 2, blurred, -1, 0, out), blurred


def unsharp_scipy(x):
    return 2 * x - ndimage.gaussian_filter(x, 1.5, mode="mirror", radius=2, axes=(0, 1))


def median(size: int, bars: Bars) -> Case:
    peers = {
        "opencv": lambda x, out=None: cv2.medianBlur(x, size, out),
        "skimage": lambda x: skfilters.median(x, np.ones((size, size, 1)), mode="mirror"),
        "scipy": lambda x: ndimage.median_filter(x, size, mode="mirror", axes=(0, 1)),
        "pil": lambda image: image.filter(ImageFilter.MedianFilter(size)),
    }
    more = {"backward": nonlinear_backward, "border": size // 2}
    return case(f"median{size}", lambda K, x: K.filters.median_blur(x, size), bars, peers, **more)


# -- edges


def canny_opencv(x, out=None, gray=None, gray8=None, blurred=None):
    """Canny by OpenCV from the same float image. Its edge detector takes 8 bits, so the later steps do too."""
    gray = cv2.cvtColor(x, cv2.COLOR_RGB2GRAY, gray)
    gray8 = cv2.convertScaleAbs(gray, gray8, 255)
    blurred = cv2.GaussianBlur(gray8, (5, 5), 1, blurred, 1, cv2.BORDER_REFLECT_101)
    return cv2.Canny(blurred, 25.5, 51, out, 3, L2gradient=True), gray, gray8, blurred


def canny_skimage(x):
    return skfeature.canny(x @ np.float32([0.299, 0.587, 0.114]), 1, 0.1, 0.2).astype(np.float32)


# -- any kernel


def any_kernel(name: str, size: int, bars: Bars, shared: bool = True) -> Case:
    """One kernel of full rank for all images, or one for each image."""

    def inputs(images: Size, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, ...]:
        kernel = torch.rand(1 if shared else images[0], size, size, generator=torch.Generator().manual_seed(1))
        return (*photographs(images, dtype, device), (kernel / kernel.sum((1, 2), keepdim=True)).to(device, dtype))

    one_for_all = {
        "opencv": lambda x, k, out=None: cv2.filter2D(x, -1, k, out, borderType=cv2.BORDER_REFLECT_101),
        "scipy": lambda x, k: ndimage.correlate(x, k, mode="mirror", axes=(0, 1)),
    }
    more = {"inputs": inputs, "border": size // 2}
    return case(name, lambda K, x, k: K.filters.filter2d(x, k), bars, one_for_all if shared else {}, **more)


CASES = [
    case(
        "sobel",
        lambda K, x: K.filters.sobel(x),
        Bars(floor=1.25, both=1.4, half=1.7, opencv=0.5),
        {"opencv": sobel_opencv, "skimage": sobel_skimage, "scipy": sobel_scipy, "pil": sobel_pil},
        result=without_eps,
        backward=nonlinear_backward,
    ),
    case(
        "spatial_gradient",
        lambda K, x: K.filters.spatial_gradient(x),
        linear(floor=1.25, half=1.7),
        {"opencv": gradient_opencv, "scipy": gradient_scipy},
    ),
    case(
        "laplacian3",
        lambda K, x: K.filters.laplacian(x, 3),
        linear(floor=1.2, half=1.7, opencv=1.0),
        {
            "opencv": laplacian_opencv,
            "scipy": lambda x: ndimage.correlate(x, LAPLACIAN, mode="mirror", axes=(0, 1)),
        },
    ),
    box(5, linear(floor=1.2, half=1.7, opencv=1.0)),
    box(31, linear(floor=1.6, opencv=1.0)),
    gauss(5, 1.5, linear(floor=1.2, half=1.7, opencv=1.0)),
    gauss(11, 2.0, linear(floor=1.35, half=1.7, opencv=1.0)),
    gauss(31, 5.0, linear(floor=2.5, opencv=1.0)),
    case(
        "unsharp5",
        lambda K, x: K.filters.unsharp_mask(x, (5, 5), (1.5, 1.5)),
        linear(floor=1.3, half=1.7),
        {
            "opencv": unsharp_opencv,
            # channel_axis=-1 would filter the first three rows only (scikit-image 0.26)
            "skimage": lambda x: skfilters.unsharp_mask(x, 1.5, 1, preserve_range=True, channel_axis=2),
            "scipy": unsharp_scipy,
            "pil": lambda image: image.filter(ImageFilter.UnsharpMask(1.5, 100, 0)),
        },
        border=2,
    ),
    median(3, Bars(floor=1.5, opencv=1.0)),
    median(5, Bars(floor=5.0, opencv=1.0)),
    case(
        "bilateral5",
        lambda K, x: K.filters.bilateral_blur(x, (5, 5), 0.1, (1.5, 1.5)),
        Bars(floor=3.0, opencv=1.0),
        {
            # d=5 is a disc of 13 pixels in OpenCV and a square of 25 in the others
            "opencv": lambda x, out=None: cv2.bilateralFilter(x, 5, 0.1, 1.5, out, cv2.BORDER_REFLECT_101),
            "skimage": lambda x: skrestoration.denoise_bilateral(x, 5, 0.1, 1.5, mode="symmetric", channel_axis=-1),
        },
        backward=nonlinear_backward,
        border=2,
    ),
    case(
        "canny",
        lambda K, x: K.filters.canny(x),
        Bars(floor=10.0, launches=None, opencv=1.0),
        {"opencv": canny_opencv, "skimage": canny_skimage},
        result=lambda outputs: outputs[1],
        backward=nonlinear_backward,
        border=3,
    ),
    any_kernel("filter2d_3x3", 3, linear(opencv=1.0)),
    any_kernel("filter2d_5x5", 5, linear(floor=1.6, opencv=1.0)),
    any_kernel("filter2d_11x11", 11, linear()),
    any_kernel("filter2d_5x5_each", 5, linear(), shared=False),
]
